"""From experiments to a campaign: sensors of one record, units, the rig and what is known of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bayes_sensor.campaign import STAGES, Campaign, CampaignError, Experiment, SideInformation
from bayes_sensor.io.readers.campaign_file import ExperimentTable, RigTable, read_side_information
from bayes_sensor.io.readers.quantities import conversion_factor
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.ties import tie_parameters

_LONGEST_MESSAGE = 2000

KnownOf = Callable[[Sequence[str], Sequence[str]], dict[str, SideInformation]]
"""side information by flat name, of the rig's stages and the names of several sensors"""


def by_sensor(entry: ExperimentTable) -> list[tuple[ExperimentTable, str, str]]:
    """The entry of each sensor, with the names of the record and the sensor."""
    if not entry.signals:
        return [(entry, "", "")]
    if entry.signal is not None:
        raise CampaignError(
            f"experiment '{entry.name}' ({entry.file}): both signal and signals are given; "
            "expected one of them: remove signal"
        )
    return [
        (
            entry.model_copy(
                update={
                    "name": f"{entry.name},{sensor}",
                    # a design has no columns; data in memory have, but no file
                    "signal": None if entry.duration is not None else column,
                    "signals": {},
                }
            ),
            entry.name,
            sensor,
        )
        for sensor, column in entry.signals.items()
    ]


def side_information_of(table: Mapping[str, Any], label: str) -> KnownOf:
    """What reads a table of side information once the rig is known."""
    return lambda stages, sensors: read_side_information(dict(table), label, stages, sensors)


def join(
    title: str,
    experiments: Sequence[Experiment],
    units: list[tuple[str, str]],
    warnings: Sequence[str],
    rig: RigTable,
    known: KnownOf,
    label: str,
    source: str = "",
) -> Campaign:
    """The campaign of experiments on one rig.

    Without stages the rig is the published one or, where no flow is known, that without its volume.

    Raises
    ------
    CampaignError
        If units differ, some records have several sensors and some one, side information is of
        another rig, or a stage needs a flow that is not known.
    """
    sensors = [e.sensor for e in experiments if e.sensor]
    if sensors and len(sensors) < len(experiments):
        raise CampaignError(
            f"{label}: some experiments have signals and some have signal; expected the sensors of "
            "every record: write signals in all of them"
        )
    stages, said = rig.stages or STAGES, list(warnings)
    if rig.stages is None and not any(e.flow_known for e in experiments):
        stages = tuple(stage for stage in STAGES if stage != "manifold")
        said.append(
            f"{label}: no flows are given, so the rig is taken as {' and '.join(stages)}, without "
            "a volume; write [rig] stages to say what the gas passes"
        )
    found = Campaign(
        title=title,
        experiments=tuple(experiments),
        side_information=known(stages, tuple(dict.fromkeys(sensors))),
        signal_unit=one_unit(units, label),
        warnings=tuple(one_line(text) for text in said),
        source=source,
        sensor_is=rig.sensor_is,
        stages=stages,
    )
    Layout.of(found)  # raises where a stage needs a flow that is not known
    return tie_parameters(found, rig.tie, f"{label}: [rig] tie") if rig.tie else found


def one_line(text: str) -> str:
    """The text without control characters, shortened to the length of a message."""
    shown = "".join(c if c.isprintable() else "\ufffd" for c in text)
    return shown if len(shown) <= _LONGEST_MESSAGE else shown[: _LONGEST_MESSAGE - 3] + "..."


def one_unit(units: list[tuple[str, str]], label: str) -> str:
    """The unit of all experiments, given by name; CampaignError where they differ."""
    first_name, first = units[0]
    for name, unit in units:
        if unit != first and conversion_factor(unit, first) != 1.0:
            raise CampaignError(
                f"experiment '{name}' ({label}): its signal is in '{unit}', but that of experiment "
                f"'{first_name}' in '{first}'; expected one unit: set the same signal_unit for all"
            )
    return first
