"""The blind check from the command line: draw and seal, diagnose, open and score."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor.analysis.put_report import last_step, put_report
from bayes_sensor.blind_check import (
    SETTINGS,
    card_table,
    diagnose_cases,
    draw_cases,
    open_seals,
    score,
    sealed_late,
    table,
)
from bayes_sensor.blind_check.sealing import CAMPAIGNS, SEALED, VERDICTS
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli.logged_notes import noted
from bayes_sensor.cli.put_figure import put_figure
from bayes_sensor.cli.terminal import lined_up, progress_bar, say
from bayes_sensor.figures.plot_blind_check import score_card
from bayes_sensor.io.csv_text import csv_text
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import Results, StagingFolder

if TYPE_CHECKING:
    from bayes_sensor.cli.command_options import BlindCheck

PARTS = "blind-check-parts"
"""folder of finished parts, for --resume; removed once all is done"""
KEEP_UP_TO = 100
"""cases whose campaigns are kept unless the user says otherwise: some 13 MB each"""


def blind_check(wanted: BlindCheck, only: str | None) -> None:
    """Run all of it, or ``only`` ``cases``, ``diagnose`` or ``score``."""
    clock, seconds = CommandClock(), dict[str, float]()
    out, n, quiet = wanted.out, wanted.cases, wanted.quiet
    if wanted.setting not in SETTINGS:
        raise CampaignError(
            f"--setting: expected one of {', '.join(SETTINGS)}, but got '{wanted.setting}'; "
            "correct it"
        )
    results = Results(out)
    for name in (SEALED, VERDICTS, CAMPAIGNS):
        results.own_folder(name)
    plan = results.json("plan.json")
    drawn = {case["case"] for case in plan["cases"]} if plan else set()
    found = {path.parent.name for path in (out / "campaigns").glob("*/campaign.toml")}
    own = bool(found - drawn) or ((out / "campaigns").is_dir() and not plan)
    if own and only in (None, "cases"):
        raise CampaignError(
            f"--out {out}: campaigns/ there holds campaigns of your own, which drawn cases would "
            "replace; diagnose yours with --diagnose-only, or choose another folder"
        )
    keep = n <= KEEP_UP_TO if wanted.keep is None else wanted.keep
    card: dict[str, Any] | None = None
    with results.locked():
        parts = results.own_folder(PARTS)
        if not wanted.resume:
            results.clear(PARTS)
        with results.writing() as stage:
            made = stage.inside if only is None else results.folder
            if only in (None, "cases"):
                begin = time.perf_counter()
                with progress_bar("drawing", quiet) as tell:
                    draw_cases(
                        stage.inside, parts, n, wanted.seed, reserve=wanted.reserve,
                        size=wanted.size, keep=keep, jobs=wanted.jobs, scheduler=wanted.scheduler,
                        progress=lambda done, of: tell(done / of, f"{done} of {of} cases"),
                    )  # fmt: skip
                seconds["cases"] = time.perf_counter() - begin
            if only in (None, "diagnose"):
                begin = time.perf_counter()
                with progress_bar("diagnosing", quiet) as tell:
                    diagnose_cases(
                        made, stage.inside, parts, wanted.setting, jobs=wanted.jobs,
                        scheduler=wanted.scheduler,
                        progress=lambda done, of: tell(done / of, f"{done} of {of} cases"),
                    )  # fmt: skip
                seconds["diagnosis"] = time.perf_counter() - begin
            if only in (None, "score"):
                card = _write_card(stage, made)
            put_run(
                stage, "blind-check", clock, seed=wanted.seed, seconds=seconds, warnings=noted(),
                settings={
                    "cases": n, "setting": wanted.setting, "only": only,
                    "reserve": wanted.reserve, "size": wanted.size,
                },
            )  # fmt: skip
        if card is not None:  # from the whole folder, which may hold an analysis as well
            with progress_bar("report", quiet) as tell, last_step(results):
                put_report(results, tell)
        results.clear(PARTS)
    if card is not None:
        say(summary(card), quiet)
        if card["sealed_late"]:
            say(f"truths not sealed before the verdicts: {', '.join(card['sealed_late'])}", quiet)
        say(f"score card: {results.path('score_card.png')}", quiet)
        say(f"report: {results.path('report.html')}", quiet)
    elif only == "diagnose":
        names = results.json("verdicts.json")
        say(f"verdicts of {len(names)} campaigns: {results.path('verdicts')}", quiet)
        sealed = results.json("sealed.json") or {}
        if missing := [name for name in names if name not in sealed]:
            say(f"no truth yet, and too late to seal one: {', '.join(missing)}", quiet)
    else:
        say(f"{n} cases, truths sealed: {results.path('sealed.json')}", quiet)


def _write_card(stage: StagingFolder, folder: Path) -> dict[str, Any]:
    card, rows = score(open_seals(folder))
    card["sealed_late"] = sealed_late(folder)
    stage.json("score.json", card)
    stage.text("cases.csv", csv_text(table(rows)))
    stage.text("score.csv", csv_text(card_table(card)))
    put_figure(stage, "score_card", score_card(card))
    return card


def summary(card: Mapping[str, Any]) -> str:
    """One line a goal: what was wanted, what was reached, whether it was met."""
    rows = [["goal", "wanted", "reached", "95 % interval", ""]]
    for goal in card["goals"]:
        interval = "" if goal["lo95"] is None else f"{goal['lo95']:.3f} to {goal['hi95']:.3f}"
        reached = "no case" if goal["reached"] is None else f"{goal['reached']:.3f}"
        met = {True: "met", False: "missed", None: ""}[goal["met"]]
        rows.append([goal["goal"], goal["wanted"] or "", reached, interval, met])
    kinds = ", ".join(f"{n} {kind}" for kind, n in card["kinds"].items())
    return "\n".join([f"{card['n']} cases: {kinds}", *lined_up(rows, left=len(rows[0]))])
