"""Noise of the measurement: iid, or AR(1) with a variance that depends on concentration.

::

    y_i = m_i + s_i z_i        z: stationary AR(1), unit variance, coefficient phi
    s_i^2 = sigma0^2 + sigma1^2 (c_k/c_ref) max(x3(t_i), 0)      variance grows
    s_i^2 = sigma0^2 (1 - u_i) + sigma1^2 u_i                     two levels: it may fall as well
            u_i = (c_k/c_ref) x3(t_i), kept within 0 and 1

``phi`` refers to the campaign's most common sampling interval; an experiment sampled every ``dt``
uses phi^(dt/reference), and across m missing samples the coefficient is phi^(m + 1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.display import record_card

VARIANCES = ("concentration", "signal", "constant", "levels")
AUTOCORRELATIONS = ("ar1", "white")


@dataclass(frozen=True)
class Noise:
    """Which noise law, as options; its parameters are phi, sigma0_V, sigma1_V.

    ``variance``: ``concentration`` (x3 weighted by the experiment's concentration over the highest
    of the campaign), ``signal`` (x3 alone), ``constant``, or ``levels``: sigma0 is the noise at the
    baseline and sigma1 that at the campaign's highest concentration, above or below it.
    ``autocorrelation``: ``ar1`` or ``white``.  ``per_experiment``: own noise parameters for every
    experiment.

    >>> Noise("constant", "white").fixed
    {'phi': 0.0, 'sigma1_V': 0.0}
    """

    _repr_html_ = record_card

    variance: str = "concentration"
    autocorrelation: str = "ar1"
    per_experiment: bool = False

    def __post_init__(self) -> None:
        for label, value, known in (
            ("variance", self.variance, VARIANCES),
            ("autocorrelation", self.autocorrelation, AUTOCORRELATIONS),
        ):
            if value not in known:
                raise CampaignError(f"noise {label} must be one of {known}, but is '{value}'")

    @property
    def fixed(self) -> dict[str, float]:
        """Noise parameters that this law pins, with their values."""
        pinned = {}
        if self.autocorrelation == "white":
            pinned["phi"] = 0.0
        if self.variance == "constant":
            pinned["sigma1_V"] = 0.0
        return pinned

    def weight(self, campaign: Campaign, experiment: Experiment) -> float:
        """Factor of sigma1^2 x3 in the variance of this experiment."""
        return self.weight_of(experiment.concentration / campaign.reference_concentration)

    def weight_of(self, share: float) -> float:
        """The same at ``share`` of the campaign's highest concentration."""
        return {"constant": 0.0, "signal": 1.0}.get(self.variance, share)

    @property
    def by_concentration(self) -> bool:
        """Whether sigma1 refers to the campaign's highest concentration."""
        return self.variance in ("concentration", "levels")

    @property
    def fading(self) -> float:
        """Share of sigma0^2 that is gone at the highest concentration: 1 of ``levels``, else 0."""
        return 1.0 if self.variance == "levels" else 0.0

    def referred(self, sigma0: float, sigma1: float, times: float) -> float:
        """V, what sigma1 is when it refers to ``times`` the concentration it refers to now.

        Noise that falls with concentration is not taken to fall below the lower of its levels.

        >>> Noise().referred(0.3, 0.4, 4.0), round(Noise("levels").referred(0.3, 0.5, 0.5), 4)
        (0.8, 0.4123)
        """
        if not self.fading:
            return float(np.sqrt(times)) * sigma1
        square = sigma0**2 + times * (sigma1**2 - sigma0**2)
        return float(np.sqrt(max(square, min(sigma0, sigma1) ** 2)))

    def referred_slopes(self, sigma0: float, sigma1: float, times: float) -> tuple[float, float]:
        """Derivatives of :meth:`referred` by sigma0 and sigma1."""
        if not self.fading:
            return 0.0, float(np.sqrt(times))
        value = self.referred(sigma0, sigma1, times)
        return (1.0 - times) * sigma0 / value, times * sigma1 / value


def scale_squared(
    x3: FloatArray, sigma0: float, sigma1: float, weight: float, fading: float = 0.0
) -> FloatArray:
    """s^2 (n_t,), V^2, at normalised concentrations ``x3`` (n_t,).

    sigma0^2 + (sigma1^2 - fading sigma0^2) weight x3, with x3 not below 0 and, where sigma0 fades,
    weight x3 not above 1.

    >>> scale_squared(np.array([-1.0, 0.0, 0.5, 3.0]), 2.0, 1.0, 1.0, fading=1.0).tolist()
    [4.0, 4.0, 2.5, 1.0]
    """
    return sigma0**2 + (sigma1**2 - fading * sigma0**2) * weight * _within(x3, weight, fading)


def scale_slopes(
    x3: FloatArray, sigma0: float, sigma1: float, weight: float, fading: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives (n_t,) of :func:`scale_squared` by x3, sigma0 and sigma1."""
    x = _within(x3, weight, fading)
    moves = (x3 > 0.0) & (x == x3)
    by_x3 = np.where(moves, (sigma1**2 - fading * sigma0**2) * weight, 0.0)
    return by_x3, 2.0 * sigma0 * (1.0 - fading * weight * x), 2.0 * sigma1 * weight * x


def _within(x3: FloatArray, weight: float, fading: float) -> FloatArray:
    """x3 (n_t,) from 0 to where sigma0 has faded."""
    top = 1.0 / weight if fading * weight > 0.0 else np.inf
    return np.clip(x3, 0.0, top)


def lag_coefficient(phi: float, steps: float) -> float:
    """phi^steps: the correlation over ``steps`` reference intervals; nan where it is not real.

    >>> lag_coefficient(0.81, 0.5)
    0.9
    """
    whole = round(steps)
    if abs(steps - whole) < 1e-9 * max(1.0, steps):
        return float(phi**whole)
    return float(phi**steps) if phi >= 0 else float("nan")


def check_phi(phi: float, steps: float, name: str) -> None:
    """Raise CampaignError unless AR(1) noise can have ``phi`` in experiment ``name``, sampled every
    ``steps`` reference intervals.

    >>> check_phi(0.5, 1.5, "a")
    """
    if not abs(phi) < 1.0:
        raise CampaignError(
            f"theta: phi is {phi:g}; expected a value above -1 and below 1: correct it"
        )
    if not abs(lag_coefficient(phi, steps)) < 1.0:
        raise CampaignError(
            f"experiment '{name}': phi is {phi:g}, and its samples are {steps:g} reference "
            "intervals apart, over which a negative phi has no real power; expected phi of at "
            "least 0 where sampling intervals differ: correct it"
        )


def simulate_noise(
    scale: FloatArray, phi: float | FloatArray, rng: np.random.Generator, burn_in: int = 0
) -> FloatArray:
    """(n_t,) V: s_i z_i with z a stationary AR(1) of unit variance and lag-one coefficient phi.

    ``phi`` may be (n_t - 1,), a coefficient for each step between two samples.
    """
    e = rng.standard_normal(len(scale) + burn_in)
    if isinstance(phi, np.ndarray):
        e[1 + burn_in :] *= np.sqrt(1.0 - phi**2)
        _recurse_unevenly(e, np.concatenate([np.zeros(burn_in), phi]))
        return scale * e[burn_in:]
    e[1:] *= np.sqrt(1.0 - phi**2)
    _recurse(e, float(phi))
    return scale * e[burn_in:]


@compiled()
def _recurse_unevenly(z: FloatArray, phi: FloatArray) -> None:
    # z_i + phi_i z_(i-1), in place
    for i in range(1, len(z)):
        z[i] += phi[i - 1] * z[i - 1]


@compiled()
def _recurse(z: FloatArray, phi: float) -> None:
    # z_i + phi z_(i-1), in place
    for i in range(1, len(z)):
        z[i] += phi * z[i - 1]
