"""Campaigns written as DAQ exports come back as they were, byte for byte the same each time."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, SideInformation
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.io.writers import (
    FORMATS,
    campaign_text,
    drive_signal,
    write_campaign,
    write_csv,
    write_npz,
    write_picoscope_csv,
    write_picoscope_mat,
)

N = 4000
INTERVAL = 0.002


def experiment(name: str, **changes: object) -> Experiment:
    t = np.arange(N) * INTERVAL
    rng = np.random.default_rng(len(name))
    y = 0.3 + np.clip(t - 2, 0, 1) - np.clip(t - 6, 0, 1) + 0.05 * rng.standard_normal(N)
    fields: dict[str, object] = {
        "name": name,
        "t": t,
        "y": y,
        "carrier_flow": 8.0 / 0.06,
        "test_gas_flow": 1.0 / 0.06,
        "interval": INTERVAL,
        "commanded_on": 2.0,
        "commanded_off": 6.0,
    }
    return Experiment(**(fields | changes))  # type: ignore[arg-type]


def assert_same(found: Campaign, planted: Campaign, tolerance: float) -> None:
    assert found.title == planted.title and found.signal_unit == planted.signal_unit
    assert found.names_of_experiments == planted.names_of_experiments
    for e, p in zip(found, planted, strict=True):
        assert e.interval == p.interval and e.commanded_off == p.commanded_off
        assert e.commanded_on == p.commanded_on
        assert e.carrier_flow == pytest.approx(p.carrier_flow, rel=1e-12)
        assert e.test_gas_flow == pytest.approx(p.test_gas_flow, rel=1e-12)
        np.testing.assert_allclose(e.t, p.t, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(e.used, p.used)
        if p.y is not None:
            scale = np.abs(p.y).max()
            np.testing.assert_allclose(e.values, p.y, rtol=0, atol=tolerance * scale)


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize("drive", [False, True])
def test_round_trip(kind: str, drive: bool, tmp_path: Path) -> None:
    mask = np.ones(N, dtype=bool)
    mask[[10, 20]] = False
    mask[100:200] = False
    planted = Campaign(
        'a "quoted" \\ title',
        (experiment("1"), experiment("2 / b", mask=mask), experiment("2 ? b", commanded_off=None)),
        {"V_mL": SideInformation(60.0, 2.0), "tau_v_s": SideInformation(0.85, 0.1)},
    )
    found = read_campaign(write_campaign(planted, tmp_path / "new" / "folder", kind, drive))
    assert_same(found, planted, 1e-6)
    assert found.side_information == planted.side_information
    assert found.warnings == ()
    assert all((e.drive is not None) == drive for e in found)


@pytest.mark.parametrize("kind", FORMATS)
def test_seconds_since_an_epoch_come_back(kind: str, tmp_path: Path) -> None:
    later = 1.7e9
    mask = np.ones(N, dtype=bool)
    mask[[10, 20]] = False
    one = experiment("1", mask=mask)
    planted = replace(
        one, t=one.t + later, commanded_on=2.002 + later, commanded_off=6.002 + later
    )  # fmt: skip
    found = read_campaign(write_campaign(Campaign("late", (planted,)), tmp_path, kind))["1"]
    # doubles have steps of 0.24 us there; a PicoScope file has a start and an interval, no clock
    start = later if kind == "mat" else 0.0
    np.testing.assert_allclose(found.t, one.t + start, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(found.used, mask)
    assert found.commanded_on == pytest.approx(2.002 + start, rel=0, abs=1e-6)
    assert found.commanded_off == pytest.approx(6.002 + start, rel=0, abs=1e-6)


def test_round_trip_in_another_unit_and_mixed_formats(tmp_path: Path) -> None:
    base = experiment("1")
    scaled = [experiment(name, y=base.values * 400) for name in ("a", "b", "c", "d")]
    planted = Campaign("mixed", scaled, signal_unit="ppm")
    formats = dict(zip("abcd", FORMATS, strict=True))
    found = read_campaign(write_campaign(planted, tmp_path, formats))
    assert_same(found, planted, 1e-6)
    assert {e.source.split(".")[-1] for e in found} == {"csv", "mat", "npz"}


def test_design_round_trip(tmp_path: Path) -> None:
    planted = Campaign("plan", (experiment("1", y=None), experiment("2", y=None)))
    found = read_campaign(write_campaign(planted, tmp_path))
    assert found.is_design and [p.name for p in tmp_path.iterdir()] == ["campaign.toml"]
    assert_same(found, planted, 0)


def test_commands_can_be_left_to_the_drive(tmp_path: Path) -> None:
    e = experiment("1")
    write_picoscope_mat(
        tmp_path / "a.mat", {"A": e.values, "B": drive_signal(e)}, e.interval, start=0.0
    )
    silent = experiment("1", commanded_on=None, commanded_off=None)
    keys = {"file": "a.mat", "drive": "B"}
    (tmp_path / "campaign.toml").write_text(campaign_text(Campaign("x", (silent,)), {"1": keys}))
    (found,) = read_campaign(tmp_path / "campaign.toml")
    assert (found.commanded_on, found.commanded_off) == (2.0, 6.0)


def test_matlab_file_is_what_picoscope_writes(tmp_path: Path) -> None:
    y = np.linspace(-1, 1, 500)
    write_picoscope_mat(tmp_path / "a.mat", {"A": y, "B": y * 0}, 1e-3, -0.5, lsb=0.01)
    content = scipy.io.loadmat(tmp_path / "a.mat")
    assert content["A"].dtype == np.float32 and content["A"].shape == (500, 1)
    np.testing.assert_allclose(content["A"][:, 0], np.rint(y / 0.01) * 0.01, atol=1e-6)
    assert (content["Tstart"], content["Tinterval"], content["Length"]) == (-0.5, 1e-3, 500)


def test_picoscope_csv_has_header_units_and_a_blank_line(tmp_path: Path) -> None:
    t = np.array([0.0, 0.001])
    write_picoscope_csv(
        tmp_path / "a.csv", t, {"A": t + 0.5, "B": t}, units=["mV", "V"], decimals=3
    )
    assert (tmp_path / "a.csv").read_bytes().decode() == (
        "Time,Channel A,Channel B\r\n(ms),(mV),(V)\r\n\r\n"
        "0.0000,500.000,0.000\r\n1.0000,501.000,0.001\r\n"
    )


def test_plain_csv_with_decimal_commas(tmp_path: Path) -> None:
    columns = {"time_s": np.array([0.0, 0.5]), "voltage_V": np.array([1.25, -3e-7])}
    write_csv(tmp_path / "a.csv", columns, separator=";", decimal=",")
    assert (tmp_path / "a.csv").read_text() == "time_s;voltage_V\n0;1,25\n0,5;-3e-07\n"
    with pytest.raises(CampaignError, match="use semicolons with decimal commas"):
        write_csv(tmp_path / "b.csv", columns, decimal=",")


PROGRAM = """
import sys, numpy as np
sys.path.insert(0, {root!r})
from bayes_sensor.io.writers import write_npz, write_picoscope_mat
y = np.random.default_rng(1).standard_normal(1000)
write_picoscope_mat({folder!r} + "/a.mat", {{"A": y}}, 1e-3, compress=False)
write_picoscope_mat({folder!r} + "/b.mat", {{"A": y}}, 1e-3)
write_npz({folder!r} + "/c.npz", y, y)
"""


def test_the_same_samples_give_the_same_bytes(tmp_path: Path) -> None:
    y = np.random.default_rng(1).standard_normal(1000)
    write_picoscope_mat(tmp_path / "a.mat", {"A": y}, 1e-3, compress=False)
    write_picoscope_mat(tmp_path / "b.mat", {"A": y}, 1e-3)
    write_npz(tmp_path / "c.npz", y, y)
    first = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    root = str(Path(__file__).resolve().parents[2])
    code = PROGRAM.format(root=root, folder=str(tmp_path))
    subprocess.run([sys.executable, "-c", code], check=True)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == first
    # neither date nor machine in the first 116 bytes, which MATLAB leaves to the writer
    assert first["a.mat"][:116].rstrip().endswith(b"written by bayes_sensor")


def test_seven_records_of_two_minutes_fit_into_six_megabytes(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(120_000) * 1e-3
    total = 0
    for k in range(7):
        y = 0.3 + 0.065 * rng.standard_normal(len(t))
        if k < 6:
            path = tmp_path / f"{k}.mat"
            write_picoscope_mat(path, {"A": y}, 1e-3, lsb=20 / 2**16)
        else:
            path = tmp_path / f"{k}.csv"
            write_picoscope_csv(path, t, {"A": y}, decimals=5, time_decimals=1)
        total += path.stat().st_size
    assert total < 5e6


def test_nothing_half_written_is_left(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="expected channels of one length"):
        write_picoscope_mat(tmp_path / "a.mat", {"A": np.ones(3), "B": np.ones(4)}, 1.0)
    with pytest.raises(CampaignError, match="cannot be written"):
        write_csv(tmp_path / "absent" / "a.csv", {"t": np.ones(3), "y": np.ones(3)})
    with pytest.raises(CampaignError, match="the format 'xls' cannot be written; choose one of"):
        write_campaign(Campaign("x", (experiment("1"),)), tmp_path, "xls")
    (tmp_path / "file").write_text("")
    with pytest.raises(CampaignError, match="the folder cannot be made"):
        write_campaign(Campaign("x", (experiment("1"),)), tmp_path / "file" / "sub")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@given(st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=30))
@settings(max_examples=50)
def test_any_name_survives(name: str) -> None:
    import tomllib

    if not name.strip():
        return
    text = campaign_text(Campaign(name, (experiment(name, y=None),)), {})
    tables = tomllib.loads(text)
    assert tables["title"] == name and tables["experiment"][0]["name"] == name
