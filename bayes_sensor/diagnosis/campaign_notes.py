"""What the diagnosis says of a campaign itself: its limits, and what is taken for granted."""

from __future__ import annotations

from math import ceil, floor

import numpy as np

from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign, ChainOfCampaign

TELLING = 1.2
"""times its usual size from which noise that is louder for a while is worth a note"""
FEW_DOF = 30.0
"""degrees of freedom of the floor's level below which that is worth a note"""


def notes_on(binned: BinnedCampaign) -> list[str]:
    """Limits of the campaign, in sentences."""
    campaign, spikes = binned.campaign, binned.floor.spikes
    notes = []
    if not any(s.height < 0.0 for b in binned.bins for s in b.switches):
        notes.append(
            "No step down was recorded: effects that differ between rise and fall cannot be seen."
        )
    if len(campaign) == 1:
        notes.append(
            "One experiment: no data can be left out for a test, and effects that depend on the "
            "flow cannot be told from those that do not."
        )
    elif binned.chain is None and campaign.same_flow:
        notes.append(
            "All experiments share one total flow: valve and manifold cannot be told apart."
        )
    if any(s.commanded is None for b in binned.bins for s in b.switches):
        notes.append(
            "Not every experiment has a commanded time: misfits locked to the command, not to the "
            "response, are not looked for."
        )
    if spikes:
        notes.append(f"{spikes} samples beyond 6.5 standard deviations were taken for spikes.")
    spells = _louder_spells(binned)
    if spells:
        more = f" and {len(spells) - 3} more" if len(spells) > 3 else ""
        notes.append(
            f"Noise is louder for a while in experiment {', '.join(spells[:3])}{more}: what stands "
            "out there counts less."
        )
    if binned.chain is not None:
        return [*notes, *_on_other_rigs(binned, binned.chain)]
    if binned.order_known:
        than = "slower" if binned.sensor else "faster"
        taken = (
            f"The sensor is taken to be {than} than the valve: a cascade cannot tell them apart."
        )
    else:
        taken = (
            "Nobody knows which lag is the sensor's and which the valve's: effects of the valve "
            "are tried on the longer one, effects of the sensor on the shorter one. Say in the "
            "campaign which one is the sensor's (sensor_is), or give side information on tau or "
            "tau_v."
        )
    notes.append(taken)
    return notes


def _on_other_rigs(binned: BinnedCampaign, chain: ChainOfCampaign) -> list[str]:
    """What is less sure, or another thing, than on pulses of the published rig."""
    notes = [
        "The probabilities were calibrated on pulses of a valve, a manifold and a sensor. On this "
        "rig or programme they are less sure."
    ]
    if binned.floor.level_dof < FEW_DOF:
        notes.append(
            f"The noise is known as from {binned.floor.level_dof:.0f} independent samples only, so "
            "that only a clear misfit counts. Longer baselines and plateaus tell more."
        )
    sensors = [name for name in chain.names if name.startswith("tau_s[")]
    if sensors:
        notes.append(f"Of several sensors, tau is that of the first, {sensors[0]}.")
    if len(chain.kernels[0].rig.lags_that_commute(binned.campaign.same_flow)) > 1:
        notes.append(
            "Which lag is the sensor's is taken from the campaign: a chain of lags cannot tell."
            if binned.order_known
            else "Nobody knows which lag is the sensor's: effects of the sensor are tried on the "
            "shortest one. Say in the campaign which one it is (sensor_is)."
        )
    return notes


def _louder_spells(binned: BinnedCampaign) -> list[str]:
    """Every experiment whose noise is louder for a while: when, and by how much."""
    found = []
    for b, times in zip(binned.bins, binned.floor.loudness, strict=True):
        loud = times > TELLING
        if np.any(loud):
            begins, ends = b.edges
            span = f"from {floor(begins[loud][0])} to {ceil(ends[loud][-1])} s"
            found.append(f"{b.experiment.name} ({span} up to {times.max():.1f} times)")
    return found
