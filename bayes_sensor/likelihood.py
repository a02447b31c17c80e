"""The exact Gaussian log-likelihood of a campaign, the priors, and simulated campaigns.

With r = (y - m)/s, AR(1) coefficient phi over one sample and phi_i over the step to sample i
(phi^(m + 1) across m missing samples), a stationary first sample gives::

    log L = -1/2 sum_i [log 2 pi + log s_i^2]
            -1/2 r_1^2 - 1/2 sum_(i>1) [(r_i - phi_i r_(i-1))^2 / (1 - phi_i^2) + log(1 - phi_i^2)]

(Brockwell and Davis, Time Series: Theory and Methods, 1991, eq. 8.7.4 for the AR(1) case.)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import exp, isfinite, log, pi, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.lags import (
    Assignment,
    Naming,
    assignments,
    by_size,
    common_flow,
    lags_of,
    named,
    places_of_lags,
)
from bayes_sensor.model import (
    SHARED,
    Cascade,
    Layout,
    Theta,
    cascade_response,
    check_name,
    divided_exponential,
    local_parameters,
    time_constants,
)
from bayes_sensor.noise import (
    Noise,
    check_phi,
    lag_coefficient,
    scale_squared,
    simulate_noise,
)

# --------------------------------------------------------------------------- priors


@dataclass(frozen=True)
class Prior:
    """One parameter's prior law: ``kind`` with its two numbers.

    ``half_normal`` (scale), ``log_normal`` (median, sd of the logarithm), ``normal`` (mean, sd),
    ``uniform`` (low, high), ``log_uniform`` (low, high), ``flat`` (improper).

    Raises
    ------
    CampaignError
        If the kind is unknown or its numbers describe no law.
    """

    kind: str
    a: float = 0.0
    b: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise CampaignError(
                f"a prior's kind must be one of {', '.join(KINDS)}, but is '{self.kind}'; "
                "correct it"
            )
        if self.kind == "flat":
            return
        what, holds = {
            "normal": ("a mean and a positive sd", self.b > 0),
            "half_normal": ("a positive scale", self.a > 0),
            "log_normal": ("a positive median and a positive sd", self.a > 0 and self.b > 0),
            "uniform": ("low < high", self.a < self.b),
            "log_uniform": ("0 < low < high", 0 < self.a < self.b),
        }[self.kind]
        if not (holds and isfinite(self.a) and isfinite(self.b)):
            raise CampaignError(f"prior {self}: expected {what}, all finite; correct its numbers")

    def log_density(self, value: FloatArray | float) -> FloatArray:
        """Natural log of the density at ``value`` (any shape); -inf outside; 0 for ``flat``."""
        x = np.asarray(value, dtype=float)
        positive = np.maximum(x, 1e-300)
        if self.kind == "flat":
            return np.zeros_like(x)
        if self.kind == "normal":
            return -0.5 * log(2 * pi) - log(self.b) - 0.5 * ((x - self.a) / self.b) ** 2
        if self.kind == "half_normal":
            inside = x >= 0
            density = 0.5 * log(2 / pi) - log(self.a) - 0.5 * (x / self.a) ** 2
        elif self.kind == "log_normal":
            inside = x > 0
            u = np.log(positive / self.a) / self.b
            density = -0.5 * log(2 * pi) - np.log(self.b * positive) - 0.5 * u * u
        else:
            inside = (x >= self.a) & (x <= self.b)
            if self.kind == "uniform":
                density = np.full_like(x, -log(self.b - self.a))
            else:
                density = -np.log(positive * log(self.b / self.a))
        return np.where(inside, density, -np.inf)

    def scaled(self, factor: float) -> Prior:
        """The law of ``factor`` (positive) times the parameter.

        >>> Prior("uniform", 0.0, 60.0).scaled(0.5), Prior("log_normal", 4.0, 1.5).scaled(0.5).b
        (Prior(kind='uniform', a=0.0, b=30.0), 1.5)
        """
        if self.kind in ("half_normal", "log_normal"):
            return replace(self, a=factor * self.a)
        return replace(self, a=factor * self.a, b=factor * self.b)

    @cached_property
    def law(self) -> Any:
        """The same law as a frozen ``scipy.stats`` distribution; None for ``flat``."""
        from scipy import stats

        laws: dict[str, Callable[[], Any]] = {
            "flat": lambda: None,
            "half_normal": lambda: stats.halfnorm(scale=self.a),
            "log_normal": lambda: stats.lognorm(s=self.b, scale=self.a),
            "normal": lambda: stats.norm(self.a, self.b),
            "uniform": lambda: stats.uniform(self.a, self.b - self.a),
            "log_uniform": lambda: stats.loguniform(self.a, self.b),
        }
        return laws[self.kind]()

    @cached_property
    def width(self) -> float:
        """Half the distance between its 16th and 84th percentile; nan for ``flat``."""
        if self.law is None:
            return float("nan")
        low, high = self.law.ppf([0.16, 0.84])
        return 0.5 * float(high - low)

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value allowed."""
        if self.kind in ("flat", "normal"):
            return -np.inf, np.inf
        return (0.0, np.inf) if self.kind in ("half_normal", "log_normal") else (self.a, self.b)

    def __str__(self) -> str:
        numbers = {"flat": "", "half_normal": f"({self.a:g})"}
        return self.kind.replace("_", "-") + numbers.get(self.kind, f"({self.a:g}, {self.b:g})")


KINDS = ("flat", "normal", "half_normal", "log_normal", "uniform", "log_uniform")

# Scale of the half-normal prior on tau at the published rig, and the time its fastest experiment
# (9 L/min) takes from 10 to 90 %; another rig's scale follows in proportion.
TAU_PRIOR_SCALE = 0.200
PUBLISHED_TIMES = (0.0481, 0.8577, 0.05823 / 0.15)
MOST_RISES = 10.0
"""fastest rises up to which a lag of unknown name is looked for"""
FEWEST_OF_RISE = 16
"""samples of a step from which its rise may be read off"""


def rise_time(t: FloatArray, x: FloatArray) -> float | None:
    """10 to 90 % time of the last lasting rise through one half; earlier spikes do not count."""
    below = np.flatnonzero(x < 0.5)
    if len(below) == 0 or below[-1] + 1 >= len(x):
        return None
    half = below[-1] + 1
    low = np.flatnonzero(x[:half] < 0.1)
    high = np.flatnonzero(x[half:] > 0.9)
    if len(low) == 0 or len(high) == 0:
        return None
    return float(t[half + high[0]] - t[low[-1]])


def published_rise_time() -> float:
    """s, 10 to 90 % of the published model at 9 L/min."""
    t = np.linspace(0.0, 20.0, 20001)
    rise = rise_time(t, cascade_response(t, PUBLISHED_TIMES, 0.0))
    assert rise is not None  # the published response rises
    return rise


def fastest_rise(campaign: Campaign) -> float:
    """s, the shortest 10 to 90 % time among the measured steps.

    Each record is averaged in blocks so that noise hides neither end.  Steps smaller than a tenth
    of the largest, or than twenty times the scatter of these averages, are left out; without any
    usable step the published rig's time is returned.
    """
    seen = _fastest_seen(campaign)
    return published_rise_time() if seen is None else seen


def _fastest_seen(campaign: Campaign) -> float | None:
    """s, the shortest rise among the steps that can be used; None where there is none."""
    seen = [found for e in campaign if e.y is not None and (found := _measured_rise(e))]
    largest = max((step for step, _ in seen), default=0.0)
    return min((rise for step, rise in seen if step >= 0.1 * largest), default=None)


def usual_rise(campaign: Campaign) -> float:
    """s, to one digit: the fastest rise that is seen, or the longest step where none is."""
    seen = _fastest_seen(campaign)
    scale = max(_step_end(e) - _step_begin(e) for e in campaign) if seen is None else seen
    return float(f"{scale:.0e}")


def _step_begin(e: Experiment) -> float:
    return float(e.t[0]) if e.commanded_on is None else e.commanded_on


def _step_end(e: Experiment) -> float:
    return float(e.t[-1]) if e.commanded_off is None else e.commanded_off


def _measured_rise(e: Experiment) -> tuple[float, float] | None:
    """Size of the step (V) and its 10 to 90 % time (s), or None where it cannot be seen."""
    t, y = e.t[e.used], e.values[e.used]
    first, last = np.searchsorted(t, [_step_begin(e), _step_end(e)])
    if last - first < FEWEST_OF_RISE:
        return None
    # averages over a six-hundredth of the stretch: short against any rise that fills a tenth of it
    n_bin = max(1, (last - first) // 600)
    n = (last - first) // n_bin * n_bin
    means = y[first : first + n].reshape(-1, n_bin).mean(axis=1)
    times = t[first : first + n].reshape(-1, n_bin).mean(axis=1)
    tenth = max(min(5, len(means) // 4), len(means) // 10)
    low = float(np.median(means[:3] if first < 20 else y[:first]))
    high = float(np.median(means[-tenth:]))
    scatter = float(np.std(np.diff(means[-tenth:]))) / sqrt(2.0)
    if abs(high - low) < 20.0 * scatter or high == low:
        return None
    rise = rise_time(times, (means - low) / (high - low))
    return None if rise is None else (abs(high - low), max(rise, n_bin * e.interval))


def default_priors(
    campaign: Campaign, layout: Layout, shortest_is_tau: bool | None = None
) -> dict[str, Prior]:
    """Weakly informative priors for every parameter of a campaign, by flat name.

    theta holds lags by size (:mod:`bayes_sensor.lags`): ``tau_s`` is the name of the shortest lag's
    place here, ``tau_v_s`` of the longest's and, at one flow, ``V_mL`` of the middle one's.

    * Where the sensor is said to be the faster lag, as in the paper, the shortest lag is half-
      normal, 200 ms at the published rig and in proportion to the fastest rise seen elsewhere
      (rounded to one digit, so that noise does not move it); the information is on tau^2, so this
      choice matters near zero; see the prior table in the report.  Where flows differ ``tau_v`` is
      log-normal around a third of the fastest rise, sd 1.5 in the logarithm.
    * All other lags that may be exchanged have one law, so that no prior decides which is which:
      uniform up to ten times the fastest rise.
    * ``V``, where flows tell it: log-normal around the volume that flow would fill in a third of
      the rise, sd 1.5.
    * ``t0``, ``tf``: uniform from the commanded time (nothing happens before the command) to the
      next command or the record's end; without commanded times uniform over the record.
    * ``y0``, ``beta``: flat (the data hold them to a thousandth; flat makes the marginal exact).
    * ``phi``: uniform on (-1, 1), or (0, 1) when sampling intervals differ.
    * ``sigma0``, ``sigma1``: half-normal, ten times the campaign's sample-to-sample scatter.

    Side information and priors that the user gives come on top (:attr:`Problem.priors`).
    ``shortest_is_tau``: whether the shortest lag is the sensor's for sure; default as the campaign
    says.
    """
    if shortest_is_tau is None:
        shortest_is_tau = campaign.sensor_is == "faster"
    rise = fastest_rise(campaign)
    scale = TAU_PRIOR_SCALE * rise / published_rise_time()
    scale = float(f"{scale:.0e}")
    flow = float(np.median([e.total_flow for e in campaign]))
    measured = [e for e in campaign if e.y is not None]
    scatter = max((max(_scatter(e), e.rounding) for e in measured), default=1e-9)
    priors: dict[str, Prior] = {
        "tau_s": Prior("half_normal", scale),
        "tau_v_s": Prior("log_normal", rise / 3.0, 1.5),
        "V_mL": Prior("log_normal", flow * rise / 3.0, 1.5),
    }
    if campaign.same_flow or not shortest_is_tau:
        most = MOST_RISES * usual_rise(campaign)
        priors["tau_v_s"] = Prior("uniform", 0.0, most)
        if not shortest_is_tau:
            priors["tau_s"] = Prior("uniform", 0.0, most)
        if campaign.same_flow:
            priors["V_mL"] = Prior("uniform", 0.0, most * flow)
    for e in campaign:
        priors[f"y0_V[{e.name}]"] = Prior("flat")
        priors[f"beta_V[{e.name}]"] = Prior("flat")
        end = float(e.t[-1])
        priors[f"t0_s[{e.name}]"] = Prior("uniform", _step_begin(e), _step_end(e))
        if e.has_fall:
            priors[f"tf_s[{e.name}]"] = Prior("uniform", _step_end(e), end)
    for name in layout.noise_names:
        kind = name.split("[")[0]
        if kind == "phi":
            priors[name] = Prior("uniform", -1.0 if campaign.same_interval else 0.0, 1.0)
        else:
            priors[name] = Prior("half_normal", 10.0 * scatter)
    return priors


def _scatter(e: Experiment) -> float:
    y = e.values[e.used]
    return float(np.std(y[: max(10, len(y) // 10)])) + float(np.std(np.diff(y)))


# --------------------------------------------------------------------------- the problem


@dataclass(frozen=True, eq=False)
class Problem:
    """A campaign with the model, the noise law and the priors that explain it.

    Effects return a changed Problem: another ``model`` (with ``extra`` parameters), another
    ``noise``, further ``priors``; nothing else needs to know.

    A model is any object with ``extra`` (names of its own parameters, units included),
    ``response(t, theta, layout, experiment)`` and ``mean(..)`` (n_t,), smooth in ``t`` between the
    switch times.  It may further have

    * ``mean_and_response(t, theta, layout, experiment)``, both at the price of one,
    * ``affine``: True where the mean is y0 + beta times something plus something, both of them
      and the response free of y0 and beta (taken for granted where the mean is the cascade's),
    * ``kinks(low, high, layout, experiment)``: stretches (start, end) in s, for theta between
      ``low`` and ``high`` (n_theta,), in which the mean or the response may jump or bend other
      than at t0 and tf.
    """

    campaign: Campaign
    model: Cascade = field(default_factory=Cascade)
    noise: Noise = field(default_factory=Noise)
    given_priors: Mapping[str, Prior] = field(default_factory=dict)
    """priors that replace the default ones, by flat name; one for ``phi``, ``sigma0_V`` or
    ``sigma1_V`` also serves every experiment that has its own, and those of experiments that are
    not in the campaign wait"""

    @cached_property
    def layout(self) -> Layout:
        """Order of the flat vector."""
        return Layout.of(self.campaign, self.noise.per_experiment, self.model.extra)

    @cached_property
    def named_laws(self) -> dict[str, Prior]:
        """What is known of tau, tau_v and V by name: side information, or a prior that is given."""
        known = {
            name: Prior("normal", info.mean, info.sd)
            for name, info in self.campaign.side_information.items()
        }
        return {name: law for name, law in {**known, **self.given_priors}.items() if name in SHARED}

    @cached_property
    def assignments(self) -> tuple[Assignment, ...]:
        """The ways in which the campaign's lags may be named, all of one prior probability."""
        one_flow = self.campaign.same_flow
        return assignments(self.campaign.sensor_is, one_flow, "V_mL" in self.named_laws)

    @cached_property
    def flow(self) -> float | None:
        """mL/s, the total flow where all experiments share one, else None."""
        return common_flow(self.campaign)

    @cached_property
    def priors(self) -> dict[str, Prior]:
        """The prior law of every place in theta, by flat name.

        Lags stand in theta by size (see :func:`default_priors`).  What is known by name replaces
        the law of its place where all possible assignments of names agree on that; where they do
        not it weighs them (:attr:`name_factors`), and the laws of the places stay as they are.

        Raises CampaignError where one is given for a name that no parameter has.
        """
        # not when it is made: a problem may be on its way to another model, with its parameters
        for name in self.given_priors:
            check_name(self.layout, name, "Problem.given_priors")
        given = {name: law for name, law in self.given_priors.items() if name not in SHARED}
        for name in self.layout.noise_names:
            kind = name.split("[")[0]
            if kind in given:
                given.setdefault(name, given[kind])
        settled = self._settled
        for name, law in self.named_laws.items():
            if name in settled:
                given[SHARED[settled[name]]] = law
        faster = self.campaign.sensor_is == "faster" and settled.get("tau_s") == 0
        return {**default_priors(self.campaign, self.layout, faster), **given}

    @cached_property
    def _settled(self) -> dict[str, int]:
        """Place in theta of tau, tau_v and V, where it is the same in all assignments."""
        found = {}
        for name, role in (("tau_s", "sensor"), ("tau_v_s", "valve"), ("V_mL", "manifold")):
            places = {getattr(choice, role) for choice in self.assignments}
            if len(places) == 1:
                (place,) = places
                # V where flows tell it, else a lag
                found[name] = 2 if place is None else places_of_lags(self.flow)[place]
        return found

    @cached_property
    def lag_priors(self) -> tuple[Prior, ...]:
        """The prior law of every lag (s) that the flows do not tell apart, shortest first."""
        shortest, longest, volume = (self.priors[name] for name in SHARED)
        if self.flow is None:
            return shortest, longest
        return shortest, volume.scaled(1.0 / self.flow), longest

    def prior_of_tau(self, theta: FloatArray) -> Prior:
        """The prior law of the sensor's lag at ``theta`` (n_theta,), which is by name: what is
        known of it, or the law of its place among the lags."""
        if "tau_s" in self.named_laws:
            return self.named_laws["tau_s"]
        place = self.naming().place("sensor")
        if place is None:
            lags = lags_of(by_size(theta, self.flow), self.flow)
            place = int(np.argmin(np.abs(lags - theta[0])))
        return self.lag_priors[place]

    @cached_property
    def name_factors(self) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray]:
        """What is known by name and weighs the assignments, as factors of the prior.

        The law of factor ``j`` under assignment ``a`` is ``KINDS[kind[j]]`` with ``numbers[j]``, at
        ``theta[place[a, j]] * scale[a, j]``: place (n_assignments, n_factors), kind (n_factors,),
        numbers (n_factors, 2), scale (n_assignments, n_factors).  The prior is the mean over the
        assignments of their products, on top of the uniform law that all lags have.
        """
        names = [
            name
            for name, law in self.named_laws.items()
            if name not in self._settled and law.kind != "flat"
        ]
        places = places_of_lags(self.flow)
        # what makes a lag of theta's values there
        to_lag = (1.0, 1.0) if self.flow is None else (1.0, 1.0 / self.flow, 1.0)
        shape = (len(self.assignments), len(names))
        place, scale = np.zeros(shape, dtype=np.int64), np.ones(shape)
        for a, assignment in enumerate(self.assignments):
            whose = {
                "tau_s": assignment.sensor,
                "tau_v_s": assignment.valve,
                "V_mL": assignment.manifold or 0,
            }
            for j, name in enumerate(names):
                place[a, j] = places[whose[name]]
                scale[a, j] = to_lag[whose[name]]
                if name == "V_mL" and self.flow is not None:
                    scale[a, j] *= self.flow
        laws = [self.named_laws[name] for name in names]
        kind = np.array([KINDS.index(law.kind) for law in laws], dtype=np.int64)
        return place, kind, np.array([(law.a, law.b) for law in laws]).reshape(-1, 2), scale

    def log_weights(self, thetas: FloatArray) -> FloatArray:
        """(.., n_assignments) log of what is known by name under every assignment, at ``thetas``
        (.., n_theta) that hold lags by size."""
        place, kind, numbers, scale = self.name_factors
        total = np.zeros((*thetas.shape[:-1], len(self.assignments)))
        for j in range(len(kind)):
            law = Prior(KINDS[kind[j]], *numbers[j])
            total += law.log_density(thetas[..., place[:, j]] * scale[:, j])
        return total

    def naming(self, probabilities: FloatArray | None = None) -> Naming:
        """What may be said of the lags' names.

        ``probabilities`` (n_assignments,) of the assignments: default equal.
        """
        n = len(self.assignments)
        shares = np.full(n, 1.0 / n) if probabilities is None else probabilities
        return Naming(
            self.campaign.sensor_is, self.assignments, tuple(map(float, shares)), self.flow
        )

    def shares(self, thetas: FloatArray) -> FloatArray:
        """(.., n_assignments) probability of every assignment at ``thetas`` (.., n_theta)."""
        weights = self.log_weights(thetas)
        found: FloatArray = np.exp(weights - np.logaddexp.reduce(weights, axis=-1)[..., None])
        return found

    def by_size(self, theta: Theta) -> FloatArray:
        """:meth:`flat` with the lags in the places that they have by size.

        Where the campaign says that the sensor is the faster lag, ``theta`` is taken to mean that.
        """
        vector = self.flat(theta)
        if self.flow is None and self.campaign.sensor_is == "faster":
            return vector
        return by_size(vector, self.flow)

    def by_name(self, theta: Theta) -> FloatArray:
        """:meth:`flat` with tau, tau_v and V in the first three places.

        A mapping says which lag is which.  A flat vector may come from a fit or a posterior, with
        lags by size: then the campaign has to say it.

        Raises CampaignError where neither does.
        """
        vector = self.flat(theta)
        if isinstance(theta, Mapping) or self.campaign.sensor_is == "faster":
            return vector
        if self.naming().order == "undecided":
            raise CampaignError(
                f"{self.campaign.source or self.campaign.title}: expected to be told which lag is "
                "the sensor's, but [rig] sensor_is is unknown and theta has no names; say "
                'sensor_is = "faster" or "slower" in the campaign, or give theta as a mapping'
            )
        vector[:3] = named(by_size(vector, self.flow), self.flow, self.assignments)
        return vector

    @cached_property
    def fixed(self) -> dict[str, float]:
        """Flat names that the noise law pins, with their values."""
        pinned = self.noise.fixed
        return {
            name: pinned[name.split("[")[0]]
            for name in self.layout.noise_names
            if name.split("[")[0] in pinned
        }

    def flat(self, theta: Theta) -> FloatArray:
        """The flat vector (n_theta,) of ``theta``, a new one, under this problem's noise law.

        What the law pins (:attr:`fixed`) has its pinned value whatever ``theta`` says, as in a fit
        or a posterior of this problem: a ``theta`` made under another law can be used.

        Raises CampaignError as :meth:`Layout.flat`.
        """
        vector = self.layout.flat(theta)
        for name, value in self.fixed.items():
            vector[self.layout.index(name)] = value
        return vector

    @cached_property
    def prior_table(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Place of each law in ``KINDS`` (n_theta,), its numbers (n_theta, 2); pinned: flat.

        Raises CampaignError where a parameter of the model has no prior.
        """
        missing = [name for name in self.layout.extra if name not in self.priors]
        if missing:
            raise CampaignError(
                f"the model's parameter '{missing[0]}' has no prior; give one in "
                f"Problem.given_priors, such as {{'{missing[0]}': Prior('normal', 0.0, 1.0)}}"
            )
        table = np.zeros((len(self.layout), 2))
        kinds = np.full(len(self.layout), KINDS.index("flat"))
        for i, name in enumerate(self.layout.names):
            if name not in self.fixed:
                prior = self.priors[name]
                kinds[i], table[i] = KINDS.index(prior.kind), (prior.a, prior.b)
        return kinds, table

    def steps(self, experiment: Experiment) -> float:
        """The experiment's sampling interval in reference intervals."""
        return experiment.interval / self.campaign.reference_interval


def as_problem(campaign: Campaign | Problem) -> Problem:
    """A Problem with the default model and noise where a campaign is given."""
    return campaign if isinstance(campaign, Problem) else Problem(campaign)


def log_priors(problem: Problem, thetas: FloatArray) -> FloatArray:
    """(n,) natural log of the prior density at each row of ``thetas`` (n, n_theta).

    Flat laws count as 0, pinned parameters are left out; -inf outside the support, which holds
    lags by size only: tau <= tau_v, and V/Q between them at one flow.
    """
    thetas = np.ascontiguousarray(np.atleast_2d(thetas), dtype=float)
    total = np.empty(len(thetas))
    flow = 0.0 if problem.flow is None else problem.flow
    _sum_log_priors(thetas, *problem.prior_table, flow, total)
    if len(problem.name_factors[1]):
        total += np.logaddexp.reduce(problem.log_weights(thetas), axis=-1)
        total -= log(len(problem.assignments))
    return total


@njit(cache=True, error_model="numpy")
def _sum_log_priors(
    thetas: FloatArray,
    kinds: NDArray[np.int64],
    table: FloatArray,
    flow: float,
    total: FloatArray,
) -> None:  # pragma: no cover - compiled
    # Prior.log_density for every parameter, in the order of KINDS; -inf where lags are not by size
    # (flow: that of all experiments, or 0 where flows differ)
    for n in range(len(thetas)):
        total[n] = -np.inf if thetas[n, 0] > thetas[n, 1] else 0.0
        if flow > 0.0 and not thetas[n, 0] * flow <= thetas[n, 2] <= thetas[n, 1] * flow:
            total[n] = -np.inf
        for i in range(len(kinds)):
            x, a, b = thetas[n, i], table[i, 0], table[i, 1]
            if kinds[i] == 0:
                continue
            elif kinds[i] == 1:
                value = -0.5 * log(2 * pi) - log(b) - 0.5 * ((x - a) / b) ** 2
            elif kinds[i] == 2:
                value = 0.5 * log(2 / pi) - log(a) - 0.5 * (x / a) ** 2 if x >= 0.0 else -np.inf
            elif kinds[i] == 3:
                value = -np.inf
                if x > 0.0:
                    value = -0.5 * log(2 * pi) - log(b * x) - 0.5 * (log(x / a) / b) ** 2
            elif not a <= x <= b:
                value = -np.inf
            elif kinds[i] == 4:
                value = -log(b - a)
            else:
                value = -log(x * log(b / a))
            total[n] += value


def log_prior_derivatives(problem: Problem, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First derivative of the log prior and minus the second where that is positive, (n,) each."""
    first, second = np.zeros(len(theta)), np.zeros(len(theta))
    _prior_derivatives(theta, *problem.prior_table, first, second)
    place, kind, numbers, scale = problem.name_factors
    if len(kind):
        weights = problem.log_weights(theta)
        with np.errstate(invalid="ignore"):  # where none is possible the prior is zero anyway
            share = np.exp(weights - np.logaddexp.reduce(weights))
        slopes, curves = np.zeros((2, len(weights), len(theta)))
        for a in np.flatnonzero(share > 0.0):
            slope, curve = np.zeros(len(kind)), np.zeros(len(kind))
            _prior_derivatives(theta[place[a]] * scale[a], kind, numbers, slope, curve)
            np.add.at(slopes[a], place[a], slope * scale[a])
            np.add.at(curves[a], place[a], curve * scale[a] ** 2)
        mean = share @ slopes
        first += mean
        # the mixture is flatter than its parts by the spread of their slopes
        second += np.maximum(share @ curves - (share @ slopes**2 - mean**2), 0.0)
    return first, second


@njit(cache=True, error_model="numpy")
def _prior_derivatives(
    theta: FloatArray,
    kinds: NDArray[np.int64],
    table: FloatArray,
    first: FloatArray,
    second: FloatArray,
) -> None:  # pragma: no cover - compiled
    for i in range(len(kinds)):
        x, a, b = theta[i], table[i, 0], table[i, 1]
        if kinds[i] == 1:
            second[i] = 1.0 / b**2
            first[i] = (a - x) * second[i]
        elif kinds[i] == 2:
            second[i] = 1.0 / a**2
            first[i] = -x * second[i]
        elif kinds[i] == 3:
            u = log(x / a) / b**2
            first[i] = -(1.0 + u) / x
            second[i] = max(1.0 / b**2 - 1.0 - u, 0.0) / x**2
        elif kinds[i] == 5:
            first[i] = -1.0 / x


def log_prior(campaign: Campaign | Problem, theta: Theta) -> float:
    """Natural log of the prior density at ``theta``; -inf outside the support.

    Lags may be given in any order, but where the campaign says that the sensor is the faster one.
    """
    problem = as_problem(campaign)
    return float(log_priors(problem, problem.by_size(theta)[None])[0])


# --------------------------------------------------------------------------- the full pass


@njit(cache=True)
def _fill_cascade(
    first: float, h: float, rates: FloatArray, edge: float, sign: float, x: FloatArray
) -> None:  # pragma: no cover - compiled
    # Adds sign * x3(t - edge) to x.  Inside blocks of 64 samples x3 = 1 - row(i) . v with v the
    # distance of the three stages from 1 at the block's start; v itself is propagated by the exact
    # lower-triangular exponential, so that coinciding time constants need no special case.
    n = len(x)
    start = int(np.ceil((edge - first) / h - 1e-9))
    if start < 0:
        start = 0
    if start >= n:
        return
    s = max(first + start * h - edge, 0.0)
    a1, a2, a3 = rates[0], rates[1], rates[2]
    block = 64
    rows = np.empty((block + 1, 3))
    pair = np.empty(2)
    step = np.empty((3, 3))
    for i in range(block + 1):
        u = i * h
        pair[0] = a2
        pair[1] = a3
        rows[i, 2] = exp(-a3 * u)
        rows[i, 1] = -a3 * divided_exponential(pair, u)
        rows[i, 0] = a2 * a3 * divided_exponential(rates, u)
    u = block * h
    pair[0] = a1
    pair[1] = a2
    step[0, 0] = exp(-a1 * u)
    step[1, 0] = -a2 * divided_exponential(pair, u)
    step[1, 1] = exp(-a2 * u)
    step[2, :] = rows[block]
    # distances from 1 at the first sample: survival functions of 1, 2 and 3 stages
    v1 = exp(-a1 * s)
    v2 = exp(-a2 * s) - a2 * divided_exponential(pair, s)
    pair[0] = a2
    pair[1] = a3
    v3 = exp(-a3 * s) - a3 * divided_exponential(pair, s) + a2 * a3 * divided_exponential(rates, s)
    i = start
    while i < n:
        m = min(block, n - i)
        if v1 + v2 + v3 < 1e-17:
            for k in range(i, n):
                x[k] += sign
            return
        for k in range(m):
            x[i + k] += sign * (1.0 - (rows[k, 0] * v1 + rows[k, 1] * v2 + rows[k, 2] * v3))
        w3 = step[2, 0] * v1 + step[2, 1] * v2 + step[2, 2] * v3
        w2 = step[1, 0] * v1 + step[1, 1] * v2
        v1 *= step[0, 0]
        v2 = w2
        v3 = w3
        i += m


def grid_response(
    experiment: Experiment, taus: FloatArray, t0: float, tf: float | None
) -> FloatArray:
    """x3 (n_t,) on the experiment's own grid: :func:`cascade_response`, by recurrence, fast."""
    x = np.zeros(len(experiment.t))
    rates = np.sort(1.0 / taus)
    _fill_cascade(experiment.t[0], experiment.interval, rates, t0, 1.0, x)
    if tf is not None:
        _fill_cascade(experiment.t[0], experiment.interval, rates, tf, -1.0, x)
    return x


@njit(cache=True, error_model="numpy")
def _log_density(
    y: FloatArray,
    m: FloatArray,
    s2: FloatArray,
    runs: NDArray[np.int64],
    phi: float,
    phi_reference: float,
    steps: float,
) -> float:  # pragma: no cover - compiled
    # runs (n_runs, 2); phi over one sample; across a gap phi_reference ** (steps * distance)
    total = 0.0
    n = 0
    last = 0.0
    last_index = 0
    innovation = 1.0 - phi * phi
    log_innovation = log(innovation)
    for run in range(len(runs)):
        a, b = runs[run, 0], runs[run, 1]
        n += b - a
        z = (y[a] - m[a]) / sqrt(s2[a])
        if run == 0:
            total += z * z
        else:
            distance = a - last_index
            across = phi**distance if phi_reference < 0 else phi_reference ** (steps * distance)
            rest = 1.0 - across * across
            e = z - across * last
            total += e * e / rest + log(rest)
        product = 1.0
        squares = 0.0
        unit = 1.0 / s2[a]  # of the variance, whatever the volts are
        total -= (b - a) * log(unit)
        for i in range(a + 1, b):
            z_next = (y[i] - m[i]) / sqrt(s2[i])
            e = z_next - phi * z
            squares += e * e
            z = z_next
            product *= s2[i] * unit
            # products leave the range of doubles long after 8 factors of any sensible variance
            if (i - a) & 7 == 0:
                total += log(product)
                product = 1.0
        total += log(product) + squares / innovation + (b - a - 1) * log_innovation
        last = z
        last_index = b - 1
    return -0.5 * (total + n * log(2.0 * pi))


def noise_in_range(
    problem: Problem, vector: FloatArray, k: int
) -> tuple[float, float, float, float] | None:
    """phi over one sample, phi, sigma0, sigma1 (V) of experiment number ``k``; None where one of
    them or a time constant has a value that no likelihood allows.

    Raises CampaignError where the flat vector (n_theta,) has no sigma0.
    """
    phi_reference, sigma0, sigma1 = (float(v) for v in vector[problem.layout.noise[k]])
    if np.isnan(sigma0):
        raise CampaignError("theta lacks sigma0_V; a likelihood needs the noise's size in volts")
    if not (abs(phi_reference) < 1.0 and sigma0 > 0.0 and sigma1 >= 0.0):
        return None
    if problem.noise.fading and sigma1 == 0.0:
        return None  # no noise at all is left at the highest concentration
    phi = lag_coefficient(phi_reference, problem.steps(problem.campaign.experiments[k]))
    if not (abs(phi) < 1.0 and (vector[:3] > 0).all()):
        return None
    return phi, phi_reference, sigma0, sigma1


def experiment_log_likelihood(
    problem: Problem, vector: FloatArray, k: int, y: FloatArray | None = None
) -> float:
    """Log density of experiment number ``k`` at the flat vector; -inf outside the noise's range."""
    e = problem.campaign.experiments[k]
    noise = noise_in_range(problem, vector, k)
    if noise is None:
        return -np.inf
    phi, phi_reference, _, _ = noise
    values, steps = e.values if y is None else y, problem.steps(e)
    if is_affine(problem):  # from its own level a signal far from zero keeps its digits
        i_y0 = problem.layout.local[k, 0]
        values, vector = values - vector[i_y0], vector.copy()
        vector[i_y0] = 0.0
    mean, s2 = mean_and_variance(problem, vector, k)
    return float(_log_density(values, mean, s2, e.runs, phi, phi_reference, steps))


def mean_and_response(
    problem: Problem, vector: FloatArray, e: Experiment, t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean (n_t,) V and response (n_t,) of any model at any times ``t`` (n_t,) s."""
    layout, model = problem.layout, problem.model
    together = getattr(model, "mean_and_response", None)
    if together is not None:
        mean, x = together(t, vector, layout, e)
        return mean, x
    x = model.response(t, vector, layout, e)
    if has_plain_mean(problem):
        y0, beta, _, _ = local_parameters(vector, layout, e.name)
        return y0 + beta * x, x
    return model.mean(t, vector, layout, e), x


def has_plain_mean(problem: Problem) -> bool:
    """Whether the mean is y0 + beta x with x the model's response."""
    model = problem.model
    return type(model).mean is Cascade.mean and not hasattr(model, "mean_and_response")


def is_affine(problem: Problem) -> bool:
    """Whether the mean is y0 + beta a(t) + b(t) with a, b and the response free of both."""
    model = problem.model
    return bool(getattr(model, "affine", type(model).mean is Cascade.mean))


def mean_on_grid(problem: Problem, vector: FloatArray, k: int) -> FloatArray:
    """Mean (n_t,) V of experiment number ``k`` on its grid."""
    e, model = problem.campaign.experiments[k], problem.model
    if type(model) is Cascade and model.method == "exact":
        y0, beta, t0, tf = local_parameters(vector, problem.layout, e.name)
        taus = time_constants(vector[0], vector[1], vector[2], e.total_flow)
        mean = grid_response(e, taus, t0, tf)
        mean *= beta
        mean += y0
        return mean
    return mean_and_response(problem, vector, e, e.t)[0]


def mean_and_variance(
    problem: Problem, vector: FloatArray, k: int
) -> tuple[FloatArray, FloatArray]:
    """Mean (n_t,) V and noise variance (n_t,) V^2 of experiment number ``k`` on its grid."""
    layout, model = problem.layout, problem.model
    e = problem.campaign.experiments[k]
    _, sigma0, sigma1 = vector[layout.noise[k]]
    law = problem.noise.weight(problem.campaign, e), problem.noise.fading
    if type(model) is Cascade and model.method == "exact":
        y0, beta, t0, tf = local_parameters(vector, layout, e.name)
        taus = time_constants(vector[0], vector[1], vector[2], e.total_flow)
        x = grid_response(e, taus, t0, tf)
        return y0 + beta * x, scale_squared(x, sigma0, sigma1, *law)
    mean, x = mean_and_response(problem, vector, e, e.t)
    return mean, scale_squared(x, sigma0, sigma1, *law)


def log_likelihood(campaign: Campaign | Problem, theta: Theta) -> float:
    """Exact Gaussian log-likelihood of all samples at ``theta``; -inf outside its range.

    What the problem's noise law pins has its pinned value there (:meth:`Problem.flat`).

    Raises CampaignError for a malformed ``theta`` or a design without data.
    """
    problem = as_problem(campaign)
    vector = problem.flat(theta)
    return sum(experiment_log_likelihood(problem, vector, k) for k in range(len(problem.campaign)))


# --------------------------------------------------------------------------- simulation


def _check_noise(problem: Problem, vector: FloatArray, k: int) -> None:
    """Raise CampaignError where experiment number ``k`` cannot have such noise."""
    e = problem.campaign.experiments[k]
    check_phi(float(vector[problem.layout.noise[k, 0]]), problem.steps(e), e.name)
    for i in problem.layout.noise[k, 1:]:
        if vector[i] < 0.0:
            raise CampaignError(
                f"theta: {problem.layout.names[i]} is {vector[i]:g}; expected a size of noise, "
                "zero or more: correct it"
            )


def simulate(campaign: Campaign | Problem, theta: Theta, seed: int = 1) -> Campaign:
    """A campaign of the same design with data drawn from the model at ``theta``.

    Noise is that of the problem's noise law with theta's phi, sigma0, sigma1 (absent: white,
    constant; sigma0 absent: no noise); what the law pins has its pinned value
    (:meth:`Problem.flat`).  One seed gives one campaign; every experiment has its own stream by its
    place.  Leaving out the last one does not change the others as long as the highest concentration
    and the most common interval, to which sigma1 and phi refer, remain the same.

    Raises CampaignError for a malformed ``theta``, and where it holds nan, a size of noise below
    zero or a phi that an experiment's noise cannot have.
    """
    problem = as_problem(campaign)
    layout = problem.layout
    vector = problem.flat(theta)
    i_sigma0 = layout.noise[:, 1]
    vector[i_sigma0] = np.where(np.isnan(vector[i_sigma0]), 0.0, vector[i_sigma0])
    if not np.isfinite(vector).all():
        i = int(np.argmin(np.isfinite(vector)))
        raise CampaignError(
            f"theta: {layout.names[i]} is {vector[i]}; a simulation needs a number: give one"
        )
    for k in range(len(problem.campaign)):
        _check_noise(problem, vector, k)
    streams = np.random.SeedSequence(seed).spawn(len(problem.campaign))
    values = {}
    for k, (e, stream) in enumerate(zip(problem.campaign, streams, strict=True)):
        mean, s2 = mean_and_variance(problem, vector, k)
        phi = lag_coefficient(float(vector[layout.noise[k, 0]]), problem.steps(e))
        rng = np.random.default_rng(stream)
        values[e.name] = mean + simulate_noise(np.sqrt(s2), phi, rng)
    return replace(problem.campaign.with_data(values), warnings=())
