"""The coordinates of a hypothesis: what a refit may move, its priors, and the means that follow.

Coordinates have standard priors.  The cascade is unchanged when tau and tau_v swap places, so they
hold the two by size: ``ln shorter <= ln longer - .3``.  Whose each is the sketch says.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import exp, inf

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import SHARED, Sketch
from bayes_sensor.diagnosis.effects.effect import (
    Effect,
    Form,
    RigView,
    Setting,
    Strength,
    check_settings,
)
from bayes_sensor.rig.perturbed import (
    BETA,
    CONCENTRATION,
    FIRST,
    INDEX,
    MIDDLE,
    NEUTRAL,
    START,
    T0,
    TAU,
    TAU_M,
    TAU_V,
    TF,
    Y0,
    campaign_means,
    moved_means,
    rig_mean,
    rig_response,
)

FASTER = 0.3
"""the shorter lag is below the longer by at least this in the logarithm"""
WIDE = 100.0
"""step heights; spread of the priors of y0 and beta"""
LOOSER = 30.0
"""factor on the spread of the prior of an amplitude that it holds back"""


@lru_cache(maxsize=1)
def coating_modes() -> tuple[FloatArray, FloatArray]:
    """Shares (6,) and time constants (6,) over the time to 63.2 % of the published coating."""
    from bayes_sensor.coating import Coating, reduced

    modes = reduced(Coating()).with_tau63(1.0)
    return np.array(modes.amplitude), 1.0 / np.array(modes.rate)


@dataclass(frozen=True)
class Part:
    """An effect in one of its forms."""

    effect: Effect
    form: Form


@dataclass(frozen=True, eq=False)
class Plan:
    """The coordinates of a hypothesis.

    Order: the three shared ones; the shared strengths; then per experiment y0, beta, t0, tf
    (where there is a fall) and its own strengths.
    """

    sketch: Sketch
    parts: tuple[Part, ...] = ()
    held: Mapping[str, float] = field(default_factory=dict)
    """strengths (by name) that are not fitted but held at a value"""
    loose: frozenset[str] = frozenset()
    """strengths (by name) whose spreads are :data:`LOOSER` times the stated ones in
    :attr:`own_prior_matrix`"""

    @cached_property
    def strengths(self) -> list[list[Strength]]:
        """Per part, its strengths scaled to the campaign."""
        return [list(part.form.strengths(self.sketch.settings[0])) for part in self.parts]

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

    @cached_property
    def local(self) -> list[int]:
        """First coordinate of each experiment, and one after the last."""
        return self.sketch.local(SHARED + len(self.shared), len(self.own))

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
        mean[1:3] = self.sketch.centre[1:]
        precision[1:3] = 1.0 / self.sketch.sd[1:] ** 2
        precision[SHARED : SHARED + len(self.shared)] = 1.0
        n = len(self.own)
        for k, (at, end) in enumerate(itertools.pairwise(self.sketch.local(SHARED))):
            m = end - at
            here = slice(self.local[k], self.local[k] + m)
            mean[here] = self.sketch.base[at:end]
            wide = [WIDE * self.sketch.signal_scale] * 2 + [self.sketch.duration] * (m - 2)
            precision[here] = 1.0 / np.array(wide) ** 2
            precision[self.local[k + 1] - n : self.local[k + 1]] = 1.0
        return mean, precision

    def prior_matrix(self, widths: FloatArray | None = None) -> FloatArray:
        """(n, n) precision of the prior; ``widths`` (n,) scale the strengths' spreads."""
        _, precision = self.prior
        widths = np.ones(self.size) if widths is None else widths
        matrix = np.diag(precision / widths**2)
        tau = 1.0 / self.sketch.sd[0] ** 2
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
        total = np.sum(np.log((precision / widths**2)[proper])) - 2.0 * np.log(self.sketch.sd[0])
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
        centre[0] = centre[1] - FASTER - self.sketch.centre[0]
        return centre

    @cached_property
    def _fitted(self) -> list[list[tuple[int, Strength, int]]]:
        """Per experiment, every fitted strength: its part, itself and its coordinate."""
        made = []
        for k in range(len(self.sketch.bins)):
            i, j = SHARED, self.local[k + 1] - len(self.own)
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
        x[:SHARED] = base[:SHARED]
        at = SHARED
        n = len(self.own)
        time, scales = self.sketch.time_scale, {"V": self.sketch.height}

        def begin(s: Strength) -> float:
            if f"{s.name}*" in chosen:
                return s.coordinate(chosen[f"{s.name}*"] * scales.get(s.unit, time))
            return s.coordinate(chosen[s.name]) if s.name in chosen else 0.0

        for i, s in enumerate(self.shared):
            x[SHARED + i] = begin(s)
        for k, e in enumerate(self.sketch.campaign):
            m = 4 if e.has_fall else 3
            x[self.local[k] : self.local[k] + m] = base[at : at + m]
            at += m
            for i, s in enumerate(self.own):
                x[self.local[k + 1] - n + i] = begin(s)
        return x

    def mean(self, x: FloatArray, k: int, times: FloatArray | None = None) -> FloatArray:
        """V (n_times,), the mean of experiment ``k`` at sorted ``times`` (default: the bins')."""
        p, own = self.rig(x, k)
        at = self.sketch.bins[k].times if times is None else times
        if own is None:
            return np.asarray(rig_mean(at, p, *coating_modes()))
        form, values = own
        return self._own_mean(at, p, form, values, self.sketch.settings[k])

    def _own_mean(
        self,
        at: FloatArray,
        p: FloatArray,
        form: Form,
        values: Mapping[str, float],
        setting: Setting,
    ) -> FloatArray:
        here = replace(setting, t0=float(p[T0]), tf=min(float(p[TF]), setting.tf + 1e6))

        def changed(settings: Mapping[str, float]) -> FloatArray:
            check_settings("user's own", settings)
            q = p.copy()
            for name, value in settings.items():
                q[FIRST + INDEX[name]] = value
            return q

        view = RigView(
            here, float(p[Y0]), float(p[BETA]),
            lambda t, s: np.asarray(rig_mean(t, changed(s), *coating_modes())),
            lambda t, s: np.asarray(rig_response(t, changed(s), *coating_modes())),
        )  # fmt: skip
        assert form.mean is not None
        try:
            made = np.asarray(form.mean(at, values, view), dtype=float)
        except CampaignError:
            raise
        except Exception as error:  # whatever the user's code raises is the user's to see
            raise CampaignError(
                f"an own effect's function stops with {type(error).__name__}: {error}; expected "
                f"the voltage at each of the {len(at)} times it is given, from the strengths "
                f"{', '.join(values)}: correct it"
            ) from error
        if made.shape != at.shape:
            raise CampaignError(
                f"an own effect's function returned shape {made.shape}; expected {at.shape}, the "
                "voltage at each time it is given: correct it"
            )
        return made

    def rig(
        self, x: FloatArray, k: int
    ) -> tuple[FloatArray, tuple[Form, Mapping[str, float]] | None]:
        """The kernel's parameters for experiment ``k``, and a user's own mean if there is one."""
        at = self.local[k]
        p = self._fixed[k].copy()
        shorter, longer = self._slots
        p[shorter], p[longer], volume = _lags(*x[:SHARED].tolist())
        p[TAU_M] = volume / self._flows[k]
        m = 4 if self._falls[k] else 3
        p[Y0 : Y0 + m] = x[at : at + m]
        return p, self._set(p, self.values(x, k), k) if self.parts else None

    def _set(
        self, p: FloatArray, strengths: Sequence[Mapping[str, float]], k: int
    ) -> tuple[Form, Mapping[str, float]] | None:
        # the settings of ``p`` that go with the parts' strengths; a user's own mean is returned
        own, setting = None, self.sketch.settings[k]
        for part, values in zip(self.parts, strengths, strict=True):
            for name, value in part.form.settings(values, setting).items():
                p[FIRST + INDEX[name]] = value
            if part.form.mean is not None:
                own = (part.form, values)
        return own

    @cached_property
    def _slots(self) -> tuple[int, int]:
        # the kernel's parameters that are the shorter and the longer lag
        return (TAU_V, TAU) if self.sketch.sensor else (TAU, TAU_V)

    @cached_property
    def _flows(self) -> FloatArray:
        return np.array([e.total_flow for e in self.sketch.campaign])

    @cached_property
    def _falls(self) -> NDArray[np.bool_]:
        return np.array([e.has_fall for e in self.sketch.campaign])

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        # (n_experiments,) coordinate y0 of each
        return np.array(self.local[:-1], dtype=np.int64)

    @cached_property
    def _fixed(self) -> FloatArray:
        # (n_experiments, n_parameters) the kernel's parameters that no coordinate changes
        found = np.zeros((len(self.sketch.bins), FIRST + len(NEUTRAL)))
        found[:, FIRST:] = NEUTRAL
        found[:, TF] = 1e30
        for p, e in zip(found, self.sketch.campaign, strict=True):
            p[CONCENTRATION] = e.concentration
            p[START] = e.t[0] - 0.5 * e.interval
            p[MIDDLE] = 0.5 * (e.t[0] + e.t[-1])
        return found

    def binned(self, x: FloatArray, k: int) -> FloatArray:
        """V (n_bins,), mean of each bin of experiment ``k``."""
        if self.own_mean:
            return self.sketch.bins[k].reduce(self.mean(x, k))
        p, _ = self.rig(x, k)
        made: FloatArray = campaign_means(*self.sketch.bins[k].alone, p[None], *coating_modes())
        return made

    def means(self, x: FloatArray) -> list[FloatArray]:
        """V (n_bins,) of every experiment, mean of each of its bins."""
        made = self.all_means(x)
        return [made[rows] for rows in self.sketch.rows]

    def all_means(self, x: FloatArray) -> FloatArray:
        """V (n_bins in all,), the same of all experiments, one after the other."""
        if self.own_mean:
            return np.concatenate([self.binned(x, k) for k in range(len(self.sketch.bins))])
        made: FloatArray = campaign_means(*self.sketch.all_bins, self._rigs(x), *coating_modes())
        return made

    @cached_property
    def own_mean(self) -> bool:
        """Whether a form gives the mean voltage itself, as a user's own may."""
        return any(part.form.mean is not None for part in self.parts)

    def _rigs(self, x: FloatArray) -> FloatArray:
        """(n_experiments, n_parameters) of the kernel."""
        rigs = self._fixed.copy()
        shorter, longer = self._slots
        rigs[:, shorter], rigs[:, longer], volume = _lags(*x[:SHARED].tolist())
        rigs[:, TAU_M] = volume / self._flows
        first = self._first
        for i, name in enumerate((Y0, BETA, T0)):
            rigs[:, name] = x[first + i]
        rigs[self._falls, TF] = x[first[self._falls] + 3]
        strengths = self.values(x, 0) if self.parts else []
        for k in range(len(rigs)) if self.parts else ():
            if k and self.own:
                strengths = self.values(x, k)
            self._set(rigs[k], strengths, k)
        return rigs

    def columns(self, k: int) -> NDArray[np.int64]:
        """Coordinates that experiment ``k`` depends on."""
        return self._columns[k]

    @cached_property
    def _columns(self) -> list[NDArray[np.int64]]:
        shared = np.arange(SHARED + len(self.shared))
        return [
            np.concatenate([shared, np.arange(a, b)]) for a, b in itertools.pairwise(self.local)
        ]

    @cached_property
    def steps(self) -> FloatArray:
        """(n,) steps of the derivatives."""
        steps = np.full(self.size, 0.02)
        steps[0] = 0.01
        steps[1:SHARED] = 1e-3
        for k, e in enumerate(self.sketch.campaign):
            at = self.local[k]
            steps[at : at + 2] = 1e-3 * self.sketch.height
            steps[at + 2 : at + (4 if e.has_fall else 3)] = 1e-3 * self.sketch.time_scale
        return steps

    @cached_property
    def longest_steps(self) -> FloatArray:
        """(n,) how far one iteration may go: logarithms by 1, switch times by a time scale."""
        most = np.full(self.size, 1.5)
        most[:SHARED] = (2.0, 0.7, 0.7)
        for k, fall in enumerate(self._falls):
            at = self.local[k]
            most[at : at + 2] = 10.0 * self.sketch.signal_scale
            most[at + 2 : at + (4 if fall else 3)] = self.sketch.time_scale
        return most

    @cached_property
    def lowest(self) -> FloatArray:
        """(n,) what coordinates may not go below.

        The shorter lag stays the shorter, and normal strengths at or above their lower limits.
        """
        least = np.full(self.size, -inf)
        least[0] = 0.0
        for fitted in self._fitted:
            for _, s, at in fitted:
                if s.kind == "normal" and s.limits[0] > -inf:
                    least[at] = (s.limits[0] - s.centre) / s.sd
        return least

    @cached_property
    def switch_times(self) -> NDArray[np.int64]:
        """Coordinates t0 and tf of all experiments."""
        found = []
        for at, fall in zip(self.local[:-1], self._falls, strict=True):
            found += [at + 2, at + 3] if fall else [at + 2]
        return np.array(found, dtype=np.int64)

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """(n_experiments, n_columns) coordinate of every column of :meth:`derivatives`, or -1."""
        found = np.full((len(self._columns), max(map(len, self._columns))), -1, dtype=np.int64)
        for row, columns in zip(found, self._columns, strict=True):
            row[: len(columns)] = columns
        return found

    def derivatives(self, x: FloatArray, here: FloatArray, finer: float = 1.0) -> FloatArray:
        """(n_bins in all, n_columns) whitened derivatives of the bins' means, which are ``here`` V.

        By every coordinate that an experiment depends on, see :attr:`places`.  ``finer``: factor on
        the steps of the differences.
        """
        steps = finer * self.steps
        if self.own_mean:
            means = self._moved_own_means(x, steps)
        else:
            means = moved_means(
                *self.sketch.all_bins, self._moved(x, steps), self._of_rigs, *coating_modes()
            )
        return self.sketch.whitened((means - here[:, None]) / (finer * self._steps_by_bin))

    @cached_property
    def _steps_by_bin(self) -> FloatArray:
        # (n_bins in all, n_columns); infinite where an experiment has fewer columns than others
        by_experiment = np.where(self.places < 0, inf, self.steps[self.places])
        return np.repeat(by_experiment, [len(d) for d in self.sketch.data], axis=0)

    def _moved_own_means(self, x: FloatArray, steps: FloatArray) -> FloatArray:
        means = np.zeros((self.sketch.n_bins, self.places.shape[1]))
        moved = np.array(x)
        for k, rows in enumerate(self.sketch.rows):
            for i, c in enumerate(self._columns[k]):
                moved[c] += steps[c]
                means[rows, i] = self.binned(moved, k)
                moved[c] = x[c]
        return means

    @cached_property
    def _of_rigs(self) -> NDArray[np.int64]:
        # (n_experiments + 1,) first row of each in what :meth:`_moved` makes, and their number
        return np.cumsum([0, *(1 + len(columns) for columns in self._columns)])

    def _moved(self, x: FloatArray, steps: FloatArray) -> FloatArray:
        """(n_rows, n_parameters): every experiment's rig, and with each coordinate moved."""
        n = SHARED + len(self.shared)
        first = self._of_rigs[:-1]
        rigs = np.repeat(self._rigs(x), np.diff(self._of_rigs), axis=0)
        (x0, x1, x2), (h0, h1, h2) = x[:SHARED].tolist(), steps[:SHARED].tolist()
        shorter, longer = self._slots
        rigs[first + 1, shorter], _, _ = _lags(x0 + h0, x1, x2)
        rigs[first + 2, shorter], rigs[first + 2, longer], _ = _lags(x0, x1 + h1, x2)
        rigs[first + 3, TAU_M] = _lags(x0, x1, x2 + h2)[2] / self._flows
        moved = x + steps
        for i, name in enumerate((Y0, BETA, T0)):
            rigs[first + 1 + n + i, name] = moved[self._first + i]
        rigs[first[self._falls] + 4 + n, TF] = moved[self._first[self._falls] + 3]
        for k, fitted in enumerate(self._fitted):
            if not fitted:
                continue
            strengths = self.values(x, k)
            for part, s, c in fitted:
                row = first[k] + 1 + (c if c < n else n + c - self.local[k])
                here = strengths[part][s.name]
                strengths[part][s.name] = s.value(float(moved[c]))
                rigs[row, FIRST:] = NEUTRAL  # what depends on strengths is theirs to say
                self._set(rigs[row], strengths, k)
                strengths[part][s.name] = here
        return rigs


def _lags(x0: float, x1: float, x2: float) -> tuple[float, float, float]:
    # s, the shorter and the longer lag, and V mL, of the shared coordinates, kept within what the
    # kernel can bear
    return exp(max(x1 - FASTER - x0, -60.0)), exp(min(x1, 40.0)), exp(min(x2, 60.0))
