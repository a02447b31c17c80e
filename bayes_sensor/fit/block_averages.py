"""Weighted points that represent the samples, and the sum of squares on them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.fit.first_estimates import Look, typical_rise
from bayes_sensor.rig.partial_fractions import partial_fractions, quick_step_response, sorted_apart


class Points(NamedTuple):
    """Weighted points that represent the samples; all experiments in a row."""

    first: NDArray[np.int64]  # (n_exp + 1,)
    t: FloatArray
    weight: FloatArray  # how many samples the point stands for
    y: FloatArray


def joined(parts: list[tuple[FloatArray, FloatArray, FloatArray]]) -> Points:
    first = np.concatenate([[0], np.cumsum([len(part[0]) for part in parts])]).astype(np.int64)
    t, count, y = (np.concatenate([part[i] for part in parts]) for i in range(3))
    return Points(first, t, count, y)


def scatter(campaign: Campaign, points: Points) -> float:
    """Sum of squares inside the averages, which no mean can explain, V^2."""
    total = 0.0
    for k, e in enumerate(campaign):
        part = slice(points.first[k], points.first[k + 1])
        y = e.values[e.used]
        origin = float(y.mean())
        within = np.sum((y - origin) ** 2) - points.weight[part] @ (points.y[part] - origin) ** 2
        total += max(float(within), 0.0)
    return total


def averages(campaign: Campaign, looks: list[Look], per_rise: int, most: int) -> Points:
    """Means over stretches: ``per_rise`` to a rise time around the switches, few elsewhere."""
    usual = typical_rise(looks, 0.0)
    parts = []
    for e, look in zip(campaign, looks):
        rise = look.rise or usual or 0.1 * (look.off - look.on)
        first, last = float(e.t[0]), float(e.t[-1]) + e.interval
        edges = [first]
        for low, high in look.stretches:
            if low > edges[-1]:
                edges += list(np.linspace(edges[-1], low, 9)[1:])
            high = min(high + 4.0 * rise, last)
            width = max(rise / per_rise, (high - low) / most, e.interval)
            edges += list(np.arange(max(low, edges[-1]), high, width)[1:])
        edges += list(np.linspace(edges[-1], last, 17)[1:])
        index = np.unique(np.searchsorted(e.t, np.array(edges) - 1e-9 * e.interval))
        index = index[index < len(e.t)]
        weight = e.used.astype(float)
        count = np.add.reduceat(weight, index)
        total = np.add.reduceat(np.where(e.used, e.values, 0.0), index)
        times = np.add.reduceat(weight * e.t, index)
        keep = count > 0
        parts.append((times[keep] / count[keep], count[keep], total[keep] / count[keep]))
    return joined(parts)


class SwitchSeries(NamedTuple):
    """How positions of the swarm become the switches of all experiments."""

    first: NDArray[np.int64]  # (n_exp + 1,) of the switches, all experiments in a row
    moves: NDArray[np.int64]  # (n_switches,) place in z of what moves each
    offset: FloatArray  # (n_switches,) s, what is added to it
    height: FloatArray  # (n_switches,)
    rest: FloatArray  # (n_exp,) input before them


@compiled()
def _profile(
    z: Any, lags: Any, delays: Any, series: Any, first: Any, t: Any, count: Any, y: Any, linear: Any
) -> float:
    # Sum of squares at z = (.., switch times) for lags (n_exp, n_lags) s and delays of the stages
    # (n_exp,) s with the best y0 and beta, which are left in linear (n_exp, 2).
    taus, c = np.empty(lags.shape[1]), np.empty(lags.shape[1])
    total = 0.0
    for k in range(len(lags)):
        for j in range(len(taus)):
            taus[j] = lags[k, j]
        sorted_apart(taus)
        partial_fractions(taus, c)
        begin, end = series.first[k], series.first[k + 1]
        over = 30.0 * taus[-1]
        done, level = begin, series.rest[k]
        n = sx = sxx = sy = sxy = syy = 0.0
        origin = y[first[k]]
        for i in range(first[k], first[k + 1]):
            # switches whose response is over need no exponential again
            now = t[i] - delays[k]
            while done < end and now - z[series.moves[done]] - series.offset[done] > over:
                level += series.height[done]
                done += 1
            x = level
            for e in range(done, end):
                s = now - z[series.moves[e]] - series.offset[e]
                if s > 0.0:
                    x += series.height[e] * quick_step_response(s, taus, c)
                elif end - begin > 2:
                    break  # commands in order; two free switches may cross
            w = count[i]
            d = y[i] - origin
            n += w
            sx += w * x
            sxx += w * x * x
            sy += w * d
            sxy += w * x * d
            syy += w * d * d
        vxx = sxx - sx * sx / n
        vxy = sxy - sx * sy / n
        beta = vxy / vxx if vxx > 1e-9 * n else 0.0
        linear[k, 0] = origin + (sy - beta * sx) / n
        linear[k, 1] = beta
        total += syy - sy * sy / n - beta * vxy
    return total


@compiled()
def profiles(
    Z: Any, lags: Any, delays: Any, series: Any, first: Any, t: Any, count: Any, y: Any, linear: Any
) -> FloatArray:
    costs = np.empty(len(Z))
    for i in range(len(Z)):
        costs[i] = _profile(Z[i], lags[i], delays[i], series, first, t, count, y, linear)
    return costs
