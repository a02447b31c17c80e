"""The coordinates of a hypothesis: which there are, their priors, and where fits begin.

Coordinates have standard priors.  The cascade is unchanged when tau and tau_v swap places, so they
hold the two by size: ``ln shorter <= ln longer - .3``.  Whose each is the binned campaign says.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import exp, inf

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

FASTER = 0.3
"""the shorter lag is below the longer by at least this in the logarithm"""
WIDE = 100.0
"""step heights; spread of the priors of y0 and beta"""
LOOSER = 30.0
"""factor on the spread of the prior of an amplitude that it holds back"""


@dataclass(frozen=True)
class Part:
    """An effect in one of its forms."""

    effect: Effect
    form: Form


@dataclass(frozen=True, eq=False)
class CoordinatePriors:
    """The coordinates of a hypothesis and their priors.

    Order: the three shared ones; the shared strengths; then per experiment y0, beta, t0, tf
    (where there is a fall) and its own strengths.
    """

    binned: BinnedCampaign
    parts: tuple[Part, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    """strengths (by name) that are not fitted but held at a value"""
    loose: frozenset[str] = frozenset()
    """strengths (by name) whose spreads are :data:`LOOSER` times the stated ones in
    :attr:`own_prior_matrix`"""

    @cached_property
    def strengths(self) -> list[list[Strength]]:
        """Per part, its strengths scaled to the campaign."""
        return [list(part.form.strengths(self.binned.settings[0])) for part in self.parts]

    @cached_property
    def shared(self) -> list[Strength]:
        """Strengths that all experiments share and that are fitted."""
        return [
            s for part in self.strengths for s in part
            if not s.per_experiment and s.name not in self.held
        ]  # fmt: skip

    @cached_property
    def own(self) -> list[Strength]:
        """Strengths that every experiment has for itself and that are fitted."""
        return [
            s for part in self.strengths for s in part
            if s.per_experiment and s.name not in self.held
        ]  # fmt: skip

    @property
    def n_ordered(self) -> int:
        """How many of the first coordinates hold one lag below another: 1, or none.

        The cascade is unchanged when two lags swap places, so the shorter one is kept the shorter.
        """
        return 1

    def at_limit(self, x: FloatArray) -> bool:
        """Whether the shorter lag is as long as it may be, so that its coordinate does not move."""
        return bool(x[0] <= 0.0)

    @property
    def places_of_tau(self) -> tuple[int, int]:
        """Coordinates of the logarithm of tau: the second less the first where tau is the shorter
        lag, else the second."""
        return 0, 1

    @property
    def tau_is_difference(self) -> float:
        """1 where the logarithm of tau is the second of these less the first, else 0."""
        return 1.0 - self.binned.sensor

    def tau_of(self, x: FloatArray) -> float:
        """s, the sensor's lag."""
        return self.lags_of(x)[self.binned.sensor]

    def lags_of(self, x: FloatArray) -> tuple[float, float]:
        """s, the shorter and the longer of tau and tau_v."""
        return exp(max(x[1] - FASTER - x[0], -60.0)), exp(x[1])

    def logarithms(self, x: FloatArray) -> FloatArray:
        """(n_shared,) logarithms of the rig's parameters, as their priors have them."""
        return np.log([*self.lags_of(x), exp(x[2])])

    def bent(self, before: FloatArray, after: FloatArray) -> float:
        """s, by which the shorter lag gains more than is linear in its coordinates."""
        lag, by = before[1] - FASTER - before[0], (after[1] - before[1]) - (after[0] - before[0])
        return float(exp(max(lag, -60.0)) * (exp(by) - 1.0 - by))

    @cached_property
    def local(self) -> list[int]:
        """First coordinate of each experiment, and one after the last."""
        return self.binned.local(self.first_strength + len(self.shared), len(self.own))

    @property
    def first_strength(self) -> int:
        """First coordinate of the shared strengths."""
        return self.binned.n_shared

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.local[-1]

    @cached_property
    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Means and precisions (n,) of the coordinates.

        The first coordinate's prior is that of the shorter lag given the longer and enters through
        :meth:`prior_matrix`.  y0, beta, t0 and tf have priors so wide that they only matter for an
        experiment that does not show its step.
        """
        mean, precision = np.zeros(self.size), np.zeros(self.size)
        first = self.first_strength
        known = slice(self.n_ordered, first)
        mean[known] = self.binned.centre[known]
        precision[known] = 1.0 / self.binned.sd[known] ** 2
        precision[first : first + len(self.shared)] = 1.0
        n = len(self.own)
        for k, (at, end) in enumerate(itertools.pairwise(self.binned.local(first))):
            m = end - at
            here = slice(self.local[k], self.local[k] + m)
            mean[here] = self.binned.base[at:end]
            wide = [WIDE * self.binned.signal_scale] * 2 + [self.binned.duration] * (m - 2)
            precision[here] = 1.0 / np.array(wide) ** 2
            precision[self.local[k + 1] - n : self.local[k + 1]] = 1.0
        return mean, precision

    def prior_matrix(self, widths: FloatArray | None = None) -> FloatArray:
        """(n, n) precision of the prior; ``widths`` (n,) scale the strengths' spreads."""
        _, precision = self.prior
        widths = np.ones(self.size) if widths is None else widths
        matrix = np.diag(precision / widths**2)
        if self.n_ordered:
            tau = 1.0 / self.binned.sd[0] ** 2
            # the logarithm of the shorter lag is x1 - FASTER - x0
            matrix[0, 0] += tau
            matrix[1, 1] += tau
            matrix[0, 1] -= tau
            matrix[1, 0] -= tau
        for index, alike in self._alike:
            # the inverse of (1 - alike) I + alike 1 1', in units of the spreads
            n = len(index)
            inverse = np.eye(n) - alike / (1.0 + (n - 1.0) * alike)
            spread = np.outer(widths[index], widths[index])
            matrix[np.ix_(index, index)] = inverse / (1.0 - alike) / spread
        return matrix

    def log_prior_determinant(self, widths: FloatArray) -> float:
        """ln of the determinant of :meth:`prior_matrix`."""
        _, precision = self.prior
        proper = precision > 0
        total = np.sum(np.log((precision / widths**2)[proper]))
        if self.n_ordered:
            total -= 2.0 * np.log(self.binned.sd[0])
        for index, alike in self._alike:
            n = len(index)
            total -= (n - 1) * np.log1p(-alike) + np.log1p((n - 1) * alike)
        return float(total)

    @cached_property
    def _alike(self) -> list[tuple[NDArray[np.int64], float]]:
        """Coordinates and correlation of every own strength that experiments have alike."""
        n = len(self.own)
        return [
            (np.array([end - n + i for end in self.local[1:]], dtype=np.int64), s.alike)
            for i, s in enumerate(self.own)
            if s.alike > 0.0
        ]

    @cached_property
    def own_prior_matrix(self) -> FloatArray:
        """(n, n) precision of the prior at the stated spreads, those of :attr:`loose` aside."""
        return self.prior_matrix(self.widths(dict.fromkeys(self.loose, LOOSER)))

    def widths(self, factors: Mapping[str, float]) -> FloatArray:
        """(n,) factors on the spreads of strengths, by name; 1 for all other coordinates."""
        made = np.ones(self.size)
        for fitted in self._fitted:
            for _, s, at in fitted:
                made[at] = factors.get(s.name, 1.0)
        return made

    @cached_property
    def amplitudes(self) -> dict[str, NDArray[np.int64]]:
        """Coordinates of every fitted amplitude, by name."""
        found: dict[str, set[int]] = {}
        for fitted in self._fitted:
            for _, s, at in fitted:
                if s.scaled:
                    found.setdefault(s.name, set()).add(at)
        return {name: np.array(sorted(here), dtype=np.int64) for name, here in found.items()}

    @cached_property
    def prior_centre(self) -> FloatArray:
        """(n,) where the prior is highest."""
        mean, _ = self.prior
        centre = mean.copy()
        if self.n_ordered:
            centre[0] = centre[1] - FASTER - self.binned.centre[0]
        return centre

    @cached_property
    def _fitted(self) -> list[list[tuple[int, Strength, int]]]:
        """Per experiment, every fitted strength: its part, itself and its coordinate."""
        made = []
        for k in range(len(self.binned.bins)):
            i, j = self.first_strength, self.local[k + 1] - len(self.own)
            found = []
            for part, strengths in enumerate(self.strengths):
                for s in strengths:
                    if s.name in self.held:
                        continue
                    if s.per_experiment:
                        found.append((part, s, j))
                        j += 1
                    else:
                        found.append((part, s, i))
                        i += 1
            made.append(found)
        return made

    def values(self, x: FloatArray, k: int) -> list[dict[str, float]]:
        """Per part, the strengths of experiment ``k``."""
        found = [part.copy() for part in self._given]
        for part, s, at in self._fitted[k]:
            found[part][s.name] = s.value(float(x[at]))
        return found

    @cached_property
    def _given(self) -> list[dict[str, float]]:
        # per part, the strengths that are held, and zeros in place of the fitted ones
        return [{s.name: self.held.get(s.name, 0.0) for s in part} for part in self.strengths]

    def start(self, base: FloatArray, chosen: Mapping[str, float]) -> FloatArray:
        """Coordinates from the base fit's, strengths at ``chosen`` or at their centres.

        Strengths whose name ends in ``*`` in ``chosen`` are in units of the time scale, those of
        volts in units of the step's height.
        """
        x = np.zeros(self.size)
        first = at = self.first_strength
        x[:first] = base[:first]
        n = len(self.own)
        time, scales = self.binned.time_scale, {"V": self.binned.height}

        def begin(s: Strength) -> float:
            if f"{s.name}*" in chosen:
                return s.coordinate(chosen[f"{s.name}*"] * scales.get(s.unit, time))
            return s.coordinate(chosen[s.name]) if s.name in chosen else 0.0

        for i, s in enumerate(self.shared):
            x[first + i] = begin(s)
        for k, m in enumerate(self.binned.own_sizes):
            x[self.local[k] : self.local[k] + m] = base[at : at + m]
            at += m
            for i, s in enumerate(self.own):
                x[self.local[k + 1] - n + i] = begin(s)
        return x

    @cached_property
    def _falls(self) -> NDArray[np.bool_]:
        return np.array([e.has_fall for e in self.binned.campaign])

    def columns(self, k: int) -> NDArray[np.int64]:
        """Coordinates that experiment ``k`` depends on."""
        return self._columns[k]

    @cached_property
    def _columns(self) -> list[NDArray[np.int64]]:
        shared = np.arange(self.first_strength + len(self.shared))
        return [
            np.concatenate([shared, np.arange(a, b)]) for a, b in itertools.pairwise(self.local)
        ]

    @cached_property
    def steps(self) -> FloatArray:
        """(n,) steps of the derivatives."""
        steps = np.full(self.size, 0.02)
        steps[: self.first_strength] = 1e-3
        steps[: self.n_ordered] = 0.01
        for at, m in zip(self.local, self.binned.own_sizes, strict=False):
            steps[at : at + 2] = 1e-3 * self.binned.height
            steps[at + 2 : at + m] = 1e-3 * self.binned.time_scale
        return steps

    @cached_property
    def longest_steps(self) -> FloatArray:
        """(n,) how far one iteration may go: logarithms by 1, switch times by a time scale."""
        most = np.full(self.size, 1.5)
        most[: self.first_strength] = 0.7
        most[: self.n_ordered] = 2.0
        for at, m in zip(self.local, self.binned.own_sizes, strict=False):
            most[at : at + 2] = 10.0 * self.binned.signal_scale
            most[at + 2 : at + m] = self.binned.time_scale
        return most

    @cached_property
    def lowest(self) -> FloatArray:
        """(n,) what coordinates may not go below.

        The shorter lag stays the shorter, and normal strengths at or above their lower limits.
        """
        least = np.full(self.size, -inf)
        least[: self.n_ordered] = 0.0
        for fitted in self._fitted:
            for _, s, at in fitted:
                if s.kind == "normal" and s.limits[0] > -inf:
                    least[at] = (s.limits[0] - s.centre) / s.sd
        return least

    @cached_property
    def switch_times(self) -> NDArray[np.int64]:
        """Coordinates t0 and tf of all experiments."""
        found = [
            np.arange(at + 2, at + m)
            for at, m in zip(self.local, self.binned.own_sizes, strict=False)
        ]
        return np.concatenate(found).astype(np.int64)

    def switches_of(self, k: int, falling: bool) -> NDArray[np.int64]:
        """Coordinates that move the switches up, or down, of experiment ``k``."""
        moves = {
            self.local[k] + 2 + int(j)
            for j, s in zip(self.binned.moved_by(k), self.binned.bins[k].switches, strict=True)
            if (s.height < 0.0) == falling
        }
        return np.array(sorted(moves), dtype=np.int64)

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """(n_experiments, n_columns) coordinate of every column of :meth:`derivatives`, or -1."""
        found = np.full((len(self._columns), max(map(len, self._columns))), -1, dtype=np.int64)
        for row, columns in zip(found, self._columns, strict=True):
            row[: len(columns)] = columns
        return found

    def start_from(self, old: CoordinatePriors, fitted: FloatArray) -> FloatArray:
        """Coordinates from a fit ``fitted`` (n,) of those of ``old``, which has one part less."""
        x = self.start(fitted, {})  # the shared ones; the local ones follow another layout
        first, n_shared, n_own = self.first_strength, len(old.shared), len(old.own)
        x[first : first + n_shared] = fitted[first : first + n_shared]
        for k, m in enumerate(self.binned.own_sizes):
            here, there = self.local[k], old.local[k]
            x[here : here + m + n_own] = fitted[there : there + m + n_own]
        return x

    def with_strengths(self, x: FloatArray, chosen: Mapping[str, float]) -> FloatArray:
        """``x`` (n,) with the last part's strengths at chosen values."""
        base = self.start(np.zeros(self.size), chosen)
        made = x.copy()
        last = {s.name for s in self.strengths[-1]}
        first = self.first_strength
        for i, s in enumerate(self.shared):
            if s.name in last:
                made[first + i] = base[first + i]
        n = len(self.own)
        for end, (i, s) in itertools.product(self.local[1:], enumerate(self.own)):
            if s.name in last:
                made[end - n + i] = base[end - n + i]
        return made

    def with_tau(self, x: FloatArray, log_tau: float) -> FloatArray:
        """``x`` (n,) with another shorter lag, tau unless the sensor's is the longer one.

        ``log_tau``: its logarithm (of s).  A lag delays the response by itself, so that what it
        gains the switch times lose.
        """
        made = x.copy()
        made[0] = max(float(x[1]) - FASTER - log_tau, 0.0)
        made[self.switch_times] -= exp(x[1] - FASTER - made[0]) - exp(x[1] - FASTER - x[0])
        return made
