"""The committed tables of the study: bands hold the input, and the lag's uncertainty counts."""

from pathlib import Path

import pandas as pd
import pytest

TABLES = Path(__file__).resolve().parents[2] / "paper" / "tables"

pytestmark = pytest.mark.tables


def test_bands_hold_the_input_in_93_to_97_percent() -> None:
    table = pd.read_csv(TABLES / "restoration.csv")
    whole = table[table["by"] == "all"].set_index("lag_sd")
    assert whole["share95"].between(0.93, 0.97).all() and (whole["records"] >= 400).all()
    assert table["share95"].between(0.91, 0.98).all()  # by input, number of lags and noise
    assert whole.loc[0.1, "share95_known"] < 0.9  # what it costs to take the lags as known


def test_the_restored_slow_sensor_beside_the_fast_one() -> None:
    table = pd.read_csv(TABLES / "slow_and_fast.csv").set_index(["record", "scale"])
    found = table.loc[("lag from the step", "fast sensor's")]
    assert found["r2"] >= 0.88
    assert table.loc[("lag as known", "fast sensor's"), "share95"] < found["share95"]
