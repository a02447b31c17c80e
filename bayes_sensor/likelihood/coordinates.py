"""Coordinates in which the likelihood is nearly quadratic: psi = (tau^2, .., t0 + tau, ..)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.switching import is_switch_time

NOISE_SIZES = ("sigma0_V", "sigma1_V")


@dataclass(frozen=True)
class Coordinates:
    """The map between theta and psi for one problem; pinned parameters are left out of psi."""

    problem: Problem

    @cached_property
    def free(self) -> np.ndarray:
        """Positions in theta of the parameters that vary."""
        layout = self.problem.layout
        return np.array([i for i, n in enumerate(layout.names) if n not in self.problem.fixed])

    @cached_property
    def names(self) -> list[str]:
        """Flat names of the varying parameters, in psi's order."""
        return [self.problem.layout.names[i] for i in self.free]

    @cached_property
    def _kinds(self) -> list[str]:
        return [name.split("[")[0] for name in self.names]

    def _where(self, *kinds: str) -> np.ndarray:
        return np.array([i for i, kind in enumerate(self._kinds) if kind in kinds], dtype=int)

    @cached_property
    def squared(self) -> np.ndarray:
        """Positions in psi that hold a square: of tau, of each sigma1 that may be zero.

        tau is not among them where there are several sensors.
        """
        tau = ("tau_s",) if self.shifts else ()
        return self._where(*tau, *(set(NOISE_SIZES) - set(self._sizes)))

    @property
    def shifts(self) -> bool:
        """Whether switch times stand in psi with tau added, and tau as its square: for one sensor
        whose place is not held."""
        return self.problem.layout.one_sensor and "tau_s" in self._kinds

    @cached_property
    def switches(self) -> np.ndarray:
        """Positions in psi of t0 + tau, tf + tau and other switch times plus tau."""
        return self._where(*self.problem.layout.switch_kinds) if self.shifts else _NONE

    @cached_property
    def switch_times(self) -> np.ndarray:
        """Positions in psi of all switch times, whether tau is added or not."""
        return self._where(*self.problem.layout.switch_kinds)

    @cached_property
    def phi(self) -> np.ndarray:
        """Positions in psi of atanh phi."""
        return self._where("phi")

    @cached_property
    def _sizes(self) -> tuple[str, ...]:
        """Which sizes of noise cannot be zero: sigma0, and sigma1 where it is a level."""
        return NOISE_SIZES if self.problem.noise.fading else NOISE_SIZES[:1]

    @cached_property
    def log_sigmas(self) -> np.ndarray:
        """Positions in psi of log sigma0, and of log sigma1 where it is a level of its own."""
        return self._where(*self._sizes)

    @cached_property
    def logs(self) -> np.ndarray:
        """Positions in psi of the logarithms of a model's own parameters with such a prior."""
        return np.array(
            [
                i
                for i, name in enumerate(self.names)
                if name in self.problem.layout.extra
                and self.problem.priors[name].kind in ("log_normal", "log_uniform")
            ],
            dtype=int,
        )

    @cached_property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest psi (n_psi,) of a model's own parameters; others are unlimited."""
        low, high = np.full(len(self.names), -np.inf), np.full(len(self.names), np.inf)
        for i, name in enumerate(self.names):
            if name in self.problem.layout.extra:
                low[i], high[i] = self.problem.priors[name].support
        with np.errstate(divide="ignore"):
            low[self.logs], high[self.logs] = np.log(low[self.logs]), np.log(high[self.logs])
        return low, high

    @cached_property
    def limited(self) -> np.ndarray:
        """Positions in psi that have a limit."""
        low, high = self.limits
        return np.flatnonzero(np.isfinite(low) | np.isfinite(high))

    @cached_property
    def linear(self) -> np.ndarray:
        """(n_experiments, 2) positions in psi of y0 and beta."""
        y0, beta = self._where("y0_V"), self._where("beta_V")
        return np.stack([y0, beta], axis=1)

    def signs(self, theta: FloatArray) -> FloatArray:
        """(n_psi,) the sign of each experiment's step at its y0 and beta, 1 elsewhere.

        Random numbers times this give draws of a signal upside down that are upside down.
        """
        signs = np.ones(len(self.names))
        signs[self.linear] = np.where(theta[self.free[self.linear[:, 1:]]] < 0.0, -1.0, 1.0)
        return signs

    def psi(self, thetas: FloatArray) -> FloatArray:
        """(.., n_psi) coordinates of ``thetas`` (.., n_theta)."""
        psi = np.array(thetas, dtype=float)[..., self.free]
        tau = psi[..., :1].copy()
        psi[..., self.switches] += tau
        psi[..., self.squared] **= 2
        phi, sigmas = self.phi, self.log_sigmas
        psi[..., phi] = np.arctanh(psi[..., phi])
        psi[..., sigmas] = np.log(psi[..., sigmas])
        psi[..., self.logs] = np.log(psi[..., self.logs])
        return psi

    def theta(self, psis: FloatArray) -> FloatArray:
        """(.., n_theta) parameters; negative squares count as zero."""
        values = np.array(psis, dtype=float)
        values[..., self.squared] = np.sqrt(np.maximum(values[..., self.squared], 0.0))
        values[..., self.switches] -= values[..., :1]
        phi, sigmas = self.phi, self.log_sigmas
        # 1 - 1e-12: tanh rounds to 1 far out, where the density is zero anyway
        values[..., phi] = np.clip(np.tanh(values[..., phi]), -1 + 1e-12, 1 - 1e-12)
        values[..., sigmas] = np.exp(np.minimum(values[..., sigmas], 300.0))
        values[..., self.logs] = np.exp(np.minimum(values[..., self.logs], 300.0))
        theta = np.zeros((*values.shape[:-1], len(self.problem.layout)))
        for name, value in self.problem.fixed.items():
            theta[..., self.problem.layout.index(name)] = value
        theta[..., self.free] = values
        return theta

    def log_jacobian(self, thetas: FloatArray, roots: bool = False) -> FloatArray:
        """log |d theta / d psi| (..,).  ``roots``: with tau and sigma1 themselves, not squared."""
        values = np.asarray(thetas)[..., self.free]
        phi, sigmas = self.phi, self.log_sigmas
        with np.errstate(divide="ignore"):
            total: FloatArray = np.log(1.0 - values[..., phi] ** 2).sum(axis=-1)
            total = total + np.log(values[..., sigmas]).sum(axis=-1)
            total = total + np.log(values[..., self.logs]).sum(axis=-1)
            if not roots:
                total = total - np.log(2.0 * values[..., self.squared]).sum(axis=-1)
        return total

    def slopes(self, theta: FloatArray) -> FloatArray:
        """(n_psi, n_psi) derivatives of the varying theta by psi at one theta (n_theta,)."""
        values = theta[self.free]
        diagonal = np.ones(len(values))
        # a root has no slope at zero: a time of almost nothing, a sigma1 of almost no sigma0
        least = np.where(self.squared == 0, 1e-12, 1e-12 * values[self.log_sigmas].min())
        diagonal[self.squared] = 0.5 / np.maximum(values[self.squared], least)
        diagonal[self.phi] = 1.0 - values[self.phi] ** 2
        diagonal[self.log_sigmas] = values[self.log_sigmas]
        diagonal[self.logs] = values[self.logs]
        slopes = np.diag(diagonal)
        slopes[self.switches, 0] = -diagonal[0]
        return slopes


_NONE = np.empty(0, dtype=int)


def names_of_psi(names: Sequence[str], noise: Noise | None = None) -> list[str]:
    """What each coordinate is, for figures and tables: ``tau_s^2``, ``t0_s[1] + tau_s``, .."""
    labels = {"sigma1_V": "{}^2", "phi": "atanh {}", "sigma0_V": "log {}"}
    if "tau_s" in names:
        labels["tau_s"] = "{}^2"
        labels |= {kind: "{} + tau_s" for kind in map(_kind, names) if is_switch_time(kind)}
    if noise is not None and noise.fading:
        labels["sigma1_V"] = "log {}"
    return [labels.get(_kind(name), "{}").format(name) for name in names]


def _kind(name: str) -> str:
    return name.split("[")[0]
