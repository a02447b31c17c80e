"""Remarks on the choice of the signal, from what else is in the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.io.readers import read_campaign

T = np.round(0.05 * np.arange(1200), 6)
RNG = np.random.default_rng(11)
RISE = np.where(T > 20.0, -np.expm1(-np.maximum(T - 20.0, 0.0) / 2.0), 0.0)
COLUMNS = {
    "a_V": 0.2 + RISE + RNG.normal(0.0, 0.01, len(T)),
    "b_V": 1.0 - 2.0 * RISE + RNG.normal(0.0, 0.02, len(T)),
    "room_V": 0.5 + RNG.normal(0.0, 0.01, len(T)),
    "flat_V": np.full(len(T), 3.3),
    "valve": np.where(T >= 19.5, 5.0, 0.0),
    "flow_set": np.where(T > 19.5, 10.0, 1.0) + RNG.normal(0.0, 0.1, len(T)),
}


def remarks(tmp_path: Path, names: list[str], more: str = "") -> list[str]:
    """What is remarked on when a file of these columns is read."""
    rows = [",".join(["time_s", *names])]
    rows += [",".join(f"{v:.6g}" for v in row) for row in zip(T, *(COLUMNS[n] for n in names))]
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    path = tmp_path / "campaign.toml"
    path.write_text(
        '[[experiment]]\nname = "1"\nfile = "a.csv"\ncommanded_on = "19.5 s"\n'
        f'carrier_flow = "4 L/min"\ntest_gas_flow = "0.5 L/min"\n{more}\n',
        encoding="utf-8",
    )
    return list(read_campaign(path).warnings)


def test_a_second_sensor_is_named_unless_the_signal_is(tmp_path: Path) -> None:
    (said,) = remarks(tmp_path, ["a_V", "b_V", "room_V"])
    assert "'b_V' steps at the same time as 'a_V', which was taken as the signal" in said
    assert "room_V" not in said and "set signal to the sensor that is meant" in said
    assert remarks(tmp_path, ["a_V", "b_V", "room_V"], 'signal = "a_V"') == []


def test_a_drive_a_constant_and_a_quiet_column_are_no_second_sensor(tmp_path: Path) -> None:
    assert remarks(tmp_path, ["a_V", "valve", "room_V", "flat_V"]) == []
    assert remarks(tmp_path, ["a_V", "valve"], 'drive = "valve"') == []


@pytest.mark.parametrize("signal", ["valve", "flow_set", "flat_V"])
def test_a_command_or_a_constant_as_the_signal_says_what_to_choose(
    signal: str, tmp_path: Path
) -> None:
    said = " | ".join(remarks(tmp_path, [signal, "a_V"], f'signal = "{signal}"'))
    reason = {
        "valve": "only jumps between 2 values, as a command does",
        "flow_set": "is called like a set point",
        "flat_V": "never changes; set signal to",
    }[signal]
    assert reason in said and "'a_V'" in said


def test_two_columns_of_one_file_with_the_same_commands_may_be_two_sensors(tmp_path: Path) -> None:
    second = (
        'signal = "a_V"\n[[experiment]]\nname = "2"\nfile = "a.csv"\ncommanded_on = "{on}"\n'
        'carrier_flow = "4 L/min"\ntest_gas_flow = "0.5 L/min"\nsignal = "{signal}"'
    )
    names = ["a_V", "b_V", "room_V"]
    (said,) = remarks(tmp_path, names, second.format(on="19.5 s", signal="b_V"))
    advice = 'signals = {A = "a_V", B = "b_V"}'
    assert "experiments '1' and '2': two columns of a.csv" in said and advice in said
    assert remarks(tmp_path, names, advice) == []
    # another command is another run; the same column twice is no second sensor
    assert not any(
        "two columns" in text
        for on, signal in (("19.4 s", "b_V"), ("19.5 s", "a_V"))
        for text in remarks(tmp_path, names, second.format(on=on, signal=signal))
    )
