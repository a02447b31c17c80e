"""The command line on other rigs than the published one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import bayes_sensor as bs
from tests.cli.test_cli import run

DESIGN = """
title = "two sensors on one gas"
[rig]
stages = ["valve", "sensor"]
[[experiment]]
name = "1"
signals = {A = "a", B = "b"}
commanded_on = "10 s"
commanded_off = "40 s"
interval = "0.1 s"
duration = "70 s"
"""


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    design = folder / "design.toml"
    design.write_text(DESIGN)
    assert run("simulate", "--design", design, "--out", folder / "data", "--quiet") == 0
    return folder / "data"


@pytest.mark.slow
def test_a_simulated_rig_is_analysed_and_reported(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = json.loads((simulated / "truth.json").read_text())
    campaign, out = simulated / "campaign.toml", tmp_path / "out"
    (tmp_path / "over.toml").write_text('[bounds]\nmethods = ["crlb_ar1", "posterior"]\n')
    options = ["--sampler", "independence", "--no-figures", "--config", tmp_path / "over.toml"]
    assert run("analyze", campaign, "--out", out, *options) == 0
    said = capsys.readouterr().out
    assert "not diagnosed" not in said and "tau[A] could be anywhere from" in said
    posterior = json.loads((out / "posterior.json").read_text())
    for sensor in "AB":
        row = posterior["parameters"][f"tau_s[{sensor}]"]
        assert row["q0.5"] < truth[f"tau_s[{sensor}]"] < row["q99.5"]
        assert posterior["chain"][f"1,{sensor}"]["t63_s"]["q50"] > row["q50"]
    fit = json.loads((out / "fit.json").read_text())
    assert set(fit["parameters"]["experiments"]) == {"1", "1,A", "1,B"}
    gap = json.loads((out / "gap.json").read_text())
    assert {row["effect"] for row in gap["which"]} >= {"none", "unlisted", "valve_asymmetry"}
    assert not {row["effect"] for row in gap["which"]} & {"dead_volume", "flow_error"}
    assert {cell["experiment"] for cell in gap["where"]} == {"1,A", "1,B"}
    delays = json.loads((out / "delays.json").read_text())
    assert delays["start"]["status"] == "No regression: no flow is known."
    page = (out / "report.html").read_text()
    assert "sensor A" in page and "no flow is known" in page


def test_lags_longer_than_every_pulse_of_a_train_are_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # a pulse alone hardly shows; what they do together does
    on, off = ([f"{10 * k + at} s" for k in range(20)] for at in (5, 10))
    design, truth = tmp_path / "design.toml", tmp_path / "theta.json"
    design.write_text(
        '[rig]\nstages = ["valve", "sensor"]\n[[experiment]]\nname = "1"\ndelays = "shared"\n'
        f"commanded_on = {json.dumps(on)}\ncommanded_off = {json.dumps(off)}\n"
        'interval = "0.1 s"\nduration = "250 s"\n'
    )
    assert run("simulate", "--design", design, "--out", tmp_path / "short", "--quiet") == 0
    theta = json.loads((tmp_path / "short" / "truth.json").read_text())
    assert theta["tau_s"] == pytest.approx(0.2)  # of pulses of 5 s
    truth.write_text(json.dumps({**theta, "tau_s": 30.0, "tau_v_s": 1.0}))
    options = ("--truth", truth, "--out", tmp_path / "long", "--quiet")
    assert run("simulate", "--design", design, *options) == 0
    found = bs.fit_least_squares(bs.read_campaign(tmp_path / "long" / "campaign.toml"), seed=1)
    assert found.at_bound == []
    assert found.theta_hat[1] == pytest.approx(30.0, rel=0.1)


def test_check_lists_the_commands_of_a_train(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "campaign.toml"
    pair = 'commanded_on = "10 s"\ncommanded_off = "40 s"'
    assert pair in DESIGN
    steps = [f'{{at = "{10 + 4 * i} s", to = {(i + 1) % 2}}}' for i in range(14)]
    path.write_text(DESIGN.replace(pair, f"steps = [{', '.join(steps)}]", 1))
    assert run("check", path) == 0
    said = capsys.readouterr().out
    listed = "10, 14, 18, 22, 26, 30, ... 2 more ..., 42, 46, 50, 54, 58, 62"
    assert f"commands of 1,A (s): {listed}\n" in said


def test_a_rig_that_needs_a_flow_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "campaign.toml"
    path.write_text(DESIGN.replace('"valve", "sensor"', '"cell", "sensor"'))
    assert run("check", path) == 2
    assert "the stage 'cell' depends on the total flow, but none is given" in (
        capsys.readouterr().err
    )
