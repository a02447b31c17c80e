"""Design: predicted intervals of tau with additional knowledge, and the next experiments.

Predictions are posterior-like.  Data are expected at the truth and their information is Gaussian in
(tau^2, tau_v, V, t0 + tau, tf + tau, ..), so that with everything else integrated out::

    p(tau) ~ exp(-D(tau)/2) half-normal(tau),   D = (dq, dtau) M (dq, dtau)',
    dq = tau^2 - tau_true^2,  dtau = tau - tau_true

where M_qq is the information of the records on tau^2.  The other entries come from knowledge of t0,
such as a trigger.  The interval is that density's equal-tailed one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray, counted
from bayes_sensor.io.json_files import plain
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.mesh import expected_information
from bayes_sensor.likelihood.noise import Noise, lag_coefficient
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.posterior import FASTEST, sample_posterior
from bayes_sensor.rig.cascade import local_parameters
from bayes_sensor.rig.layout import Layout, Theta

if TYPE_CHECKING:
    import pandas as pd

COMMON = ("tau^2", "tau", "tau_v", "V", "phi", "sigma0", "sigma1")
EXACT = 1e-6
"""s, sd of a switch time that counts as known exactly"""
AS_GOOD = 0.03
"""share of the gain that is sacrificed for a shorter experiment"""
BEGIN, END = 0.2, 0.6
"""when a proposed experiment's step starts and ends, as fractions of its duration"""


# --------------------------------------------------------------------------- prediction


@dataclass(frozen=True)
class Setting:
    """One planned experiment: its design and its own parameters."""

    experiment: Experiment
    y0: float
    beta: float
    t0: float
    tf: float | None
    weight: float
    """of sigma1^2 x3 in the variance (concentration over the campaign's highest)"""


@dataclass(frozen=True)
class Truth:
    """Shared parameters and noise for which a prediction is made; s, mL, V."""

    tau: float
    tau_v: float
    V: float
    phi: float
    sigma0: float
    sigma1: float
    noise: Noise
    interval: float
    """s, that phi refers to"""


@dataclass(frozen=True)
class Prediction:
    """The expected interval of tau."""

    sd: float
    """s, the Cramer-Rao bound at the true tau"""
    sd_square: float
    """s^2, of tau^2 without knowledge of the switch times"""
    low68: float
    high68: float
    low95: float
    high95: float

    @property
    def half_width95(self) -> float:
        """s, half the length of the 95 % interval."""
        return 0.5 * (self.high95 - self.low95)


def settings_of(problem: Problem, vector: FloatArray) -> list[Setting]:
    """The campaign's experiments as settings, data left out."""
    settings = []
    for e in problem.campaign:
        y0, beta, t0, tf = local_parameters(vector, problem.layout, e.name)
        weight = problem.noise.weight(problem.campaign, e)
        settings.append(Setting(replace(e, y=None), y0, beta, t0, tf, weight))
    return settings


def truth_of(problem: Problem, vector: FloatArray) -> Truth:
    """Shared parameters of a flat vector; the first experiment's noise where each has its own."""
    phi, sigma0, sigma1 = (float(v) for v in vector[problem.layout.noise[0]])
    if not (np.isfinite(sigma0) and sigma0 > 0):
        raise CampaignError("theta lacks sigma0_V; a prediction needs the noise's size in volts")
    tau, tau_v, V = (float(v) for v in vector[:3])
    law = replace(problem.noise, per_experiment=False)
    return Truth(tau, tau_v, V, phi, sigma0, sigma1, law, problem.campaign.reference_interval)


def record_information(setting: Setting, truth: Truth, tau: float) -> FloatArray:
    """Information (n, n) of one experiment's record on (tau^2, tau, tau_v, V, y0, beta, t0 + tau,
    tf + tau, phi, sigma0, sigma1), sensitivities taken at ``tau`` (s, positive).

    Rows of tau itself are zero: see :func:`information_of`.
    """
    e = setting.experiment
    alone = Campaign("one", (e,), sensor_is="faster")  # one lag of each: nothing to tell apart
    problem = Problem(alone, noise=truth.noise)
    steps = e.interval / truth.interval
    phi = lag_coefficient(truth.phi, steps)
    own = truth.noise.weight(alone, e)
    times = setting.weight / own if own > 0 else 0.0
    sigma1 = truth.noise.referred(truth.sigma0, truth.sigma1, times)
    local = [setting.y0, setting.beta, setting.t0 + truth.tau - tau]
    if setting.tf is not None:
        local.append(setting.tf + truth.tau - tau)
    vector = np.array([tau, truth.tau_v, truth.V, *local, phi, truth.sigma0, sigma1])
    information = expected_information(problem, vector)
    n = len(vector)
    # theta by (tau^2, tau_v, V, y0, beta, t0 + tau, tf + tau, noise), and a column for tau itself
    slopes = np.eye(n)
    slopes[0, 0] = 0.5 / tau
    slopes[5 : 3 + len(local), 0] = -0.5 / tau
    slopes[-3, -3] = steps * phi / truth.phi if truth.phi != 0 else float(steps == 1.0)
    slopes[-1, -2:] = truth.noise.referred_slopes(truth.sigma0, truth.sigma1, times)
    full = np.zeros((n + 1, n + 1))
    place = np.array([0, *range(2, n + 1)])
    full[np.ix_(place, place)] = slopes.T @ information @ slopes
    return full


Known = dict[tuple[Setting, Truth, float], FloatArray]
"""informations of records that were computed before"""


def information_of(
    setting: Setting,
    truth: Truth,
    tau: float,
    trigger: float | None = None,
    known: Known | None = None,
) -> FloatArray:
    """(7, 7) information of one experiment on :data:`COMMON`, its y0, beta, t0, tf eliminated.

    ``tau`` (s, positive): where sensitivities are taken.  ``trigger``: sd (s) with which the switch
    times are known beforehand.
    """
    known = {} if known is None else known
    key = (setting, truth, tau)
    if key not in known:
        known[key] = record_information(setting, truth, tau)
    full = known[key].copy()
    n = len(full)
    if trigger is not None:
        precision = 1.0 / max(trigger, EXACT) ** 2
        for i in range(6, n - 3):  # t0 + tau - tau is normal about the triggered time
            full[i, i] += precision
            full[1, 1] += precision
            full[1, i] -= precision
            full[i, 1] -= precision
    return _eliminate(full, [0, 1, 2, 3, n - 3, n - 2, n - 1])


def _eliminate(information: FloatArray, keep: Sequence[int]) -> FloatArray:
    """Information on ``keep`` once the other parameters are estimated too (Schur complement)."""
    keep = list(keep)
    rest = [i for i in range(len(information)) if i not in keep and information[i, i] > 0]
    if not rest:
        return information[np.ix_(keep, keep)]
    scale = 1.0 / np.sqrt(np.diag(information)[rest])
    inner = information[np.ix_(rest, rest)] * np.outer(scale, scale)
    across = information[np.ix_(keep, rest)] * scale
    result: FloatArray = information[np.ix_(keep, keep)] - across @ np.linalg.solve(inner, across.T)
    return result


def predict_tau(
    common: FloatArray, tau: float, prior: Prior | None = None, V_sd: float | None = None
) -> Prediction:
    """Interval of tau (s) from information (7, 7) on :data:`COMMON`, expected at the true ``tau``.

    ``prior`` on tau (default flat on tau > 0); ``V_sd``: V known beforehand to this (mL).
    """
    common = common.copy()
    if V_sd is not None:
        common[3, 3] += 1.0 / max(V_sd, 1e-9) ** 2
    M = _eliminate(common, [0, 1])
    q = tau**2
    sd_square = float(1.0 / np.sqrt(M[0, 0])) if M[0, 0] > 0 else np.inf
    slope = np.array([2.0 * tau, 1.0])
    information = float(slope @ M @ slope)
    top = float(np.sqrt(q + 9.0 * sd_square)) if np.isfinite(sd_square) else 10.0 * max(tau, 1.0)
    bottom = 0.0
    for _ in range(3):  # look where the density is
        taus = np.linspace(bottom, top, 4001)
        d = np.stack([taus**2 - q, taus - tau])
        log_density = -0.5 * np.einsum("in,ij,jn->n", d, M, d)
        if prior is not None:
            log_density += prior.log_density(taus)
        inside = np.flatnonzero(log_density > log_density.max() - 30.0)
        width = taus[1] - taus[0]
        bottom, top = max(taus[inside[0]] - width, 0.0), taus[inside[-1]] + width
    density = np.exp(log_density - log_density.max())
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    ends = np.interp(np.array([0.16, 0.84, 0.025, 0.975]) * mass[-1], mass, taus)
    sd = 1.0 / np.sqrt(information) if information > 0 else np.inf
    return Prediction(float(sd), sd_square, *(float(end) for end in ends))


def known_volume(problem: Problem) -> float | None:
    """sd (mL) with which V is known beforehand; None without side information."""
    prior = problem.named_laws.get("V_mL")
    return prior.b if prior is not None and prior.kind == "normal" else None


def predict(
    settings: Sequence[Setting],
    truth: Truth,
    prior: Prior | None = None,
    trigger: float | None = None,
    V_sd: float | None = None,
    repeats: float = 1.0,
    known: Known | None = None,
) -> Prediction:
    """Expected interval of tau from these experiments, each done ``repeats`` times.

    Sensitivities are taken at the true tau or, if that cannot be distinguished from zero, at the
    root of one spread of tau^2.
    """
    fastest = min(truth.tau_v, min(truth.V / s.experiment.total_flow for s in settings))
    tau = max(truth.tau, 2e-3 * fastest)
    for _ in range(2):
        common = sum_information(settings, truth, tau, trigger, known) * repeats
        prediction = predict_tau(common, truth.tau, prior, V_sd)
        raised = min(float(np.sqrt(prediction.sd_square)), prediction.high68, 0.5 * fastest)
        if raised <= 1.02 * tau:
            break
        tau = raised
    return prediction


def sum_information(
    settings: Sequence[Setting],
    truth: Truth,
    tau: float,
    trigger: float | None = None,
    known: Known | None = None,
) -> FloatArray:
    """(7, 7) information of independent experiments on :data:`COMMON`."""
    parts = [information_of(setting, truth, tau, trigger, known) for setting in settings]
    total: FloatArray = np.sum(parts, axis=0)
    return total


# --------------------------------------------------------------------------- what if


def what_if(campaign: Campaign | Problem, theta: Theta, prior: Prior | None = None) -> pd.DataFrame:
    """Predicted interval of tau for extra knowledge or another way to measure.

    Columns: ``change`` (words), ``kind``, ``value`` (in ``unit``), ``sd_tau_s`` (bound under the
    noise law), ``lo68_s``, ``hi68_s``, ``lo95_s``, ``hi95_s``, ``half_width95_s``, ``gain`` (the
    present half width over this one).  ``prior`` on tau: the campaign's own by default.

    A higher sampling rate keeps the noise in continuous time: phi per sample becomes
    phi^(1/factor); a negative phi has no process in continuous time and is set to zero there. A
    pulse train is approximated by as many short experiments as there are pulses (each with its own
    y0, beta and switch times, started from rest).  That is pessimistic, because a real train shares
    them. A design is enough.

    tau is the sensor's lag, be it the shorter or the longer one (:meth:`Problem.by_name`).
    """
    import pandas as pd

    problem = as_problem(campaign)
    vector = problem.by_name(theta)
    settings, truth = settings_of(problem, vector), truth_of(problem, vector)
    prior = prior or problem.prior_of_tau(vector)
    volume = known_volume(problem)
    rows: list[dict[str, Any]] = []
    known: Known = {}

    def add(change: str, kind: str, value: float, unit: str, prediction: Prediction) -> None:
        before = rows[0]["half_width95_s"] if rows else prediction.half_width95
        rows.append(
            {
                "change": change,
                "kind": kind,
                "value": value,
                "unit": unit,
                "sd_tau_s": prediction.sd,
                "lo68_s": prediction.low68,
                "hi68_s": prediction.high68,
                "lo95_s": prediction.low95,
                "hi95_s": prediction.high95,
                "half_width95_s": prediction.half_width95,
                "gain": before / prediction.half_width95,
            }
        )

    add("as it is", "none", 0.0, "", predict(settings, truth, prior, V_sd=volume, known=known))
    for ms in (20.0, 10.0, 5.0, 2.0, 1.0):
        found = predict(settings, truth, prior, 1e-3 * ms, volume, known=known)
        add(f"a trigger that times the valve to +-{ms:g} ms", "trigger", ms, "ms", found)
    for mL in (2.0, 1.0, 0.5, 0.1):
        found = predict(settings, truth, prior, V_sd=_both(mL, volume), known=known)
        add(f"V measured to +-{mL:g} mL", "volume", mL, "mL", found)
    found = predict(settings, truth, prior, 2e-3, _both(0.5, volume), known=known)
    add("a trigger to +-2 ms and V to +-0.5 mL", "trigger and volume", 2.0, "ms", found)
    for factor in (2.0, 4.0, 10.0):
        fast = replace(truth, tau_v=truth.tau_v / factor)
        add(
            f"a valve {factor:g} times faster",
            "valve",
            factor,
            "x",
            predict(settings, fast, prior, V_sd=volume),
        )
    for factor in (2.0, 4.0):
        stronger = [_with_flow(setting, factor) for setting in settings]
        add(
            f"{factor:g} times the flow",
            "flow",
            factor,
            "x",
            predict(stronger, truth, prior, V_sd=volume),
        )
    for factor in (2.0, 4.0, 10.0):
        found = predict(settings, truth, prior, V_sd=volume, repeats=factor, known=known)
        add(f"{factor:g} times the experiments", "repeats", factor, "x", found)
    for factor in (2, 10):
        denser = [_with_rate(setting, factor) for setting in settings]
        found = predict(denser, replace(truth, phi=max(truth.phi, 0.0)), prior, V_sd=volume)
        add(f"{factor} times the sampling rate", "rate", float(factor), "x", found)
    for pulses in (3, 6):
        short = [_as_pulse(setting, pulses, truth) for setting in settings]
        if all(setting is not None for setting in short):
            each = [setting for setting in short if setting is not None]
            found = predict(each, truth, prior, V_sd=volume, repeats=float(pulses))
            add(f"{pulses} pulses in each record", "pulses", float(pulses), "", found)
    return pd.DataFrame(rows)


def _both(sd: float, other: float | None) -> float:
    """sd of the combined knowledge from two sources."""
    return sd if other is None else float((sd**-2 + other**-2) ** -0.5)


def _with_flow(setting: Setting, factor: float) -> Setting:
    e = setting.experiment
    return replace(
        setting,
        experiment=replace(
            e, carrier_flow=factor * e.carrier_flow, test_gas_flow=factor * e.test_gas_flow
        ),
    )


def _with_rate(setting: Setting, factor: int) -> Setting:
    e = setting.experiment
    interval = e.interval / factor
    t = e.t[0] + interval * np.arange(len(e.t) * factor)
    mask = np.repeat(e.used, factor)
    return replace(setting, experiment=replace(e, t=t, interval=interval, mask=mask, drive=None))


def _as_pulse(setting: Setting, pulses: int, truth: Truth) -> Setting | None:
    """One of ``pulses`` equal parts of the record; None if the response would not settle."""
    e = setting.experiment
    n = len(e.t) // pulses
    duration = n * e.interval
    slowest = max(truth.tau_v, truth.V / e.total_flow, truth.tau)
    if (END - BEGIN) * duration < 6.0 * slowest:
        return None
    return planned(
        e.name, e.total_flow, e.concentration, duration, e.interval, setting.y0, setting.beta,
        setting.weight,
    )  # fmt: skip


def planned(
    name: str,
    total_flow: float,
    concentration: float,
    duration: float,
    interval: float,
    y0: float,
    beta: float,
    weight: float,
    delay: float = 0.0,
) -> Setting:
    """A step experiment of ``duration`` s: up at 20 %, down at 60 % of it (mL/s, fraction, s, V).

    The valve answers ``delay`` s after its commands.
    """
    t: FloatArray = interval * np.arange(max(round(duration / interval), 2), dtype=float)
    on, off = BEGIN * duration, END * duration
    e = Experiment(
        name, t, None, (1.0 - concentration) * total_flow, concentration * total_flow, interval,
        on, off,
    )  # fmt: skip
    return Setting(e, y0, beta, on + delay, off + delay, weight)


# --------------------------------------------------------------------------- the next experiments


@dataclass(frozen=True, eq=False)
class Design:
    """Experiments to do next, and their expected result."""

    experiments: pd.DataFrame
    """one row each: ``name``, ``total_flow_mL_s``, ``concentration``, ``duration_s``, ``on_s``,
    ``off_s``, ``interval_s``, ``beta_V`` (expected step)"""
    campaign: Campaign
    """the campaign with the proposals appended, all without data: ready for ``simulate``"""
    theta: FloatArray
    """flat vector for that campaign"""
    before: Prediction
    """with the existing experiments"""
    after: Prediction
    """with the proposals added"""
    target: float
    """s, wanted half width of the 95 % interval"""
    reached: bool
    status: str
    """one sentence"""
    prior: Prior
    """prior on tau in the prediction"""
    noise: Noise
    """law of the noise, one for all experiments"""

    @property
    def new_names(self) -> list[str]:
        """Names of the proposed experiments."""
        return [str(row["name"]) for row in self.experiments.to_dict("records")]

    @property
    def new(self) -> Campaign | None:
        """The proposed experiments alone; None if none are needed."""
        some = tuple(e for e in self.campaign if e.name in self.new_names)
        return (
            replace(self.campaign, title="proposed experiments", experiments=some) if some else None
        )

    @property
    def truth(self) -> dict[str, Any]:
        """The prediction's assumptions, for a simulation of :attr:`new` (of :attr:`campaign` if
        none is needed); see :meth:`truth_for`."""
        return self.truth_for(self.new or self.campaign)

    def truth_for(self, campaign: Campaign) -> dict[str, Any]:
        """The prediction's assumptions in the form that ``simulate --truth`` reads; every record's
        time starts at zero there.

        ``campaign``: some of the experiments of :attr:`campaign`.  sigma1 and phi refer to the
        highest concentration and to the most common interval of that campaign.  It has the
        parameters of every experiment.
        """
        shared, theta = self.campaign, self.theta.copy()
        i_phi, i_sigma0, i_sigma1 = Layout.of(shared).noise[0]
        if self.noise.by_concentration:
            of = campaign.reference_concentration / shared.reference_concentration
            theta[i_sigma1] = self.noise.referred(theta[i_sigma0], theta[i_sigma1], of)
        if campaign.reference_interval != shared.reference_interval:
            steps = campaign.reference_interval / shared.reference_interval
            theta[i_phi] = lag_coefficient(float(theta[i_phi]), steps)
        nested = Layout.of(shared).nested(theta)
        for e in self.campaign:
            own = nested["experiments"][e.name]
            for key in ("t0_s", "tf_s"):
                if key in own:
                    own[key] -= float(e.t[0])
        return nested

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, units in the keys."""
        return {
            "target_half_width95_s": self.target,
            "reached": self.reached,
            "status": self.status,
            "before": _plain(self.before),
            "after": _plain(self.after),
            "experiments": self.experiments.to_dict("records"),
        }


def _plain(prediction: Prediction) -> dict[str, float | None]:
    numbers: dict[str, float | None] = plain({
        "sd_tau_s": prediction.sd,
        "lo68_s": prediction.low68,
        "hi68_s": prediction.high68,
        "lo95_s": prediction.low95,
        "hi95_s": prediction.high95,
        "half_width95_s": prediction.half_width95,
    })  # fmt: skip
    return numbers


def design_experiments(
    campaign: Campaign | Problem,
    theta: Theta,
    target_tau: float,
    flows: tuple[float, float],
    concentrations: tuple[float, float],
    durations: tuple[float, float],
    k: int | None = None,
    k_max: int = 40,
    trigger: float | None = None,
    prior: Prior | None = None,
    n_grid: tuple[int, int, int] = (5, 4, 3),
) -> Design:
    """The next experiments that bring tau's 95 % interval to +- ``target_tau`` (s, half length).

    Candidates: total flow (mL/s), concentration (fraction) and duration (s) on a grid within the
    given limits.  The best one is added until the target is met or ``k`` are chosen (``k`` None: as
    many as needed up to ``k_max``), then single ones are exchanged while the interval improves
    (Fedorov, Theory of Optimal Experiments, 1972).  ``trigger``: sd (s) with which the new
    experiments' switch times will be known.  The step's size is taken proportional to the
    concentration, by least squares over the campaign; noise as in ``theta``; the existing
    experiments count as done.

    tau is the sensor's lag, be it the shorter or the longer one (:meth:`Problem.by_name`).

    Raises CampaignError for limits that are not a range, a target that is not positive, or if
    neither the campaign nor ``theta`` says which lag is the sensor's.
    """
    problem = as_problem(campaign)
    vector = problem.by_name(theta)
    if not target_tau > 0:
        raise CampaignError(f"design: the target must be a positive time, but is {target_tau} s")
    for label, (low, high) in (
        ("flows", flows),
        ("concentrations", concentrations),
        ("durations", durations),
    ):
        if not 0 < low <= high or not np.isfinite(high):
            raise CampaignError(f"design: {label} must be a range with 0 < low <= high")
    if concentrations[1] >= 1.0:
        raise CampaignError("design: concentrations are fractions below 1")
    truth, present = truth_of(problem, vector), settings_of(problem, vector)
    prior = prior or problem.prior_of_tau(vector)
    candidates = _candidates(
        problem, vector, present, truth, flows, concentrations, durations, n_grid
    )
    if not candidates:
        raise CampaignError(
            "design: no duration within its limits lets the response settle; allow longer ones"
        )
    lengths = [len(c.experiment.t) * c.experiment.interval for c in candidates]
    volume = known_volume(problem)
    before = predict(present, truth, prior, V_sd=volume)
    fastest = min(truth.tau_v, min(truth.V / s.experiment.total_flow for s in present))
    tau = min(max(truth.tau, before.high68, 2e-3 * fastest), max(truth.tau, 0.5 * fastest))
    chosen: list[int] = []
    for _ in range(2):  # once more with sensitivities where the better experiments put tau
        base = sum_information(present, truth, tau)
        parts = [information_of(c, truth, tau, trigger) for c in candidates]
        chosen = _choose(base, parts, truth.tau, prior, volume, target_tau, k, k_max, lengths)
        total = base + np.sum([parts[i] for i in chosen], axis=0) if chosen else base
        after = predict_tau(total, truth.tau, prior, volume)
        better = max(truth.tau, min(after.high68, tau), 2e-3 * fastest)
        if better > 0.9 * tau:
            break
        tau = better
    picked = [candidates[i] for i in sorted(chosen)]
    reached = bool(after.half_width95 <= target_tau)
    words = (
        f"{counted(len(picked), 'more experiment')}: 95 % interval of tau "
        f"+-{1e3 * after.half_width95:.3g} ms"
    )
    words += "" if reached else f", not the +-{1e3 * target_tau:.3g} ms wanted"
    combined, new_theta, table = _proposal(problem, vector, truth, picked)
    return Design(
        table, combined, new_theta, before, after, target_tau, reached, words, prior, truth.noise
    )


def _candidates(
    problem: Problem,
    vector: FloatArray,
    present: list[Setting],
    truth: Truth,
    flows: tuple[float, float],
    concentrations: tuple[float, float],
    durations: tuple[float, float],
    n_grid: tuple[int, int, int],
) -> list[Setting]:
    c = np.array([s.experiment.concentration for s in present])
    beta = np.array([s.beta for s in present])
    gain = float(c @ beta / (c @ c))
    y0 = float(np.median([s.y0 for s in present]))
    reference = problem.campaign.reference_concentration
    delays = [
        s.t0 - s.experiment.commanded_on for s in present if s.experiment.commanded_on is not None
    ]
    delay = max(float(np.median(delays)), 0.0) if delays else 0.5 * truth.tau_v
    result = []
    for flow in np.unique(np.geomspace(*flows, n_grid[0])):
        for fraction in np.unique(np.linspace(*concentrations, n_grid[1])):
            for duration in np.unique(np.linspace(*durations, n_grid[2])):
                slowest = max(truth.tau_v, truth.V / flow, truth.tau)
                if (END - BEGIN) * duration < 6.0 * slowest:
                    continue
                weight = truth.noise.weight_of(float(fraction / reference))
                result.append(
                    planned(
                        "candidate", float(flow), float(fraction), float(duration),
                        truth.interval, y0, gain * float(fraction), weight, delay,
                    )
                )  # fmt: skip
    return result


def _choose(
    base: FloatArray,
    parts: list[FloatArray],
    tau: float,
    prior: Prior,
    volume: float | None,
    target: float,
    k: int | None,
    k_max: int,
    durations: list[float],
) -> list[int]:
    """Greedy addition, then exchange; positions in ``parts``, with repetition."""

    def worth(total: FloatArray) -> float:
        # the bound on tau and on tau^2 together stand for the interval, and cost no quadrature
        M = _eliminate(total, [0, 1])
        slope = np.array([2.0 * tau, 1.0])
        return float(slope @ M @ slope) + 1e-9 * float(M[0, 0])

    def pick(total: FloatArray) -> int:
        # the shortest of those that are as good as the best
        gains = np.array([worth(total + part) for part in parts]) - worth(total)
        good = np.flatnonzero(gains >= (1.0 - AS_GOOD) * gains.max())
        return int(min(good, key=lambda i: (durations[i], -gains[i])))

    def half_width(total: FloatArray) -> float:
        return predict_tau(total, tau, prior, volume).half_width95

    total, chosen = base.copy(), list[int]()
    most = k_max if k is None else k
    while len(chosen) < most:
        if k is None and half_width(total) <= target:
            break
        best = pick(total)
        chosen.append(best)
        total = total + parts[best]
    improved = True
    while improved and chosen:
        improved = False
        for position, old in enumerate(chosen):
            without = total - parts[old]
            best = pick(without)
            if best != old and worth(without + parts[best]) > worth(total) * (1 + 1e-9):
                chosen[position] = best
                total = without + parts[best]
                improved = True
    return chosen


def _proposal(
    problem: Problem, vector: FloatArray, truth: Truth, picked: list[Setting]
) -> tuple[Campaign, FloatArray, pd.DataFrame]:
    import pandas as pd

    taken = set(problem.campaign.names_of_experiments)
    experiments = [replace(e, y=None) for e in problem.campaign]
    local: list[float] = []
    rows = []
    number = 0
    for setting in picked:
        number += 1
        while f"new{number}" in taken:
            number += 1
        name = f"new{number}"
        e = replace(setting.experiment, name=name)
        experiments.append(e)
        assert setting.tf is not None and e.commanded_off is not None  # as planned
        local += [setting.y0, setting.beta, setting.t0, setting.tf]
        rows.append(
            {
                "name": name,
                "total_flow_mL_s": e.total_flow,
                "concentration": e.concentration,
                "duration_s": len(e.t) * e.interval,
                "on_s": e.commanded_on,
                "off_s": e.commanded_off,
                "interval_s": e.interval,
                "beta_V": setting.beta,
            }
        )
    order = problem.campaign.sensor_is
    if order == "unknown":  # theta says it
        order = "faster" if truth.tau <= truth.tau_v else "slower"
    combined = Campaign(
        f"{problem.campaign.title}, with proposals", tuple(experiments),
        problem.campaign.side_information, problem.campaign.signal_unit,
        sensor_is=order,
    )  # fmt: skip
    n = problem.layout.n_mean
    noise = [truth.phi, truth.sigma0, truth.sigma1]
    if truth.noise.by_concentration:
        # sigma1 refers to the highest concentration, which a proposal may raise
        times = combined.reference_concentration / problem.campaign.reference_concentration
        noise[2] = truth.noise.referred(truth.sigma0, truth.sigma1, times)
    if combined.reference_interval != truth.interval:
        noise[0] = lag_coefficient(truth.phi, combined.reference_interval / truth.interval)
    theta = np.concatenate([vector[:n], local, noise])
    assert len(theta) == len(Layout.of(combined))
    return combined, theta, pd.DataFrame(rows)


# --------------------------------------------------------------------------- check by simulation


def check_design(
    design: Design,
    n: int,
    seed: int = 1,
    trigger: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Posterior intervals of ``n`` simulated campaigns of the proposal against the prediction.

    ``trigger``: sd (s) with which the new switch times are known; they then get normal priors about
    times drawn with that error.  Returns ``n``, ``mean_half_width95_s``, its ``sd_half_width95_s``
    between campaigns, ``predicted_half_width95_s``, their ``ratio``, ``within_20_percent`` and
    ``n_not_converged`` (left out of the mean).
    """
    names = design.new_names
    layout = Layout.of(design.campaign)
    widths, lost = [], 0
    for i, stream in enumerate(np.random.SeedSequence(seed).spawn(n)):
        data, sampling, timing = stream.spawn(3)
        plan = Problem(design.campaign, noise=design.noise)
        campaign = simulate(plan, design.theta, int(data.generate_state(1)[0]))
        priors = {"tau_s": design.prior}
        if trigger is not None:
            rng = np.random.default_rng(timing)
            for flat in layout.names:
                kind, _, rest = flat.partition("[")
                if kind in ("t0_s", "tf_s") and rest[:-1] in names:
                    sd = max(trigger, EXACT)
                    centre = design.theta[layout.index(flat)] + sd * rng.standard_normal()
                    priors[flat] = Prior("normal", float(centre), sd)
        posterior = sample_posterior(
            replace(plan, campaign=campaign, given_priors=priors),
            design.theta,
            int(sampling.generate_state(1)[0]),
            FASTEST,
        )
        if posterior.converged:
            low, high = posterior.quantiles("tau_s", [0.025, 0.975])
            widths.append(0.5 * (high - low))
        else:
            lost += 1
        if progress is not None:
            progress((i + 1) / n)
    mean = float(np.mean(widths)) if widths else np.nan
    ratio = mean / design.after.half_width95
    return {
        "n": n,
        "mean_half_width95_s": mean,
        "sd_half_width95_s": float(np.std(widths, ddof=1)) if len(widths) > 1 else np.nan,
        "predicted_half_width95_s": design.after.half_width95,
        "ratio": ratio,
        "within_20_percent": bool(abs(ratio - 1.0) <= 0.2),
        "n_not_converged": lost,
    }
