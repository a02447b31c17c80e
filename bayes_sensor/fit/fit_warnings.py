"""Warnings of a fit: search bounds reached, steps not visible, records not described."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.fit.first_estimates import Look, typical_rise
from bayes_sensor.fit.identifiability import step_error
from bayes_sensor.likelihood.noise import scale_squared
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.named_values import unit_of
from bayes_sensor.rig.switching import is_switch_time

LAGS_TO_SETTLE = 3.0
"""lags after which a signal has all but settled: exp(-3) is 5 % of the step"""


def local_noise(z: FloatArray, used: NDArray[np.bool_]) -> tuple[float, float]:
    """Variance and lag-one coefficient of the fast part of residuals ``z`` (n_t,).

    An AR(1)'s autocovariance differences give both: g0 - g1 = v (1 - phi), g1 - g2 = v phi (1 -
    phi).  Slow parts, such as a misfit of the mean, cancel in the differences. Medians over
    sections of the record also remove spikes.
    """
    n_sections = int(np.clip(len(z) // 200, 1, 40))
    size = len(z) // n_sections
    halves = []
    for start in range(0, n_sections * size, size):
        part, keep = z[start : start + size], used[start : start + size]
        one = keep[1:] & keep[:-1]
        two = keep[2:] & keep[:-2]
        if min(one.sum(), two.sum()) >= 10:
            halves.append(
                (
                    0.5 * np.mean((part[1:] - part[:-1])[one] ** 2),
                    0.5 * np.mean((part[2:] - part[:-2])[two] ** 2),
                )
            )
    if not halves:
        return float(np.mean(z[used] ** 2)), 0.0
    half1, half2 = (float(v) for v in np.median(halves, axis=0))
    if half1 <= 0.0:
        return 0.0, 0.0
    phi = min(max((half2 - half1) / half1, -0.99), 0.999)
    return half1 / (1.0 - phi), phi


def _lack_of_fit(
    e: Experiment, r: FloatArray, scale: FloatArray, rise: float, n_experiments: int
) -> tuple[float, float]:
    """(largest, share): largest misfit of the mean in V, and the ratio of the misfits to the noise.

    Means of r/s over stretches of a quarter of the rise are compared with the means that noise like
    the residuals' fast part would give.  ``share`` is the ratio of their mean square to that, or 0
    where chance explains it (level 1e-3 over all experiments, with a factor 1.5 because AR(1) noise
    is an approximation).
    """
    size = max(int(rise / 4.0 / e.interval), 8)
    n = len(r) // size
    if n < 8:
        size = max(len(r) // 8, 1)
        n = len(r) // size
    z = np.where(e.used, r / scale, 0.0)
    variance, phi = local_noise(z, e.used)
    count = e.used[: n * size].reshape(n, size).sum(axis=1)
    full = count >= 0.5 * size
    if full.sum() < 8 or variance <= 0.0:
        return 0.0, 0.0
    means = z[: n * size].reshape(n, size).sum(axis=1)[full] / count[full]
    # variance of a mean of m AR(1) values (e.g. Priestley 1981, eq. 5.3.5)
    m = count[full].astype(float)
    expected = variance / m * ((1 + phi) / (1 - phi) - 2 * phi * (1 - phi**m) / m / (1 - phi) ** 2)
    if phi > 0.95:
        # smooth noise: its correlation cannot be read off neighbours; the blocks' usual scatter can
        expected = np.full(len(means), (1.4826 * float(np.median(np.abs(means)))) ** 2)
        if expected[0] <= 0.0:
            return 0.0, 0.0
    ratio = means**2 / expected
    total = float(ratio.mean())
    level = 1e-3 / n_experiments
    worst = chdtri(1, level / len(ratio))
    if total > 1.5 * chdtri(len(ratio), level) / len(ratio) or ratio.max() > 1.5 * worst:
        volts = means * np.sqrt(np.mean(scale[e.used] ** 2))
        return float(np.abs(volts).max()), max(total, float(ratio.max()) / worst)
    return 0.0, 0.0


def warn(
    problem: Problem,
    vector: FloatArray,
    residuals: list[tuple[FloatArray, FloatArray]],
    looks: list[Look],
    unit: str,
) -> list[str]:
    campaign, layout = problem.campaign, problem.layout
    warnings = []
    if problem.commuting.flow is not None:
        if layout.is_published:
            who = "the sensor's tau, the valve's tau_v and the manifold's V/Q"
        else:
            names = [name.rsplit("_", 1)[0] for name in problem.commuting.names]
            who = " and ".join(f"{name}/Q" if name.startswith("V") else name for name in names)
        warnings.append(
            f"There is one total flow only: {who} enter alike and cannot be told apart by the "
            "data; only the set of lags is determined."
        )
    slowest = [layout.slowest(vector, k, e.total_flow) for k, e in enumerate(campaign)]
    moving = [
        e.name
        for e, look, lag in zip(campaign, looks, slowest)
        if not look.settled or (look.late and look.off - look.on < LAGS_TO_SETTLE * lag)
    ]
    if moving:
        warnings.append(
            f"Experiment{'s' if len(moving) > 1 else ''} {', '.join(repr(n) for n in moving)}: the "
            "signal still moves when the step ends, so slow lags and the step's height cannot be "
            "told apart; record longer steps."
        )
    lengths = [len(e.t) * e.interval for e in campaign]
    usual = typical_rise(looks, 0.1 * float(np.median(lengths)))
    for k, e in enumerate(campaign):
        r, x = residuals[k]
        _, sigma0, sigma1 = vector[layout.noise[k]]
        law = problem.noise.weight(campaign, e), problem.noise.fading
        scale = np.sqrt(scale_squared(x, sigma0, sigma1, *law))
        beta = abs(vector[layout.local[k, 1]])
        error = step_error(e, r, x)
        if beta <= 3.0 * error:
            warnings.append(
                f"Experiment '{e.name}': the step ({beta:.2g} {unit}) is not visible above its own "
                f"error ({error:.2g} {unit}); its switch times mean little."
            )
            continue
        miss, share = _lack_of_fit(e, r, scale, looks[k].rise or usual, len(campaign))
        if share > 0.0 and miss > 0.005 * beta:
            # a fit that is wrong altogether may have next to no step
            percent = 100.0 * miss / max(beta, abs(looks[k].step), miss)
            digits = 0 if percent >= 10.0 else 1
            warnings.append(
                f"Experiment '{e.name}': the model does not describe the trace everywhere; it "
                f"misses by up to {miss:.2g} {unit} ({percent:.{digits}f} % of the step), more "
                "than AR(1) noise explains, unless the noise is another."
            )
    return warnings


def at_bounds(
    layout: Layout, vector: FloatArray, box: Mapping[str, tuple[float, float]]
) -> list[str]:
    names = []
    for name, (low, high) in box.items():
        value = float(vector[layout.index(name)])
        width = min(high - low, 1e3 * max(abs(value), 1e-9))
        near = 1e-6 * width
        if value - low <= near or high - value <= near:
            names.append(name)
    return names


def unseen_lags(
    at_bound: Sequence[str],
    vector: FloatArray,
    layout: Layout,
    box: Mapping[str, tuple[float, float]],
    given: Container[str],
) -> list[str]:
    """Flat names of lags, and V, at the lower end of a search range that was not ``given``: the
    data show no effect of them."""
    found = []
    for name in at_bound:
        low, high = box[name]
        value = vector[layout.index(name)]
        if name in layout.shared_names and name not in given and value - low < high - value:
            found.append(name)
    return found


def bound_warnings(
    at_bound: list[str],
    box: Mapping[str, tuple[float, float]],
    vector: FloatArray,
    layout: Layout,
    unit: str,
    labels: Mapping[str, str],
    unseen: Sequence[str],
) -> list[str]:
    """A sentence for every estimate at a search bound.

    ``labels``: by flat name of theta's places, the name that may be stated for each lag;
    ``unseen``: the lags and V that are too small to be seen.
    """
    sentences = []
    for name in at_bound:
        low, high = box[name]
        lower = vector[layout.index(name)] - low < high - vector[layout.index(name)]
        if name in unseen:
            word = OF_LAGS.get(labels[name], labels[name])
            sentences.append(
                f"least squares cannot tell {word} from zero: these data give an upper limit "
                "only; see the posterior's limits."
            )
        elif is_switch_time(name.partition("[")[0]) and lower:
            what = "fall" if name.startswith("tf_s") else "response"
            sentences.append(
                f"{name} is at its lower bound ({low:.10g} s, the commanded time or the earliest "
                f"that was tried): the {what} seems to begin no later than the command. Check "
                "that time: one written too late makes tau too small."
            )
        else:
            side, own = "lower" if lower else "upper", unit_of(name.partition("[")[0], unit)
            digits = 10 if own == "s" else 6  # clocks may show anything
            sentences.append(
                f"{labels.get(name, name)} is at its {side} bound "
                f"({low if lower else high:.{digits}g} {own}): what lies beyond was not looked "
                "for, so distrust it; check flows and times, or give fit_least_squares other "
                "bounds."
            )
    return sentences


OF_LAGS = {
    "tau_s": "tau",
    "tau_v_s": "tau_v",
    "V_mL": "V",
    "lag_fast_s": "the shorter lag",
    "lag_between_s": "the middle lag",
    "lag_slow_s": "the longer lag",
}
"""words for the names of theta's first three values"""
