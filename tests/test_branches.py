"""Ends that other tests do not reach; and what the tests see of each room, as tabulated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayes_sensor.checks.coverage import SETTINGS, _limits, simulate_setting, small_design
from bayes_sensor.posterior import Settings
from bayes_sensor.posterior.checkpoints import Checkpoint
from bayes_sensor.posterior.samplers.emcee_ensembles import _hopeless

TABLES = Path(__file__).resolve().parent.parent / "paper" / "tables"


def test_coverage_of_no_interval_has_no_limits() -> None:
    none = np.zeros((5, 1), dtype=bool)
    assert np.isnan(_limits(none, none)).all()
    low, high = _limits(~none, ~none)
    assert 0.4 < low < 0.8 and high == 1.0


def test_a_setting_without_a_step_down_stays_up() -> None:
    design, theta = small_design()
    up = replace(
        design, experiments=tuple(replace(e, commanded_off=None) for e in design.experiments)
    )
    kept = np.array([i for i in range(len(theta)) if i < 3 or (i - 3) % 4 != 3])
    e = simulate_setting(up, theta[kept], SETTINGS["iid"], 1).experiments[0]
    y0, beta = theta[3], theta[4]
    # noise of 14 mV in a thousand samples
    assert e.values[-100:].mean() == pytest.approx(y0 + beta, abs=0.01)
    down = simulate_setting(design, theta, SETTINGS["iid"], 1).experiments[0]
    assert down.values[-100:].mean() < y0 + 0.5 * beta


def test_an_ensemble_that_cannot_get_there_is_given_up_after_500_steps() -> None:
    rng = np.random.default_rng(3)
    settings = Settings(n_chains=2, n_draws=400, burn_in=0, max_steps=2000)
    good = rng.standard_normal((4, 500, 2))
    stuck = good + 5.0 * np.arange(4)[:, None, None]
    assert _hopeless(stuck, 500, settings)
    assert not _hopeless(good, 500, settings)
    assert not _hopeless(stuck, 400, settings)  # too soon to tell


def test_what_a_killed_run_left_half_written_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".ensemble-0-00000.npz.tmp").write_bytes(b"half")
    Checkpoint(tmp_path, "digest", resume=True)
    assert [p.name for p in tmp_path.iterdir()] == ["run.json"]


def test_the_tests_see_nine_branches_in_ten() -> None:
    table = pd.read_csv(TABLES / "branches.csv").set_index("room")
    assert len(table) == 21 and (table["statements"] > 0).all()
    assert (table["taken"] <= table["branches"]).all()
    rooms = table.drop(index="all")
    assert table.loc["all", "branches"] == rooms["branches"].sum()
    low = rooms.index[rooms["taken"] < 0.9 * rooms["branches"]]
    assert len(low) == 0, f"below nine in ten: {', '.join(low)}"


def test_the_mutants_were_noticed_or_reviewed() -> None:
    table = pd.read_csv(TABLES / "mutants.csv").set_index("room")
    survived = pd.read_csv(TABLES / "mutants_survived.csv", keep_default_na=False)
    total = table.loc["all"]
    assert len(table) == 21 and (table.drop(index="all")["mutants"] >= 3).all()
    assert total["survived"] == len(survived)
    assert total["killed"] + total["timed_out"] + total["survived"] == total["mutants"]
    left = total[["equivalent", "killed_by_new_tests", "open"]].sum()
    assert left == total["survived"]
    assert set(survived["verdict"]) <= {"equivalent", "test added", "open"}
    assert (survived["remark"] != "").all()  # every survivor was looked at
    assert total["score"] > 0.9 and total["lo95"] > 0.8


def test_both_draws_of_mutants_are_counted_and_noticed_alike() -> None:
    total = pd.read_csv(TABLES / "mutants.csv").set_index("room").loc["all"]
    draws = pd.read_csv(TABLES / "mutants_by_draw.csv")
    tried = pd.read_csv(TABLES / "mutants_tried.csv", keep_default_na=False)
    counts = ["mutants", "killed", "timed_out", "survived", "equivalent", "killed_by_new_tests"]
    assert (draws[counts].sum() == total[counts]).all() and len(tried) == total["mutants"]
    assert (tried["outcome"].value_counts()[["killed", "survived"]]
            == total[["killed", "survived"]]).all()  # fmt: skip
    assert not tried.duplicated(["file", "operator", "before", "after"]).any()
    # docs/robustness.md: about as many got past the tests as before
    first, second = draws["score_before"]
    assert abs(first - second) < 0.1 and (draws["mutants"] >= 80).all()
