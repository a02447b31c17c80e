"""What single samples show: the registry of signals, and one loop over them.

A signal is one file with one :class:`~bayes_sensor.diagnosis.signals.signal.Signal`, entered here.
Those of listed effects are the effects' own
(:attr:`~bayes_sensor.diagnosis.effects.effect.OnNoise.signal`); the others are notes, and speak for
an unlisted cause as far as the calibration map says.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from bayes_sensor.diagnosis.signals import (
    bursts,
    converter,
    events,
    level_changes,
    lines,
    local_misfit,
    mains,
    plateau_noise,
    ringing,
    swing,
    tails,
    transient_lines,
)
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal

if TYPE_CHECKING:
    from bayes_sensor.diagnosis.effects.effect import Effect

SIGNALS: tuple[Signal, ...] = (
    converter.SIGNAL,  # first: its steps change what the samples show of all else
    tails.SIGNAL,
    mains.SIGNAL,
    bursts.SIGNAL,
    lines.SIGNAL,
    swing.SIGNAL,
    transient_lines.SIGNAL,
    events.SIGNAL,  # before those that are judged by the tails it measures
    local_misfit.SIGNAL,
    level_changes.SIGNAL,
    ringing.SIGNAL,
    plateau_noise.SIGNAL,
)


def look_for_signals(samples: Samples, catalogue: Mapping[str, Effect]) -> list[Finding]:
    """What every signal finds in the samples, those of a user's own effects included.

    A finding of a listed effect that is not in the ``catalogue`` is taken for what it then is, or
    left out.
    """
    of_effects = (e.on_noise.signal for e in catalogue.values() if e.on_noise)
    own = [s for s in of_effects if s is not None and s not in SIGNALS]
    even = all(e.regular for e in samples.campaign)
    for signal in (*SIGNALS, *own):
        if signal.by_frequency and not even:
            continue
        if signal.despite_rounding or not samples.rounding_hides_the_noise:
            found = signal.look(samples)
            samples = replace(samples, found=(*samples.found, *found))
    told = []
    for f in samples.found:
        if f.name in catalogue or not f.signal.listed:
            told.append(f)
        elif f.signal.if_not_listed:
            told.append(f.signal.if_not_listed(f))
    return told
