"""The command ``design``: proposals that ``simulate`` takes, predictions checked, errors."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.cli import main
from bayes_sensor.design import check_design, design_experiments
from bayes_sensor.io.readers import read_campaign


def run(*arguments: str | Path) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return int(ended.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small simulated campaign with its truth."""
    folder = tmp_path_factory.mktemp("planned")
    assert 0 == run(
        "simulate", "--out", folder, "--duration", "30 s", "--interval", "10 ms", "--seed", "2",
        "--experiments", "1,6,7", "--tau", "250 ms", "--sigma0", "20 mV", "--sigma1", "30 mV",
        "--phi", "0.5", "-q",
    )  # fmt: skip
    return folder


LIMITS = ("--flow", "4 L/min", "12 L/min", "--concentration", "10 %", "0.2", "--duration", "20 s",
          "40 s")  # fmt: skip


@pytest.mark.slow
def test_a_proposal_is_written_predicted_and_simulated(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "plan"
    code = run("design", folder / "campaign.toml", "--out", out, "--target-tau", "25 ms",
               "--truth", folder / "truth.json", *LIMITS, "--check", "8")  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "with these: tau between" in said.out and "simulated campaigns" in said.out
    record = json.loads((out / "design.json").read_text())
    assert record["reached"] and record["after"]["half_width95_s"] <= 0.025
    assert record["after"]["half_width95_s"] < record["before"]["half_width95_s"]
    assert record["check"]["within_20_percent"] and record["check"]["n"] == 8
    assert record["check"]["ratio"] == pytest.approx(1.0, abs=0.2)
    plan, new = read_campaign(out / "design.toml"), read_campaign(out / "next.toml")
    assert plan.is_design and new.names_of_experiments == [r["name"] for r in record["experiments"]]
    assert len(plan) == 3 + len(new)
    for e, row in zip(new, record["experiments"], strict=True):
        assert 4.0 / 0.06 <= e.total_flow * (1 + 1e-9) and e.total_flow <= 12.0 / 0.06 * (1 + 1e-9)
        assert 0.1 - 1e-9 <= e.concentration <= 0.2 + 1e-9
        assert 20.0 - 1e-9 <= len(e.t) * e.interval <= 40.0 + 1e-9
        assert e.commanded_on == pytest.approx(row["on_s"])
    assert 0 == run("simulate", "--design", out / "design.toml", "--truth", out / "truth.json",
                    "--out", tmp_path / "data", "-q")  # fmt: skip
    made = read_campaign(tmp_path / "data" / "campaign.toml")
    assert len(made) == len(plan) and not made.is_design
    truth = json.loads((tmp_path / "data" / "truth.json").read_text())
    assert truth["tau_s"] == pytest.approx(0.25)
    # the noise on a plateau is the same whether the proposal is made with the others or alone
    alone, together = (json.loads((out / f"{n}.json").read_text()) for n in ("next_truth", "truth"))
    ratio = new.reference_concentration / plan.reference_concentration
    assert alone["sigma1_V"] == pytest.approx(together["sigma1_V"] * ratio**0.5)
    assert 0 == run("simulate", "--design", out / "next.toml", "--truth", out / "next_truth.json",
                    "--out", tmp_path / "next", "-q")  # fmt: skip


def test_an_estimate_is_made_where_no_truth_is_given(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "plan"
    code = run("design", folder / "campaign.toml", "--out", out, "--target-tau", "1 ms", *LIMITS,
               "--experiments", "2", "--tau", "100 ms", "-q")  # fmt: skip
    assert code == 0  # so many were asked for, and so many are proposed
    record = json.loads((out / "design.json").read_text())
    assert len(record["experiments"]) == 2 and not record["reached"]
    assert record["assumed"]["tau_s"] == 0.1
    assert record["assumed"]["V_mL"] == pytest.approx(58.23, rel=0.1)
    assert record["check"] is None


def test_nothing_is_proposed_where_nothing_is_needed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "plan"
    code = run("design", folder / "campaign.toml", "--out", out, "--target-tau", "1 s",
               "--truth", folder / "truth.json")  # fmt: skip
    assert code == 0 and "suffice" in capsys.readouterr().out
    assert json.loads((out / "design.json").read_text())["experiments"] == []
    assert not (out / "next.toml").exists() and len(read_campaign(out / "design.toml")) == 3


def test_a_target_out_of_reach_is_said_so(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "plan"
    code = run("design", folder / "campaign.toml", "--out", out, "--target-tau", "10 us", *LIMITS,
               "--truth", folder / "truth.json", "--most", "2", "-q")  # fmt: skip
    assert code == 3
    assert "not the +-0.01 ms wanted" in capsys.readouterr().err
    assert not json.loads((out / "design.json").read_text())["reached"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--target-tau", "5"], r'--target-tau: expected a time with its unit.*"5 ms"'),
        (["--target-tau=-5 ms"], r"--target-tau: expected a positive time"),
        (["--target-tau", "5 ms", "--concentration", "5", "20 %"], r"--concentration: expected"),
        (
            ["--target-tau", "5 ms", "--flow", "9 L/min", "3 L/min"],
            r"--flow: expected two positive",
        ),
        (
            ["--target-tau", "5 ms", "--duration", "1 s", "2 s"],
            r"lets the response settle.*at least [\d.]+ s.*longest is 2 s.*--duration",
        ),
        (
            ["--target-tau", "5 ms", "--truth", "none.json"],
            r"none.json: expected .* there is no such file",
        ),
    ],
)
def test_mistakes_are_one_message(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    out = tmp_path / "plan"
    if "--truth" not in options:
        options = [*options, "--truth", str(folder / "truth.json")]
    assert run("design", folder / "campaign.toml", "--out", out, *options) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and said.count("\n") == 1

    assert re.search(message, said), said
    assert not out.exists()


@pytest.mark.slow
def test_a_trigger_in_the_check_narrows_the_posterior_as_predicted(folder: Path) -> None:
    campaign = read_campaign(folder / "campaign.toml")
    truth = json.loads((folder / "truth.json").read_text())
    truth["tau_s"] = 0.05
    limits = {"flows": (100.0, 200.0), "concentrations": (0.1, 0.2), "durations": (30.0, 40.0)}
    found = design_experiments(campaign, truth, 0.01, k=2, trigger=0.003, **limits)
    seen = check_design(found, 8, seed=3, trigger=0.003)
    assert seen["n_not_converged"] == 0
    assert seen["ratio"] == pytest.approx(1.0, abs=0.2)
    # without the trigger's priors the same data tell far less
    blind = check_design(found, 2, seed=3)
    assert blind["mean_half_width95_s"] > 1.5 * seen["mean_half_width95_s"]
    assert np.isfinite(seen["sd_half_width95_s"])
