"""What was done to the gas: pulse trains, staircases, drives of many edges, recorded inputs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayes_sensor.campaign import FREE_SWITCHES, CampaignError, Commands, FloatArray
from bayes_sensor.io.readers.campaign_file import ExperimentTable
from bayes_sensor.io.readers.stamps import Moment

Seconds = Callable[[float | Moment, str], float]
"""a time of the campaign file, and the key it stands in, to s on the record's own axis"""


def check_keys(entry: ExperimentTable, where: str) -> None:
    """Raise CampaignError where keys say twice what was done to the gas."""
    lists = any(isinstance(each, tuple) for each in (entry.commanded_on, entry.commanded_off))
    said = {
        "steps": bool(entry.steps),
        "input": entry.input is not None,
        "commanded_on": entry.commanded_on is not None,
        "drive": entry.drive is not None,
    }
    for one, others in (("steps", ("input", "commanded_on", "drive")), ("input", ("commanded_on",
                        "drive"))):  # fmt: skip
        other = next((key for key in others if said[one] and said[key]), None)
        if other:
            raise CampaignError(
                f"{where}: both {one} and {other} say what was done to the gas; expected one of "
                f"them: remove {other}"
            )
    if entry.delays is not None and not (lists or entry.steps or entry.drive):
        raise CampaignError(
            f"{where}: delays is for several switches in a record (lists in commanded_on, steps or "
            "drive), but there are none; remove it"
        )


def commands_of_entry(entry: ExperimentTable, where: str, seconds: Seconds) -> Commands | None:
    """The programme of an entry's steps or lists; None where it has at most one pulse."""
    if entry.steps:
        times = [seconds(step.at, "steps") for step in entry.steps]
        levels = np.array([step.to for step in entry.steps])
        if any(step.percent for step in entry.steps):
            levels = levels / levels.max()  # of the highest concentration of the record
        return _made(times, levels, 0.0, entry, where)
    on, off = entry.commanded_on, entry.commanded_off
    if not (isinstance(on, tuple) or isinstance(off, tuple)):
        return None
    ups = [seconds(each, "commanded_on") for each in _listed(on)]
    downs = [seconds(each, "commanded_off") for each in _listed(off)]
    if len(ups) - len(downs) not in (0, 1):
        raise CampaignError(
            f"{where}: {len(ups)} times in commanded_on and {len(downs)} in commanded_off; "
            "expected one off after each on (but for the last): complete the lists"
        )
    if len(ups) == 1:
        return None
    times = [0.0] * (len(ups) + len(downs))
    times[::2], times[1::2] = ups, downs
    return _made(times, _alternating(len(times), True), 0.0, entry, where)


def single(times: float | Moment | tuple[float | Moment, ...] | None) -> float | Moment | None:
    """The one time of a key; None where there are several."""
    if isinstance(times, tuple):
        return times[0] if len(times) == 1 else None
    return times


def commands_of_edges(
    times: list[float], starts_high: bool, entry: ExperimentTable, where: str
) -> Commands | None:
    """The programme of a drive's edges; None where it is one pulse that starts low."""
    if not starts_high and len(times) <= 2:
        return None
    levels = _alternating(len(times), not starts_high)
    return _made(times, levels, float(starts_high), entry, where)


def commands_of_input(t: FloatArray, values: FloatArray, where: str, name: str) -> Commands:
    """A recorded input, counted from its first value in units of its range."""
    known = np.isfinite(values)
    if known.sum() < 2:
        raise CampaignError(
            f"{where}: the input '{name}' has {int(known.sum())} samples; expected a recorded "
            "channel: choose another, or give the commands"
        )
    t, values = t[known], values[known]
    span = float(np.ptp(values))
    if not span > 0.0:
        raise CampaignError(
            f"{where}: the input '{name}' stays at {values[0]:.6g}; expected one that changes: "
            "choose another channel, or give the commands"
        )
    return Commands(t, (values - values[0]) / span, recorded=True)


def within_record(commands: Commands, t: FloatArray, where: str, notes: list[str]) -> Commands:
    """The commands within a record at times ``t``; those after its end are dropped with a remark.

    Raises CampaignError where the first is before the record, or none is left.
    """
    if commands.recorded:
        return commands
    first, last = float(t[0]), float(t[-1])
    if commands.times[0] < first or commands.times[0] >= last:
        raise CampaignError(
            f"{where}: the first command is at {commands.times[0]:.10g} s, but the record runs "
            f"from {first:.10g} s to {last:.10g} s; expected times on the record's own axis: "
            "correct them, or the crop in keep"
        )
    kept = commands.times < last
    if kept.all():
        return commands
    notes.append(
        f"{where}: {int((~kept).sum())} commands lie beyond the end of the record at "
        f"{last:.10g} s; they were not used"
    )
    return Commands(commands.times[kept], commands.levels[kept], commands.rest, commands.delays)


def _listed(
    times: float | Moment | tuple[float | Moment, ...] | None,
) -> tuple[float | Moment, ...]:
    if times is None:
        return ()
    return times if isinstance(times, tuple) else (times,)


def _alternating(n: int, up: bool) -> FloatArray:
    """(n,) levels after each of ``n`` switches, the first up or down."""
    levels: FloatArray = (np.arange(n) % 2 == (0 if up else 1)).astype(float)
    return levels


def _made(
    times: list[float], levels: FloatArray, rest: float, entry: ExperimentTable, where: str
) -> Commands:
    delays = entry.delays or ("free" if len(times) <= FREE_SWITCHES else "shared")
    try:
        return Commands(np.array(times, dtype=float), levels, rest, delays)
    except CampaignError as error:
        raise CampaignError(f"{where}: {error}") from None
