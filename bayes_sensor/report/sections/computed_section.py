"""How it was computed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from bayes_sensor import __version__, figures
from bayes_sensor.report.parts import Part, Picture, Section, Table, pointing, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.draws_section import of_draws, posterior_table
from bayes_sensor.report.words import sentence


def computed(saved: Saved) -> Section:
    """Versions, seed, settings, files, convergence."""
    run, posterior = saved.last, saved.posterior
    answer = (
        f"bayes-sensor {run['versions'].get('bayes-sensor', __version__)}, command "
        f"{saved.run['last']}, seed {run['seed']}, finished {run['finished']}"
        f"{see('versions', 'settings', 'files')}."
    )
    paragraphs = []
    if posterior is not None:
        status = posterior.get("convergence", posterior["status"])
        paragraphs = [
            pointing(status, "posterior-shared", "posterior-experiments"),
            *(sentence(reason) for reason in posterior.get("reasons", [])),
            "Convergence asks for R-hat below 1.01 between independent runs and for at least 400 "
            "effective draws, in bulk and in the tails, of every parameter.",
        ]
    return Section("computed", "How it was computed", answer, paragraphs, list(_content(saved)))


def _content(saved: Saved) -> Iterator[Part]:
    run = saved.last
    if saved.posterior is not None:
        if saved.draws is not None:
            yield Picture(
                "traces",
                partial(of_draws, figures.traces_and_ranks, saved.draws, saved.unit),
                "The chains, and how often each chain's draws hold each rank among all draws. "
                "When the chains agree the bars scatter about the middle of the grey band.",
                on_paper=True,
            )
        yield posterior_table(saved, shared=False)
        priors = saved.posterior.get("priors", {})
        yield _pairs(
            "priors",
            "Priors, in s, mL and the signal's unit.",
            ("parameter", "prior"),
            [(figures.parameter_words(name, saved.unit)[0], text) for name, text in priors.items()],
        )
    settings = [(key, _plain_text(value)) for key, value in _flattened(run.get("settings") or {})]
    yield _pairs("settings", "Settings that were in force.", ("setting", "value"), settings)
    files = run.get("files_sha256", {}).items()
    yield _pairs("files", "Input files and their SHA-256.", ("file", "sha-256"), files)
    yield _pairs("versions", "Versions.", ("package", "version"), run["versions"].items())
    yield Table(
        "runs",
        "What was run, and how long it took.",
        ["command", "finished", "seed", "exit code", "seconds"],
        [
            [name, e["finished"], e["seed"], e["exit_code"], sum(e["seconds"].values())]
            for name, e in saved.run["commands"].items()
        ],
    )


def _pairs(
    key: str, caption: str, heads: tuple[str, str], rows: Iterable[tuple[str, Any]]
) -> Table:
    return Table(key, caption, list(heads), [list(row) for row in rows])


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
