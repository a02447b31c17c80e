"""The binned campaign of a campaign and its fit: bins, noise floor, priors, the refitted base."""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.bins import ExperimentBins, make_bins
from bayes_sensor.diagnosis.data.chain_preparation import FittedChain, residuals_of_chain
from bayes_sensor.diagnosis.data.noise_floor import NoiseFloor, estimate_floor
from bayes_sensor.diagnosis.data.quiet_stretches import (
    NARROW,
    WIDTH,
    QuietSpans,
    Stretch,
    clean,
    quiet_stretches,
)
from bayes_sensor.diagnosis.data.switch_times import settling_time
from bayes_sensor.diagnosis.evidence.chain_coordinates import coordinates_of
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER
from bayes_sensor.diagnosis.evidence.refit import Refit, base_starts, refit
from bayes_sensor.diagnosis.signals.signal import Samples
from bayes_sensor.likelihood.density import grid_response
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.residuals.converter_step import lattice_step
from bayes_sensor.rig.cascade import cascade_response
from bayes_sensor.rig.lags import Naming
from bayes_sensor.rig.layout import Layout

NUISANCE_SD = {"shorter": 1.0, "longer": 0.7, "V": 0.3}
"""sd of the logarithms around plausible values"""
SHORTER_OVER_LONGER = 0.07
"""plausible ratio of the two lags that do not depend on the flow"""


def full_rate_residuals(campaign: Campaign, theta: FloatArray) -> list[FloatArray]:
    """(n_t,) V per experiment: measurement minus the cascade at ``theta``."""
    layout = Layout.of(campaign)
    if not layout.is_published:
        return residuals_of_chain(campaign, theta)
    found = []
    for k, e in enumerate(campaign):
        i_y0, i_beta, i_t0, i_tf = layout.local[k]
        taus = layout.lags(theta, k, e.total_flow)
        tf = float(theta[i_tf]) if i_tf >= 0 else None
        x = grid_response(e, taus, float(theta[i_t0]), tf)
        found.append(np.where(e.used, e.values - theta[i_y0] - theta[i_beta] * x, 0.0))
    return found


def base_coordinates(campaign: Campaign, theta: FloatArray) -> FloatArray:
    """Coordinates of the fit without effects at a flat ``theta``, tau and tau_v in either order."""
    layout = Layout.of(campaign)
    *lags, volume = theta[layout.shared[0]].tolist()
    tau, tau_v = sorted(lags)
    tau = max(tau, 1e-4 * tau_v)
    x = np.array(theta[: layout.n_mean], dtype=float)
    x[1] = log(tau_v)
    x[0] = max(x[1] - FASTER - log(tau), 0.0)
    x[2] = log(volume)
    return x


def flat_theta(campaign: Campaign, x: FloatArray) -> FloatArray:
    """The flat ``theta``, lags by size, of the mean at coordinates of the fit without effects."""
    theta = np.array(x, dtype=float)
    shared = Layout.of(campaign).shared[0]
    theta[shared] = np.exp([x[1] - FASTER - x[0], x[1], x[2]])
    return theta


@dataclass(frozen=True, eq=False)
class PreparedCampaign:
    """A campaign in bins, with the residuals and quiet stretches that it was made from."""

    binned: BinnedCampaign
    residuals: tuple[FloatArray, ...]
    """(n_t,) V of each experiment, measurement minus the fit, spikes replaced"""
    stretches: tuple[Stretch, ...]
    """quiet parts, spikes replaced"""
    raw: tuple[Stretch, ...]
    """the same as measured"""
    quiet: tuple[QuietSpans, ...]
    """switches and quiet spans of every experiment, and its noise"""
    theta: FloatArray
    """the flat fit that the residuals belong to, tau and tau_v by size"""
    settle: tuple[float, ...] | None
    """s after a switch that every experiment's quiet spans leave out; None: what each switch needs
    """

    @property
    def deviations(self) -> list[FloatArray]:
        """(n_t,) V of every experiment, the noise's standard deviation."""
        return [q.deviation for q in self.quiet]

    def samples(self, best: Refit) -> Samples:
        """What signals look at: the samples less the mean of the ``best`` explanation."""
        residuals = self.residuals_of(best)
        campaign, bins = self.binned.campaign, self.binned.bins
        stretches = quiet_stretches(campaign, residuals, bins, self.settle)
        return Samples(campaign, residuals, self.deviations, stretches, self.raw, self.quiet, best)

    def residuals_of(self, found: Refit) -> list[FloatArray]:
        """(n_t,) V of every experiment, spikes replaced, measurement minus a refit's mean."""
        campaign = self.binned.campaign
        if self.binned.chain is not None:
            base = coordinates_of(self.binned)
            return [
                np.where(
                    e.used,
                    r - found.coords.mean(found.x, k, e.t) + base.mean(self.binned.base, k, e.t),
                    0.0,
                )
                for k, (e, r) in enumerate(zip(campaign, self.residuals, strict=True))
            ]
        layout = Layout.of(campaign)
        made = []
        for k, (e, r) in enumerate(zip(campaign, self.residuals, strict=True)):
            i_y0, i_beta, i_t0, i_tf = layout.local[k]
            taus = layout.lags(self.theta, k, e.total_flow)
            tf = float(self.theta[i_tf]) if i_tf >= 0 else None
            n = int(max((e.t[-1] - e.t[0]) / max(FINE, e.interval), 1.0)) + 2
            grid = np.linspace(float(e.t[0]), float(e.t[-1]), n)
            here = float(self.theta[i_y0]) + float(self.theta[i_beta]) * cascade_response(
                grid, taus, float(self.theta[i_t0]), tf
            )
            moved = found.coords.mean(found.x, k, grid) - here
            made.append(np.where(e.used, r - np.interp(e.t, grid, moved), 0.0))
        return made


NO_VOLUME = 0.02
"""share of the valve's lag below which the manifold's is none that a rig has"""
ANY_VOLUME = 1.0
"""sd of ln V where the fit tells nothing of it"""
FINE = 0.005
"""s, steps in which two means are compared at full rate"""


def prepare(
    campaign: Campaign, theta: FloatArray, naming: Naming | None = None
) -> PreparedCampaign:
    """Bins, floor and priors of a measured campaign around a fit (flat ``theta``, lags by size).

    ``naming``: what may be said of the lags' names; default what the campaign says.

    Raises CampaignError where no record has a quiet stretch.
    """
    naming = naming or Problem(campaign).naming()
    if not Layout.of(campaign).is_published:
        return _prepare_chain(FittedChain.of(campaign, theta, naming), naming)
    theta, lags = _by_name(theta, naming)
    layout = Layout.of(campaign)
    x = base_coordinates(campaign, theta)
    flat = flat_theta(campaign, x)
    raw = full_rate_residuals(campaign, flat)
    # the longer lag, the manifold's, the shorter lag
    taus = [layout.lags(flat, k, e.total_flow) for k, e in enumerate(campaign)]
    longer, through_manifold, _ = np.median(taus, axis=0).tolist()
    scale = max(longer, through_manifold)
    switches = []
    for k in range(len(campaign)):
        _, _, i_t0, i_tf = layout.local[k]
        switches.append((float(flat[i_t0]), float(flat[i_tf]) if i_tf >= 0 else None))
    bins = make_bins(campaign, switches, taus, scale)
    levels = [
        b.reduce(cascade_response(b.times, taus[k], *switches[k])) for k, b in enumerate(bins)
    ]
    made = _measured(campaign, raw, bins, levels, [settling_time(t) for t in taus])
    steps = [abs(float(flat[layout.local[k][1]])) for k in range(len(campaign))]
    # at one flow V/Q is one of the lags, and V a name that may be another's
    names = (*lags, "V_mL" if "tau_s" in lags or naming.flow is None else "")
    centre, sd = _plausible(campaign, flat, names), _spread(campaign, names)
    flow = float(np.median([e.total_flow for e in campaign]))
    interval = float(np.median([e.interval for e in campaign]))
    shorter, longer, volume = flat[layout.shared[0]].tolist()
    tau_v = shorter if lags[0] == "tau_v_s" else longer
    if volume < NO_VOLUME * tau_v * flow and "V_mL" not in campaign.side_information:
        sd[2] = ANY_VOLUME
        if not (campaign.same_flow and volume < interval * flow):
            # no rig is without a manifold: the fit has bent it away to do some effect's work; but
            # at one flow, what one sampling interval hides is where the fit has it
            centre[2] = log(0.5 * tau_v * flow)
    binned = BinnedCampaign(
        campaign=campaign,
        bins=tuple(bins),
        data=tuple(made.data),
        floor=made.floor,
        base=x,
        centre=centre,
        sd=sd,
        time_scale=scale,
        signal_scale=float(np.median(steps)) or 1.0,
        reference_flow=flow,
        duration=float(np.median([len(e.t) * e.interval for e in campaign])),
        lags=lags,
    )
    at_samples = [cascade_response(e.t, taus[k], *switches[k]) for k, e in enumerate(campaign)]
    return made.prepared(binned, at_samples, steps, flat)


def _prepare_chain(fitted: FittedChain, naming: Naming) -> PreparedCampaign:
    """The same on a rig that is a chain of stages."""
    campaign = fitted.campaign
    bins = fitted.bins()
    levels = [b.reduce(fitted.level(k, b.times)) for k, b in enumerate(bins)]
    made = _measured(campaign, fitted.residuals, bins, levels, None)
    centre, sd = fitted.priors
    flow = float(np.median([e.total_flow for e in campaign]))
    known = naming.order != "undecided"
    binned = BinnedCampaign(
        campaign=campaign,
        bins=tuple(bins),
        data=tuple(made.data),
        floor=made.floor,
        base=fitted.coordinates,
        centre=centre,
        sd=sd,
        time_scale=fitted.time_scale,
        signal_scale=float(np.median(fitted.steps)) or 1.0,
        reference_flow=flow if np.isfinite(flow) else 1.0,
        duration=float(np.median([np.ptp(e.t) + e.interval for e in campaign])),
        chain=fitted.chain,
        lags=("tau_s", "tau_v_s") if known else ("lag_fast_s", "lag_slow_s"),
    )
    at_samples = [fitted.level(k, e.t) for k, e in enumerate(campaign)]
    return made.prepared(binned, at_samples, fitted.steps, fitted.theta)


@dataclass(frozen=True, eq=False)
class _Measured:
    """What is measured around a fit: bin means, noise floor, quiet stretches."""

    campaign: Campaign
    bins: list[ExperimentBins]
    raw: list[FloatArray]
    cleaned: list[FloatArray]
    data: list[FloatArray]
    stretches: list[Stretch]
    floor: NoiseFloor
    settle: list[float] | None

    def prepared(
        self,
        binned: BinnedCampaign,
        at_samples: list[FloatArray],
        steps: list[float],
        theta: FloatArray,
    ) -> PreparedCampaign:
        """With the ``binned`` campaign; ``at_samples`` (n_t,): the response, 0 to 1."""
        return PreparedCampaign(
            binned,
            tuple(self.cleaned),
            tuple(self.stretches),
            tuple(quiet_stretches(self.campaign, self.raw, self.bins, self.settle)),
            tuple(_quiet(self, at_samples, steps)),
            theta,
            None if self.settle is None else tuple(self.settle),
        )


def _measured(
    campaign: Campaign,
    raw: list[FloatArray],
    bins: list[ExperimentBins],
    levels: list[FloatArray],
    settle: list[float] | None,
) -> _Measured:
    cleaned, spikes = [], 0
    for e, r in zip(campaign, raw, strict=True):
        width = WIDTH if settle is not None else NARROW
        values, n = clean(r, e.used, lattice_step(e.values[e.used]), width)
        cleaned.append(values)
        spikes += n
    # bin means of the cleaned measurement: the model at every sample plus the cleaned residual
    data = [
        b.average(np.where(e.used, e.values - full + r, 0.0))
        for e, b, r, full in zip(campaign, bins, cleaned, raw, strict=True)
    ]
    fits = [e.values - r for e, r in zip(campaign, raw, strict=True)]
    stretches = quiet_stretches(campaign, cleaned, bins, settle)
    floor = estimate_floor(campaign, cleaned, bins, stretches, levels, spikes, fits)
    return _Measured(campaign, bins, raw, cleaned, data, stretches, floor, settle)


def _quiet(made: _Measured, at_samples: list[FloatArray], steps: list[float]) -> list[QuietSpans]:
    deviation = np.sqrt(made.floor.density @ np.diff(made.floor.edges))
    found = []
    for k, (e, b) in enumerate(zip(made.campaign, made.bins, strict=True)):
        switches = [s.at for s in b.switches]
        own = made.settle
        waits = [s.settle if own is None else own[k] for s in b.switches]
        begins = [at + wait for at, wait in zip(switches, waits, strict=True)]
        x = np.clip(at_samples[k], 0.0, 1.0)
        low, high = deviation[k]
        before = bool(b.switches) and b.switches[0].height < 0.0
        found.append(
            QuietSpans(
                switches=tuple(switches),
                spans=tuple(
                    zip([float(e.t[0]), *begins], [*switches, float(e.t[-1])], strict=True)
                ),
                deviation=low + (high - low) * x,
                step=steps[k],
                high=(before, *(s.high for s in b.switches)),
            )
        )
    return found


def _by_name(theta: FloatArray, naming: Naming) -> tuple[FloatArray, tuple[str, str]]:
    """``theta`` with tau, tau_v and V in its first places, and names of the lesser and the greater
    of the first two.

    The shorter lag stands for tau where nobody knows.
    """
    if naming.place("sensor") is None:
        return theta, ("lag_fast_s", "lag_slow_s")
    if naming.exchanged is None:
        return theta, ("tau_s", "tau_v_s")
    made = np.array(theta, dtype=float)
    made[:3] = naming.commuting.named(made, [naming.exchanged])
    return made, ("tau_v_s", "tau_s") if made[0] > made[1] else ("tau_s", "tau_v_s")


def _plausible(campaign: Campaign, theta: FloatArray, names: tuple[str, ...]) -> FloatArray:
    _, longer, volume = theta[Layout.of(campaign).shared[0]].tolist()
    centre = np.array([log(SHORTER_OVER_LONGER * longer), log(longer), log(volume)])
    given = campaign.side_information
    for i, name in enumerate(names):
        if name in given and given[name].mean > 0:
            centre[i] = log(given[name].mean)
    return centre


def _spread(campaign: Campaign, names: tuple[str, ...]) -> FloatArray:
    sd = np.array(list(NUISANCE_SD.values()))
    for i, name in enumerate(names):
        if name in campaign.side_information and campaign.side_information[name].mean > 0:
            known = campaign.side_information[name]
            sd[i] = max(known.sd / known.mean, 1e-4)
    return sd


def fit_base(binned: BinnedCampaign) -> Refit:
    """The model without effects: the best of several starts."""
    coords = coordinates_of(binned)
    rough = [
        refit(coords, x, most_steps=12, tolerance=0.5) for x in base_starts(binned, binned.base)
    ]
    best = min(rough, key=lambda r: r.objective)
    return refit(coords, best.x)
