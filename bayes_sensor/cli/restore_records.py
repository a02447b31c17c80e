"""The command restore: the input of a slow sensor from one record of it or from many."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor.analysis.overrides import make_problem, read_overrides
from bayes_sensor.analysis.read_input import read_input
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli.put_figure import put_figure
from bayes_sensor.cli.terminal import Progress, progress_bar, say
from bayes_sensor.io.disk import own_folder
from bayes_sensor.io.json_files import sha256
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.readers import FORMATS
from bayes_sensor.io.record_file import Record, read_record
from bayes_sensor.io.results import Results, StagingFolder
from bayes_sensor.posterior.samplers import FASTEST
from bayes_sensor.restoration import Restored, restore
from bayes_sensor.restoration.lag_draws import LagDraws, posterior_lags, saved_lags, stated_lags

if TYPE_CHECKING:
    from bayes_sensor.cli.command_options import Restoring

USAGE = (
    'give CAMPAIGN.toml or a folder of results and then the record, or --lag "40 +- 2 min" and the '
    "record"
)


def restore_records(wanted: Restoring) -> int:
    """Restore every record, one folder each where there are several; the exit code."""
    clock = CommandClock()
    source, files = _parted(wanted.paths, wanted.lag or ())
    # everything that can be wrong with the input is found before anything is written
    read = partial(
        read_record, signal=wanted.signal, time=wanted.time, interval=wanted.interval,
        signal_unit=wanted.signal_unit,
    )  # fmt: skip
    records = [read(file) for file in files]
    names = _names(files)
    with progress_bar("lags", wanted.quiet) as tell:
        lags, code, used = _lags(source, wanted, tell)
    for file, record, name in zip(files, records, names, strict=True):
        with progress_bar("restore", wanted.quiet) as tell:
            found = restore(
                lags, record, nonnegative=wanted.non_negative, seed=wanted.seed, jobs=wanted.jobs,
                progress=tell,
            )  # fmt: skip
        folder = wanted.out if len(files) == 1 else wanted.out / name
        if len(files) > 1:
            wanted.out.mkdir(parents=True, exist_ok=True)
            own_folder(folder)
        results = Results(folder)
        with results.locked(), results.writing() as stage:
            _put(stage, found, record)
            put_run(
                stage, "restore", clock, seed=wanted.seed, settings=_settings(wanted, source, file),
                campaign="" if source is None else str(source),
                files={file.name: record.sha256, **used}, exit_code=code, warnings=found.warnings,
            )  # fmt: skip
        say(f"{file.name}:" if len(files) > 1 else "", wanted.quiet or len(files) == 1)
        for text in (*found.sentences, *(f"warning: {text}" for text in found.warnings)):
            say(text, wanted.quiet)
        say(f"results: {folder}{os.sep}restored.csv", wanted.quiet)
    return code


def _parted(paths: Sequence[Path], lags: Sequence[str]) -> tuple[Path | None, list[Path]]:
    """Where the lags come from (None where they are stated), and the files of the records."""
    source: Path | None = None
    rest = list(paths)
    first_is_source = rest[0].suffix.casefold() == ".toml" or (rest[0] / "posterior.nc").is_file()
    if first_is_source:
        source = rest.pop(0)
    if source is not None and lags:
        raise CampaignError(f"--lag: the lags are also those of {source}; expected one: {USAGE}")
    if source is None and not lags and (rest[0] / "campaign.json").is_file():
        raise CampaignError(
            f"{rest[0]}: expected results with posterior.nc, but there is none; run bayes-sensor "
            "posterior or analyze with --out there first"
        )
    if source is None and not lags:
        raise CampaignError(f"{rest[0]}: nothing says the sensor's lag; {USAGE}")
    files: list[Path] = []
    for path in rest:
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.casefold() in FORMATS)
            if not inside:
                raise CampaignError(
                    f"{path}: expected records in this folder, files ending in "
                    f"{', '.join(FORMATS)}, but there are none; give the folder that holds them"
                )
            files += inside
        else:
            files.append(path)
    if not files:
        raise CampaignError(f"{source}: expected a record after it, but there is none; {USAGE}")
    return source, files


def _names(files: Sequence[Path]) -> list[str]:
    names = [file.stem for file in files]
    for name, file in zip(names, files, strict=True):
        if names.count(name) > 1:
            raise CampaignError(
                f"{file}: two records are called '{name}'; expected names that differ, as each "
                "gets a folder of its name: rename one"
            )
    return names


def _lags(
    source: Path | None, wanted: Restoring, tell: Progress
) -> tuple[LagDraws, int, dict[str, str]]:
    """Draws of the lags, the exit code of what made them, and the hashes of the files used."""
    flow = _flow(wanted.flow)
    if source is None:
        read_overrides(wanted.config)  # a mistake in it is refused, though nothing of it acts
        return stated_lags(wanted.lag or (), wanted.seed, "--lag"), 0, {}
    if source.is_dir():
        read_overrides(wanted.config)
        path = source / "posterior.nc"
        return saved_lags(source, wanted.at, flow, wanted.sensor), 0, {path.name: sha256(path)}
    from bayes_sensor.fit import fit_least_squares
    from bayes_sensor.posterior import sample_posterior

    # seconds, where the noise law allows it; otherwise it falls back
    quick = {"sampler": FASTEST} if wanted.config is None else None
    overrides: Any = read_overrides(wanted.config, quick)
    label = wanted.config.name if wanted.config is not None else "--config"
    campaign, _, _ = read_input(source)
    if campaign.is_design:
        raise CampaignError(
            f"{source.name}: this is a design without data, but restore needs the lags of measured "
            "experiments; give every experiment a file"
        )
    problem = make_problem(campaign, overrides, label)
    part = _part(tell, 0.0, 0.4)
    fit = fit_least_squares(problem, seed=wanted.seed, progress=part)
    posterior = sample_posterior(
        problem, fit, seed=wanted.seed, sampler=overrides.posterior.sampler,
        settings=overrides.sampler_settings(), jobs=wanted.jobs, progress=_part(tell, 0.4, 1.0),
    )  # fmt: skip
    code = 0 if fit.converged and posterior.converged else 3
    lags = posterior_lags(posterior, wanted.at, flow, wanted.sensor)
    return lags, code, {source.name: sha256(source)}


def _flow(text: str | None) -> float | None:
    from bayes_sensor.io.readers.flow_settings import read_flow

    return None if text is None else read_flow(text, "--flow")


def _part(tell: Progress, begin: float, end: float) -> Callable[[float, str], None]:
    return lambda fraction, text: tell(begin + (end - begin) * fraction, text)


def _settings(wanted: Restoring, source: Path | None, record: Path) -> dict[str, Any]:
    """What changes a number and is told nowhere else."""
    return {
        "record": record.name, "lags": wanted.lag or [], "signal": wanted.signal,
        "time": wanted.time,
        "interval": wanted.interval, "signal_unit": wanted.signal_unit, "at": wanted.at,
        "flow": wanted.flow, "sensor": wanted.sensor, "nonnegative": wanted.non_negative,
        "source": None if source is None else str(source),
    }  # fmt: skip


def _put(stage: StagingFolder, found: Restored, record: Record) -> None:
    from bayes_sensor import figures

    stage.json("restored.json", found.to_json())
    found.table().to_csv(stage.path("restored.csv"), index=False)
    put_figure(stage, "restored", figures.restored(found))
    lines = [f"# Restored input of {record.source}", ""]
    lines += [f"- {text[:1].upper()}{text[1:]}." for text in found.sentences]
    lines += [f"- Warning: {text}." for text in found.warnings]
    lines += ["", "![Record, restored input with 68 and 95 % bands, and resolution](restored.svg)"]
    stage.text("restored.md", "\n".join([*lines, ""]))
