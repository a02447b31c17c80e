"""A first campaign file from exports: what is proposed, marked, left out, and read back."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli.init_campaign import init_campaign
from bayes_sensor.io.check import campaign_remarks
from bayes_sensor.io.draft.exports import find_exports
from bayes_sensor.io.readers import read_campaign

H = 0.05
T = np.round(H * np.arange(1200), 6)
RNG = np.random.default_rng(7)


def response(steps: list[tuple[float, float]], lag: float = 1.0) -> np.ndarray:
    """(n,) First-order response to changes of height at times, with noise."""
    y = RNG.normal(0.2, 0.01, len(T))
    for start, height in steps:
        y += height * np.where(T > start, -np.expm1(-np.maximum(T - start, 0.0) / lag), 0.0)
    return np.asarray(y)


PULSE = response([(12.0, 1.0), (35.0, -1.0)])


def write(path: Path, head: str, *columns: np.ndarray) -> None:
    """A CSV file."""
    rows = [",".join(f"{value:.6g}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def filled(path: Path) -> str:
    """The file with every flow that is missing given."""
    text = re.sub(r'"\? L/min"', '"1 L/min"', path.read_text(encoding="utf-8"))
    path.write_text(text, encoding="utf-8")
    return text


def drafted(folder: Path, *answers: str) -> list[dict[str, Any]]:
    """The experiments of the file that is written; with ``answers``, as at a terminal."""
    queue = list(answers)
    ask = (lambda _question: queue.pop(0)) if answers else None
    init_campaign(folder, overwrite=True, quiet=True, ask=ask)
    assert not queue, "every answer was asked for"
    tables = tomllib.loads((folder / "campaign.toml").read_text(encoding="utf-8"))
    experiments: list[dict[str, Any]] = tables["experiment"]
    return experiments


def seconds(text: str) -> float:
    """The number of a time in s."""
    return float(text.removesuffix(" s"))


def test_a_pulse_gets_commands_shortly_before_it_moves_and_can_be_checked(tmp_path: Path) -> None:
    for i in (10, 2, 1):
        write(tmp_path / f"run{i}.csv", "time_s,signal_V", T, PULSE + 0.1 * i)
    experiments = drafted(tmp_path)
    assert [e["name"] for e in experiments] == ["run1", "run2", "run10"]  # as they were recorded
    for e in experiments:
        assert e["carrier_flow"] == e["test_gas_flow"] == "? L/min"
        assert 12.0 - 2.5 < seconds(e["commanded_on"]) < 12.0
        assert 35.0 - 2.5 < seconds(e["commanded_off"]) < 35.0
        assert "signal" not in e and "signal_unit" not in e  # one column, whose unit the file says
    text = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    for line in text.splitlines():
        if "?" in line.split("#")[0]:
            assert "# MISSING" in line
        if line.startswith(("commanded", "stages", "sensor_is")):
            assert "# ASSUMED" in line
    with pytest.raises(CampaignError, match="carrier_flow, test_gas_flow of experiments 'run1'"):
        read_campaign(tmp_path / "campaign.toml")
    filled(tmp_path / "campaign.toml")
    campaign = read_campaign(tmp_path / "campaign.toml")
    assert len(campaign) == 3 and not campaign.warnings
    assert [r for r in campaign_remarks(campaign) if "same total flow" not in r] == []


def test_a_drive_channel_gives_the_commands(tmp_path: Path) -> None:
    valve = np.where((T >= 11.0) & (T < 34.0), 5.0, 0.0)
    write(tmp_path / "a.csv", "time (s),valve,sensor (mV)", T, valve, 1e3 * PULSE)
    (e,) = drafted(tmp_path)
    assert e["signal"] == "sensor (mV)" and e["drive"] == "valve" and "commanded_on" not in e
    filled(tmp_path / "campaign.toml")
    (experiment,) = read_campaign(tmp_path / "campaign.toml")
    assert experiment.commanded_on == pytest.approx(11.0, abs=H)
    assert experiment.commanded_off == pytest.approx(34.0, abs=H)


def test_set_points_and_constants_are_no_signal(tmp_path: Path) -> None:
    target = np.where((T >= 11.0) & (T < 34.0), 10.0, 0.0)
    write(
        tmp_path / "a.csv", "time_s,MFC_set,battery,reading_V", T, target, np.full(len(T), 12.5),
        PULSE,
    )  # fmt: skip
    (e,) = drafted(tmp_path)
    assert e["signal"] == "reading_V" and e["drive"] == "MFC_set"


def test_a_staircase_and_a_train_become_experiments_that_share_no_sample(tmp_path: Path) -> None:
    stairs = response([(8.0, 0.5), (25.0, 0.5), (42.0, 0.5)])
    train = response([(5.0, 1.0), (15.0, -1.0), (30.0, 1.0), (45.0, -1.0)])
    write(tmp_path / "stairs.csv", "time_s,signal_V", T, stairs)
    write(tmp_path / "train.csv", "time_s,signal_V", T, train)
    names = [e["name"] for e in drafted(tmp_path)]
    assert names == ["stairs-1", "stairs-2", "stairs-3", "train-1", "train-2"]
    filled(tmp_path / "campaign.toml")
    campaign = read_campaign(tmp_path / "campaign.toml")
    for record in ("stairs", "train"):
        parts = [e for e in campaign if e.name.startswith(record)]
        times = np.concatenate([e.t for e in parts])
        np.testing.assert_allclose(times, T, atol=1e-9)
        for e in parts:
            assert e.t[0] < e.commanded_on < e.t[-1]
    assert [e.has_fall for e in campaign] == [False] * 3 + [True] * 2
    assert [r for r in campaign_remarks(campaign) if "same total flow" not in r] == []


def test_gaps_are_masked_and_what_cannot_be_used_is_named(tmp_path: Path) -> None:
    keep = (T < 20.0) | (T > 26.0)
    write(tmp_path / "gap.csv", "time_s,signal_V", T[keep], PULSE[keep])
    write(tmp_path / "ppm.csv", "time_s,CO2_ppm", T, 400 * PULSE)
    (tmp_path / "notes.txt").write_text("Tuesday, with the new valve\n", encoding="utf-8")
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 5.0")
    (e,) = drafted(tmp_path)
    assert e["file"] == "gap.csv" and len(e["mask"]) == 1
    text = filled(tmp_path / "campaign.toml")
    left = text[text.index("# Not used:") :]
    assert all(name in left for name in ("ppm.csv", "notes.txt", "broken.mat"))
    assert "its signal is in ppm" in left
    # the samples at either end of the gap are in the mask
    assert read_campaign(tmp_path / "campaign.toml")["gap"].n_samples == keep.sum() - 2


def test_files_without_times_leave_the_interval_open(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", "x_V", PULSE)
    (e,) = drafted(tmp_path)
    assert e["interval"] == "? ms" and e["commanded_on"] == e["commanded_off"] == "? s"
    text = (tmp_path / "campaign.toml").read_text(encoding="utf-8")
    sample = int(re.search(r"sample (\d+)\n", text)[1])  # type: ignore[index]
    assert 12.0 - 2.5 < sample * H < 12.0
    (e,) = drafted(tmp_path, "50 ms", "", "")
    assert e["interval"] == "50 ms"
    assert 12.0 - 2.5 < seconds(e["commanded_on"]) < 12.0


def test_answers_are_checked_repeated_and_written(tmp_path: Path) -> None:
    fast, slow = PULSE, response([(12.0, 1.0), (35.0, -1.0)], lag=4.0)
    for name in ("a", "b"):
        write(tmp_path / f"{name}.csv", "time_s,fast_V,slow_V", T, fast, slow)
    first, second = drafted(
        tmp_path,
        "sluw", "slow_V",  # asked once, as both files have the same channels
        "2",
        "500 sccm", "0.1", "10 %",  # a bare number is refused, with its fix
        "", "400 ppm",  # the last answer again
        "21 degC", "1 bar",
        "slower",
    )  # fmt: skip
    assert first["signal"] == second["signal"] == "slow_V"
    assert (first["total_flow"], first["concentration"]) == ("500 sccm", "10 %")
    assert (second["total_flow"], second["concentration"]) == ("500 sccm", "400 ppm")
    campaign = read_campaign(tmp_path / "campaign.toml")  # nothing is missing
    assert campaign.sensor_is == "slower" and not campaign.warnings
    assert campaign["a"].total_flow == pytest.approx(500 / 60 * 294.15 / 273.15 * 1.01325)


def test_names_with_quotes_and_folders_are_written_as_toml(tmp_path: Path) -> None:
    (tmp_path / "day 1").mkdir()
    write(tmp_path / "day 1" / 'the "best" # run.csv', "time_s,signal_V", T, PULSE)
    (e,) = drafted(tmp_path)
    assert e["file"] == 'day 1/the "best" # run.csv'
    filled(tmp_path / "campaign.toml")
    assert len(read_campaign(tmp_path / "campaign.toml")) == 1


def test_an_existing_campaign_is_kept(tmp_path: Path) -> None:
    write(tmp_path / "a.csv", "time_s,signal_V", T, PULSE)
    (tmp_path / "campaign.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(CampaignError, match="there is a campaign file already.*--overwrite"):
        init_campaign(tmp_path, overwrite=False, quiet=True)
    assert (tmp_path / "campaign.toml").read_text(encoding="utf-8") == "mine"
    init_campaign(tmp_path, overwrite=True, quiet=True)
    assert "[[experiment]]" in (tmp_path / "campaign.toml").read_text(encoding="utf-8")


def test_folders_without_exports_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="expected data files ending in .csv"):
        init_campaign(tmp_path, overwrite=False, quiet=True)
    with pytest.raises(CampaignError, match="there is none of that name"):
        find_exports(tmp_path / "nowhere")
    (tmp_path / "a.csv").write_text("no numbers here\n", encoding="utf-8")
    with pytest.raises(CampaignError, match="none of 1 data file can be used; the first is a.csv"):
        init_campaign(tmp_path, overwrite=False, quiet=True)
    assert not (tmp_path / "campaign.toml").exists()
