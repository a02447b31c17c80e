"""Why tau is hard to measure, in numbers and sentences.

A first-order lag and a later switch time change the response in nearly the same way: exp(-p t0)/(1
+ tau p) = exp(-p (t0 + tau)) (1 + tau^2 p^2/2 - ..).  The data determine t0 + tau well, but tau
itself only through its square.  The information on tau is proportional to tau and vanishes with it.
(Scaled information, eigenvectors, multiple correlation: Belsley, Kuh and Welsch, Regression
Diagnostics, 1980, ch. 3.)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.bounds.cramer_rao import PUBLISHED_SIGMA, CramerRao, bound_of, cramer_rao
from bayes_sensor.bounds.gaussian_intervals import normal_factor
from bayes_sensor.bounds.likelihood_surface import Maximum, Surface, coloured_surface
from bayes_sensor.bounds.profile import Profiler, profile_curve
from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.display import record_card
from bayes_sensor.io.json_files import plain
from bayes_sensor.likelihood.held_values import refuse_held
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.layout import Layout, Theta

if TYPE_CHECKING:
    import pandas as pd

KNOWN: dict[str, tuple[str, ...]] = {
    "nothing": (),
    "t0": ("t0_s",),
    "tf": ("tf_s",),
    "t0, tf": ("t0_s", "tf_s"),
    "V": ("V_mL",),
    "tau_v": ("tau_v_s",),
    "V, tau_v": ("V_mL", "tau_v_s"),
    "t0, tf, V, tau_v": ("t0_s", "tf_s", "V_mL", "tau_v_s"),
}
"""parameters that are taken as known, by label"""


@dataclass(frozen=True, eq=False)
class TauExplained:
    """Why tau is not known better."""

    _repr_html_ = record_card

    names: list[str]
    """flat names of the mean's parameters"""
    eigenvalues: FloatArray
    """(n,) of the information scaled to unit diagonal, rising; 1 each would mean no collinearity"""
    weakest: dict[str, float]
    """unit vector (in scaled parameters) with the least information"""
    condition: float
    """ratio of the largest to the smallest singular value of the scaled sensitivities"""
    correlation: dict[str, float]
    """correlation of tau's estimate with that of each other parameter"""
    collinearity: dict[str, float]
    """multiple correlation of tau's sensitivity with those of the switch times alone
    (``switches``), of all parameters but them (``others``) and of everything (``all``)"""
    known: dict[str, float]
    """s, the bound (sd) on tau when the named parameters are known"""
    tau: float
    """s"""
    sd_square: float
    """s^2, sd of tau^2"""
    by_tau: pd.DataFrame
    """bound against the true tau: ``tau_s``, ``sd_tau_s``, ``sd_square_s2``"""
    curve: pd.DataFrame
    """profile of the log-likelihood: ``tau_s``, ``drop`` below the maximum, ``gaussian`` the drop
    that estimate +- sd would claim (nan where sd exceeds the range), ``square`` the one a Gaussian
    in tau^2 gives"""
    sentences: list[str]
    """plain words"""
    noise: str = "ar1"
    """``ar1`` (the campaign's own law) or ``iid``"""
    status: str = "ok"
    """a sentence where something could not be computed"""

    def __repr__(self) -> str:
        """tau, how far it is confounded with the rest, and the status."""
        return (
            f"TauExplained(tau {self.tau:.4g} s, sd of tau^2 {self.sd_square:.4g} s^2, multiple "
            f"correlation {self.collinearity['all']:.4g}; {self.status})"
        )

    def to_json(self) -> dict[str, Any]:
        """The content of ``what_makes_tau_hard`` in ``bounds.json``: numbers, units in the keys;
        null where a bound is infinite."""
        record: dict[str, Any] = plain(
            {
                "tau_s": self.tau,
                "noise": self.noise,
                "names": self.names,
                "eigenvalues": self.eigenvalues,
                "condition": self.condition,
                "weakest": self.weakest,
                "correlation_with_tau": self.correlation,
                "collinearity": self.collinearity,
                "sd_tau_if_known_s": self.known,
                "sd_tau_square_s2": self.sd_square,
                "by_tau": self.by_tau.to_dict("list"),
                "profile": self.curve.to_dict("list"),
                "sentences": self.sentences,
                "status": self.status,
            }
        )
        return record


def to_unit_diagonal(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Information (n, n) in units of one over ``scale`` (n,), and that scale: 0 for a parameter of
    which there is none, as of a lag that is over between two samples.

    >>> to_unit_diagonal(np.diag([4.0, 0.0]))[1]
    array([0.5, 0. ])
    """
    diagonal = np.diag(information)
    scale = np.zeros(len(diagonal))
    scale[diagonal > 0.0] = 1.0 / np.sqrt(diagonal[diagonal > 0.0])
    return information * np.outer(scale, scale), scale


def multiple_correlation(information: FloatArray, i: int, others: list[int]) -> float:
    """R of sensitivity ``i`` on the sensitivities ``others``, from information (n, n).

    R^2 = 1 - 1/(I_ii [I^-1]_ii): the share of tau's effect that the others can reproduce.

    >>> round(multiple_correlation(np.array([[1.0, 0.6], [0.6, 1.0]]), 0, [1]), 6)
    0.6
    """
    scaled, scale = to_unit_diagonal(information)
    others = [j for j in others if scale[j] > 0.0]
    if not others:
        return 0.0
    cross = scaled[i, others]
    explained = float(cross @ np.linalg.solve(scaled[np.ix_(others, others)], cross))
    return float(np.sqrt(min(max(explained, 0.0), 1.0)))


def square_coordinates(layout: Layout, tau: float) -> FloatArray:
    """(n_mean, n_mean) derivatives of theta by (tau^2, .., t0 + tau, tf + tau)."""
    slopes = np.eye(layout.n_mean)
    slopes[layout.tau, layout.tau] = 0.5 / tau
    slopes[layout.all_switches, layout.tau] = -0.5 / tau
    return slopes


def sd_of_square(bound: CramerRao, layout: Layout, tau: float) -> float:
    """sd of tau^2 (s^2), inf where no sample sees tau; stays finite as tau goes to zero."""
    slopes = square_coordinates(layout, tau)
    scaled, scale = to_unit_diagonal(slopes.T @ bound.information @ slopes)
    if scale[layout.tau] == 0.0:
        return inf
    inverse = np.linalg.pinv(scaled, rcond=1e-13, hermitian=True)
    return float(np.sqrt(inverse[layout.tau, layout.tau]) * scale[layout.tau])


def explain_tau(
    campaign: Campaign | Problem,
    theta: Theta,
    sigma: float = PUBLISHED_SIGMA,
    n_curve: int = 41,
    likelihood: tuple[Surface, Maximum] | None = None,
) -> TauExplained:
    """Eigen-analysis, collinearity, bounds under extra knowledge and the profile of tau.

    Under the noise parameters of ``theta`` where it has them, otherwise under iid noise ``sigma``
    (V).  A design is enough; its profile is then the expected one, in tau^2.  ``likelihood``: that
    of the data with its maximum, if it was computed (``Bounds.likelihood``).
    """
    import pandas as pd

    problem = as_problem(campaign)
    refuse_held(problem, "explain_tau")
    layout = problem.layout
    if layout.sensors_are_named:
        raise CampaignError(
            "explain_tau: there are several sensors; give it a campaign with one of them"
        )
    vector = layout.flat(theta).copy()
    coloured = bool(np.isfinite(vector[layout.noise]).all())
    noise = "ar1" if coloured else "iid"
    own = layout.tau
    tau = float(vector[own])
    # at a vanishing tau nothing about tau itself is finite; look where tau is a thousandth of tau_v
    at = vector.copy()
    beside = max((tau, *problem.commuting.lags(vector)[1:].tolist()))
    at[own] = max(tau, 1e-3 * beside)
    bound = cramer_rao(problem, at, sigma, noise=noise)
    others = [i for i in range(layout.n_mean) if i != own]
    values, vectors = np.linalg.eigh(to_unit_diagonal(bound.information)[0])
    direction = vectors[:, 0] * np.sign(vectors[own, 0] or 1.0)
    strongest = np.argsort(-np.abs(direction))
    weakest = {bound.names[i]: float(direction[i]) for i in strongest}
    correlation = {
        bound.names[i]: float(bound.cov[own, i] / np.sqrt(bound.cov[own, own] * bound.cov[i, i]))
        for i in others
    }
    switches = layout.all_switches.tolist()
    rest = [i for i in others if i not in switches]
    collinearity = {
        "switches": multiple_correlation(bound.information, own, switches),
        "others": multiple_correlation(bound.information, own, rest),
        "all": multiple_correlation(bound.information, own, others),
    }
    known = {}
    kinds = {name.split("[")[0] for name in bound.names}
    for label, fixed in KNOWN.items():
        if set(fixed) <= kinds:
            known[label] = bound_of(layout, bound.information, fixed)["tau_s"]
    sd_square = sd_of_square(bound, layout, float(at[own]))
    width = sd_square if np.isfinite(sd_square) else beside**2  # of what is drawn
    by_tau = pd.DataFrame(
        [_at_tau(problem, at, float(t), sigma, noise) for t in _taus(at[own], beside, width)]
    )
    ordered = problem.commuting.by_size(vector)
    lags = problem.commuting.without_volumes.places
    places = [i for i in lags if ordered[i] == tau]
    place = places[0] if places else -1
    if coloured and not problem.campaign.is_design and likelihood is None:
        likelihood = coloured_surface(problem, ordered)
    status = "ok"
    if not places:
        likelihood = None
        status = "the sensor's is the middle lag: the profile is the one to be expected"
    if likelihood is not None and not likelihood[1].converged:
        status = "the likelihood's maximum was not found: the profile is the one to be expected"
        likelihood = None
    curve = _curve(likelihood, place, tau, width, n_curve)
    return TauExplained(
        bound.names, values, weakest, float(np.sqrt(values[-1] / max(values[0], 1e-300))),
        correlation, collinearity, known, tau, sd_square, by_tau, curve,
        _sentences(tau, sd_square, known, collinearity, weakest, noise), noise, status,
    )  # fmt: skip


def _taus(tau: float, beside: float, sd_square: float) -> FloatArray:
    low = 1e-3 * beside
    return np.geomspace(low, max(3.0 * tau, 2.0 * sd_square**0.5, 10.0 * low), 12)


def _at_tau(
    problem: Problem, at: FloatArray, tau: float, sigma: float, noise: str
) -> dict[str, float]:
    vector = at.copy()
    vector[problem.layout.tau] = tau
    bound = cramer_rao(problem, vector, sigma, noise=noise)
    return {
        "tau_s": tau,
        "sd_tau_s": bound["tau_s"],
        "sd_square_s2": sd_of_square(bound, problem.layout, tau),
    }


def _curve(
    likelihood: tuple[Surface, Maximum] | None, place: int, tau: float, sd_square: float, n: int
) -> pd.DataFrame:
    """``place``: where tau stands in theta; 0 where it is the shortest of the lags."""
    import pandas as pd

    centre = tau**2
    if likelihood is not None:
        surface, maximum = likelihood
        profiler = Profiler.of(surface, maximum)
        centre, sd = float(maximum.psi[place]), float(np.sqrt(profiler.cov[place, place]))
        if place > 0:  # which psi holds itself, not its square
            centre, sd = centre**2, 2.0 * centre * sd
        sd_square = sd or sd_square  # zero stands for "not identified"
    # the shorter lag's course down to zero tells how nearly it is a later switch
    low = 0.0 if place == 0 else np.sqrt(max(centre - 3.5 * sd_square, 0.0))
    taus = np.linspace(low, np.sqrt(max(centre, 0.0) + 3.5 * sd_square), n)
    if likelihood is not None:
        drop = profile_curve(profiler, taus, place)
    else:
        drop = 0.5 * ((taus**2 - centre) / sd_square) ** 2
    best = float(np.sqrt(centre))
    sd_tau = sd_square / (2.0 * best) if best > 0 else np.inf
    if sd_tau > taus[-1]:
        sd_tau = np.nan  # wider than the range of tau: nobody would state it
    table = pd.DataFrame(
        {
            "tau_s": taus,
            "drop": drop,
            "gaussian": 0.5 * ((taus - best) / sd_tau) ** 2,
            "square": 0.5 * ((taus**2 - centre) / sd_square) ** 2,
        }
    )
    return table[np.isfinite(table["drop"])].reset_index(drop=True)


def _sentences(
    tau: float,
    sd_square: float,
    known: dict[str, float],
    collinearity: dict[str, float],
    weakest: dict[str, float],
    noise: str,
) -> list[str]:
    law = "coloured noise" if noise == "ar1" else "iid noise"
    switches = collinearity["switches"]
    partners = [name for name in weakest if name != "tau_s"][:4]
    alike = (
        ": a slower sensor and a later valve change it in almost the same way"
        if switches > 0.95
        else ""
    )
    said = [
        f"{100 * switches**2:.1f} % of what tau does to the signal can be reproduced by moving the "
        f"switch times alone, {100 * collinearity['all'] ** 2:.2f} % by moving everything "
        f"else{alike}.",
        f"The direction with the least information combines tau with {', '.join(partners)}.",
    ]
    free = known["nothing"]
    if not np.isfinite(free):
        said.append("To first order these experiments do not identify tau at all.")
    else:
        said += _square_sentences(tau, sd_square, law)
    for label, words in (("t0, tf", "switch times"), ("t0", "start times")):
        if label in known:
            gain = f", {free / known[label]:.1f} times better" if np.isfinite(free) else ""
            said.append(
                f"Were the {words} known, the bound on tau would be {_bound_words(known[label])} "
                f"in place of {_bound_words(free)}{gain}."
            )
            break
    given = [
        f"knowing {label} {'would give ' if i == 0 else ''}{_bound_words(known[label])}"
        for i, label in enumerate(label for label in ("V", "tau_v") if label in known)
    ]
    if given:
        said.append(f"K{', '.join(given)[1:]}.")
    return said


def _square_sentences(tau: float, sd_square: float, law: str) -> list[str]:
    z = normal_factor(0.95)
    low, high = np.sqrt(max(tau**2 - z * sd_square, 0.0)), np.sqrt(tau**2 + z * sd_square)
    return [
        f"Under {law} tau^2 is known to +-{_plain(sd_square * 1e6)} ms^2 (one standard "
        f"deviation), against tau^2 = {_plain(tau**2 * 1e6)} ms^2: "
        f"{_plain(tau**2 / sd_square, 2)} standard deviations "
        "from zero.",
        f"At 95 % that is tau between {1e3 * low:.1f} and {1e3 * high:.1f} ms."
        if low > 0
        else f"At 95 % that is an upper limit: tau below {1e3 * high:.1f} ms.",
    ]


def _plain(value: float, digits: int = 3) -> str:
    """Three digits without a power of ten.

    >>> _plain(2454.3), _plain(0.03214)
    ('2450', '0.0321')
    """
    return f"{float(f'{value:.{digits}g}'):.10g}"


def _bound_words(sd: float) -> str:
    return f"{1e3 * sd:.2g} ms" if np.isfinite(sd) else "no finite one"
