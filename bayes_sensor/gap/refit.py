"""Refits of the binned campaign under a hypothesis: the model, with none, one or more effects.

Levenberg-Marquardt in coordinates with standard priors, on whitened bin means.  The cascade is
unchanged when tau and tau_v swap places, so the sensor is taken to be the faster one:
``ln tau <= ln tau_v - .3``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import exp, inf, isfinite, log

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.gap.bins import AllBins, ExperimentBins
from bayes_sensor.gap.effect import Effect, Form, RigView, Setting, Strength, check_settings
from bayes_sensor.gap.floor import Floor
from bayes_sensor.gap.rig import (
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
from bayes_sensor.gap.squares import carry_on, normal_equations, whiten

FASTER = 0.3
"""the sensor's time constant is below the valve's by at least this in the logarithm"""
SHARED = 3
"""coordinates shared by all experiments: ln tau_v - ln tau - FASTER, ln tau_v, ln V"""
NUISANCE_SD = {"tau": 1.0, "tau_v": 0.7, "V": 0.3}
"""sd of the logarithms around plausible values"""
WIDE = 100.0
"""step heights; spread of the priors of y0 and beta"""
STRAIGHT = 0.25
"""share of the promised gain that a step must make for the derivatives to be carried on"""
ALIKE = 0.5
"""distance, squared and in standard deviations, below which two optima are taken for one"""
PATIENCE, FAR = 4, 60.0
"""steps after which a refit that expects to end so far above another one is given up"""
FINER = 0.01
"""factor on the differences' steps where the usual ones lead nowhere"""
BEYOND, HELD_BACK, LOOSER = 3.0, 1.0, 30.0
"""spreads of its prior that an amplitude must have, and standard deviations, squared, by which that
prior must pull it, to be sought again; the factor on the prior's spread then"""
TAU_OVER_TAU_V = 0.07
"""plausible ratio of the sensor's to the valve's time constant"""


@lru_cache(maxsize=1)
def coating_modes() -> tuple[FloatArray, FloatArray]:
    """Shares (6,) and time constants (6,) over the time to 63.2 % of the published coating."""
    from bayes_sensor.diffusion import Coating, reduced

    modes = reduced(Coating()).with_tau63(1.0)
    return np.array(modes.amplitude), 1.0 / np.array(modes.rate)


@dataclass(frozen=True, eq=False)
class Sketch:
    """A campaign in bins, with its noise floor and the priors of the nuisance parameters."""

    campaign: Campaign
    bins: tuple[ExperimentBins, ...]
    data: tuple[FloatArray, ...]
    """(n_bins,) V, mean of each bin"""
    floor: Floor
    base: FloatArray
    """coordinates of the fit without effects"""
    centre: FloatArray
    """(3,) prior means of ln tau, ln tau_v, ln V"""
    sd: FloatArray
    """(3,) their prior sds"""
    time_scale: float
    """s, of the slower of valve and manifold"""
    signal_scale: float
    """V, median step height"""
    reference_flow: float
    """mL/s, median total flow"""
    duration: float
    """s, median length of a record"""
    given_before: tuple[float, ...] | None = None
    """concentrations before each experiment where the campaign does not tell: some are left out"""

    @cached_property
    def inverse_factors(self) -> tuple[FloatArray, ...]:
        """Inverses of the floor's Cholesky factors."""
        return tuple(np.asarray(np.linalg.inv(c), dtype=float) for c in self.floor.cholesky)

    @cached_property
    def n_bins(self) -> int:
        """Bins in all experiments."""
        return sum(len(d) for d in self.data)

    @cached_property
    def all_bins(self) -> AllBins:
        """The bins of all experiments, one after the other."""
        return AllBins.of(self.bins)

    @cached_property
    def _flat_factors(self) -> FloatArray:
        return np.concatenate([factor.ravel() for factor in self.inverse_factors])

    def whitened(self, differences: FloatArray) -> FloatArray:
        """Differences V (n_bins in all,) or (n_bins in all, m) over the floor."""
        made: FloatArray = whiten(self._flat_factors, self.all_bins.of_bins, differences)
        return made

    @cached_property
    def rows(self) -> list[slice]:
        """Where each experiment's bins stand in a vector over all."""
        ends = np.cumsum([0] + [len(d) for d in self.data])
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    @property
    def concentrations_before(self) -> tuple[float, ...]:
        """Of the experiment that was run before each, be it in the sketch or not."""
        return self.given_before or self.campaign.concentrations_before

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """What effects may know of every experiment, switch times from the fit without effects."""
        plan = Plan(self)
        found = []
        for k, e in enumerate(self.campaign):
            at = plan.local[k]
            found.append(
                Setting(
                    experiment=e,
                    t0=float(self.base[at + 2]),
                    tf=float(self.base[at + 3]) if e.has_fall else float(e.t[-1]),
                    time_scale=self.time_scale,
                    reference_flow=self.reference_flow,
                    signal_scale=self.signal_scale,
                    duration=self.duration,
                    concentration_before=self.concentrations_before[k],
                )
            )
        return tuple(found)

    def restricted(self, keep: Sequence[NDArray[np.bool_]]) -> Sketch:
        """The sketch with only some bins (n_bins,) of every experiment.

        An experiment without any is left out, with its coordinates.
        """
        stay = [k for k, mask in enumerate(keep) if np.any(mask)]
        factors = []
        for k in stay:
            covariance = self.floor.cholesky[k] @ self.floor.cholesky[k].T
            kept = covariance[np.ix_(keep[k], keep[k])]
            factors.append(np.asarray(np.linalg.cholesky(kept), dtype=float))
        experiments = tuple(self.campaign.experiments[k] for k in stay)
        return replace(
            self,
            campaign=replace(self.campaign, experiments=experiments),
            bins=tuple(self.bins[k].restricted(keep[k]) for k in stay),
            data=tuple(self.data[k][keep[k]] for k in stay),
            floor=replace(
                self.floor,
                cholesky=tuple(factors),
                density=self.floor.density[stay],
                loudness=tuple(self.floor.loudness[k][keep[k]] for k in stay),
            ),
            base=self.local_coordinates(self.base, stay),
            given_before=tuple(self.concentrations_before[k] for k in stay),
        )

    def local_coordinates(self, x: FloatArray, stay: Sequence[int], own: int = 0) -> FloatArray:
        """Coordinates ``x`` without those of the experiments that do not stay.

        ``own``: strengths that every experiment has for itself.
        """
        sizes = [(4 if e.has_fall else 3) + own for e in self.campaign]
        first = len(x) - sum(sizes)
        at = first + np.cumsum([0, *sizes])
        return np.concatenate([x[:first], *(x[at[k] : at[k] + sizes[k]] for k in stay)])


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
        """First coordinate of each experiment."""
        at = SHARED + len(self.shared)
        found = []
        for e in self.sketch.campaign:
            found.append(at)
            at += (4 if e.has_fall else 3) + len(self.own)
        return [*found, at]

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.local[-1]

    @cached_property
    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Means and precisions (n,) of the coordinates.

        The first coordinate's prior is that of ln tau given ln tau_v and enters through
        :meth:`prior_matrix`.  y0, beta, t0 and tf have priors so wide that they only matter for an
        experiment that does not show its step.
        """
        mean, precision = np.zeros(self.size), np.zeros(self.size)
        mean[1:3] = self.sketch.centre[1:]
        precision[1:3] = 1.0 / self.sketch.sd[1:] ** 2
        precision[SHARED : SHARED + len(self.shared)] = 1.0
        n = len(self.own)
        at = SHARED
        for k, fall in enumerate(self._falls):
            m = 4 if fall else 3
            here = slice(self.local[k], self.local[k] + m)
            mean[here] = self.sketch.base[at : at + m]
            wide = [WIDE * self.sketch.signal_scale] * 2 + [self.sketch.duration] * (m - 2)
            precision[here] = 1.0 / np.array(wide) ** 2
            precision[self.local[k + 1] - n : self.local[k + 1]] = 1.0
            at += m
        return mean, precision

    def prior_matrix(self, widths: FloatArray | None = None) -> FloatArray:
        """(n, n) precision of the prior; ``widths`` (n,) scale the strengths' spreads."""
        _, precision = self.prior
        widths = np.ones(self.size) if widths is None else widths
        matrix = np.diag(precision / widths**2)
        tau = 1.0 / self.sketch.sd[0] ** 2
        # ln tau = x1 - FASTER - x0
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

        Strengths whose name ends in ``*`` in ``chosen`` are in units of the time scale.
        """
        x = np.zeros(self.size)
        x[:SHARED] = base[:SHARED]
        at = SHARED
        n = len(self.own)
        given = {
            name.rstrip("*"): value * (self.sketch.time_scale if name.endswith("*") else 1.0)
            for name, value in chosen.items()
        }

        def begin(s: Strength) -> float:
            return s.coordinate(given[s.name]) if s.name in given else 0.0

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
        p[TAU], p[TAU_V], volume = _lags(*x[:SHARED].tolist())
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
        rigs[:, TAU], rigs[:, TAU_V], volume = _lags(*x[:SHARED].tolist())
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
            steps[at : at + 2] = 1e-3 * self.sketch.signal_scale
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

        The sensor stays the faster lag, and normal strengths at or above their lower limits.
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
        rigs[first + 1, TAU], _, _ = _lags(x0 + h0, x1, x2)
        rigs[first + 2, TAU], rigs[first + 2, TAU_V], _ = _lags(x0, x1 + h1, x2)
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
    # tau s, tau_v s and V mL of the shared coordinates, kept within what the kernel can bear
    return exp(max(x1 - FASTER - x0, -60.0)), exp(min(x1, 40.0)), exp(min(x2, 60.0))


@dataclass(frozen=True, eq=False)
class Refit:
    """The optimum of one hypothesis, with its linearisation."""

    plan: Plan
    x: FloatArray
    residual: FloatArray
    """(n_bins in all,) whitened"""
    objective: float
    """residual'residual + prior"""
    converged: bool

    @property
    def misfit(self) -> float:
        """Q, squared whitened residual."""
        return float(self.residual @ self.residual)

    @cached_property
    def derivatives(self) -> FloatArray:
        """(n_bins in all, n_columns) :meth:`Plan.derivatives`, worked out when asked for.

        Always by the usual differences, which smooth over the bins' nodes: evidences rest on them.
        """
        return self.plan.derivatives(self.x, self.plan.all_means(self.x))

    @cached_property
    def jacobian(self) -> FloatArray:
        """(n_bins in all, n) dense."""
        made = np.zeros((len(self.residual), self.plan.size))
        for k, rows in enumerate(self.plan.sketch.rows):
            columns = self.plan.columns(k)
            made[rows, columns] = self.derivatives[rows, : len(columns)]
        return made

    @property
    def normal(self) -> FloatArray:
        """(n, n) normal matrix, of the data and of the priors at their stated spreads."""
        made: FloatArray = self.jacobian.T @ self.jacobian + self.plan.own_prior_matrix
        return made

    @cached_property
    def loosened(self) -> Refit:
        """The refit with wider priors for those amplitudes that theirs hold back.

        An amplitude far beyond its plausible size is pulled back by its prior, by a small share of
        itself that may be many standard deviations: a trace of the effect stays in the residual,
        and other parameters make up for the rest of it.
        """
        loose = self.plan.loose | self._held_back()
        if loose == self.plan.loose:
            return self
        return refit(replace(self.plan, loose=loose), self.x, most_steps=60)

    def _held_back(self) -> set[str]:
        away, prior = self.x - self.plan.prior_centre, self.plan.own_prior_matrix
        far = [
            (name, here)
            for name, here in self.plan.amplitudes.items()
            if np.mean(away[here] ** 2) >= BEYOND**2
        ]
        if not far:  # as a rule; the covariance is not needed then
            return set()
        covariance = np.linalg.inv(self.normal)
        found = set()
        for name, here in far:
            pull = prior[np.ix_(here, here)] @ away[here]
            if float(pull @ covariance[np.ix_(here, here)] @ pull) > HELD_BACK:
                found.add(name)
        return found

    @property
    def tau(self) -> float:
        """s"""
        return exp(max(self.x[1] - FASTER - self.x[0], -60.0))

    @property
    def tau_v(self) -> float:
        """s"""
        return exp(self.x[1])

    @property
    def V(self) -> float:
        """mL"""
        return exp(self.x[2])

    def strength(self) -> dict[str, float | dict[str, float]]:
        """The fitted strengths by name; per-experiment ones as a mapping."""
        made: dict[str, float | dict[str, float]] = {}
        campaign = self.plan.sketch.campaign
        for part, strengths in enumerate(self.plan.strengths):
            for s in strengths:
                if s.per_experiment:
                    made[s.name] = {
                        e.name: self.plan.values(self.x, k)[part][s.name]
                        for k, e in enumerate(campaign)
                    }
                else:
                    made[s.name] = self.plan.values(self.x, 0)[part][s.name]
            if not strengths:  # a form at full strength
                effect = self.plan.parts[part].effect
                made.update(effect.plausible)
        return made


def refit(
    plan: Plan,
    start: FloatArray,
    data: Sequence[FloatArray] | None = None,
    most_steps: int = 30,
    tolerance: float = 0.02,
    free: NDArray[np.bool_] | None = None,
    known: Sequence[Refit] = (),
    enough: float = inf,
) -> Refit:
    """Levenberg-Marquardt from ``start`` (n,) until the objective falls by < ``tolerance``.

    ``data``: bin means (n_bins,) V of each experiment in place of the measured ones.  ``free``
    (n,): coordinates that may move.  None goes below :attr:`Plan.lowest`.  ``known``: other
    refits of the same plan to the same data; one of them is returned where this one is on the way
    to its optimum, and this one as it stands where it remains far above the best of them.
    ``enough``: objective above which an optimum does not matter; a refit that expects to end there
    is given up, too.

    The derivatives are carried on by Broyden's rule as long as steps gain about what they promise.
    """
    sketch = plan.sketch
    of_bins = sketch.all_bins.of_bins
    measured = np.concatenate(sketch.data if data is None else data)
    centre, prior = plan.prior_centre, plan.own_prior_matrix
    x = np.maximum(start, plan.lowest)

    def evaluate(at: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        means, away = plan.all_means(at), at - centre
        residual = sketch.whitened(measured - means)
        total = float(residual @ residual) + float(away @ prior @ away)
        return means, residual, total if isfinite(total) else inf

    means, residual, objective = evaluate(x)
    damping, converged, finer = 1e-3, False, 1.0
    derivatives: FloatArray | None = None
    hopeless = min([enough, *(other.objective + FAR for other in known)])
    for taken in range(most_steps):
        fresh = derivatives is None
        if derivatives is None:
            derivatives = plan.derivatives(x, means, finer)
        normal, gradient = normal_equations(derivatives, residual, of_bins, plan.places, len(x))
        gradient -= prior @ (x - centre)
        normal += prior
        movable = (x > plan.lowest) | (gradient > 0.0)
        if free is not None:
            movable &= free
        index = np.flatnonzero(movable)
        within = np.ix_(index, index)
        squares = normal.diagonal().copy()
        accepted = False
        for _ in range(8):
            damped = normal[within]
            damped[np.diag_indices_from(damped)] += damping * (squares[index] + 1e-12)
            step = _solved(damped, gradient[index])
            if step is None:
                damping = max(damping, 1e-6) * 10.0
                continue
            if damping <= 1e-3:
                ahead = objective - float(step @ gradient[index])
                if taken >= PATIENCE and ahead > hopeless:
                    return Refit(plan, x, residual, objective, False)
                for other in known:
                    if other.converged and abs(ahead - other.objective) < ALIKE:
                        apart = x - other.x
                        apart[index] += step
                        if float(apart @ normal @ apart) < ALIKE:
                            return other
            trial = _stepped(plan, x, index, step)
            t_means, t_residual, t_objective = evaluate(trial)
            if t_objective < objective:
                accepted = True
                break
            if not fresh:
                break
            damping = max(damping, 1e-6) * 8.0
        if not accepted:
            if not fresh:
                derivatives = None
                continue
            offered = 0.0 if step is None else float(step @ gradient[index])
            if finer == 1.0 and offered > 0.1 * tolerance:
                # where the model bends within the steps of the differences, they mislead
                finer, damping, derivatives = FINER, 1e-3, None
                continue
            converged = True
            break
        gained, moved = objective - t_objective, trial - x
        promised = float(moved @ (2.0 * gradient - normal @ moved))
        if gained > STRAIGHT * promised:
            carry_on(derivatives, residual - t_residual, moved, squares, of_bins, plan.places)
        else:
            derivatives = None
        x, means, residual, objective = trial, t_means, t_residual, t_objective
        damping = max(damping * 0.2, 1e-9)
        if gained < tolerance and (fresh or promised < 2.0 * tolerance):
            converged = True
            break
    return Refit(plan, x, residual, objective, converged)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray | None:
    """Solution (n,) of a symmetric system, None where its matrix is not positive definite."""
    _, solution, wrong = dposv(matrix.T, right, overwrite_a=True)
    return None if wrong else solution


def _stepped(plan: Plan, x: FloatArray, index: NDArray[np.int64], step: FloatArray) -> FloatArray:
    """Coordinates (n,) after a ``step`` of those in ``index``, none of them too long.

    A lag of tau delays the response by tau, so that what tau gains the switch times lose.  Tau is
    exponential in the coordinates: the switch times make up for what it gains beyond the linear.
    """
    most = plan.longest_steps[index]
    moved = x.copy()
    moved[index] += np.clip(step, -most, most)
    moved = np.maximum(moved, plan.lowest)
    before, by = x[1] - FASTER - x[0], (moved[1] - x[1]) - (moved[0] - x[0])
    bent = exp(max(before, -60.0)) * (exp(by) - 1.0 - by)
    movable = np.zeros(plan.size, dtype=bool)
    movable[index] = True
    moved[plan.switch_times[movable[plan.switch_times]]] -= bent
    return moved


def with_tau(plan: Plan, x: FloatArray, log_tau: float) -> FloatArray:
    """Coordinates (n,) with another ``log_tau`` (of s), and the switch times moved back by it.

    A lag of tau delays the response by tau, so that what tau gains the switch times lose.
    """
    made = x.copy()
    made[0] = max(float(x[1]) - FASTER - log_tau, 0.0)
    made[plan.switch_times] -= exp(x[1] - FASTER - made[0]) - exp(x[1] - FASTER - x[0])
    return made


def base_starts(sketch: Sketch, base: FloatArray) -> list[FloatArray]:
    """Starts of the fit without effects: tau moved over two decades, t0 and tf with it."""
    plan, log_tau_v = Plan(sketch), float(base[1])
    ratios = (min(ratio, exp(-FASTER) * 0.999) for ratio in (0.012, 0.07, 0.23, 0.58))
    return [base.copy(), *(with_tau(plan, base, log_tau_v + log(ratio)) for ratio in ratios)]
