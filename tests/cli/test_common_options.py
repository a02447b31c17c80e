"""The common options are taken by every command, and act or say that they do not."""

import dataclasses
import inspect
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import typer

from bayes_sensor.checks.coverage import SETTINGS, run_coverage
from bayes_sensor.cli import app, exit_code
from bayes_sensor.cli.options import CommandRun, with_groups
from bayes_sensor.io.readers import read_campaign

COMMON = {"--seed", "--jobs", "--quiet", "--config"}
COMMANDS: dict[str, Any] = vars(typer.main.get_command(app))["commands"]


def run(*arguments: str | Path) -> int:
    """The exit code of a command, in this process."""
    return exit_code([str(a) for a in arguments])


def settings(tmp_path: Path, text: str) -> Path:
    """A file for ``--config``."""
    path = tmp_path / "overrides.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_takes_the_common_options(name: str) -> None:
    taken = {option for parameter in COMMANDS[name].params for option in parameter.opts}
    assert taken >= COMMON


OFFERED = {
    "analyze": COMMON, "posterior": COMMON, "bounds": COMMON, "gap": COMMON, "coverage": COMMON,
    "fleet": COMMON, "fit": COMMON - {"--jobs"}, "delays": COMMON - {"--jobs"},
    "design": COMMON - {"--jobs"}, "simulate": COMMON - {"--jobs"},
    "blind-check": COMMON - {"--config"}, "check": {"--quiet", "--config"}, "init": {"--quiet"},
    "report": {"--quiet", "--jobs"}, "restore": COMMON, "diffusion": {"--quiet"},
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_offers_those_that_do_something(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(name, "--help") == 0
    words = set(capsys.readouterr().out.replace(",", " ").split())
    assert words & COMMON == OFFERED[name]


@pytest.mark.parametrize(
    "arguments",
    [["check", "c.toml"], ["report", "DIR"], ["simulate"], ["diffusion"], ["coverage"],
     ["blind-check"]],
    ids=lambda arguments: arguments[0],
)  # fmt: skip
def test_bad_settings_are_refused_where_they_do_not_act_too(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = settings(tmp_path, '[noise]\nvarience = "constant"\n')
    out = [] if arguments[0] in ("check", "report") else ["--out", tmp_path / "out"]
    assert run(*arguments, *out, "--seed", "3", "--jobs", "2", "--quiet", "--config", path) == 2
    said = capsys.readouterr().err
    assert "overrides.toml: [noise] unknown key 'varience'" in said and '"variance"' in said
    assert said.count("\n") == 1 and not (tmp_path / "out").exists()


def simulated(out: Path, *options: str | Path) -> np.ndarray:
    """(n,) V: what one simulated experiment of half baseline, half plateau recorded."""
    assert run("simulate", "--out", out, "--experiments", "4", "--duration", "40 s",
               "--interval", "10 ms", "--sigma0", "10 mV", "--sigma1", "90 mV", "--phi", "0.9",
               "--quiet", "--jobs", "2", *options) == 0  # fmt: skip
    (experiment,) = read_campaign(out / "campaign.toml")
    return experiment.values


def test_simulate_draws_noise_of_the_law_in_the_settings(tmp_path: Path) -> None:
    usual = simulated(tmp_path / "usual")
    empty = simulated(tmp_path / "empty", "--config", settings(tmp_path, ""))
    np.testing.assert_array_equal(usual, empty)
    law = settings(tmp_path, '[noise]\nvariance = "constant"\nautocorrelation = "white"\n')
    flat = simulated(tmp_path / "flat", "--config", law)
    truth = json.loads((tmp_path / "flat" / "truth.json").read_text(encoding="utf-8"))
    assert truth["phi"] == 0.0 and truth["sigma1_V"] == 0.0 and truth["sigma0_V"] == 0.01
    baseline, plateau = slice(0, 900), slice(2200, 2900)
    for part in (baseline, plateau):  # 3 sd of an sd of 700 samples is 8 %
        assert flat[part].std() == pytest.approx(0.010, rel=0.1)
        lagged = np.corrcoef(flat[part][:-1], flat[part][1:])[0, 1]
        assert abs(lagged) < 0.15
    assert usual[plateau].std() > 0.04  # sqrt(.01^2 + .09^2)
    assert np.corrcoef(usual[plateau][:-1], usual[plateau][1:])[0, 1] > 0.7


@pytest.mark.slow
def test_noise_that_falls_with_gas_is_told_by_a_fit_and_fitted_with_levels(tmp_path: Path) -> None:
    levels = settings(tmp_path, '[noise]\nvariance = "levels"\n')
    made = tmp_path / "falling"
    assert run("simulate", "--out", made, "--experiments", "4,5", "--duration", "40 s",
               "--interval", "10 ms", "--sigma0", "40 mV", "--sigma1", "10 mV", "--phi", "0.5",
               "--quiet", "--config", levels) == 0  # fmt: skip
    found = {}
    for law, options in (("usual", []), ("levels", ["--config", levels])):
        out = tmp_path / law
        assert run("fit", made / "campaign.toml", "--out", out, "--quiet", *options) == 0
        names = ("fit", "residuals", "run")
        found[law] = {n: json.loads((out / f"{n}.json").read_text("utf-8")) for n in names}
    usual, fitted = found["usual"], found["levels"]
    assert not usual["residuals"]["adequate"] and "falls with gas" in usual["residuals"]["verdict"]
    doubt = f"{usual['residuals']['verdict']} {usual['residuals']['recommendation']}"
    assert doubt in usual["fit"]["warnings"]
    assert doubt in usual["run"]["commands"]["fit"]["warnings"]
    assert fitted["residuals"]["adequate"], fitted["residuals"]["verdict"]
    assert not any("variance law" in text for text in fitted["fit"]["warnings"])
    assert fitted["residuals"]["ar1"]["sigma0_V"] == pytest.approx(0.04, rel=0.1)
    assert fitted["residuals"]["ar1"]["sigma1_V"] == pytest.approx(0.01, rel=0.2)
    assert set(usual["residuals"]["checks"]) >= {
        "correlation", "variance_concentration", "variance_slope",
    }  # fmt: skip
    assert len(usual["residuals"]["variance_vs_slope"]["sd_V"]) == 11


def test_check_looks_at_the_settings_with_the_campaign(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulated(tmp_path / "sim")
    campaign = tmp_path / "sim" / "campaign.toml"
    good = settings(tmp_path, '[priors]\n"t0[4]" = "uniform(5 s, 20 s)"\n')
    assert run("check", campaign, "--config", good, "--seed", "2") == 0
    assert "1 experiment" in capsys.readouterr().out
    bad = settings(tmp_path, '[priors]\n"t0[5]" = "uniform(5 s, 20 s)"\n')
    assert run("check", campaign, "--config", bad) == 2
    said = capsys.readouterr()
    assert "unknown parameter 't0[5]'" in said.err and said.out == ""


@pytest.mark.slow
def test_coverage_takes_methods_and_resamples_from_the_settings(tmp_path: Path) -> None:
    text = '[bounds]\nmethods = ["block_bootstrap"]\nresamples = 20\n'
    out = tmp_path / "out"
    assert run("coverage", "--out", out, "--campaigns", "1", "--setting", "iid", "--quiet",
               "--config", settings(tmp_path, text)) == 0  # fmt: skip
    found = pd.read_csv(out / "coverage.csv")
    assert set(found["method"]) == {"block_bootstrap"}
    iid = {"iid": SETTINGS["iid"]}
    expected = run_coverage(tmp_path / "20", iid, 1, ["block_bootstrap"], n_resamples=20)
    pd.testing.assert_series_equal(found["median_width"], expected["median_width"])
    usual = run_coverage(tmp_path / "all", iid, 1, ["block_bootstrap"])
    assert not np.allclose(found["median_width"], usual["median_width"])


@pytest.mark.slow
@pytest.mark.parametrize("command", ["fit", "delays", "gap"])
def test_resume_starts_afresh_where_nothing_is_unfinished(command: str, tmp_path: Path) -> None:
    simulated(tmp_path / "sim")
    campaign = tmp_path / "sim" / "campaign.toml"
    options = ["--bootstrap", "0"] if command == "gap" else []
    for name, more in (("plain", []), ("new", ["--resume"]), ("new", ["--resume"])):
        out = tmp_path / name
        assert run(command, campaign, "--out", out, "--quiet", *options, *more) == 0
    expected = (tmp_path / "plain" / f"{command}.json").read_bytes()
    assert (tmp_path / "new" / f"{command}.json").read_bytes() == expected


def test_a_group_of_options_is_spelled_out_where_it_stands() -> None:
    seen: list[Any] = []

    @with_groups
    def command(first: int, run: CommandRun, last: str = "z") -> None:
        seen.extend([first, run, last])

    taken = inspect.signature(command).parameters
    expected = ["first", *(item.name for item in dataclasses.fields(CommandRun)), "last"]
    assert list(taken) == expected
    assert taken["seed"].default == 1 and taken["out"].default is inspect.Parameter.empty
    options = {name: None for name in expected} | {"first": 5, "seed": 7}
    command(**options)
    assert seen[0] == 5 and seen[1].seed == 7 and seen[2] is None
