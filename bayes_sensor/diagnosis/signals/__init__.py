"""What single samples show: detectors of lines, events, local misfit and the like, and their order.

A detector is one file with one :class:`~bayes_sensor.diagnosis.signals.finding.Signal`; it is
listed here.  Effects on the noise bring detectors of their own
(:class:`~bayes_sensor.diagnosis.effects.effect.OnNoise`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from bayes_sensor.diagnosis.data.quiet_stretches import hides_the_noise
from bayes_sensor.diagnosis.signals import (
    bursts,
    events,
    lines,
    local_misfit,
    plateau_noise,
    ringing,
    transient_lines,
)
from bayes_sensor.diagnosis.signals.finding import FOUND, Finding, Signal, converter_step

if TYPE_CHECKING:
    from bayes_sensor.diagnosis.data.preparation import PreparedCampaign
    from bayes_sensor.diagnosis.effects.effect import Effect
    from bayes_sensor.diagnosis.evidence.refit import Refit

UNLISTED: tuple[Signal, ...] = (
    lines.LINE,
    lines.SLOW_LINE,
    transient_lines.SIGNAL,
    bursts.SIGNAL,
    events.SIGNAL,
    local_misfit.BUMP,
    local_misfit.LEVEL_CHANGE,
    ringing.SIGNAL,
    plateau_noise.SIGNAL,
)
"""signals that belong to no effect of the catalogue"""


def look_at_noise(
    prepared: PreparedCampaign, known: Mapping[str, Effect], catalogue: Mapping[str, Effect]
) -> list[Finding]:
    """What the effects on the noise leave in the samples, whatever explains the mean.

    All that are ``known`` are looked for; a finding of one that is not in the ``catalogue`` is
    taken for what it then is, or left out.
    """
    found: list[Finding] = []
    # the converter's steps come first: they change what the samples show of all else
    for effect in reversed(list(known.values())):
        if effect.on_noise and effect.on_noise.look:
            found = [*effect.on_noise.look(prepared, found), *found]
    told = []
    for f in found:
        if f.name in catalogue or not f.signal.listed:
            told.append(f)
        elif f.signal.if_not_listed:
            told.append(f.signal.if_not_listed(f))
    return told


def look_at_residuals(
    prepared: PreparedCampaign, best: Refit, found: Sequence[Finding]
) -> list[Finding]:
    """What is of unlisted origin in the samples less the mean of the ``best`` explanation.

    ``found``: in the noise before.  Nothing is looked for where rounding hides the noise.
    """
    if hides_the_noise(prepared.stretches, converter_step(found)):
        return []
    heavy = any(f.signal.heavy_tailed and f.probability > FOUND for f in found)
    left = prepared.less_mean_of(best)
    campaign, residuals, deviations = left.records
    told = events.look_for_events(campaign, left.stretches, heavy)
    steady = told.tails[0] >= events.HEAVY_DOF
    return [
        *lines.look_for_lines(campaign, left.stretches),
        local_misfit.look_for_local_misfit(best, residuals, left.quiet, told.lasting),
        local_misfit.look_for_level_changes(best, told.lasting),
        told.found,
        ringing.look_for_ringing(campaign, residuals, left.quiet),
        *lines.look_for_slow_lines(campaign, residuals, deviations),
        *transient_lines.look_for_transient_lines(campaign, residuals, deviations),
        *(plateau_noise.look_for_plateau_noise(campaign, left.stretches) if steady else []),
    ]
