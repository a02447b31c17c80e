"""The table of what was understood, and what it remarks on."""

import numpy as np
import pytest

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.check import campaign_remarks, check_campaign, levels

T = np.arange(12_000) * 0.01


def experiment(
    name: str = "1", step: float = 1.8, noise: float = 0.05, **changes: object
) -> Experiment:
    """A step up at 24 s and down at 84 s with white noise and a drifting baseline."""
    rng = np.random.default_rng(3)
    x = (1 - np.exp(-np.clip(T - 24, 0, None))) - (1 - np.exp(-np.clip(T - 84, 0, None)))
    y = 0.3 + step * x + noise * rng.standard_normal(len(T)) + 1e-4 * (T - 12)
    fields: dict[str, object] = {
        "name": name,
        "t": T,
        "y": y,
        "carrier_flow": 4.0 / 0.06,
        "test_gas_flow": 0.5 / 0.06,
        "interval": 0.01,
        "commanded_on": 24.0,
        "commanded_off": 84.0,
    }
    return Experiment(**(fields | changes))  # type: ignore[arg-type]


def test_table_holds_what_was_planted() -> None:
    mask = np.ones(len(T), dtype=bool)
    mask[:100] = False
    table = check_campaign(Campaign("x", (experiment(mask=mask, source="exp1.csv"),)))
    (row,) = table.to_dict("records")
    assert row["experiment"] == "1" and row["source"] == "exp1.csv" and row["warnings"] == ""
    assert (row["samples"], row["used"]) == (12_000, 11_900)
    assert (row["interval_s"], row["duration_s"]) == (0.01, 120.0)
    assert row["carrier_flow_L_min"] == pytest.approx(4.0)
    assert row["test_gas_flow_L_min"] == pytest.approx(0.5)
    assert row["total_flow_L_min"] == pytest.approx(4.5)
    assert row["concentration_percent"] == pytest.approx(100 / 9)
    assert (row["commanded_on_s"], row["commanded_off_s"]) == (24.0, 84.0)
    # standard errors: .05/sqrt(2300) V; noise to 1.2/sqrt(2300) of itself
    assert row["baseline_V"] == pytest.approx(0.3, abs=0.006)
    assert row["step_V"] == pytest.approx(1.8, abs=0.015)
    assert row["noise_V"] == pytest.approx(0.05, rel=0.08)
    assert row["plateau_noise_V"] == pytest.approx(0.05, rel=0.08)


def test_drift_is_not_noise() -> None:
    steep = experiment(noise=0.01)
    drifting = experiment(y=steep.values + 0.05 * T)
    assert levels(drifting)[0].noise == pytest.approx(levels(steep)[0].noise, rel=0.02)


def test_unknown_commands_and_designs_leave_gaps() -> None:
    free = experiment("free", commanded_on=None, commanded_off=None)
    planned = experiment("planned", y=None)
    table = check_campaign(Campaign("x", (free, planned))).set_index("experiment")
    assert np.isfinite(table.loc["free", "baseline_V"]) and np.isnan(table.loc["free", "step_V"])
    assert np.isnan(table.loc["planned", ["baseline_V", "step_V", "noise_V"]].astype(float)).all()
    assert np.isnan(table.loc["free", "commanded_on_s"])
    assert "the commanded time is unknown" in table.loc["free", "warnings"]
    assert table.loc["planned", "warnings"] == ""


def test_no_step_and_equal_flows_are_remarked_on() -> None:
    campaign = Campaign(
        "x",
        (experiment("1"), experiment("2", step=0.0, source="b.csv")),
        warnings=("experiment '1' (a.csv): something was left out",),
    )
    remarks = campaign_remarks(campaign)
    assert len(remarks) == 3
    assert remarks[0] == campaign.warnings[0]
    assert remarks[1].startswith("experiment '2' (b.csv): no step is seen")
    assert "cannot be told apart" in remarks[2]
    table = check_campaign(campaign)
    assert list(table["warnings"]) == [remarks[0], remarks[1]]


def test_missing_baseline_and_plateau() -> None:
    before = experiment("1", commanded_on=0.0)
    after = experiment("2", commanded_on=119.99, commanded_off=None)
    remarks = campaign_remarks(Campaign("x", (before, after)))
    assert "no baseline is recorded" in remarks[0]
    assert "no plateau is recorded" in remarks[1]
