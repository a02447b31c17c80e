"""The table of what was understood, and what it remarks on."""

import numpy as np
import pytest

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.io.check import campaign_remarks, check_campaign, levels, rise_time

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


@pytest.mark.parametrize(("spike", "n"), [(1.0, 1), (0.0, 0)])
def test_a_step_that_is_small_beside_a_spike_is_remarked_on(spike: float, n: int) -> None:
    quiet = experiment(step=0.03, noise=0.001)
    y = quiet.values + spike * ((T > 24.4) & (T < 25.0))
    remarks = campaign_remarks(Campaign("x", (experiment(y=y),)))
    assert len(remarks) == n
    assert all("the step (0.03" in text and "is hidden by a change of 1" in text
               for text in remarks)  # fmt: skip


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
    assert "commanded_on = 119.99 s comes after the step" in remarks[1]
    assert "no plateau is recorded" in remarks[2]


def rising(name: str, lag: float, flow: float, **changes: object) -> Experiment:
    """A step at 24 s that settles with one lag, recorded at ``flow`` L/min of carrier gas."""
    noise = 0.03 * np.random.default_rng(int(100 * lag)).standard_normal(len(T))
    y = 0.3 + 1.8 * (1 - np.exp(-np.clip(T - 24, 0, None) / lag)) + noise
    fields = {"y": y, "carrier_flow": flow / 0.06, "commanded_off": None} | changes
    return experiment(name, **fields)  # type: ignore[arg-type]


def test_a_rise_is_timed_between_its_quarters() -> None:
    # an exponential takes lag ln 3; the delay of the step has no part in it
    for lag in (0.5, 2.0):
        rise, error = rise_time(rising("1", lag, 4.0))
        assert rise == pytest.approx(lag * np.log(3), abs=3 * error) and 0 < error < 0.05 * lag
        assert rise_time(rising("1", lag, 4.0, commanded_on=15.0))[0] == pytest.approx(rise)
    # gaps are bridged, and another sampling interval tells the same
    gaps = np.ones(len(T), dtype=bool)
    gaps[2420:2440] = False
    assert rise_time(rising("1", 2.0, 4.0, mask=gaps))[0] == pytest.approx(
        2.0 * np.log(3), rel=0.05
    )


def test_no_rise_is_timed_where_none_is_seen() -> None:
    assert np.isnan(rise_time(experiment(commanded_on=None, commanded_off=None))).all()
    assert np.isnan(rise_time(experiment(y=None))).all()
    assert np.isnan(rise_time(experiment(step=0.0))).all()
    assert np.isnan(rise_time(experiment(noise=20.0))).all()
    quick = 0.3 + 1.8 * (T >= 24.0) + 0.3 * np.random.default_rng(2).standard_normal(len(T))
    assert np.isnan(rise_time(experiment(y=quick, commanded_off=None))).all()


def test_exchanged_flows_are_remarked_on() -> None:
    lags, flows = (0.6, 0.9, 1.6, 2.5), (8.0, 5.0, 3.0, 2.0)

    def remarks(flows: tuple[float, ...]) -> list[str]:
        experiments = [
            rising(str(k), lag, q) for k, (lag, q) in enumerate(zip(lags, flows, strict=True), 1)
        ]
        found = campaign_remarks(Campaign("x", tuple(experiments)))
        return [text for text in found if "exchanged" in text]

    assert remarks(flows) == []
    (said,) = remarks((8.0, 2.0, 3.0, 5.0))
    assert said.startswith("experiment '4': takes longer ") and "experiment '2'" in said
    assert "larger (5.5 against 2.5 L/min)" in said
    # flows that hardly differ, and an order that no single exchange puts right
    assert remarks((8.0, 5.0, 2.0, 2.05)) == []
    assert remarks((2.0, 3.0, 5.0, 8.0)) == []
