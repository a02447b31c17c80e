"""How it was computed."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from bayes_sensor import __version__, figures
from bayes_sensor.report.parts import Part, Pictures, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.draws_section import posterior_table, traces_and_ranks
from bayes_sensor.report.words import sentence


def computed(saved: Saved, pictures: Pictures) -> Section:
    """Versions, seed, settings, files, convergence."""
    run = saved.last
    answer = (
        f"bayes-sensor {run['versions'].get('bayes-sensor', __version__)}, command "
        f"{saved.run['last']}, seed {run['seed']}, finished {run['finished']}"
        f"{see('versions', 'settings', 'files')}."
    )
    paragraphs = []
    content: list[Part] = []
    if saved.posterior is not None:
        status = sentence(
            saved.posterior.get("convergence", saved.posterior["status"])
        ).removesuffix(".")
        paragraphs.append(f"{status}{see('posterior-shared', 'posterior-experiments')}.")
        paragraphs += [sentence(reason) for reason in saved.posterior.get("reasons", [])]
        paragraphs.append(
            "Convergence asks for R-hat below 1.01 between independent runs and for at least 400 "
            "effective draws, in bulk and in the tails, of every parameter."
        )
        if saved.draws is not None:
            content.append(
                pictures.add(
                    "traces",
                    partial(traces_and_ranks, saved.draws, saved.unit),
                    "The chains, and how often each chain's draws hold each rank among all draws. "
                    "When the chains agree the bars scatter about the middle of the grey band.",
                    on_paper=True,
                )
            )
        content.append(posterior_table(saved, shared=False))
        content.append(
            Table(
                "priors",
                "Priors, in s, mL and the signal's unit.",
                ["parameter", "prior"],
                [
                    [figures.parameter_words(name, saved.unit)[0], text]
                    for name, text in saved.posterior.get("priors", {}).items()
                ],
            )
        )
    content.append(
        Table(
            "settings",
            "Settings that were in force.",
            ["setting", "value"],
            [[key, _plain_text(value)] for key, value in _flattened(run.get("settings") or {})],
        )
    )
    content.append(
        Table(
            "files",
            "Input files and their SHA-256.",
            ["file", "sha-256"],
            [[name, value] for name, value in run.get("files_sha256", {}).items()],
        )
    )
    content.append(
        Table(
            "versions",
            "Versions.",
            ["package", "version"],
            [[name, version] for name, version in run["versions"].items()],
        )
    )
    content.append(
        Table(
            "runs",
            "What was run, and how long it took.",
            ["command", "finished", "seed", "exit code", "seconds"],
            [
                [name, e["finished"], e["seed"], e["exit_code"], sum(e["seconds"].values())]
                for name, e in saved.run["commands"].items()
            ],
        )
    )
    return Section("computed", "How it was computed", answer, paragraphs, content)


def _flattened(settings: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in settings.items():
        if isinstance(value, Mapping):
            rows += _flattened(value, f"{prefix}{key}.")
        else:
            rows.append((prefix + key, value))
    return rows


def _plain_text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_plain_text(v) for v in value)
    return {True: "yes", False: "no", None: "default"}.get(value, str(value))
