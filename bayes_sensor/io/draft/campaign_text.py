"""The text of a first ``campaign.toml``: every assumption and everything missing is marked."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bayes_sensor.campaign import STAGES
from bayes_sensor.io.draft.exports import Unread
from bayes_sensor.io.draft.proposed_experiments import Draft, DraftLine
from bayes_sensor.io.readers.left_open import MARK as OPEN

_BARE = ("at", "to")
"""keys of inner tables that are written without quotes"""
_COLUMN = 34
"""where the remarks of a line begin"""
MISSING_FLOWS = (
    DraftLine("carrier_flow", f"{OPEN} L/min", "MISSING", "flow of the carrier gas"),
    DraftLine("test_gas_flow", f"{OPEN} L/min", "MISSING",
         "flow of the test gas; total_flow and concentration may stand for the two; leave all out "
         "where no stage of the rig is a volume"),
)  # fmt: skip


@dataclass(frozen=True)
class DraftRig:
    """What is written in ``[rig]`` and ``[conditions]``."""

    stages: tuple[str, ...] = STAGES
    stages_known: bool = False
    sensor_is: str = "unknown"
    conditions: Mapping[str, str] = field(default_factory=dict)
    flows_known: bool = True
    """whether anybody knows the flows, now or later"""

    @property
    def open_flows(self) -> tuple[DraftLine, ...]:
        """The lines of flows that were not given."""
        return MISSING_FLOWS if self.flows_known else ()


def propose_rig() -> DraftRig:
    """The rig to begin with, where nobody is asked: the published one."""
    return DraftRig()


def campaign_text(
    title: str,
    drafts: Sequence[Draft],
    left: Sequence[Unread],
    rig: DraftRig,
    flows: Mapping[str, Mapping[str, str]],
) -> str:
    """The campaign file; ``flows``: by the name of an experiment, what the user gave.

    It can be read by ``read_campaign`` as soon as no value begins with a question mark.
    """
    lines = [
        "# Written by bayes-sensor init from the exports in this folder.",
        f'# MISSING: replace each "{OPEN}" by what was set.',
        "# ASSUMED: correct it where it is wrong.",
        "# Then look at it:  bayes-sensor check campaign.toml --plot",
        "",
        f"title = {_toml(title)}",
        "",
        "[rig]",
        _line(DraftLine("stages", list(rig.stages), "" if rig.stages_known else "ASSUMED",
                   "what the gas passes, in order")),
        _line(DraftLine("sensor_is", rig.sensor_is, "ASSUMED" if rig.sensor_is == "unknown" else "",
                   '"faster" or "slower" of the lags that do not depend on flow, where you know; '
                   "else both answers are given")),
    ]  # fmt: skip
    if rig.conditions:
        lines += ["", "[conditions]"]
        lines += [_line(_given(key, value)) for key, value in rig.conditions.items()]
        if "standard_temperature" not in rig.conditions:
            lines.append(
                _line(DraftLine("standard_temperature", "0 degC", "ASSUMED",
                           "what sccm and slm stand for; makers also use 20 or 25 degC"))
            )  # fmt: skip
    for draft in drafts:
        lines += ["", "[[experiment]]", _line(DraftLine("name", draft.name)),
                  _line(DraftLine("file", draft.file))]  # fmt: skip
        given = flows.get(draft.name)
        lines += [_line(line) for line in rig.open_flows] if given is None else [
            _line(_given(key, value)) for key, value in given.items()
        ]  # fmt: skip
        lines += [_line(line) for line in draft.lines]
    if left:
        lines += ["", "# Not used:"]
        lines += [f"#   {_comment(one.file)}: {_comment(one.reason)}" for one in left]
    return "\n".join(lines) + "\n"


def _given(key: str, value: str) -> DraftLine:
    """The line of what was asked for, which may have been left open."""
    missing = value.startswith(OPEN)
    return DraftLine(key, value, "MISSING" if missing else "", "left open" if missing else "")


def _line(line: DraftLine) -> str:
    if not line.key:
        return f"# {_comment(line.reason)}"
    text = f"{line.key} = {_toml(line.value)}"
    remark = ": ".join(part for part in (line.mark, _comment(line.reason)) if part)
    return f"{text.ljust(_COLUMN - 2)}  # {remark}" if remark else text


def _toml(value: Any) -> str:
    """A text, a list or a table of texts in TOML.

    >>> print(_toml(["0 s", 'a "b"']), _toml({"A": "column 1"}))
    ["0 s", "a \\"b\\""] {"A" = "column 1"}
    """
    if isinstance(value, Mapping):
        pairs = (f"{key if key in _BARE else _toml(key)} = {_toml(v)}" for key, v in value.items())
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return f"[{', '.join(_toml(part) for part in value)}]"


def _comment(text: str) -> str:
    """One line, without control characters, which TOML refuses in comments."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+", " ", text).strip()[:300]
