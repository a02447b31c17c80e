"""Common inputs of the bound methods: the fit, the two likelihoods and their maxima, computed
once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bayes_sensor.bounds.gaussian_intervals import invert
from bayes_sensor.bounds.likelihood_surface import (
    Maximum,
    Surface,
    coloured_surface,
    region_of,
    spread_along_tau,
    white_surface,
)
from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.fit import Fit
from bayes_sensor.fit.check_fit_matches import check_data_of_fit
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.residuals import noise_doubt

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Evidence:
    """A problem, its least-squares fit and, if given, posterior; the rest is computed when
    needed."""

    problem: Problem
    fit: Fit
    posterior: Any = None
    seed: int = 1
    n_resamples: int = 400
    progress: Progress = field(default=lambda fraction, text: None)

    def __post_init__(self) -> None:
        expected, n = self.problem.layout.names, self.problem.layout.n_shared
        # the lags' own names depend on what is known of them
        if len(self.fit.names) != len(expected) or list(self.fit.names)[n:] != expected[n:]:
            raise CampaignError(
                f"the fit has {len(self.fit.names)} parameters ({', '.join(self.fit.names[:3])}, "
                f"..), the campaign needs {len(expected)}; fit this campaign with this model first"
            )

    @property
    def noise_words(self) -> str:
        """The problem's noise law in words."""
        noise = self.problem.noise
        law = "AR(1) noise" if noise.autocorrelation == "ar1" else "white noise"
        scale = {
            "concentration": "with concentration-dependent scale",
            "signal": "with signal-dependent scale",
            "constant": "of constant scale",
            "levels": "whose standard deviation changes from one level to another with "
            "concentration",
        }[noise.variance]
        return f"{law} {scale}"

    @cached_property
    def theta(self) -> FloatArray:
        """(n_theta,) the fit's estimates, noise included."""
        return np.array(self.fit.theta_hat, dtype=float)

    @cached_property
    def noise_doubts(self) -> list[str]:
        """Why the noise does not follow the problem's law; empty where it does.

        From the residuals and, if a posterior was checked, from replicated data.
        """
        found = [noise_doubt(self.problem, self.theta), *getattr(self.posterior, "doubts", ())]
        return list(dict.fromkeys(text for text in found if text))

    @cached_property
    def _coloured(self) -> tuple[Surface, Maximum]:
        return coloured_surface(self.problem, self.theta)

    @property
    def likelihood(self) -> tuple[Surface, Maximum] | None:
        """Likelihood under the problem's own noise with its maximum; None where no method needed
        it."""
        found: tuple[Surface, Maximum] | None = self.__dict__.get("_coloured")
        return found

    @property
    def coloured(self) -> Surface:
        """The likelihood under the problem's own noise."""
        return self._coloured[0]

    @property
    def coloured_maximum(self) -> Maximum:
        """Its maximum."""
        return self._coloured[1]

    @property
    def coloured_trouble(self) -> str:
        """Why the maximum under the problem's noise was not found; empty where it was."""
        if self.coloured_maximum.converged:
            return ""
        walled = self.coloured.at_wall(self.coloured_maximum.psi)
        if walled:
            return f"the likelihood keeps rising as {', '.join(walled)} moves out of its range"
        return "the maximum under this noise was not found"

    @cached_property
    def coloured_theta(self) -> FloatArray:
        """(n_theta,) maximum under the problem's noise; tau 0 where it is on the floor."""
        theta = self.coloured.coordinates.theta(self.coloured_maximum.psi)
        if self.coloured_at_bound:
            layout = self.problem.layout
            theta[layout.all_switches] += theta[layout.tau]
            theta[layout.tau] = 0.0
        return theta

    @cached_property
    def coloured_at_bound(self) -> bool:
        """Whether the maximum under the problem's noise has tau^2 on its floor."""
        surface = self.coloured
        floor = surface.floor[0] if surface.coordinates.shifts else -np.inf
        return bool(self.coloured_maximum.psi[0] <= 1.001 * floor)

    @cached_property
    def white(self) -> Surface:
        """Least squares as a likelihood."""
        region = region_of(self.problem, self.coloured, self.theta)
        return white_surface(self.problem, self.theta, self.fit.rms, region)

    @cached_property
    def psi_white(self) -> FloatArray:
        """(n_psi,) of the fit, with tau^2 not below the floor."""
        theta = self.theta.copy()
        for row in self.problem.layout.noise:
            theta[row] = 0.0, self.fit.rms, 0.0
        return self.white.psi(theta)

    @cached_property
    def white_along_tau(self) -> tuple[FloatArray, FloatArray] | None:
        """Values of tau (m,), and the sd (m,) of least squares' tau^2 there under white noise."""
        return spread_along_tau(self.white, self.psi_white)

    @cached_property
    def white_cov(self) -> tuple[FloatArray, np.ndarray]:
        """Converged covariance (n, n) of psi's mean part under iid noise of the fit's RMS, and (n,)
        whether the data identify each parameter."""
        surface = self.white
        information = surface.information(surface.expansion(self.psi_white))
        return invert(information[np.ix_(surface.mean, surface.mean)])

    @cached_property
    def psi_expansion(self) -> FloatArray:
        """(n_psi,) of the fit, tau^2 raised to its coloured spread: where derivatives exist."""
        point = self.coloured_maximum.psi.copy()
        point[0] = self.psi_white[0]
        psi = self.psi_white.copy()
        psi[0] = self.coloured.expansion(point)[0]
        return psi

    def of_mean(self, theta: FloatArray) -> tuple[list[str], FloatArray]:
        """Flat names of all parameters but the noise's, and their values (n,) in ``theta``."""
        layout = self.problem.layout
        names = [*layout.mean_names, *layout.extra]
        return names, theta[[layout.index(name) for name in names]]

    @property
    def mean_names(self) -> list[str]:
        """Flat names of all parameters but the noise's."""
        return self.of_mean(self.theta)[0]

    @cached_property
    def estimate(self) -> FloatArray:
        """(n,) the fit's estimates of ``mean_names``."""
        return self.of_mean(self.theta)[1]

    @cached_property
    def at_bound(self) -> bool:
        """Whether least squares has tau at its lower bound; False for several sensors."""
        if not self.problem.layout.one_sensor:
            return False
        longest = self.problem.commuting.without_volumes.lags(self.theta)[-1]
        tau = self.theta[self.problem.layout.tau]
        return bool(
            (self.fit.names[0] in self.fit.at_bound and tau < 0.1 * longest)
            or tau**2 <= 1.001 * self.white.floor[0]
        )


def check_data(problem: Problem, fit: Fit, posterior: Any) -> None:
    """Raise CampaignError if a fit or a posterior (or None) belongs to other data than the
    problem's."""
    check_data_of_fit(problem, fit)
    if posterior is None:
        return
    # the lags' own names depend on what is known of them
    own = problem.layout.names[problem.layout.n_shared :]
    missing = [name for name in own if name not in posterior.names]
    of = getattr(getattr(posterior, "problem", None), "campaign", None)
    if missing or (of is not None and not _same_data(of, problem.campaign)):
        what = f"has no {missing[0]}" if missing else "is of other data"
        raise CampaignError(f"the posterior {what}; sample that of this campaign first")


def _same_data(a: Campaign, b: Campaign) -> bool:
    """Whether two campaigns have the same experiments with the same samples in use."""
    return len(a) == len(b) and all(
        x.name == y.name
        and np.array_equal(x.used, y.used)
        and np.array_equal(x.values[x.used], y.values[y.used])
        for x, y in zip(a, b, strict=True)
    )
