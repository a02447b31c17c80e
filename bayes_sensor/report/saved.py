"""The content of a results directory, read for the report."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from bayes_sensor.campaign import ZIF8, CampaignError
from bayes_sensor.fit.samples import Samples, load_samples
from bayes_sensor.fit.traces import Trace, load_traces
from bayes_sensor.io.result_schema import check_result, check_together
from bayes_sensor.io.results import Results
from bayes_sensor.io.untrusted import LARGEST_JSON, read_bytes, refused
from bayes_sensor.report.drawing import inline_svg
from bayes_sensor.report.headline import Headline, headline


@dataclass
class Saved:
    """The content of a results directory; what was not computed is None."""

    campaign: dict[str, Any]
    run: dict[str, Any]
    fit: dict[str, Any] | None = None
    residuals: dict[str, Any] | None = None
    posterior: dict[str, Any] | None = None
    posterior_without_effects: dict[str, Any] | None = None
    """the earlier posterior, if the newest has effects in its model"""
    predictive: dict[str, Any] | None = None
    bounds: dict[str, Any] | None = None
    delays: dict[str, Any] | None = None
    gap: dict[str, Any] | None = None
    coating: dict[str, Any] | None = None
    score: dict[str, Any] | None = None
    """of a blind check"""
    cases: list[dict[str, str]] | None = None
    """its cases as they stand in cases.csv"""
    restored: dict[str, Any] | None = None
    restored_figure: str = ""
    """as SVG"""
    traces: list[Trace] | None = None
    samples: list[Samples] | None = None
    draws: Path | None = None
    """the file with the draws of the posterior, which only the full report reads"""
    compare_published: bool = False
    """whether to show all that concerns the published sensor, whatever the campaign says"""

    @property
    def unit(self) -> str:
        """The signal's unit."""
        return str(self.campaign.get("signal_unit", "V"))

    @property
    def small_unit(self) -> tuple[str, float]:
        """Unit for residuals and the factor to it."""
        return ("mV", 1e3) if self.unit == "V" else (self.unit, 1.0)

    @property
    def name(self) -> str:
        """The campaign's title."""
        return str(self.campaign.get("title", "campaign"))

    @property
    def concentration(self) -> dict[str, float]:
        """Test-gas fraction by experiment, of those whose flows are known."""
        return {
            e["experiment"]: e["concentration_percent"] / 100
            for e in self.campaign["experiments"]
            if e["concentration_percent"] is not None
        }

    @property
    def last(self) -> dict[str, Any]:
        """The record of the newest run."""
        return dict(self.run["commands"][self.run["last"]])

    @cached_property
    def settings(self) -> dict[str, Any]:
        """The settings of the posterior."""
        commands = self.run["commands"]
        for name in ("posterior", "analyze", self.run["last"]):
            if name in commands:
                return commands[name].get("settings") or {}
        return {}

    @cached_property
    def headline(self) -> Headline | None:
        """The first sentence of the report; None if nothing was estimated."""
        return headline(self.posterior, self.bounds, self.settings, self.gap)

    @property
    def published(self) -> bool:
        """Whether what concerns the published sensor alone is shown: its coating, its bounds with
        steps of 1 %, Euler's method and the table of the blind check."""
        return self.compare_published or self.campaign.get("coating") == ZIF8

    @property
    def missed(self) -> int:
        """How many traces the model does not describe."""
        warnings = self.fit["warnings"] if self.fit else []
        return sum("does not describe the trace" in w for w in warnings)


def check_folder(folder: str | Path) -> Results:
    """The results directory; CampaignError if it is none."""
    results = Results(folder)
    if not results.folder.is_dir():
        what = "this is a file" if results.folder.exists() else "there is no such folder"
        raise CampaignError(
            f"{folder}: {what}; expected a results folder: "
            "run bayes-sensor analyze CAMPAIGN.toml --out FOLDER first"
        )
    known = any(map(results.has, ("campaign.json", "score.json", "restored.json")))
    if not (known and results.has("run.json")):
        raise CampaignError(
            f"{folder}: expected a results folder with run.json and campaign.json (or score.json "
            "of a blind check, restored.json of restore); run bayes-sensor analyze CAMPAIGN.toml "
            "--out FOLDER first"
        )
    return results


def read_results(folder: str | Path, compare_published: bool = False) -> Saved:
    """What a results directory holds.

    Raises
    ------
    CampaignError
        If it is not a results directory, or a file in it cannot be read.
    """
    results = check_folder(folder)
    campaign = results.json("campaign.json")
    parts = ("fit", "residuals", "posterior", "posterior_without_effects", "predictive", "bounds",
             "delays", "gap", "coating", "restored")  # fmt: skip
    found = {name: results.json(f"{name}.json") for name in parts}
    traces = load_traces(results.path("traces.npz")) if results.has("traces.npz") else None
    samples = load_samples(results.path("samples.npz")) if results.has("samples.npz") else None
    if campaign is not None:
        check_together(results.folder, campaign, found, traces or [], samples or [])
    run = results.json("run.json")
    title = "Blind check of the diagnosis"
    if found["restored"] is not None:
        settings = (run["commands"].get("restore") or {}).get("settings") or {}
        title = f"Restored input of {settings.get('record', 'a record')}"
    return Saved(
        campaign=campaign or {"title": title, "experiments": []},
        run=run,
        restored_figure=_figure(results.path("restored.svg")) if found["restored"] else "",
        traces=traces,
        samples=samples,
        score=results.json("score.json"),
        cases=_cases(results.path("cases.csv")) if results.has("cases.csv") else None,
        draws=results.path("posterior.nc") if results.has("posterior.nc") else None,
        compare_published=compare_published,
        **found,
    )


def _figure(path: Path) -> str:
    """A saved drawing, which is none of the report's own; empty where there is none."""
    if not path.is_file():
        return ""
    expected = "a drawing without scripts, links and images"
    try:
        drawing = read_bytes(path, LARGEST_JSON, expected).decode("utf-8")
        inline_svg(drawing, path.stem, "")
    except ValueError as error:
        raise refused(path, expected, error) from None
    return drawing


def _cases(path: Path) -> list[dict[str, str]]:
    expected = "the cases of a blind check"
    try:
        text = read_bytes(path, LARGEST_JSON, expected).decode("utf-8")
        rows: list[dict[str, str]] = list(csv.DictReader(io.StringIO(text, newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise refused(path, expected, f"they cannot be read ({error})") from None
    check_result(rows, path)
    return rows
