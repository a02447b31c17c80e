"""The swarm's search space, and a first guess."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.block_averages import Points, SwitchSeries, profiles
from bayes_sensor.fit.first_estimates import Look
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import response
from bayes_sensor.rig.layout import Layout


def limits(layout: Layout, box: Mapping[str, tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    """Bounds as (n,) arrays over the mean's and the extra parameters."""
    pairs = np.array([box[name] for name in layout.mean_names + list(layout.extra)])
    return pairs[:, 0].copy(), pairs[:, 1].copy()


@dataclass(frozen=True, eq=False)
class SwarmProblem:
    """The sum of squares in the swarm's coordinates: logarithms of the shared parameters, then of
    each record its switch times or, for a programme of more than one pulse, one delay.

    The best y0 and beta follow from them.
    """

    problem: Problem
    points: Points

    @cached_property
    def _moves(self) -> list[tuple[NDArray[np.int64], FloatArray]]:
        """Of each experiment, by switch time or delay: (n,) the place in z of what moves it, and
        (n,) s what is added to that."""
        found, known = [], {}
        n, layout = self.problem.layout.n_shared, self.problem.layout
        for e, record, switching in zip(
            self.problem.campaign, layout.records, layout.switching, strict=True
        ):
            n_names = len(switching.names)
            if record not in known:
                n_own = n_names if switching.is_pulse else 1
                known[record] = np.resize(np.arange(n, n + n_own), n_names)
                n += n_own
            origin, done = np.zeros(n_names), e.commands
            if done is not None and not done.recorded and done.delays == "free":
                origin = done.times  # which move together here, by one delay
            found.append((known[record], origin))
        return found

    @cached_property
    def n(self) -> int:
        """How many coordinates there are."""
        return 1 + int(max(places[-1] for places, _ in self._moves))

    @cached_property
    def _series(self) -> SwitchSeries:
        switching = self.problem.layout.switching
        moves, offsets = [], []
        for each, (places, origin) in zip(switching, self._moves, strict=True):
            moves.append(places[each.places])
            offsets.append(origin[each.places] + each.offsets)
        return SwitchSeries(
            np.cumsum([0, *map(len, moves)]), np.concatenate(moves), np.concatenate(offsets),
            np.concatenate([each.heights for each in switching]),
            np.array([each.rest for each in switching]),
        )  # fmt: skip

    @property
    def searchable(self) -> bool:
        """Whether a swarm may search: the compiled sum of squares knows switches only."""
        return all(each.recorded is None for each in self.problem.layout.switching)

    def _lags(self, Z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, n_exp, n_lags) s and the delays of the stages (n, n_exp) s at positions (n, n_z)."""
        layout = self.problem.layout
        shared = np.exp(Z[:, : layout.n_shared])
        lags, delays = [], []
        for k, e in enumerate(self.problem.campaign):
            values, rig = shared[:, layout.shared[k]].T, layout.rigs[k]
            lags.append(rig.taus(values, e.total_flow).T)
            delays.append(np.broadcast_to(rig.delay(values, e.total_flow), len(Z)))
        return np.ascontiguousarray(np.stack(lags, axis=1)), np.stack(delays, axis=1)

    def cost(self, Z: FloatArray) -> FloatArray:
        """(n,) V^2 at positions (n, n_z)."""
        linear = np.empty((len(self.problem.campaign), 2))
        return self._profiles(Z, linear)

    def _profiles(self, Z: FloatArray, linear: FloatArray) -> FloatArray:
        Z = np.ascontiguousarray(Z)
        return profiles(Z, *self._lags(Z), self._series, *self.points, linear)

    def theta(self, z: FloatArray) -> FloatArray:
        """(n_mean,) parameters at one position (n_z,)."""
        layout = self.problem.layout
        theta = np.empty(layout.n_mean)
        theta[: layout.n_shared] = np.exp(z[: layout.n_shared])
        for k, (places, origin) in enumerate(self._moves):
            theta[layout.switches(k)] = origin + z[places]
        linear = np.empty((len(self.problem.campaign), 2))
        if self.searchable:
            self._profiles(z[None], linear)
        else:
            linear = self._linear(theta)
        theta[layout.local[:, :2]] = linear
        return theta

    def _linear(self, theta: FloatArray) -> FloatArray:
        """(n_exp, 2) best y0 and beta for the response at theta."""
        found, points = [], self.points
        for k, e in enumerate(self.problem.campaign):
            part = slice(points.first[k], points.first[k + 1])
            x = response(points.t[part], theta, self.problem.layout, k, e.total_flow)
            w, y = np.sqrt(points.weight[part]), points.y[part]
            A = np.stack([w, w * x], axis=1)
            found.append(np.linalg.lstsq(A, w * y, rcond=None)[0])
        return np.array(found)

    def box(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Limits (n_z,) of the coordinates, from those of the mean's parameters."""
        layout = self.problem.layout
        z_low, z_high = np.full(self.n, -np.inf), np.full(self.n, np.inf)
        n = layout.n_shared
        z_low[:n] = np.log(np.maximum(low[:n], 1e-300))
        z_high[:n] = np.log(high[:n])
        for k, (places, origin) in enumerate(self._moves):
            np.maximum.at(z_low, places, low[layout.switches(k)] - origin)
            np.minimum.at(z_high, places, high[layout.switches(k)] - origin)
        return z_low, z_high

    def guess(
        self, looks: list[Look], rise: float, low: FloatArray, high: FloatArray
    ) -> FloatArray:
        """A start from the records (n_mean,): the shortest lag is a small share of the rise, the
        others a third each; the whole rise where there is one lag."""
        layout = self.problem.layout
        z_low, z_high = self.box(low, high)
        z = np.empty(self.n)
        flow = float(np.median([e.total_flow for e in self.problem.campaign]))
        alone = layout.rig.n_lags == 1
        for i, name in enumerate(layout.shared_names):
            share = 0.03 if i == 0 and not alone and layout.one_sensor else 1.0 / 3.0
            z[i] = log(share * rise * (flow if name.startswith("V_") else 1.0))
        for k, look in enumerate(looks):
            switching, (places, _) = layout.switching[k], self._moves[k]
            half = 0.5 * (look.rise or rise)
            if switching.is_pulse:
                z[places] = [look.start_by - half, look.end_by - half][: len(places)]
            elif switching.recorded is not None:
                z[places] = 0.0
            else:
                z[places] = max(look.start_by - half - look.on, 0.0)
        return self.theta(np.clip(z, z_low, z_high))
