"""The command restore: stated lags, a campaign, results of it, many records, and bad input."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

import bayes_sensor as bs
from bayes_sensor.cli import exit_code
from bayes_sensor.io.writers import write_campaign
from tests.support.other_rigs import CASES

COLUMNS = ["time_s", "value", "lo68", "hi68", "lo95", "hi95"]


def run(*arguments: str | Path) -> int:
    """The exit code of a command, in this process."""
    return exit_code([str(a) for a in arguments])


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with field.csv: a lag of 40 min, one sample a minute, a gap, in ppm."""
    rng = np.random.default_rng(1)
    n = 600
    u = 20.0 + 10.0 * np.sin(np.arange(n) / 40.0)
    b = np.exp(-1.0 / 40.0)
    y = lfilter([1.0 - b], [1.0, -b], u, zi=[b * 20.0])[0] + 0.1 * rng.standard_normal(n)
    frame = pd.DataFrame({"time_s": 60.0 * np.arange(n), "level (ppm)": y, "other": u})
    folder = tmp_path_factory.mktemp("records")
    frame.drop(index=range(200, 260)).to_csv(folder / "field.csv", index=False)
    return folder / "field.csv"


@pytest.mark.slow
def test_restore_with_a_stated_lag(record: Path, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    arguments = ["restore", record, "--lag", "40 +- 2 min", "--out", out, "--signal", "level"]
    assert run(*arguments) == 0
    said = capsys.readouterr().out
    assert "resolution" in said and "restored.csv" in said
    table, told = pd.read_csv(out / "restored.csv"), read(out / "restored.json")
    assert list(table) == COLUMNS
    assert len(table) == 600  # a short gap is part of the grid
    inside = slice(100, 180)
    truth = 20.0 + 10.0 * np.sin(table["time_s"] / 2400.0)
    assert np.abs(table["value"] - truth)[inside].max() < 2.0
    held = (table["lo95"] < truth) & (truth < table["hi95"])
    assert held.mean() > 0.9
    assert told["signal_unit"] == "ppm" and told["resolution_s"] > 60.0
    assert told["lag_s"]["q2.5"] == pytest.approx(2400.0 - 2 * 120.0, abs=40.0)
    assert set(told) >= {"resolution_s", "lag_s", "noise", "warnings"}
    for name in ("restored.svg", "restored.png", "restored.md", "run.json"):
        assert (out / name).stat().st_size > 100, name
    assert read(out / "run.json")["commands"]["restore"]["exit_code"] == 0
    # Python gives the same, and so do more jobs
    found = bs.restore("40 +- 2 min", record, signal="level")
    np.testing.assert_allclose(found.table().to_numpy(), table.to_numpy(), rtol=1e-12)
    again = tmp_path / "again"
    assert run(*arguments[:4], "--out", again, "--signal", "level", "--jobs", "2", "--quiet") == 0
    assert (again / "restored.csv").read_bytes() == (out / "restored.csv").read_bytes()


def test_many_records_get_a_folder_each(record: Path, tmp_path: Path) -> None:
    other = tmp_path / "more"
    other.mkdir()
    for name in ("a", "b"):
        (other / f"{name}.csv").write_bytes(record.read_bytes())
    out = tmp_path / "out"
    assert run("restore", record, other, "--lag", "40 +- 2 min", "--lag", "5 min", "--signal",
               "level", "--out", out, "--non-negative", "--quiet") == 0  # fmt: skip
    a, b, field = (pd.read_csv(out / name / "restored.csv") for name in ("a", "b", "field"))
    pd.testing.assert_frame_equal(a, b)
    pd.testing.assert_frame_equal(a, field)
    assert len(read(out / "a" / "restored.json")["lags_s"]) == 2
    assert run("restore", other, other / "a.csv", "--lag", "40 min", "--out", out) == 2


def test_the_report_of_a_restored_record(record: Path, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "out"
    assert run("restore", record, "--lag", "40 +- 2 min", "--signal", "level", "--out", out) == 0
    assert run("report", out) == 0 and run("report", out, "--format", "md") == 0
    told, table = read(out / "restored.json"), pd.read_csv(out / "restored.csv")
    text = (out / "report.md").read_text(encoding="utf-8")
    resolution = f"{told['resolution_s']:.0f} s"
    for words in ("Restored input of field.csv", "1. What was the input", resolution,
                  "prediction errors (innovations) pass", "figures/restored.svg"):  # fmt: skip
        assert words in text, words
    moment = told["bands"]["highest"]
    row = table.iloc[int(table["value"].argmax())]
    assert moment == pytest.approx(row.to_dict(), rel=1e-9)
    half = np.median(table["hi95"] - table["lo95"]) / 2.0
    assert told["bands"]["median_half_width95"] == pytest.approx(half, rel=1e-9)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 1 and "Attention" not in page
    told["warnings"].append("the record is odd")
    told["innovations"]["p_value"] = 1e-5
    (out / "restored.json").write_text(json.dumps(told), encoding="utf-8")
    assert run("report", out) == 0
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "The record is odd." in page and "do not pass their tests" in page
    # what others put into the folder is looked at before it is shown
    drawing = (out / "restored.svg").read_text(encoding="utf-8")
    hostile = drawing.replace("</svg>", "<script>alert(1)</script></svg>")
    (out / "restored.svg").write_text(hostile, encoding="utf-8")
    capsys.readouterr()
    assert run("report", out) == 2 and "without scripts, links" in capsys.readouterr().err
    (out / "restored.svg").write_text(drawing, encoding="utf-8")
    del told["bands"]
    (out / "restored.json").write_text(json.dumps(told), encoding="utf-8")
    assert run("report", out) == 2 and "bands" in capsys.readouterr().err


@pytest.mark.slow
def test_a_record_of_one_of_several_sensors(tmp_path: Path, capsys: Any) -> None:
    data, record = CASES["two sensors"]().simulated(), tmp_path / "record.csv"
    campaign = write_campaign(data, tmp_path / "rig")
    for e in data:
        pd.DataFrame({"time_s": e.t, f"{e.sensor} (V)": e.values}).to_csv(record, index=False)
    arguments = ("restore", campaign, record, "--out", tmp_path / "out", "--quiet")
    assert run(*arguments) == 2 and "2 sensors (A, B)" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert run(*arguments, "--sensor", "B") in (0, 3)  # the last one written
    lags = read(tmp_path / "out" / "restored.json")["lags_s"]
    assert [lag["q50"] for lag in lags] == pytest.approx([0.7, 9.0], rel=0.1)


@pytest.mark.slow
def test_restore_with_a_campaign_and_with_its_results(tmp_path: Path) -> None:
    folder = tmp_path / "rig"
    assert run("simulate", "--out", folder, "--duration", "40 s", "--interval", "20 ms",
               "--experiments", "1,4", "--tau", "200 ms", "--sigma0", "12 mV", "--sigma1", "12 mV",
               "--phi", "0.4", "--quiet") == 0  # fmt: skip
    campaign = folder / "campaign.toml"
    record = next(folder.glob("*.csv"))
    out = tmp_path / "out"
    assert run("restore", campaign, record, "--out", out, "--quiet") in (0, 3)
    told = read(out / "restored.json")
    truth = read(folder / "truth.json")
    slow = max(truth["tau_s"], truth["tau_v_s"])
    assert told["lag_s"]["q2.5"] < slow < told["lag_s"]["q97.5"]
    assert len(told["lags_s"]) == 2 and "makes no difference" in told["remarks"][0]
    results = tmp_path / "results"
    assert run("posterior", campaign, "--out", results, "--sampler", "independence",
               "--quiet") in (0, 3)  # fmt: skip
    same = tmp_path / "same"
    assert run("restore", results, record, "--out", same, "--quiet") == 0
    saved = read(same / "restored.json")["lag_s"]
    for key, value in told["lag_s"].items():
        assert saved[key] == pytest.approx(value, rel=0.01)
    with_flow = tmp_path / "flow"
    assert run("restore", results, record, "--flow", "4.5 L/min", "--out", with_flow, "-q") == 0
    assert len(read(with_flow / "restored.json")["lags_s"]) == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["field.csv"], "nothing says the sensor's lag"),
        (["field.csv", "--lag", "< 5 min"], "an upper limit"),
        (["field.csv", "--lag", "40"], "without one"),
        (["gone.csv", "--lag", "40 min"], "there is no such file"),
        (["field.csv", "--lag", "40 min", "--signal", "lvel"], "is not in the file"),
        (["field.csv", "--lag", "40 min", "--signal-unit", "V"], "--signal-unit"),
        (["field.csv", "--lag", "40 min", "--interval", "0 s"], "--interval"),
        (["field.doc", "--lag", "40 min"], "ending in"),
        (["c.toml", "field.csv", "--lag", "40 min"], "expected one"),
        (["c.toml"], "expected a record after it"),
    ],
)
def test_bad_input_is_one_message_and_leaves_nothing(
    record: Path, arguments: list[str], words: str, tmp_path: Path, capsys: Any
) -> None:
    given = [
        str(record.parent / a) if a.endswith((".csv", ".toml", ".doc")) else a for a in arguments
    ]
    out = tmp_path / "out"
    if not any("--signal" == a for a in given):
        given += ["--signal", "level"]
    assert run("restore", *given, "--out", out) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert not out.exists()


def test_results_without_a_posterior_are_told_what_is_missing(
    record: Path, tmp_path: Path, capsys: Any
) -> None:
    fitted = tmp_path / "fitted"
    fitted.mkdir()
    (fitted / "campaign.json").write_text("{}")
    assert run("restore", fitted, record, "--out", tmp_path / "out") == 2
    assert "expected results with posterior.nc, but there is none" in capsys.readouterr().err
