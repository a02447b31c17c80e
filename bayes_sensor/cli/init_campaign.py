"""A first campaign file for a folder of exports; at a terminal with questions."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from bayes_sensor.campaign import ORDERS, CampaignError, counted
from bayes_sensor.cli.terminal import say
from bayes_sensor.io.disk import write_text
from bayes_sensor.io.draft.campaign_text import DraftRig, campaign_text, propose_rig
from bayes_sensor.io.draft.exports import Export, Unread, find_exports
from bayes_sensor.io.draft.proposed_experiments import Answers, Draft, propose
from bayes_sensor.io.readers.campaign_file import read_rig
from bayes_sensor.io.readers.flow_settings import (
    FLOWS,
    MIXTURE,
    is_standard,
    read_conditions,
    settle_flows,
)
from bayes_sensor.io.readers.left_open import MARK as OPEN
from bayes_sensor.io.readers.quantities import FLOW, TIME, read_quantity
from bayes_sensor.rig.rig import Rig as Stages

Ask = Callable[[str], str]
FILE = "campaign.toml"
WITHOUT_FLOW = ("valve", "sensor")
"""the usual rig where no flow is known"""
_TRIAL = {"temperature": "21 degC", "pressure": "1 bar"}
_EXAMPLES = {
    "carrier_flow": "4.0 L/min",
    "test_gas_flow": "0.5 L/min",
    "total_flow": "4.5 L/min",
    "concentration": "11.1 %",
    "temperature": "21 degC",
    "pressure": "1.0 bar",
}


def init_campaign(folder: Path, *, overwrite: bool, quiet: bool, ask: Ask | None = None) -> None:
    """Write FOLDER/campaign.toml from the exports there.

    ``ask`` puts a question and returns the answer; None: at a terminal the user is asked, elsewhere
    nobody.

    Raises
    ------
    CampaignError
        If there is a campaign file already and ``overwrite`` is not set, or no export can be used.
    """
    path = folder / FILE
    if (path.exists() or path.is_symlink()) and not overwrite:
        raise CampaignError(
            f"{path}: there is a campaign file already; expected a folder without one: edit it, or "
            "replace it with --overwrite"
        )
    if ask is None and not quiet and sys.stdin.isatty() and sys.stdout.isatty():
        ask = _at_terminal
    exports, unread = find_exports(folder)
    answers = _ask_about_files(exports, ask) if ask is not None else Answers()
    drafts, left = propose(exports, folder, answers)
    unread = [*unread, *left]
    if not drafts:
        first = unread[0]
        raise CampaignError(
            f"{folder}: none of {counted(len(unread), 'data file')} can be used; the first is "
            f"{first.file}: {first.reason}"
        )
    _tell_found(drafts, unread, quiet)
    flows: Mapping[str, Mapping[str, str]] = {}
    rig = propose_rig()
    if ask is not None:
        flows, rig = _ask_about_rig(drafts, rig, ask)
    text = campaign_text(folder.resolve().name or "campaign", drafts, unread, rig, flows)
    write_text(path, text)
    missing, assumed = (text.count(f"  # {mark}: ") for mark in ("MISSING", "ASSUMED"))
    marked = f"{counted(assumed, 'assumption')}, {counted(missing, 'missing value')}"
    say(f"{path}: {marked}, each marked in it", quiet)
    first_step = 'replace each "?", then run ' if missing else ""
    say(f"next: {first_step}bayes-sensor check {path} --plot", quiet)


def _at_terminal(question: str) -> str:
    import typer

    return str(typer.prompt(question, default="", show_default=False)).strip()


def _tell_found(drafts: Sequence[Draft], unread: Sequence[Unread], quiet: bool) -> None:
    for draft in drafts:
        told = {line.key: line.value for line in draft.lines}
        signal = f", signal {told['signal']}" if "signal" in told else ""
        say(f"{draft.name}: {draft.file}{signal}, {_told_times(told)}", quiet)
    for one in unread:
        say(f"not used: {one.file}: {one.reason}", quiet)


def _told_times(told: Mapping[str, Any]) -> str:
    """When the input switches, as a draft has it: the first of several times."""
    if "drive" in told:
        return f"on by {told['drive']}"
    if "steps" in told:
        return f"{counted(len(told['steps']), 'step')} from {told['steps'][0]['at']} on"
    said = [f"on {_first(told.get('commanded_on', OPEN))}"]
    said += [f"off {_first(told['commanded_off'])}"] if "commanded_off" in told else []
    return ", ".join(said)


def _first(times: str | Sequence[str]) -> str:
    if isinstance(times, str) or len(times) == 1:
        return str(times if isinstance(times, str) else times[0])
    return f"{times[0]} and {len(times) - 1} more"


def _ask_about_files(exports: Sequence[Export], ask: Ask) -> Answers:
    """Which channel is the sensor's and how files without times were sampled."""
    signal: dict[str, tuple[str, ...]] = {}
    asked: dict[tuple[str, ...], str] = {}
    for export in exports:
        names = tuple(channel.name for channel in export.measured)
        if len(names) < 2:
            continue
        if names not in asked:
            usual = export.signal.name
            listed = ", ".join(names)
            question = f"{export.file}: which channel is the sensor's? {listed} [{usual}]"
            asked[names] = _answer(ask, question, partial(_some_of, names=names))
        if asked[names]:
            signal[export.file] = tuple(_listed(asked[names], names))
    interval: dict[str, str] = {}
    last = ""
    for export in exports:
        if export.timed:
            continue
        shown = f"[{last}]" if last else "(such as 1 ms; Enter: leave it open)"
        question = f"{export.file} has no times: its sampling interval {shown}"
        last = _answer(ask, question, _positive_time) or last
        if last:
            interval[export.file] = last
    return Answers(signal, interval)


def _ask_about_rig(
    drafts: Sequence[Draft], rig: DraftRig, ask: Ask
) -> tuple[dict[str, dict[str, str]], DraftRig]:
    """Flows of every experiment, conditions of standard units, and which lag is the sensor."""
    which = _answer(
        ask,
        "flows are known as: 1 carrier and test-gas flow, 2 total flow and concentration, "
        "3 not at all (Enter: leave them open)",
        partial(_one_of, names=("1", "2", "3")),
    )
    keys = {"1": FLOWS, "2": MIXTURE}.get(which, ())
    flows: dict[str, dict[str, str]] = {}
    last: dict[str, str] = {}
    for draft in drafts if keys else ():
        mine = {}
        for key in keys:
            shown = f"[{last[key]}]" if key in last else f"(such as {_EXAMPLES[key]})"
            question = f"{draft.name}: {key.replace('_', ' ')} {shown}"
            said = _answer(ask, question, partial(_flow, key=key))
            last[key] = said or last.get(key, "")
            if not last[key]:
                del last[key]
            mine[key] = last.get(key, f"{OPEN} {'%' if key == 'concentration' else 'L/min'}")
        flows[draft.name] = mine
    conditions: dict[str, str] = {}
    if any(is_standard(value) for mine in flows.values() for value in mine.values()):
        for key in ("temperature", "pressure"):
            question = f"{key} of the gas in the rig (such as {_EXAMPLES[key]})"
            said = _answer(ask, question, partial(_condition, key=key))
            conditions[key] = said or f"{OPEN} {_EXAMPLES[key].split()[1]}"
    usual = WITHOUT_FLOW if which == "3" else rig.stages
    told = _answer(
        ask,
        f"what does the gas pass, in order (valve, line, manifold, filter, cell, sensor)? "
        f"[{', '.join(usual)}]",
        partial(_stages, flows=which != "3"),
    )
    stages = tuple(part.strip() for part in told.split(",")) if told else usual
    order = _answer(
        ask,
        "the sensor is faster or slower than the other lags that do not depend on flow "
        "(faster, slower, unknown) [unknown]",
        partial(_one_of, names=ORDERS),
    )
    return flows, DraftRig(
        stages, bool(told), order or "unknown", conditions, flows_known=which != "3"
    )


def _answer(ask: Ask, question: str, check: Callable[[str], str]) -> str:
    """The checked answer; asked again where it cannot be used, empty where none was given."""
    text = ask(question)
    while text.strip():
        try:
            return check(text.strip())
        except CampaignError as error:
            said = str(error)
        text = ask(f"{said}\n{question}")
    return ""


def _one_of(text: str, names: Sequence[str]) -> str:
    for name in names:
        if text.casefold() == name.casefold():
            return name
    raise CampaignError(f"expected one of {', '.join(names)}, but got '{text[:60]}'")


def _some_of(text: str, names: Sequence[str]) -> str:
    """The text, if it is one of the names or several with commas."""
    if not _listed(text, names):
        return _one_of(text, names)
    return text


def _listed(text: str, names: Sequence[str]) -> list[str]:
    """The names of a text, in its order; empty where a part is none of them."""
    found = [_known(part, names) for part in ([text] if _known(text, names) else text.split(","))]
    return [name for name in found if name] if all(found) else []


def _known(text: str, names: Sequence[str]) -> str:
    folded = text.strip().casefold()
    return next((name for name in names if name.casefold() == folded), "")


def _stages(text: str, flows: bool) -> str:
    """The text, if it is a rig that the campaign reader takes."""
    stages = [part.strip() for part in text.split(",")]
    read_rig({"stages": stages}, FILE)
    if not flows and Stages.parse(stages).needs_flow:
        raise CampaignError(
            f"'{text[:60]}' holds a volume, whose lag is V/Q; expected lags only, as no flow is "
            "known: leave the volumes out"
        )
    return text


def _positive_time(text: str) -> str:
    if not read_quantity(text, TIME, "interval") > 0:
        raise CampaignError(f"expected a positive time such as 1 ms, but got '{text[:60]}'")
    return text


def _flow(text: str, key: str) -> str:
    """The text, if the campaign reader takes it."""
    other = {"carrier_flow": "test_gas_flow", "test_gas_flow": "carrier_flow",
             "total_flow": "concentration", "concentration": "total_flow"}[key]  # fmt: skip
    trial = {key: text, other: _EXAMPLES[other]}
    settled, _ = settle_flows(trial, read_conditions(_TRIAL, FILE), "this answer")
    for flow in FLOWS:
        if not read_quantity(settled[flow], FLOW, key) > 0:
            raise CampaignError(f"expected a positive flow, but got '{text[:60]}'")
    return text


def _condition(text: str, key: str) -> str:
    read_conditions({key: text}, FILE)
    return text
