"""Campaigns of data in memory: the same as from files, and one message for each mistake."""

from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import bayes_sensor as bs
from tests.support.campaigns import small_problem

FLOWS = {"total_flow": "4.5 L/min", "concentration": "20 %", "commanded_on": "1.8 s"}


@pytest.fixture(scope="module")
def campaign() -> bs.Campaign:
    """Three simulated records, the last without a step down."""
    problem, _ = small_problem(n=3, interval=0.02, fall=[True, True, False])
    return problem.campaign


def keys(campaign: bs.Campaign) -> dict[str, Any]:
    """Its flows and times as keywords: by name, in order, as texts and as numbers."""
    return {
        "carrier_flow": {e.name: e.carrier_flow for e in campaign},
        "test_gas_flow": np.array([e.test_gas_flow for e in campaign]),
        "commanded_on": [f"{e.commanded_on} s" for e in campaign],
        "commanded_off": {e.name: e.commanded_off for e in campaign if e.has_fall},
        "sensor_is": "faster",
        "title": "in memory",
    }


def test_frames_give_the_campaign_that_files_give(campaign: bs.Campaign, tmp_path: Path) -> None:
    text = 'title = "in memory"\n[rig]\nsensor_is = "faster"\n'
    for e in campaign:
        pd.DataFrame({"time_s": e.t, "A_V": e.y}).to_csv(tmp_path / f"{e.name}.csv", index=False)
        text += f'[[experiment]]\nname = "{e.name}"\nfile = "{e.name}.csv"\n'
        text += (
            f'carrier_flow = "{e.carrier_flow} mL/s"\ntest_gas_flow = "{e.test_gas_flow} mL/s"\n'
        )
        text += f'commanded_on = "{e.commanded_on} s"\n'
        text += f'commanded_off = "{e.commanded_off} s"\n' if e.has_fall else ""
        text += 'mask = [["4 s", "4.2 s"]]\nkeep = ["0.5 s", "11 s"]\n'
    (tmp_path / "campaign.toml").write_text(text)
    read = bs.read_campaign(tmp_path / "campaign.toml")
    frames = {e.name: pd.DataFrame({"time_s": e.t, "A_V": e.y}) for e in campaign}
    made = bs.Campaign.from_frames(
        frames, **keys(campaign), mask=[(4.0, "4.2 s")], keep=("0.5 s", 11)
    )
    assert (made.title, made.sensor_is, made.signal_unit) == ("in memory", "faster", "V")
    for ours, theirs in zip(made, read, strict=True):
        for name in ("t", "y", "used"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        for name in ("name", "carrier_flow", "test_gas_flow", "commanded_on", "commanded_off"):
            assert getattr(ours, name) == getattr(theirs, name)
        assert ours.source == "" and len(ours.sha256) == 64


def kinds(t: np.ndarray, y: np.ndarray) -> dict[str, Any]:
    """The same record in every form."""
    stamps = pd.Timestamp("2024-03-01 10:00") + pd.to_timedelta(t, unit="s")
    return {
        "tuple": {"1": (t, y)},
        "list": [(t, y)],
        "one frame": pd.DataFrame({"t": t, "y": y}),
        "one tuple": (t, y),
        "one mapping": {"time": t, "y": y},
        "lists": {"1": (t.tolist(), y.tolist())},
        "mapping": {"1": {"t": t, "y": y}},
        "milliseconds": {"1": {"time_ms": 1e3 * t, "A_mV": 1e3 * y}},
        "index": {"1": pd.DataFrame({"A": y}, index=pd.Index(t, name="time"))},
        "series": {"1": pd.Series(y, index=t)},
        "stamps": {"1": pd.DataFrame({"A": y}, index=stamps)},
        "zoned stamps": {"1": pd.DataFrame({"when": stamps.tz_localize("Asia/Tokyo"), "A": y})},
        "durations": {"1": {"t": pd.to_timedelta(t, unit="s").to_numpy(), "y": y}},
        "dataset": {"1": xr.Dataset({"A": ("time", y)}, coords={"time": t})},
        "data array": {"1": xr.DataArray(y, dims="time", coords={"time": t})},
        "objects": {"1": {"t": t.astype(object), "y": y.astype(object)}},
    }


@pytest.mark.parametrize("kind", kinds(np.arange(2.0), np.zeros(2)))
def test_every_kind_of_frame(campaign: bs.Campaign, kind: str) -> None:
    e = campaign["a"]
    made = bs.Campaign.from_frames(kinds(e.t, e.y)[kind], **FLOWS)
    np.testing.assert_allclose(made["1"].t, e.t, atol=1e-9)
    np.testing.assert_allclose(made["1"].y, e.y, rtol=1e-12)
    assert made["1"].total_flow == 75.0 and made["1"].concentration == pytest.approx(0.2)


def test_quantities_are_texts_numbers_or_times(campaign: bs.Campaign) -> None:
    e = campaign["a"]
    for on in ("1.8 s", "1800 ms", 1.8, np.float64(1.8), timedelta(seconds=1.8)):
        for flow, share in (("4.5 L/min", "20 %"), (75, 0.2), (np.int64(75), "200000 ppm")):
            made = bs.Campaign.from_frames(
                (e.t, e.y), total_flow=flow, concentration=share, commanded_on=on
            )["1"]
            assert made.commanded_on == 1.8
            assert (made.carrier_flow, made.test_gas_flow) == pytest.approx((60.0, 15.0))


def test_drive_interval_and_side_information(campaign: bs.Campaign) -> None:
    e = campaign["a"]
    drive = np.where((e.t >= 1.8) & (e.t < 6.8), 5.0, 0.0)
    flows = {key: FLOWS[key] for key in ("total_flow", "concentration")}
    made = bs.Campaign.from_frames(
        {"x": (e.t, e.y, drive)}, **flows, side_information={"V": (14, 1), "tau_v": "0.3 +- 0.1 s"}
    )
    assert (made["x"].commanded_on, made["x"].commanded_off) == pytest.approx((1.8, 6.8), abs=0.02)
    assert made.side_information["V_mL"] == bs.SideInformation(14.0, 1.0)
    assert made.side_information["tau_v_s"].mean == 0.3
    made = bs.Campaign.from_frames({"1": e.y}, **FLOWS, interval="20 ms")
    np.testing.assert_allclose(made["1"].t, e.t, atol=1e-12)
    two = pd.DataFrame({"t": e.t, "sensor": e.y, "valve": drive})
    made = bs.Campaign.from_frames({"1": two}, **flows, signal="sensor", drive="valve")
    assert made["1"].has_fall


T, Y = np.arange(200) * 0.05, np.sin(np.arange(200.0))


@pytest.mark.parametrize(
    ("frames", "more", "message"),
    [
        (3, {}, "expected frames by the name of their experiment, but got a int"),
        ({}, {}, "but got none"),
        (Y, {}, "but got a ndarray; give {'1': frame}"),
        ({"1": 3}, {}, "experiment '1': expected samples, but got a int; give a pandas DataFrame"),
        ({"1": {"t": T, "y": Y[:-1]}}, {}, "vectors of one length, but got 't' 200, 'y' 199"),
        ({"1": {"t": T, "y": ["a"] * 200}}, {}, "column 'y' has the type <U1; expected numbers"),
        ({"1": {"t": T, "y": np.ones((200, 2))}}, {}, r"'y' has shape \(200, 2\)"),
        ({"1": (T[::-1], Y)}, {}, "time must increase"),
        ({"1": (T, Y)}, {"total_flw": 75}, "unknown keyword 'total_flw'; .* write total_flow"),
        ({"1": (T, Y)}, {"file": "a.csv"}, "file is a key of campaign.toml .*read_campaign"),
        ({"1": (T, Y)}, {"concentration": 20}, 'share between 0 and 1.*write "20 %"'),
        ({"1": (T, Y)}, {"commanded_on": "4 L"}, "commanded_on: expected a time, but '4 L'"),
        ({"1": (T, Y)}, {"commanded_on": {"2": 4}}, "commanded_on: there is no experiment '2'"),
        ({"1": (T, Y), "2": (T, Y)}, {"commanded_on": [1, 2, 3]}, "one value for each of the 2"),
        ({"1": (T, Y)}, {"total_flow": None}, "add total_flow"),
        ({"1": (T, Y)}, {"signal": "B"}, "signal = \"B\" is not in the file"),
        ({"1": (T, Y)}, {"sensor_is": "quicker"}, "sensor_is: expected one of faster"),
        ({"1": (T, Y)}, {"side_information": {"W": "1 +- 1 s"}}, "unknown key 'W'"),
        ({"1": xr.DataArray(np.ones((3, 3)), dims=("a", "b"))}, {}, "has the dimensions a, b"),
    ],
)  # fmt: skip
def test_mistakes(frames: Any, more: dict[str, Any], message: str) -> None:
    with pytest.raises(bs.CampaignError, match=message):
        bs.Campaign.from_frames(frames, **{**FLOWS, **more})


def test_every_sensor_has_its_own_column() -> None:
    frame = {"time_s": T, "a_V": Y, "b_V": 2.0 * Y + 1.0}
    keys = {"stages": ["sensor"], "commanded_on": "2 s"}
    pair = bs.Campaign.from_frames(frame, signals={"A": "a_V", "B": "b_V"}, **keys)
    np.testing.assert_array_equal(pair["1,A"].values, Y)
    np.testing.assert_array_equal(pair["1,B"].values, 2.0 * Y + 1.0)


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Zurich", "Asia/Kolkata"])
def test_commanded_times_are_on_the_clock_of_a_zone(zone: str | None) -> None:
    index = pd.date_range("2024-05-01 23:50", freq="5s", periods=len(T), tz=zone)
    at = index[0] + pd.Timedelta("2 s")
    for frame in (pd.DataFrame({"y": Y}, index=index), pd.DataFrame({"time": index, "y": Y})):
        for command in ("23:50:02", "2024-05-01 23:50:02", at, at.to_pydatetime()):
            made = bs.Campaign.from_frames(frame, stages=["sensor"], commanded_on=command)
            assert made.experiments[0].commanded_on == 2.0
    if zone is not None:  # the same moment, in another zone
        made = bs.Campaign.from_frames(
            frame, stages=["sensor"], commanded_on=at.tz_convert("America/Lima")
        )
        assert made.experiments[0].commanded_on == 2.0


@pytest.mark.parametrize("suffix", ["parquet", "feather"])
def test_the_zone_of_a_file_is_that_of_its_commands(suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    index = pd.date_range("2024-05-01 12:00", freq="5s", periods=len(T), tz="Europe/Zurich")
    getattr(pd.DataFrame({"time": index, "y_V": Y}), f"to_{suffix}")(tmp_path / f"a.{suffix}")
    (tmp_path / "campaign.toml").write_text(
        f'[rig]\nstages = ["sensor"]\n[[experiment]]\nname = "1"\nfile = "a.{suffix}"\n'
        'commanded_on = "12:00:02"\n'
    )
    assert bs.read_campaign(tmp_path / "campaign.toml").experiments[0].commanded_on == 2.0


def test_an_hour_that_is_there_twice_is_counted_on() -> None:
    index = pd.date_range("2024-10-27 01:50", freq="60s", periods=len(T), tz="Europe/Zurich")
    made = bs.Campaign.from_frames(
        pd.DataFrame({"y": Y}, index=index), stages=["sensor"], commanded_on="01:55:00"
    )
    assert made.experiments[0].commanded_on == 300.0
    assert made.experiments[0].t[-1] == 60.0 * (len(T) - 1)


def test_masked_samples_are_left_out() -> None:
    masked = np.ma.masked_array(np.where(T > T[-5], 99.0, Y), mask=T > T[-5])
    gaps = np.where(T > T[-5], np.nan, Y)
    made, same = (
        bs.Campaign.from_frames({"1": (T, y)}, stages=["sensor"], commanded_on=1.0)
        for y in (masked, gaps)
    )
    assert made.n_samples == same.n_samples < len(T)
