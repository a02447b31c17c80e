"""The command fit says how many lags the data support, and what it cannot tell apart."""

import json
from pathlib import Path

import pytest

from bayes_sensor.cli import exit_code
from bayes_sensor.io.writers import write_csv
from tests.support.other_rigs import CASES


def test_fit_says_how_many_lags(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = CASES["sensor"]().simulated(3)
    e = data["2"]
    write_csv(tmp_path / "a.csv", {"time_s": e.t, "voltage_V": e.values})
    text = """
title = "one lag in the default rig"
[[experiment]]
name = "1"
file = "a.csv"
carrier_flow = "0.9 L/min"
test_gas_flow = "0.1 L/min"
commanded_on = "20 s"
commanded_off = "70 s"
"""
    (tmp_path / "campaign.toml").write_text(text)
    out = tmp_path / "out"
    assert exit_code(["fit", str(tmp_path / "campaign.toml"), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "lags: one lag suffices" in said and '[rig] stages = ["sensor"]' in said
    fit = json.loads((out / "fit.json").read_text())
    assert fit["n_lags"]["supported"] == 1
    assert set(fit["n_lags"]["log_evidence"]) == {"1", "2", "3", "4"}
    (apart,) = fit["cannot_tell_apart"]
    assert apart["parameters"] == ["tau_s", "tau_v_s", "V_mL"]
    assert "second total flow" in apart["measure"]
