"""The means over bins that a hypothesis predicts, and their derivatives by its coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, inf

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import SHARED
from bayes_sensor.diagnosis.effects.effect import Form
from bayes_sensor.diagnosis.effects.rig_view import RigView, coating_modes
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER, CoordinatePriors
from bayes_sensor.rig.imperfections import (
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
)
from bayes_sensor.rig.perturbed import rig_mean, rig_means


@dataclass(frozen=True, eq=False)
class Coordinates(CoordinatePriors):
    """The coordinates of a hypothesis, and the means over bins that follow from them."""

    def mean(self, x: FloatArray, k: int, times: FloatArray | None = None) -> FloatArray:
        """V (n_times,), the mean of experiment ``k`` at sorted ``times`` (default: the bins')."""
        p, own = self.rig(x, k)
        at = self.binned.bins[k].times if times is None else times
        if own is None:
            return self._mean_of(at, p, k)
        form, values = own
        return self._own_mean(at, p, form, values, self.binned.settings[k])

    def _mean_of(self, at: FloatArray, p: FloatArray, k: int) -> FloatArray:
        """V (n_times,) of the kernel's parameters ``p`` of experiment ``k``."""
        return np.asarray(rig_mean(at, p, *coating_modes()))

    def _view(self, setting: Setting, p: FloatArray) -> RigView:
        """The rig of an experiment, as an effect's own function of the mean sees it."""
        return RigView(setting, p)

    def _own_mean(
        self,
        at: FloatArray,
        p: FloatArray,
        form: Form,
        values: Mapping[str, float],
        setting: Setting,
    ) -> FloatArray:
        here = replace(setting, t0=float(p[T0]), tf=min(float(p[TF]), setting.tf + 1e6))

        view = self._view(here, p)
        assert form.mean is not None
        try:
            made = np.asarray(form.mean(at, values, view), dtype=float)
        except CampaignError:
            raise
        except Exception as error:  # whatever the user's code raises is the user's to see
            raise CampaignError(
                f"an own effect's function stops with {type(error).__name__}: {error}; expected "
                f"the signal at each of the {len(at)} times it is given, from the strengths "
                f"{', '.join(values)}: correct it"
            ) from error
        if made.shape != at.shape:
            raise CampaignError(
                f"an own effect's function returned shape {made.shape}; expected {at.shape}, the "
                "signal at each time it is given: correct it"
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
        own, setting = None, self.binned.settings[k]
        for part, values in zip(self.parts, strengths, strict=True):
            for name, value in part.form.settings(values, setting).items():
                p[FIRST + INDEX[name]] = value
            if part.form.mean is not None:
                own = (part.form, values)
        return own

    @cached_property
    def _slots(self) -> tuple[int, int]:
        # the kernel's parameters that are the shorter and the longer lag
        return (TAU_V, TAU) if self.binned.sensor else (TAU, TAU_V)

    @cached_property
    def _flows(self) -> FloatArray:
        return np.array([e.total_flow for e in self.binned.campaign])

    @cached_property
    def _first(self) -> NDArray[np.int64]:
        # (n_experiments,) coordinate y0 of each
        return np.array(self.local[:-1], dtype=np.int64)

    @cached_property
    def _fixed(self) -> FloatArray:
        # (n_experiments, n_parameters) the kernel's parameters that no coordinate changes
        found = np.zeros((len(self.binned.bins), FIRST + len(NEUTRAL)))
        found[:, FIRST:] = NEUTRAL
        found[:, TF] = 1e30
        for p, e in zip(found, self.binned.campaign, strict=True):
            p[CONCENTRATION] = e.concentration
            p[START] = e.t[0] - 0.5 * e.interval
            p[MIDDLE] = 0.5 * (e.t[0] + e.t[-1])
        return found

    def bin_means(self, x: FloatArray, k: int) -> FloatArray:
        """V (n_bins,), mean of each bin of experiment ``k``."""
        if self.own_mean:
            return self.binned.bins[k].reduce(self.mean(x, k))
        p, _ = self.rig(x, k)
        one = np.array([0, 1])
        return np.asarray(
            rig_means(*self.binned.bins[k].alone, p[None], one, *coating_modes())[:, 0]
        )

    def means(self, x: FloatArray) -> list[FloatArray]:
        """V (n_bins,) of every experiment, mean of each of its bins."""
        made = self.all_means(x)
        return [made[rows] for rows in self.binned.rows]

    def all_means(self, x: FloatArray) -> FloatArray:
        """V (n_bins in all,), the same of all experiments, one after the other."""
        if self.own_mean:
            return np.concatenate([self.bin_means(x, k) for k in range(len(self.binned.bins))])
        bins, rigs = self.binned.all_bins, self.rigs(x)
        each = np.arange(len(rigs) + 1)
        return np.asarray(rig_means(*bins, rigs, each, *coating_modes())[:, 0])

    def other_starts(self, x: FloatArray) -> list[FloatArray]:
        """``x`` (n,); further starts are those of the order of two lags."""
        return [x.copy()]

    def signature(self, x: FloatArray, here: FloatArray, chosen: Mapping[str, float]) -> FloatArray:
        """(n_bins in all,) whitened: what strengths of the last part change in means ``here`` V."""
        return self.binned.whitened(self.all_means(self.with_strengths(x, chosen)) - here)

    @cached_property
    def own_mean(self) -> bool:
        """Whether a form gives the mean voltage itself, as a user's own may."""
        return any(part.form.mean is not None for part in self.parts)

    def rigs(self, x: FloatArray) -> FloatArray:
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

    def derivatives(self, x: FloatArray, here: FloatArray, finer: float = 1.0) -> FloatArray:
        """(n_bins in all, n_columns) whitened derivatives of the bins' means, which are ``here`` V.

        By every coordinate that an experiment depends on, see :attr:`places`.  ``finer``: factor on
        the steps of the differences.
        """
        steps = finer * self.steps
        if self.own_mean:
            means = self._moved_own_means(x, steps)
        else:
            means = rig_means(
                *self.binned.all_bins, self._moved(x, steps), self._of_rigs, *coating_modes()
            )[:, 1:]
        return self.binned.whitened((means - here[:, None]) / (finer * self._steps_by_bin))

    @cached_property
    def _steps_by_bin(self) -> FloatArray:
        # (n_bins in all, n_columns); infinite where an experiment has fewer columns than others
        by_experiment = np.where(self.places < 0, inf, self.steps[self.places])
        return np.repeat(by_experiment, [len(d) for d in self.binned.data], axis=0)

    def _moved_own_means(self, x: FloatArray, steps: FloatArray) -> FloatArray:
        means = np.zeros((self.binned.n_bins, self.places.shape[1]))
        moved = np.array(x)
        for k, rows in enumerate(self.binned.rows):
            for i, c in enumerate(self._columns[k]):
                moved[c] += steps[c]
                means[rows, i] = self.bin_means(moved, k)
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
        rigs = np.repeat(self.rigs(x), np.diff(self._of_rigs), axis=0)
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
