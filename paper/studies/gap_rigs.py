"""Campaigns of the published design in which one cause acts at a wanted detectability.

The rig is drawn anew around the published values, with noise of one of four laws.  A listed cause
acts through the rig of the catalogue; a cause outside it is a function of its own below.  The
strength follows from the detectability d wanted: the root of the misfit that is left when the
model without effects is refitted to the noise-free record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import lfilter

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.cli.simulate_campaigns import published_design
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.preparation import prepare
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import Effect, Form
from bayes_sensor.diagnosis.effects.rig_view import coating_modes
from bayes_sensor.diagnosis.evidence.chain_coordinates import coordinates_of
from bayes_sensor.diagnosis.evidence.refit import Refit, base_starts, refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.likelihood.noise import scale_squared, simulate_noise
from bayes_sensor.rig.cascade import cascade_response
from bayes_sensor.rig.imperfections import FIRST, INDEX
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.perturbed import rig_mean

LAWS = ("ar1", "ar1 + 1 s", "heavy tails", "1/f")
SPREAD = {"tau_s": 0.35, "tau_v_s": 0.2, "V_mL": 0.12, "beta": 0.1, "sigma0": 0.15, "sigma1": 0.2}
"""standard deviations of the logarithms of what is drawn anew"""
DELAY_SPREAD = 0.02
"""s, of the switch times"""
PHI = (0.3, 0.93)
"""lag-one coefficients are drawn between these"""
SLOW_V, SLOW_S = 6e-3, 1.0
"""size and correlation time of the slow part of the second law"""
TAIL_DOF = 3.5
CORNER_HZ = 2.0
"""where 1/f noise crosses the white one"""
BURN_IN = 2000
REACHED = 0.7
"""share of the wanted detectability below which a cause counts as hidden"""

Shape = Callable[[float], Callable[[int, FloatArray], FloatArray]]
"""amount -> mean (n_times,) V of an experiment (its number) at sorted times"""


@dataclass(frozen=True, eq=False)
class Rig:
    """A rig with known parameters, and a record of it in which nothing is wrong."""

    campaign: Campaign
    theta: Mapping[str, Any]
    noise: tuple[FloatArray, ...]
    """(n_t,) V of each experiment"""

    @cached_property
    def binned(self) -> BinnedCampaign:
        """Bins and floor of the record in which nothing is wrong, around the truth."""
        plain = self.record(self.mean)
        return prepare(plain, Layout.of(self.campaign).flat(self.theta)).binned

    def own(self, k: int) -> Mapping[str, float]:
        """y0, beta, t0, tf of an experiment."""
        return self.theta["experiments"][self.campaign.experiments[k].name]

    def lags(self, k: int) -> list[float]:
        """Valve, manifold, sensor, s."""
        flow = self.campaign.experiments[k].total_flow
        return [self.theta["tau_v_s"], self.theta["V_mL"] / flow, self.theta["tau_s"]]

    def response(self, k: int, t: FloatArray, lags: list[float] | None = None) -> FloatArray:
        """x3 (n_t,) of the model, with its own lags or others."""
        own = self.own(k)
        taus = np.array(lags or self.lags(k))
        return np.asarray(cascade_response(t, taus, own["t0_s"], own["tf_s"]))

    def mean(self, k: int, t: FloatArray) -> FloatArray:
        """V (n_t,) of the model."""
        own = self.own(k)
        return own["y0_V"] + own["beta_V"] * self.response(k, t)

    def changed(self, k: int, t: FloatArray, settings: Mapping[str, float]) -> FloatArray:
        """V (n_t,) of the catalogue's rig with some settings changed."""
        p, _ = Coordinates(self.binned).rig(self.binned.base, k)
        for name, value in settings.items():
            p[FIRST + INDEX[name]] = value
        return np.asarray(rig_mean(t, p, *coating_modes()))

    def record(self, mean: Callable[[int, FloatArray], FloatArray]) -> Campaign:
        """The campaign as it is measured with this mean."""
        return self.campaign.with_data(
            {
                e.name: mean(k, e.t) + noise
                for k, (e, noise) in enumerate(zip(self.campaign, self.noise, strict=True))
            }
        )


def draw_rig(rng: np.random.Generator, law: str = "ar1", phi: float | None = None) -> Rig:
    """A rig near the published one; with ``phi`` given exactly the published one."""
    campaign, theta = published_design()
    width = 1.0 if phi is None else 0.0

    def factor(name: str) -> float:
        return float(np.exp(width * SPREAD[name] * rng.standard_normal()))

    made: dict[str, Any] = {n: theta[n] * factor(n) for n in ("tau_s", "tau_v_s", "V_mL")}
    made["experiments"] = {}
    for name, own in theta["experiments"].items():
        late = width * DELAY_SPREAD * rng.standard_normal(2)
        made["experiments"][name] = {
            "y0_V": own["y0_V"], "beta_V": own["beta_V"] * factor("beta"),
            "t0_s": own["t0_s"] + late[0], "tf_s": own["tf_s"] + late[1],
        }  # fmt: skip
    drawn = float(rng.uniform(*PHI))
    made["phi"] = drawn if phi is None else phi
    sigma0, sigma1 = theta["sigma0_V"] * factor("sigma0"), theta["sigma1_V"] * factor("sigma1")
    rig = Rig(campaign, made, ())
    noise = []
    for k, e in enumerate(campaign):
        weight = e.concentration / campaign.reference_concentration
        scale = np.sqrt(scale_squared(rig.response(k, e.t), sigma0, sigma1, weight))
        noise.append(_noise(law, scale, e.interval, made["phi"], rng))
    return replace(rig, noise=tuple(noise))


def _noise(
    law: str, scale: FloatArray, interval: float, phi: float, rng: np.random.Generator
) -> FloatArray:
    n = len(scale)
    if law == "heavy tails":
        e = rng.standard_t(TAIL_DOF, n + BURN_IN) * np.sqrt((TAIL_DOF - 2.0) / TAIL_DOF)
        return scale * lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], e)[BURN_IN:]
    if law == "1/f":  # power 1 + corner/f, twice as long as the record so that it does not close
        f = np.fft.rfftfreq(2 * n, interval)
        power = 1.0 + CORNER_HZ / np.maximum(f, f[1])
        white = np.fft.rfft(rng.standard_normal(2 * n))
        return scale * np.fft.irfft(white * np.sqrt(power / power.mean()), 2 * n)[:n]
    noise = simulate_noise(scale, phi, rng)
    if law == "ar1 + 1 s":
        noise = noise + simulate_noise(np.full(n, SLOW_V), float(np.exp(-interval / SLOW_S)), rng)
    return noise


# --------------------------------------------------------------------------- listed causes

# name -> strength that is varied, its largest value here
LISTED = {
    "flow_switching": ("flow_switching", 1.0),
    "valve_asymmetry": ("closing_ratio", 2.0),
    "valve_second_order": ("inertia", 0.6),
    "two_rate_valve": ("slow_valve_share", 0.4),
    "finite_stroke": ("stroke", 2.5),
    "dead_volume": ("pocket_share", 0.8),
    "axial_dispersion": ("tank_share", 0.5),
    "flow_settling": ("settling_share", 0.9),
    "flow_error": ("flow_factor", 1.5),
    "sensor_diffusion": ("coating", 1.0),
    "sorption_asymmetry": ("release_ratio", 8.0),
    "slow_sorption": ("slow_site_share", 0.4),
    "optical_nonlinearity": ("curvature", 0.3),
    "baseline_drift": ("drift", 0.01),
    "baseline_step": ("step", 0.5),
    "gain_drift": ("gain_drift", 0.01),
    "carry_over": ("carry_over", 0.8),
    "daq_filter": ("filter", 0.8),
}
EITHER_SIGN = ("valve_asymmetry", "sorption_asymmetry", "flow_settling", "optical_nonlinearity",
               "baseline_drift", "baseline_step", "gain_drift")  # fmt: skip
OFTEN_OWN = ("baseline_drift", "baseline_step", "gain_drift", "carry_over")
"""in 40 of 100 campaigns every experiment has a strength of its own; for flow_error always"""


def nested_form(effect: Effect, strength: str, binned: BinnedCampaign) -> Form:
    """The first form in which the strength can be varied."""
    setting = binned.settings[0]
    for form in effect.forms:
        if strength in {s.name for s in form.strengths(setting)}:
            return form
    raise KeyError(strength)


@dataclass(frozen=True, eq=False)
class Listed:
    """An effect of the catalogue with everything but its amount drawn."""

    rig: Rig
    name: str
    sign: float
    each: FloatArray | None
    """(n_experiments,) relative strengths where every experiment has its own; none of them
    negative where the effect is never so"""
    others: Mapping[str, float]

    @classmethod
    def draw(cls, rig: Rig, name: str, rng: np.random.Generator | None = None) -> Listed:
        """One version of the effect; without ``rng`` the plausible one."""
        strength = LISTED[name][0]
        others = {n: v for n, v in CATALOGUE[name].plausible.items() if n != strength}
        pattern = np.resize([0.5, -1.2, 0.8, 1.4, -0.6, -1.0, 0.3], len(rig.campaign))
        if rng is None:
            return cls(rig, name, 1.0, pattern if name == "flow_error" else None, others)
        others = {n: v * float(np.exp(0.5 * rng.standard_normal())) for n, v in others.items()}
        sign = float(rng.choice([-1.0, 1.0])) if name in EITHER_SIGN else 1.0
        own = name == "flow_error" or (name in OFTEN_OWN and rng.random() < 0.4)
        drawn = rng.standard_normal(len(rig.campaign))
        form = nested_form(CATALOGUE[name], strength, rig.binned)
        law = next(s for s in form.strengths(rig.binned.settings[0]) if s.name == strength)
        if law.kind == "normal" and law.limits[0] == 0.0:
            drawn = np.abs(drawn)
        return cls(rig, name, sign, drawn if own else None, others)

    @property
    def highest(self) -> float:
        """The largest amount: of the strength, for ratios of its distance from one."""
        return LISTED[self.name][1] - self._null

    @property
    def _null(self) -> float:
        return CATALOGUE[self.name].null[LISTED[self.name][0]]

    def strengths(self, amount: float, k: int) -> dict[str, float]:
        """Strengths of an experiment."""
        size = self.sign * (1.0 if self.each is None else float(self.each[k]))
        ratio = self._null == 1.0
        value = float((1.0 + amount) ** size) if ratio else amount * size
        return {LISTED[self.name][0]: value, **self.others}

    @cached_property
    def form(self) -> Form:
        """The form it acts in."""
        return nested_form(CATALOGUE[self.name], LISTED[self.name][0], self.rig.binned)

    def __call__(self, amount: float) -> Callable[[int, FloatArray], FloatArray]:
        """The mean with this amount of it."""

        def mean(k: int, t: FloatArray) -> FloatArray:
            values = self.strengths(amount, k)
            return self.rig.changed(k, t, self.form.settings(values, self.rig.binned.settings[k]))

        return mean


# --------------------------------------------------------------------------- causes outside


def _valve_by_flow(rig: Rig, amount: float) -> Callable[[int, FloatArray], FloatArray]:
    # the valve's lag grows with a power of the flow
    median = float(np.median([e.total_flow for e in rig.campaign]))

    def mean(k: int, t: FloatArray) -> FloatArray:
        valve, manifold, sensor = rig.lags(k)
        factor = (rig.campaign.experiments[k].total_flow / median) ** amount
        own = rig.own(k)
        x = rig.response(k, t, [valve * factor, manifold, sensor])
        return own["y0_V"] + own["beta_V"] * x

    return mean


def _added(
    rig: Rig, extra: Callable[[int, FloatArray], FloatArray]
) -> Callable[[int, FloatArray], FloatArray]:
    return lambda k, t: rig.mean(k, t) + extra(k, t)


def _echo(rig: Rig, amount: float) -> Callable[[int, FloatArray], FloatArray]:
    # a part of the gas takes a way that is 300 mL longer
    def extra(k: int, t: FloatArray) -> FloatArray:
        late = 300.0 / rig.campaign.experiments[k].total_flow
        return amount * rig.own(k)["beta_V"] * (rig.response(k, t - late) - rig.response(k, t))

    return _added(rig, extra)


def _spike(rig: Rig, amount: float) -> Callable[[int, FloatArray], FloatArray]:
    # the valve's drive couples into the signal at both commands
    def extra(k: int, t: FloatArray) -> FloatArray:
        e = rig.campaign.experiments[k]
        pulses = [
            np.where(s > 0.0, np.exp(-np.maximum(s, 0.0) / 0.25), 0.0)
            for s in (t - e.commanded_on, t - e.commanded_off)
        ]
        return amount * (pulses[0] - pulses[1])

    return _added(rig, extra)


def _thermal(rig: Rig, amount: float) -> Callable[[int, FloatArray], FloatArray]:
    # the gas warms the sensor for some seconds, and cools it when it leaves
    def bump(since: FloatArray) -> FloatArray:
        s = np.maximum(since, 0.0) / 4.0
        return s * np.exp(1.0 - s)

    def extra(k: int, t: FloatArray) -> FloatArray:
        own = rig.own(k)
        return amount * own["beta_V"] * (bump(t - own["t0_s"]) - 0.7 * bump(t - own["tf_s"]))

    return _added(rig, extra)


def _pump(rig: Rig, amount: float) -> Callable[[int, FloatArray], FloatArray]:
    # the concentration swings with a pump at .37 Hz
    def extra(k: int, t: FloatArray) -> FloatArray:
        swing = np.sin(2.0 * np.pi * 0.37 * t + k)
        return amount * rig.own(k)["beta_V"] * rig.response(k, t) * swing

    return _added(rig, extra)


def _stick(rig: Rig, amount: float) -> Callable[[int, FloatArray], FloatArray]:
    # the valve sticks half way for some time as it opens
    def extra(k: int, t: FloatArray) -> FloatArray:
        own = rig.own(k)
        late = np.asarray(
            cascade_response(t, np.array(rig.lags(k)), own["t0_s"] + amount, own["tf_s"])
        )
        return 0.5 * own["beta_V"] * (late - rig.response(k, t))

    return _added(rig, extra)


def _wander(rig: Rig, amount: float) -> Callable[[int, FloatArray], FloatArray]:
    # the baseline wanders, in every experiment in its own way
    n, orders = len(rig.campaign), np.arange(1, 31)
    rng = np.random.default_rng(int(rig.theta["tau_s"] * 1e9))
    sizes = rng.standard_normal((n, 30)) / orders
    phases = rng.uniform(0.0, 2.0 * np.pi, (n, 30))

    def extra(k: int, t: FloatArray) -> FloatArray:
        length = float(np.ptp(rig.campaign.experiments[k].t))
        made = np.zeros_like(t)
        for size, phase, order in zip(sizes[k], phases[k], orders, strict=True):
            made += size * np.sin(2.0 * np.pi * 1.3 * order * t / length + phase)
        return amount * made

    return _added(rig, extra)


# name -> mean for an amount of it, largest amount
OUTSIDE: dict[str, tuple[Callable[[Rig, float], Callable[[int, FloatArray], FloatArray]], float]]
OUTSIDE = {
    "valve lag grows with flow": (_valve_by_flow, 3.0),
    "part of the gas comes later": (_echo, 0.9),
    "drive couples into the signal": (_spike, 1.5),
    "gas warms the sensor": (_thermal, 0.3),
    "pump swings": (_pump, 0.15),
    "valve sticks half way": (_stick, 9.0),
    "baseline wanders": (_wander, 0.3),
}


def outside(rig: Rig, name: str) -> tuple[Shape, float]:
    """A cause that the catalogue does not hold, and its largest amount."""
    make, highest = OUTSIDE[name]
    return (lambda amount: make(rig, amount)), highest


# --------------------------------------------------------------------------- detectability


def noise_free(
    binned: BinnedCampaign, mean: Callable[[int, FloatArray], FloatArray]
) -> list[FloatArray]:
    """(n_bins,) V of each experiment: every sample of the mean averaged in its bin."""
    return [b.average(mean(k, b.experiment.t)) for k, b in enumerate(binned.bins)]


def detectability(rig: Any, mean: Callable[[int, FloatArray], FloatArray]) -> Refit:
    """The model without effects refitted to this mean; d is the root of its misfit."""
    binned = rig.binned
    data = noise_free(binned, mean)
    plan = coordinates_of(binned)
    starts = base_starts(binned, binned.base)[:3:2]
    return min(
        (refit(plan, x, data=data, most_steps=15) for x in starts), key=lambda r: r.objective
    )


def amount_for(rig: Rig, shape: Shape, highest: float, wanted: float) -> tuple[float, float]:
    """The amount at which the cause has the detectability wanted, and what it has there.

    The highest where that is not enough.
    """

    def d(amount: float) -> float:
        return float(np.sqrt(detectability(rig, shape(amount)).misfit))

    amount, found = highest, d(highest)
    above, below = (amount, found), (0.0, 0.0)
    for _ in range(12):
        if abs(found / wanted - 1.0) < 0.05 or (amount == highest and found < wanted):
            break
        power = 1.0  # d rises nearly with a power of the amount
        if below[1] > 0.0:
            power = float(np.log(above[1] / below[1]) / np.log(above[0] / below[0]))
        amount = float(above[0] * (wanted / above[1]) ** (1.0 / power))
        if not below[0] < amount < above[0]:
            amount = 0.5 * (below[0] + above[0])
        found = d(amount)
        above, below = ((amount, found), below) if found > wanted else (above, (amount, found))
    return amount, found
