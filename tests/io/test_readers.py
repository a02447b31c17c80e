"""Reading campaigns: every format, every mistake, and nothing but CampaignError for any bytes."""

import io
import os
import pickle
import re
import sys
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from bayes_sensor.campaign import Campaign, CampaignError, SideInformation
from bayes_sensor.io.check import campaign_rows
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.io.readers import saturation as sat
from bayes_sensor.io.readers.drive import drive_edges
from bayes_sensor.io.readers.quantities import FLOW, TIME, read_quantity
from bayes_sensor.io.readers.recording import split_name
from bayes_sensor.io.readers.sampling import grid_through, simplest_near
from bayes_sensor.io.run_record import campaign_record
from bayes_sensor.io.toml_text import read_toml
from bayes_sensor.io.writers import campaign_text

REAL = Path(__file__).resolve().parents[2] / ".." / "shared" / "real"
N = 1000
INTERVAL = 0.01
ON, OFF = 2.0, 7.0


def step(t: np.ndarray, noise: float = 0.01, seed: int = 1) -> np.ndarray:
    """(n,) V, a step up at 2 s and down at 7 s, with white noise."""
    rng = np.random.default_rng(seed)
    rise = 1 - np.exp(-np.clip(t - ON, 0, None) / 0.5)
    fall = 1 - np.exp(-np.clip(t - OFF, 0, None) / 0.5)
    return 0.3 + 1.8 * (rise - fall) + noise * rng.standard_normal(len(t))


T = np.arange(N) * INTERVAL
Y = np.round(step(T), 5)
DRIVE = np.where((T > ON - 1e-9) & (T < OFF - 1e-9), 5.0, 0.0)


def rows(
    t: np.ndarray = T,
    *columns: np.ndarray,
    separator: str = ",",
    header: str = "time_s,voltage_V\n",
    t_format: str = "%.3f",
    decimal: str = ".",
) -> str:
    """A text table."""
    columns = columns or (Y,)
    lines = [
        separator.join([t_format % a[0], *(f"{v:.6g}" for v in a[1:])]).replace(".", decimal)
        for a in zip(t, *columns)
    ]
    return header + "\n".join(lines) + "\n"


def entry(file: str | None = "a.csv", name: str = "1", **keys: str | None) -> str:
    """The text of one [[experiment]]; values are TOML, None drops a key."""
    table: dict[str, str | None] = {
        "name": f'"{name}"',
        "file": None if file is None else f'"{file}"',
        "carrier_flow": '"4.0 L/min"',
        "test_gas_flow": '"0.5 L/min"',
        "commanded_on": '"2 s"',
        "commanded_off": '"7 s"',
    } | keys
    lines = [f"{key} = {value}" for key, value in table.items() if value is not None]
    return "\n".join(["[[experiment]]", *lines, ""])


def campaign(
    folder: Path,
    data: str | bytes | None = None,
    toml: str | None = None,
    file: str = "a.csv",
    **keys: str | None,
) -> Campaign:
    """The campaign read from one data file with one experiment."""
    if data is not None:
        (folder / file).write_bytes(data.encode() if isinstance(data, str) else data)
    text = entry(file, **keys) if toml is None else toml
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return read_campaign(folder / "campaign.toml")


def assert_is_the_step(found: Campaign, tolerance: float = 1e-9) -> None:
    (e,) = found
    assert e.interval == INTERVAL
    np.testing.assert_allclose(e.t, T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(e.values, Y, rtol=0, atol=tolerance)
    assert e.used.all() and found.warnings == () and found.signal_unit == "V"
    assert (e.commanded_on, e.commanded_off) == (ON, OFF)
    assert e.total_flow == pytest.approx(75.0, rel=1e-13)
    assert len(e.sha256) == 64


# --------------------------------------------------------------------------- formats

PICO = "Time,Channel A,Channel B\r\n"
SEMICOLON = "time_s;voltage_V\n"
TABLES: dict[str, tuple[str | bytes, dict[str, str]]] = {
    "plain": (rows(), {}),
    "semicolon": (rows(separator=";", header=SEMICOLON), {}),
    "decimal comma": (rows(separator=";", header=SEMICOLON, decimal=","), {}),
    "tab": (rows(separator="\t", header="time_s\tvoltage_V\n"), {}),
    "tab, decimal comma": (rows(separator="\t", header="t\ty\n", decimal=","), {}),
    "blanks": (rows(separator="  ", header="t y\n"), {}),
    "no header": (rows(header=""), {}),
    "no header, decimal comma": (rows(header="", separator=";", decimal=","), {}),
    "BOM": ("\ufeff" + rows(), {}),
    "CRLF": (rows().replace("\n", "\r\n"), {}),
    "CR": (rows().replace("\n", "\r"), {}),
    "UTF-16": (rows().encode("utf-16"), {}),
    "UTF-16 BE": (("\ufeff" + rows()).encode("utf-16-be"), {}),
    "UTF-16 without BOM": (rows().encode("utf-16-le"), {}),
    "Latin-1": (rows(header="Zeit,Spannung in µ-Küvette\n").encode("latin-1"), {}),
    "comments": (rows(header="# made by hand\n# second line\n\ntime_s,voltage_V\n"), {}),
    "Excel": (rows(separator=";", header="sep=;\n" + SEMICOLON, decimal=","), {}),
    "quoted": (rows(header='"time_s","voltage_V"\n'), {}),
    "trailing separator": (rows(header="time_s,voltage_V,\n").replace("\n", ",\n"), {}),
    "no end of line": (rows().rstrip("\n"), {}),
    "PicoScope s": (rows(T, Y, DRIVE, header=PICO + "(s),(V),(V)\r\n\r\n"), {}),
    "PicoScope ms, mV": (
        rows(T * 1e3, Y * 1e3, DRIVE, header=PICO + "(ms),(mV),(V)\r\n\r\n"),
        {},
    ),
    "PicoScope drive": (
        rows(T, Y, DRIVE, header=PICO + "(s),(V),(V)\r\n\r\n"),
        {"signal": '"A"', "drive": '"B"', "commanded_on": None, "commanded_off": None},
    ),
    "unit in name": (rows(T * 1e3, Y * 1e3, header="time_ms,voltage_mV\n"), {}),
    "unit in brackets": (rows(T * 1e3, Y * 1e3, header="Time [ms],Signal (mV)\n"), {}),
    "minutes": (rows(T / 60, header="t (min),y\n", t_format="%.12g"), {}),
    "time is second": (rows(Y, T, header="voltage_V,time_s\n", t_format="%.6g"), {}),
    "third column": (
        rows(T, Y * 0, Y, header="time_s,other,sensor\n"),
        {"signal": '"Sensor"', "signal_unit": '"V"'},
    ),
    "no unit but signal_unit": (
        rows(T, Y * 1e3, header="t,y\n"),
        {"signal_unit": '"mV"'},
    ),
    "coarse times": (rows(T, t_format="%.2f"), {}),
}


@pytest.mark.parametrize("name", TABLES)
def test_text_tables(name: str, tmp_path: Path) -> None:
    data, keys = TABLES[name]
    assert_is_the_step(campaign(tmp_path, data, **keys), 1e-6)


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".tsv", ".CSV"])
def test_text_suffixes(suffix: str, tmp_path: Path) -> None:
    assert_is_the_step(campaign(tmp_path, rows(), file=f"a{suffix}"), 1e-6)


def mat(compress: bool = False, **variables: object) -> bytes:
    stream = io.BytesIO()
    savemat(stream, variables, do_compression=compress)
    return stream.getvalue()


CLOCK = {"Tstart": 0.0, "Tinterval": np.float32(INTERVAL), "Length": N}
MATLAB: dict[str, tuple[bytes, dict[str, str | None]]] = {
    "PicoScope column": (mat(A=Y[:, None], B=DRIVE[:, None], **CLOCK), {}),
    "PicoScope row": (mat(A=Y[None, :], **CLOCK), {}),
    "PicoScope float32": (mat(True, A=Y.astype("f4")[:, None], **CLOCK), {}),
    "PicoScope drive": (
        mat(A=Y, B=DRIVE.astype("i2"), **CLOCK),
        {"drive": '"B"', "commanded_on": None, "commanded_off": None},
    ),
    "without Length": (mat(A=Y, Tstart=0.0, Tinterval=INTERVAL), {}),
    "general names": (mat(True, time=T, sensor=Y, valve=DRIVE), {"signal": '"sensor"'}),
    "first vector": (mat(t=T, signal=Y, valve=DRIVE, note="text", s={"a": 1}), {}),
    "milliseconds": (mat(time_ms=T * 1e3, y_mV=Y * 1e3), {}),
}


@pytest.mark.parametrize("name", MATLAB)
def test_matlab(name: str, tmp_path: Path) -> None:
    data, keys = MATLAB[name]
    assert_is_the_step(campaign(tmp_path, data, file="a.mat", **keys), 1e-6)


@pytest.mark.parametrize("orientation", ["row", "column"])
def test_matlab_version_7_3(orientation: str, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as f:
        for name, value in {"A": Y.astype("f4"), "Tinterval": INTERVAL, "Tstart": 0.0}.items():
            array = np.atleast_2d(value)
            f[name] = array if orientation == "column" else array.T
            kind = b"single" if name == "A" else b"double"
            f[name].attrs["MATLAB_class"] = np.bytes_(kind)
    with (tmp_path / "a.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    assert_is_the_step(campaign(tmp_path, file="a.mat"), 1e-6)


def npz(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (npz(t=T, y=Y), {}),
        (npz(t=T.astype("f4"), y=Y.astype("f4")[:, None]), {}),
        (npz(y=Y, t=T, drive=DRIVE), {"commanded_on": None, "commanded_off": None}),
        (npz(time_ms=T * 1e3, sensor=Y, other=Y * 0), {"signal": '"sensor"'}),
    ],
)
def test_npz(data: bytes, keys: dict[str, str | None], tmp_path: Path) -> None:
    assert_is_the_step(campaign(tmp_path, data, file="a.npz", **keys), 1e-6)


def test_parquet(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    table = pa.table({"note": ["x"] * N, "time_s": T, "voltage_V": Y.astype("f4"), "valve": DRIVE})
    pq.write_table(table, tmp_path / "a.parquet")
    keys = {"signal": '"voltage"', "drive": '"valve"', "commanded_on": None, "commanded_off": None}
    assert_is_the_step(campaign(tmp_path, file="a.parquet", **keys), 1e-6)
    with pytest.raises(CampaignError, match="column 'note' has the type .*; expected numbers"):
        campaign(tmp_path, file="a.parquet", signal='"note"')


@pytest.mark.parametrize("clock", ["waveform", "time channel"])
def test_tdms(clock: str, tmp_path: Path) -> None:
    tdms = pytest.importorskip("nptdms")
    waveform = {"wf_increment": INTERVAL, "wf_start_offset": 0.0, "unit_string": "mV"}
    channels = [
        tdms.ChannelObject("g", "sensor", Y * 1e3, waveform),
        tdms.ChannelObject("g", "valve", DRIVE, {}),
    ]
    if clock == "time channel":
        channels.insert(0, tdms.ChannelObject("g", "Time", T * 1e3, {"unit_string": "ms"}))
    with tdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(channels)
    keys = {"drive": '"valve"', "commanded_on": None, "commanded_off": None}
    assert_is_the_step(campaign(tmp_path, file="a.tdms", **keys), 1e-6)
    with pytest.raises(CampaignError, match="nothing. is not in the file.*'sensor', 'valve'"):
        campaign(tmp_path, file="a.tdms", signal='"nothing"')
    with pytest.raises(CampaignError, match="signal and drive are both 'valve'"):
        campaign(tmp_path, file="a.tdms", signal='"valve"', drive='"valve"')


@pytest.mark.parametrize(("suffix", "module"), [("parquet", "pyarrow"), ("tdms", "nptdms")])
def test_missing_package_names_the_extra(
    suffix: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(CampaignError, match=rf"pip install 'bayes-sensor\[{suffix}\]'"):
        campaign(tmp_path, b"data", file=f"a.{suffix}")


def test_incomplete_tdms_is_refused(tmp_path: Path) -> None:
    tdms = pytest.importorskip("nptdms")
    path = tmp_path / "a.tdms"
    with tdms.TdmsWriter(path) as writer:
        writer.write_segment([tdms.ChannelObject("g", "y", Y, {"wf_increment": INTERVAL})])
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(CampaignError, match="incomplete or damaged"):
        campaign(tmp_path, file="a.tdms")


def test_link_to_a_file_of_another_name(tmp_path: Path) -> None:
    (tmp_path / "blob").write_text(rows())
    (tmp_path / "a.csv").symlink_to("blob")
    assert_is_the_step(campaign(tmp_path), 1e-6)


def test_masked_samples_are_finite_too(tmp_path: Path) -> None:
    data = with_values(i5=1e300, i6=np.inf, i7=np.nan)
    (e,) = campaign(tmp_path, data, mask='[["0.05 s", "0.07 s"]]')
    assert (~e.used).sum() == 3 and np.abs(e.values).max() < 3


def test_signal_units_are_kept_or_settled(tmp_path: Path) -> None:
    found = campaign(tmp_path, rows(T, Y * 1e3, header="t,y\n"), signal_unit='"ppm"')
    assert found.signal_unit == "ppm"
    np.testing.assert_allclose(found["1"].values, Y * 1e3, atol=1e-2)
    kilo = campaign(tmp_path, rows(header="time_s,r (kohm)\n"), signal_unit='"ohm"')
    assert kilo.signal_unit == "ohm"
    np.testing.assert_allclose(kilo["1"].values, Y * 1e3, atol=1e-2)
    (tmp_path / "b.csv").write_text(rows(header="time_s,y\n"))
    both = entry("a.csv") + entry("b.csv", "2")
    with pytest.raises(CampaignError, match="'2' .*in 'V', but that of experiment '1' in 'kohm'"):
        campaign(tmp_path, toml=both)


def test_side_information(tmp_path: Path) -> None:
    head = '[side_information]\nV = "60 ± 2 mL"\ntau = "(48 +/- 5) ms"\ntau_v = "0.85+-0.1 s"\n'
    found = campaign(tmp_path, rows(), toml=head + entry())
    assert found.side_information == {
        "V_mL": SideInformation(60.0, 2.0),
        "tau_s": SideInformation(0.048, 0.005),
        "tau_v_s": SideInformation(0.85, 0.1),
    }


def test_design(tmp_path: Path) -> None:
    text = 'title = "plan"\n' + entry(None, interval='"1 ms"', duration='"120 s"')
    found = campaign(tmp_path, toml=text)
    (e,) = found
    assert found.is_design and e.y is None and len(e.t) == 120_000 and e.interval == 0.001
    assert e.t[0] == 0 and e.t[-1] == pytest.approx(119.999, abs=1e-12)
    assert (e.commanded_on, e.commanded_off) == (2.0, 7.0)


def test_keep_and_mask(tmp_path: Path) -> None:
    keys = {"keep": '["1 s", "9000 ms"]', "mask": '[["3.0 s", "3.5 s"], ["8 s", "8.01 s"]]'}
    (e,) = campaign(tmp_path, rows(), **keys)
    assert e.t[0] == 1.0 and e.t[-1] == 9.0 and len(e.t) == 801
    out = ~e.used
    np.testing.assert_allclose(e.t[out][[0, 50]], [3.0, 3.5])
    assert out.sum() == 51 + 2


def test_the_coating_is_read_and_written(tmp_path: Path) -> None:
    found = campaign(tmp_path, rows(), toml='coating = "zif8"\n' + entry())
    assert found.coating == "zif8" and 'coating = "zif8"\n' in campaign_text(found, {})
    assert campaign_record(found, (), campaign_rows(found))["coating"] == "zif8"
    plain = campaign(tmp_path, rows())
    assert plain.coating == "" and "coating" not in campaign_text(plain, {})
    assert "coating" not in campaign_record(plain, (), campaign_rows(plain))
    with pytest.raises(CampaignError, match="coating must be 'zif8' or left out"):
        replace(plain, coating="gold")


def test_files_outside_need_permission(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    folder.mkdir()
    (tmp_path / "a.csv").write_text(rows())
    (folder / "link.csv").symlink_to(tmp_path / "a.csv")
    for file in ("../a.csv", "link.csv", str(tmp_path / "a.csv")):
        with pytest.raises(CampaignError, match="outside the campaign's folder.*allow_outside"):
            campaign(folder, toml=entry(file))
        assert_is_the_step(campaign(folder, toml="allow_outside = true\n" + entry(file)), 1e-6)


def test_hostile_names_are_only_names(tmp_path: Path) -> None:
    name = "<script>alert('1')</script> ${x} %s {0} ../.. \U0001f4a5"
    (e,) = campaign(tmp_path, rows(), toml=entry(name=name))
    assert e.name == name


# --------------------------------------------------------------------------- mistakes in the TOML

MISTAKES: dict[str, tuple[str, str]] = {
    "bare number": (entry(carrier_flow="4.0"), 'bare number 4; write carrier_flow = "4 L/min"'),
    "no unit": (
        entry(carrier_flow='"4.0"'),
        'without one; add the unit that is meant, as in carrier_flow = "4.0 L/min"',
    ),
    "flow in seconds": (entry(carrier_flow='"4.0 s"'), r"carrier_flow: .* in 's', which is not"),
    "time in litres": (entry(commanded_on='"2 L"'), "commanded_on: expected a time"),
    "unknown unit": (entry(carrier_flow='"4 lpq"'), "'lpq' is not a unit that is known"),
    "standard flow": (
        entry(carrier_flow='"400 sccm"'),
        "in standard units, which need the temperature and pressure",
    ),
    "decimal comma": (entry(carrier_flow='"4,0 L/min"'), "with a decimal point"),
    "zero flow": (entry(test_gas_flow='"0 L/min"'), "test_gas_flow: expected a positive flow"),
    "negative flow": (entry(carrier_flow='"-4 L/min"'), "carrier_flow: expected a positive flow"),
    "large flow": (entry(carrier_flow='"4e30 L/min"'), "is out of range"),
    "huge flow": (entry(carrier_flow='"4e300 L/min"'), "is out of range"),
    "infinite flow": (entry(carrier_flow='"1e999 L/min"'), "is out of range"),
    "bare infinite flow": (entry(carrier_flow="inf"), "got the number inf, which is out of range"),
    "exponent of five digits": (entry(carrier_flow='"1e99999 L/min"'), "is out of range"),
    "standard flow beyond floats": (
        "[conditions]\ntemperature = '20 degC'\npressure = '1 bar'\n"
        + entry(carrier_flow='"1e400 sccm"'),
        "carrier_flow = '1e400 sccm' is out of range",
    ),
    "time that no float holds": (entry(commanded_on='"1e-400 s"'), "commanded_on.*out of range"),
    "subnormal spread": (
        "[side_information]\nV = '60 +- 5e-324 mL'\n" + entry(),
        "V: .*out of range",
    ),
    "subnormal step": (
        entry(steps='[{at = "2 s", to = 5e-324}]', commanded_on=None, commanded_off=None),
        "steps: expected a concentration between",
    ),
    "power bomb": (entry(carrier_flow='"1 L**9**9**9**9"'), "is not a unit that is known"),
    "number bomb": (entry(carrier_flow='"9**9**9**9 s"'), "is not a unit that is known"),
    "long text": (entry(carrier_flow='"' + "9" * 2000 + ' L/min"'), "2006 characters"),
    "boolean flow": (entry(carrier_flow="true"), "carrier_flow: expected .* but got True"),
    "misspelt key": (entry(carier_flow='"4 L/min"', carrier_flow=None), 'write "carrier_flow"'),
    "unknown key": (entry(colour='"red"'), "unknown key 'colour'; .* known are name, file"),
    "unknown top key": ("titel = 'x'\n" + entry(), "unknown key 'titel'.*write \"title\""),
    "unknown side key": (
        "[side_information]\ntauv = '1 s'\n" + entry(),
        r'\[side_information\] unknown key \'tauv\'.*write "tau_v"',
    ),
    "side without spread": (
        "[side_information]\nV = '60 mL'\n" + entry(),
        r'V: expected a volume with its standard deviation such as "60 \+- 2 mL"',
    ),
    "side zero spread": (
        "[side_information]\nV = '60 +- 0 mL'\n" + entry(),
        "positive standard deviation",
    ),
    "side wrong unit": ("[side_information]\nV = '60 +- 2 s'\n" + entry(), "V: .*which is not one"),
    "missing flow": (entry(carrier_flow=None), "got test_gas_flow alone; .*add carrier_flow"),
    "missing name": (
        entry().replace('name = "1"', ""),
        "experiment number 1 .*the key name is missing",
    ),
    "number as name": (entry().replace('"1"', "1"), 'expected text in quotes.*name = "1"'),
    "empty name": (entry(name=" "), "name: expected 1 to 1000 characters"),
    "invisible name": (entry(name="\u200b\ufe0f"), r"got 2 \(none that can be seen\)"),
    "control character": (entry(name="a\\u0007b"), "control characters"),
    "line separator": (entry(name="a\\u2028b"), "control characters"),
    "name that turns the text": (entry(name="a\\u202eb"), "control characters"),
    "invisible sensor": (entry(signals='{A = "A", "\u200b" = "B"}'), "for each sensor"),
    "names that look the same": (
        entry(name="caf\u00e9") + entry(name="cafe\u0301\u200b"),
        "number 1 and 2 have names that look the same",
    ),
    "sensors that look the same": (
        entry(signals='{"A b" = "time_s", "A\u00a0b" = "voltage_V"}'),
        "two look the same",
    ),
    "backslash in a path": (entry(file="C:\\data\\exp1.csv"), "write / between folders"),
    "tab in a path": (entry(file="sub\\temp.csv"), "file: .*write / between folders"),
    "stage of a long name": (
        f'[rig]\nstages = ["{"x" * 41}: lag", "sensor"]\n' + entry(),
        "at most 40 characters",
    ),
    "zero byte in path": (entry(file="a\\u0000.csv"), "file: .*control characters"),
    "no experiment": ('title = "x"\n', "the key experiment is missing; add"),
    "empty list": ("experiment = []\n", "expected at least one experiment"),
    "experiment not a table": ("experiment = 3\n", "experiment: expected"),
    "experiments not tables": ("experiment = [3]\n", "experiment: expected"),
    "title is a number": ("title = 3\n" + entry(), "title: expected text in quotes"),
    "allow_outside is text": ('allow_outside = "yes"\n' + entry(), "allow_outside = true"),
    "another coating": ('coating = "gold"\n' + entry(), "coating: expected 'zif8', .*'gold'"),
    "duplicate names": (entry() + entry(), "experiments number 1 and 2 share this name"),
    "syntax": ("title = \n" + entry(), r"expected TOML, but .*line 1"),
    "no quotes": ("[rig]\nV = 60 mL\n" + entry(), "line 2, .* stand in straight quotes"),
    "curly quotes": ("mask = [[“1 s”, “2 s”]]\n" + entry(), "line 1, .* in straight quotes"),
    "no value": ('title = "a"\nmask = \n' + entry(), r"line 2, column 8\); correct that line"),
    "number of digits": ("x = " + "9" * 3900 + "\n", "unknown key|expected TOML"),
    "deep brackets": ("x = " + "[" * 3000 + "\n", "nested too deeply|expected TOML"),
    "dotted bomb": (".".join("a" * 40) + " = 1\n", "too deeply dotted"),
    "long line": ("# " + "x" * 200_000 + "\n", "line 1 is too long"),
    "keep swapped": (entry(keep='["9 s", "1 s"]'), "expected the start before the end"),
    "keep of one": (entry(keep='["9 s"]'), "expected two times"),
    "keep outside": (entry(keep='["100 s", "200 s"]'), "record runs from 0 s to 9.99 s"),
    "mask flat": (entry(mask='["1 s", "2 s"]'), "expected a list of pairs"),
    "mask bare": (
        entry(mask="[[1, 2]]"),
        r'mask: .* bare number 1; write for example mask = \[\["6.3 s"',
    ),
    "key with a line end": ('"a\\nb" = 1\n' + entry(), "unknown key 'a\ufffdb'"),
    "name with a bell": (entry(name="a\\u0007b", carrier_flow=None), "experiment 'a\ufffdb'"),
    "mask all": (entry(mask='[["0 s", "10 s"]]'), "the mask leaves no sample"),
    "off before on": (entry(commanded_off='"1 s"'), "is not after commanded_on"),
    "off without on": (entry(commanded_on=None), "without commanded_on"),
    "on after the end": (entry(commanded_on='"20 s"'), "lies outside the record"),
    "on cropped away": (entry(keep='["3 s", "9 s"]'), "lies outside the record.*from 3 s"),
    "times in ms": (entry(commanded_on='"2000 s"', commanded_off=None), "is time in ms"),
    "signal missing": (entry(signal='"voltag"'), 'did you mean "voltage_V"'),
    "signal is time": (entry(signal='"time_s"'), "which is the time column"),
    "drive missing": (entry(drive='"B"'), "drive = \"B\" is not in the file.*'voltage_V'"),
    "unit of another kind": (entry(signal_unit='"ppm"'), "signal_unit is 'ppm', but the file"),
    "unknown signal unit": (entry(signal_unit='"foo"'), "signal_unit: 'foo' is not a unit"),
    "no such file": (entry(file="b.csv"), "there is no such file"),
    "unknown suffix": (entry(file="a.xls"), r"expected a data file ending in \.csv.*\.tdms"),
    "no suffix": (entry(file="a"), "it ends in ''"),
    "folder as file": (entry(file="folder.csv"), "it is a folder"),
    "long path": (entry(file="x" * 300 + ".csv"), "cannot be (read|followed)"),
    "interval with times": (
        entry(interval='"1 ms"'),
        "interval = 0.001 s, but the times in column 'time_s' are 0.01 s apart",
    ),
    "interval and time": (entry(interval='"1 ms"', time='"time_s"'), "are both given"),
    "duration with file": (entry(duration='"9 s"'), "duration belongs to a design"),
    "time missing": (entry(time='"clock"'), "time = \"clock\" is not in the file.*'time_s'"),
    "clock without one": (entry(commanded_on='"09:00:02"'), "are no times of day"),
    "hexadecimal beyond floats": (entry(carrier_flow="0x1" + "0" * 3900), "out of range"),
    "number beyond floats": (entry(carrier_flow="1" + "0" * 400), "about 401 digits, which is out"),
    "mixed": (
        entry() + entry(None, "2", interval='"1 ms"', duration='"9 s"'),
        "expected all measured or all planned",
    ),
    "design without duration": (entry(None, interval='"1 ms"'), "the key duration is missing"),
    "design too long": (entry(None, interval='"1 ns"', duration='"9 s"'), r"gives 9e\+09 samples"),
    "design of one sample": (entry(None, interval='"9 s"', duration='"9 s"'), "gives 1 samples"),
    "design with signal": (
        entry(None, interval='"1 ms"', duration='"9 s"', signal='"A"'),
        "signal belongs to a measured",
    ),
    "design off beyond the end": (
        entry(None, interval='"1 ms"', duration='"5 s"'),
        "commanded_off = 7 s lies beyond the end",
    ),
    "negative interval": (entry(None, interval='"-1 ms"', duration='"5 s"'), "positive time"),
}


def assert_is_one_clear_message(error: pytest.ExceptionInfo[CampaignError]) -> None:
    """One line that names a place and offers something to do."""
    text = str(error.value)
    assert "\n" not in text and 30 < len(text) < 900
    assert ": " in text and (";" in text or ": " in text.split(": ", 1)[1])
    assert "Traceback" not in text and "pydantic" not in text
    assert error.value.__cause__ is None


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_in_the_campaign_file(name: str, tmp_path: Path) -> None:
    toml, message = MISTAKES[name]
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(CampaignError, match=message) as error:
        campaign(tmp_path, rows(), toml=toml)
    assert_is_one_clear_message(error)


def test_a_thousand_times_may_stand_in_one_line() -> None:
    times = [f"{10 * k} s" for k in range(1000)]
    text = "commanded_on = [" + ", ".join(f'"{each}"' for each in times) + "]"
    assert read_toml(text.encode(), "campaign.toml")["commanded_on"] == times


def test_campaign_files_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "campaign.toml"
    with pytest.raises(CampaignError, match=r"campaign\.toml: there is no such file"):
        read_campaign(path)
    path.write_bytes(b"")
    with pytest.raises(CampaignError, match="the file is empty"):
        read_campaign(path)
    with pytest.raises(CampaignError, match=r"it is a folder; give .*campaign\.toml"):
        read_campaign(tmp_path)
    path.write_bytes(b"title = 'ok'\n# \xff\n")
    with pytest.raises(CampaignError, match="line 2 is not UTF-8 text"):
        read_campaign(path)
    path.write_bytes(entry().encode("utf-16"))
    with pytest.raises(CampaignError, match="it is UTF-16; save it as UTF-8"):
        read_campaign(path)
    path.write_bytes(b"# x\n" * (1 << 19))
    with pytest.raises(CampaignError, match="at most 1 MB"):
        read_campaign(path)
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(CampaignError, match="not a regular file"):
        read_campaign(tmp_path / "pipe.toml")
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    with pytest.raises(CampaignError, match="cannot be (followed|read)"):
        campaign(tmp_path, toml=entry("loop.csv"))


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_unreadable_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(rows())
    (tmp_path / "a.csv").chmod(0)
    with pytest.raises(CampaignError, match="cannot be read .*permission"):
        campaign(tmp_path)


# --------------------------------------------------------------------------- mistakes in the data


def edited(row: int, text: str) -> str:
    """The plain table with the line of that row (from 1) replaced."""
    lines = rows().split("\n")
    lines[row - 1] = text
    return "\n".join(lines)


def without(first: int, last: int) -> str:
    """The plain table without samples first to last."""
    keep = np.r_[0:first, last + 1 : N]
    return rows(T[keep], Y[keep])


def with_values(**at: float) -> str:
    y = Y.copy()
    for where, value in at.items():
        y[int(where[1:])] = value
    return rows(T, y)


HOLES = ~(((T > 2.995) & (T < 3.595)) | ((T > 4.995) & (T < 5.495)) | ((T > 7.995) & (T < 8.395)))
"""where three gaps are too long"""

BROKEN: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "the file is empty"),
    "only blanks": ("\n \n", "the file is empty"),
    "only a header": ("time_s,voltage_V\n", "expected rows of numbers after the header"),
    "one sample": ("time_s,voltage_V\n0,1\n", "expected at least 2 samples"),
    "one column": ("voltage_V\n1\n2\n3\n", "there is no time column: .*write interval"),
    "text in a cell": (edited(7, "0.05,abc"), "row 7, column 'voltage_V': .*got 'abc'"),
    "text in time": (edited(7, "soon,0.3"), "row 7, column 'time_s': .*got 'soon'"),
    "text in the first row": (edited(2, "0.0,abc"), "row 2, column 'voltage_V': .*'abc'"),
    "text, no header": (rows(header="0.0,abc\n"), "row 1: expected a header or numbers"),
    "extra cell": (edited(7, "0.05,0.3,4"), "row 7: expected 2 cells.*got 3"),
    "decimal comma in one row": (edited(7, "0,05,0,3"), "row 7: expected 2 cells.*got 4"),
    "decimal commas with commas": (
        rows(decimal=",", header="time_s,voltage_V\n"),
        "decimal commas need semicolons or tabs",
    ),
    "mixed decimals": (
        rows(separator=";", header=SEMICOLON).replace("0.050;0.", "0.050;0,"),
        "row 7, column 'voltage_V': expected a number .decimal point.",
    ),
    "changed separator": (edited(7, "0.05;0.3"), "row 7, column 'time_s': .*'0.05;0.3'"),
    "open quote": (edited(7, '"0.05,0.3'), "row 7"),
    "binary": (bytes(range(256)) * 20, "the content is binary"),
    "zero byte": (rows().encode() + b"9.99,\0\n", r"row 1002 holds a zero byte"),
    "half a UTF-16": (rows().encode("utf-16")[:-1], "cannot be decoded"),
    "repeated row": (edited(7, "0.04,0.3"), r"row 7 \(0.04 s\) follows row 6 \(0.04 s\); drop"),
    "time falls": (edited(7, "0.01,0.3"), r"row 7 \(0.01 s\) follows row 6.*sort the rows"),
    "shuffled": (
        rows(T[np.random.default_rng(1).permutation(N)]),
        "time must increase strictly",
    ),
    "few digits": (rows(t_format="%.1f"), "export times with more digits"),
    "time is nan": (edited(7, "nan,0.3"), "row 7: the time is nan"),
    "time is missing": (edited(7, ",0.3"), "row 7: the time is nan"),
    "time is huge": (edited(1001, "1e300,0.3"), r"jumps from 9.98 s to 1e\+300 s at row 1001"),
    "times beyond float": (rows().replace("9.990,", "1e400,"), "the time is inf"),
    "log spaced": (rows(np.geomspace(0.01, 10, N), t_format="%.9f"), "gaps of at most 0.0438 s"),
    "long gap": (without(300, 359), r"a gap of 0.6 s in time between 2.99 s and 3.6 s"),
    "long gaps": (
        rows(T[HOLES], Y[HOLES]),
        r"are 3 gaps in time of up to 0.6 s, between 2.99 s and 3.6 s, between 4.99 s and 5.5 s, "
        r"between 7.99 s and 8.4 s; .* accept them with mask = \[\[\"2.99 s\", \"3.6 s\"\], "
        r"\[\"4.99 s\", \"5.5 s\"\], \[\"7.99 s\", \"8.4 s\"\]\]",
    ),
    "many long gaps": (
        rows(T[T % 0.5 < 0.24], Y[T % 0.5 < 0.24]),
        r"are 19 gaps in time of up to 0.26 s, .* and further on; .*, \.\.\]$",
    ),
    "many gaps": (rows(T[T * 100 % 8 < 6.5], Y[T * 100 % 8 < 6.5]), "samples are missing"),
    "all nan": (rows(T, Y * np.nan), "none of the 1000 samples is a finite number"),
    "many nan": (rows(T, np.where(T < 1.5, np.nan, Y)), "150 of 1000 samples are not a number"),
    "out of proportion": (with_values(i5=1e300), "row 7: the signal is 1e.300"),
    "time unit": (rows(header="Time,A\n(V),(V)\n\n"), "should be time, but its unit is 'V'"),
    "unknown unit row": (rows(header="Time,A\n(s),(foo)\n\n"), "'foo' of column 'A' is not known"),
    "unit row too short": (rows(header="Time,A\n(s)\n\n"), "expected one unit for each of the 2"),
    "names missing": (rows(header="time_s\n"), "row 1 names 1 columns, but row 2 has 2 cells"),
    "many columns": (",".join(["c"] * 5000) + "\n", "at most 4096 columns"),
    "one endless line": (b"1" * (1 << 21), "the first line is longer"),
    "wrong magic": (b"PK\x03\x04" + bytes(200), "the content is binary"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_mistakes_in_a_table(name: str, tmp_path: Path) -> None:
    data, message = BROKEN[name]
    with pytest.raises(CampaignError, match=message) as error:
        campaign(tmp_path, data)
    assert_is_one_clear_message(error)
    assert "a.csv" in str(error.value)


def test_the_masks_that_a_message_proposes_do(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="accept them with") as error:
        campaign(tmp_path, rows(T[HOLES], Y[HOLES]))
    masks = str(error.value).split("mask = ")[1]
    found = campaign(tmp_path, mask=masks)
    assert len(found.experiments[0].t) == N


def npy(shape: tuple[int, ...], descr: str = "<f8") -> bytes:
    """An NPZ archive whose array claims that shape."""
    header = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode().ljust(117)
    array = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + header + b"\n" + bytes(64)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in ("t", "y"):
            archive.writestr(f"{name}.npy", array)
    return stream.getvalue()


class Touch:
    """Unpickling this would make a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., None], tuple[str]]:
        return os.mkdir, (str(self.path),)


GOOD_MAT = mat(True, A=Y, **CLOCK)
BINARY: dict[str, tuple[str, bytes, str]] = {
    "MAT is text": ("a.mat", rows().encode(), "does not begin like one"),
    "MAT is zeros": ("a.mat", bytes(4096), "expected a MATLAB file|expected a time vector"),
    "MAT truncated": ("a.mat", GOOD_MAT[:-100], "truncated"),
    "MAT header only": ("a.mat", GOOD_MAT[:128], "expected a time vector 't'.* no variables"),
    "MAT damaged": ("a.mat", GOOD_MAT[:400] + b"\xff" * 50 + GOOD_MAT[450:], "cannot be read"),
    "MAT bomb": ("a.mat", mat(True, A=np.zeros(25_000_000)), "unpack to more than 152 MB"),
    "MAT without time": ("a.mat", mat(A=Y), "expected a time vector 't' .*'A'"),
    "MAT Length": ("a.mat", mat(A=Y, Tinterval=0.01, Length=5), "Length says 5 samples"),
    "MAT Tinterval": ("a.mat", mat(A=Y, Tinterval=0.0), "Tinterval: expected a positive"),
    "MAT Tstart": ("a.mat", mat(A=Y, Tinterval=0.01, Tstart=np.nan), "Tstart: expected a finite"),
    "MAT lengths": ("a.mat", mat(t=T[:-1], A=Y), "time vector to have the 1000 samples"),
    "MAT complex": ("a.mat", mat(t=T, A=Y + 1j), "complex numbers"),
    "MAT matrix": ("a.mat", mat(t=T, A=np.stack([Y, Y, Y])), "expected a vector with the signal"),
    "MAT cell": ("a.mat", mat(t=T, A=np.array([Y, "x"], dtype=object)), "expected a vector with"),
    "MAT 7.3 truncated": ("a.mat", b"MATLAB 7.3".ljust(512) + b"\x89HDF\r\n\x1a\n", "cannot be"),
    "NPZ is text": ("a.npz", rows().encode(), "cannot be read as one"),
    "NPZ is a pickle": ("a.npz", pickle.dumps({"t": 1}), "cannot be read as one"),
    "NPZ truncated": ("a.npz", npz(t=T, y=Y)[:-200], "cannot be read as one"),
    "NPZ empty": ("a.npz", npz(), "the archive has none"),
    "NPZ without time": ("a.npz", npz(y=Y), "expected an array 't'"),
    "NPZ without signal": ("a.npz", npz(t=T), "expected an array 'y'"),
    "NPZ lengths": ("a.npz", npz(t=T, y=Y[:-3]), "expected 't' to have the 997 samples"),
    "NPZ complex": ("a.npz", npz(t=T, y=Y + 1j), "has the type complex128"),
    "NPZ matrix": ("a.npz", npz(t=T, y=np.ones((N, 2))), "expected one dimension"),
    "NPZ text": ("a.npz", npz(t=T, y=np.array(["a"] * N)), "has the type <U1"),
    "NPZ huge claim": ("a.npz", npy((10**13,)), "at most 20000000 samples"),
    "NPZ false claim": ("a.npz", npy((1000,)), "cannot be read as one"),
    "Parquet is text": ("a.parquet", rows().encode(), "cannot be read as one"),
    "TDMS is text": ("a.tdms", rows().encode(), "cannot be read as one"),
}


@pytest.mark.parametrize("name", BINARY)
def test_mistakes_in_a_binary_file(name: str, tmp_path: Path) -> None:
    file, data, message = BINARY[name]
    if "parquet" in file:
        pytest.importorskip("pyarrow")
    if "tdms" in file:
        pytest.importorskip("nptdms")
    with pytest.raises(CampaignError, match=message) as error:
        campaign(tmp_path, data, file=file)
    assert_is_one_clear_message(error)
    assert file in str(error.value)


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    trap = tmp_path / "sprung"
    objects = np.array([Touch(trap)], dtype=object)
    with pytest.raises(CampaignError, match="pickled Python objects, which are never loaded"):
        campaign(tmp_path, npz(t=T, y=objects), file="a.npz")
    assert not trap.exists()


def test_matlab_links_into_other_files_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["A"] = Y
    with h5py.File(tmp_path / "a.mat", "w") as f:
        f["t"] = T
        f["A"] = h5py.ExternalLink("other.h5", "/A")
    with pytest.raises(CampaignError, match="points into another file or place, which is refused"):
        campaign(tmp_path, file="a.mat")


# --------------------------------------------------------------------------- warnings

NOTED: dict[str, tuple[str, dict[str, str | None], str, int]] = {
    "short gap": (without(300, 304), {}, "one gap in time, 5 missing samples.* 3 s", 5),
    "gap under the mask": (without(300, 359), {"mask": '[["2.9 s", "3.7 s"]]'}, "", 81),
    "gap cropped away": (without(900, 959), {"keep": '["0 s", "8.5 s"]'}, "", 0),
    "some nan": (with_values(i5=np.nan, i600=np.nan), {}, "2 samples are not a number.*row 7", 2),
    "empty cells": (edited(7, "0.05,"), {}, "1 sample is not a number, the first at row 7", 1),
    "nan under the mask": (with_values(i5=np.nan), {"mask": '[["0.04 s", "0.06 s"]]'}, "", 3),
    "overrange": (
        with_values(i250=np.inf),
        {},
        "1 samples .0.1 %. are clipped at the end of the range .marked inf.",
        1,
    ),
    "jitter": (
        rows(T + np.random.default_rng(3).uniform(-0.001, 0.001, N), t_format="%.7f"),
        {},
        "times are up to 10 % of the interval off",
        0,
    ),
    "clipped plateau": (
        rows(T, np.minimum(Y, 1.5)),
        {},
        "are clipped at 1.5 .*the plateau is not seen",
        int((Y >= 1.5).sum()),
    ),
    "infinite plateau": (
        rows(T, np.where(Y > 1.5, np.inf, Y)).replace("inf", "∞"),
        {},
        "the plateau is not seen",
        int((Y > 1.5).sum()),
    ),
    "off beyond the end": (rows(), {"commanded_off": '"12 s"'}, "no step down is recorded", 0),
    "empty mask": (rows(), {"mask": '[["50 s", "60 s"]]'}, "holds no sample", 0),
    "constant": (rows(T, Y * 0 + 1), {}, "the signal never changes", 0),
    "drive disagrees": (
        rows(T, Y, DRIVE, header="t,y,d\n"),
        {"drive": '"d"', "commanded_on": '"1.9 s"'},
        "commanded_on = 1.9 s, but the drive's edge is at 2 s, 100 ms apart",
        0,
    ),
    "drive agrees": (
        rows(T, Y, DRIVE, header="t,y,d\n"),
        {"drive": '"d"', "commanded_on": '"1.96 s"'},
        "",
        0,
    ),
    "drive is useless": (
        rows(T, Y, DRIVE * 0, header="t,y,d\n"),
        {"drive": '"d"'},
        "shows no edge.*the drive was not used",
        0,
    ),
    "swapped": (
        rows(T, Y, DRIVE, header="t,y,d\n"),
        {"drive": '"y"', "signal": '"d"', "commanded_on": None, "commanded_off": None},
        "signal and drive may be swapped",
        0,
    ),
}


@pytest.mark.parametrize("name", NOTED)
def test_warnings_and_masking(name: str, tmp_path: Path) -> None:
    data, keys, message, left_out = NOTED[name]
    found = campaign(tmp_path, data, **keys)
    (e,) = found
    assert (~e.used).sum() == left_out
    assert np.isfinite(e.values).all()
    if message:
        assert len(found.warnings) == 1 and re.search(message, found.warnings[0])
        assert found.warnings[0].startswith("experiment '1' (a.csv): ")
    else:
        assert found.warnings == ()


# --------------------------------------------------------------------------- drive

DRIVES: dict[str, tuple[np.ndarray, str]] = {
    "no edge": (DRIVE * 0, "shows no edge"),
    "noise only": (np.random.default_rng(4).normal(0, 0.1, N), "shows no edge|edges"),
    "all nan": (DRIVE * np.nan, "0 finite samples"),
}


@pytest.mark.parametrize("name", DRIVES)
def test_mistakes_in_the_drive(name: str, tmp_path: Path) -> None:
    drive, message = DRIVES[name]
    data = rows(T, Y, drive, header="t,y,d\n")
    keys = {"drive": '"d"', "commanded_on": None, "commanded_off": None}
    with pytest.raises(CampaignError, match=f"a.csv.: drive 'd': .*{message}") as error:
        campaign(tmp_path, data, **keys)
    assert_is_one_clear_message(error)


@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        (DRIVE, (2.0, 7.0)),
        (DRIVE + np.random.default_rng(5).normal(0, 0.3, N), (2.0, 7.0)),
        (np.where(T >= ON, 24.0, 0.0), (2.0, None)),
        (-DRIVE + 5 * (DRIVE > 0) * 2 - 7, (2.0, 7.0)),
        (np.where(np.arange(N) == 100, 5.0, DRIVE), (2.0, 7.0)),
        (np.where(np.arange(N) == 300, np.nan, DRIVE), (2.0, 7.0)),
    ],
    ids=["clean", "noisy", "stays on", "offset", "glitch", "nan"],
)
def test_commanded_times_from_the_drive(
    drive: np.ndarray, expected: tuple[float, float | None]
) -> None:
    times, starts_high = drive_edges(T, drive, CampaignError)
    assert times == pytest.approx([t for t in expected if t is not None], abs=INTERVAL)
    assert not starts_high


# --------------------------------------------------------------------------- sampling


@pytest.mark.parametrize("interval", [1e-3, 1e-4, 2e-3, 0.05, 1 / 3000, 1 / 44100, 0.0125, 1.0])
@pytest.mark.parametrize("written", ["exact", "float32", "7 digits", "tenth"])
def test_sampling_interval_is_exact(interval: float, written: str) -> None:
    t = 3.0 + np.arange(20_000) * interval
    if written == "float32":
        t = (t - 3.0).astype(np.float32).astype(np.float64)
    elif written == "7 digits":
        t = np.round(t, 7)
    elif written == "tenth":  # a clock read to a tenth of the interval
        t = np.round(t / (interval / 10)) * (interval / 10)
    grid = grid_through(t, str, CampaignError)
    assert grid.interval == pytest.approx(interval, rel=1e-12)
    assert grid.index[-1] == len(t) - 1
    if 1 / interval == round(1 / interval, 6):
        assert grid.interval == interval


@given(
    st.integers(2, 6).map(lambda k: 10.0**-k),
    st.lists(st.integers(1, 8), min_size=60, max_size=200),
    st.floats(-100, 100),
)
@settings(max_examples=60)
def test_dropped_samples_keep_their_place(interval: float, steps: list[int], start: float) -> None:
    # most samples in sequence, so that the interval is defined
    index = np.concatenate((np.arange(300), 299 + np.cumsum(steps)))
    grid = grid_through(start + index * interval, str, CampaignError)
    np.testing.assert_array_equal(grid.index, index)
    assert grid.interval == pytest.approx(interval, rel=1e-6)


@given(st.floats(1e-9, 1e9), st.floats(0, 0.1))
def test_simplest_number_is_within_tolerance(value: float, relative: float) -> None:
    assert abs(simplest_near(value, relative * value) - value) <= relative * value


# --------------------------------------------------------------------------- saturation


def cascade(t: np.ndarray, phi: float, sigma: float, growth: float, seed: int) -> np.ndarray:
    """(n,) V, three lags with coloured noise that grows with concentration."""
    from scipy.signal import lfilter

    h = t[1] - t[0]
    x = ((t >= 20) & (t < 70)).astype(float)
    for tau in (0.8, 0.75, 0.05):
        a = np.exp(-h / tau)
        x = lfilter([1 - a], [1, -a], x)
    white = np.random.default_rng(seed).standard_normal(len(t))
    z = lfilter([np.sqrt(1 - phi**2)], [1, -phi], white)
    return 0.3 + 1.8 * x + sigma * np.sqrt(1 + growth**2 * x) * z


@pytest.mark.parametrize("interval", [0.002, 0.1])
@pytest.mark.parametrize("sigma", [0.0, 0.0005, 0.005, 0.05])
@pytest.mark.parametrize("lsb", [0.0, 0.001, 0.0078, 0.039])
def test_quiet_and_coarse_signals_are_not_clipped(
    interval: float, sigma: float, lsb: float
) -> None:
    t = np.arange(0, 100, interval)
    for seed, phi in enumerate((0.0, 0.8, 0.99)):
        y = cascade(t, phi, sigma, 1.5, seed)
        for signed in (y, -y):
            z = np.rint(signed / lsb) * lsb if lsb else signed
            assert not sat.clipped_samples(z, np.ones(len(t), dtype=bool)).any()


@pytest.mark.parametrize("sigma", [0.0, 0.005, 0.05])
@pytest.mark.parametrize("lsb", [0.0, 0.001])
@pytest.mark.parametrize("part", [0.5, 0.9])
def test_clipped_signals_are_found(sigma: float, lsb: float, part: float) -> None:
    t = np.arange(0, 100, 0.002)
    y = cascade(t, 0.8, sigma, 1.0, 7)
    y = np.rint(y / lsb) * lsb if lsb else y
    rail = 0.3 + 1.8 * part
    beyond = y > rail
    found = sat.clipped_samples(np.minimum(y, rail), np.ones(len(t), dtype=bool))
    assert (found & beyond).sum() == beyond.sum()
    assert (found & ~beyond).sum() < 0.02 * beyond.sum() + 200


def test_partly_clipped_plateau_is_masked_with_a_warning(tmp_path: Path) -> None:
    y = step(T, noise=0.05)
    y[300:420] += 0.6  # an overshoot that runs into the rail
    found = campaign(tmp_path, rows(T, np.minimum(y, 2.5)))
    (e,) = found
    assert 0 <= (~e.used).sum() - (y > 2.5).sum() <= 10
    assert "are clipped at 2.5 or among clipped ones" in found.warnings[0]
    y[330:360] -= 0.4  # what dips below the rail is caught among the clipped, and is no rail
    caught = campaign(tmp_path, rows(T, np.minimum(y, 2.5)))
    assert "are clipped at 2.5 or among clipped ones" in caught.warnings[0]


# --------------------------------------------------------------------------- quantities


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("4.5 L/min", FLOW, 75.0),
        ("4.5 l / min", FLOW, 75.0),
        ("75 cm^3/s", FLOW, 75.0),
        ("75cm³/s", FLOW, 75.0),
        ("75 cm3/s", FLOW, 75.0),
        ("75 mL*s**-1", FLOW, 75.0),
        ("4500 millilitre/minute", FLOW, 75.0),
        (".5 uL/ms", FLOW, 0.5),
        ("12 ms", TIME, 0.012),
        ("-1.5e1 µs", TIME, -1.5e-5),
        ("2 min", TIME, 120.0),
    ],
)
def test_quantities(text: str, kind: object, value: float) -> None:
    assert read_quantity(text, kind, "key") == value


@pytest.mark.slow
@given(st.text(max_size=40))
@settings(max_examples=150)
def test_any_text_is_a_quantity_or_a_message(text: str) -> None:
    message = "key"
    try:
        assert isinstance(read_quantity(text, TIME, "key"), float)
    except CampaignError as error:
        message = str(error)
    assert "key" in message


@pytest.mark.parametrize(
    ("name", "base", "unit"),
    [
        ("time_ms", "time", "ms"),
        ("Time (ms)", "Time", "ms"),
        ("U [mV]", "U", "mV"),
        ("T_degC", "T", "degC"),
        ("RH_%", "RH", "%"),
        ("t/ms", "t", "ms"),
        ("Channel A", "Channel A", ""),
        ("Channel (A)", "Channel (A)", ""),
        ("sensor_A", "sensor_A", ""),
        ("raw (filtered)", "raw (filtered)", ""),
    ],
)
def test_column_names(name: str, base: str, unit: str) -> None:
    column = split_name(name)
    assert (column.base, column.unit) == (base, unit)


# --------------------------------------------------------------------------- anything at all

FUZZ = settings(
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
CELLS = st.sampled_from(
    [
        "0",
        "0.1",
        "0.2",
        "1e300",
        "-1e400",
        "nan",
        "inf",
        "∞",
        "",
        "abc",
        '"',
        "1,5",
        "1.2.3",
        "\ufeff",
    ]
    + ["99999999999999999999", "0x10", "True", "1 000", "(V)", "time", "\x00", "é", "#", "1e-400"]
)
TABLE_TEXT = st.lists(
    st.tuples(st.lists(CELLS, max_size=4), st.sampled_from([",", ";", "\t", " "])), max_size=12
).map(lambda lines: "\n".join(separator.join(cells) for cells, separator in lines))


def survives(folder: Path, data: bytes, file: str) -> None:
    """The file is read or refused with CampaignError; nothing else."""
    message = file
    try:
        campaign(folder, data, file=file, commanded_on=None, commanded_off=None)
    except CampaignError as error:
        message = str(error)
    assert file in message and "\n" not in message


@pytest.mark.slow
@given(
    # a sample 1e12 times as large as most is refused as out of all proportion
    st.lists(
        st.floats(-1e9, 1e9).filter(lambda v: v == 0 or abs(v) > 0.01), min_size=20, max_size=60
    ),
    st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"]),
    st.sampled_from(["t,y", "time_s,sensor V", "Time (s),U [V]", "Time,Channel A\n(s),(V)\n"]),
)
@FUZZ
def test_any_numbers_in_any_dialect_come_back(
    tmp_path: Path, values: list[float], marks: tuple[str, str], end: str, code: str, header: str
) -> None:
    separator, decimal = marks
    lines = [header.replace(",", separator)]
    for i, value in enumerate(values):
        lines.append(f"{i * INTERVAL:.3f}{separator}{value!r}".replace(".", decimal))
    data = "\n".join(lines).replace("\n", end).encode(code)
    (e,) = campaign(tmp_path, data, commanded_on=None, commanded_off=None)
    np.testing.assert_allclose(e.values, values, rtol=1e-14)
    assert e.interval == INTERVAL


@given(st.one_of(TABLE_TEXT.map(str.encode), st.binary(max_size=300)))
@FUZZ
def test_any_bytes_as_a_table(tmp_path: Path, data: bytes) -> None:
    survives(tmp_path, data, "a.csv")


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.integers(0, len(rows()) - 1), st.binary(max_size=3)), min_size=1, max_size=4
    )
)
@FUZZ
def test_a_damaged_table(tmp_path: Path, edits: list[tuple[int, bytes]]) -> None:
    data = bytearray(rows().encode())
    for at, new in edits:
        data[at : at + len(new)] = new
    survives(tmp_path, bytes(data), "a.csv")


GOOD = {
    "compressed MAT": ("a.mat", GOOD_MAT),
    "MAT": ("a.mat", mat(A=Y[:60], B=DRIVE[:60], t=T[:60])),
    "NPZ": ("a.npz", npz(t=T, y=Y)),
}


@pytest.mark.parametrize("kind", GOOD)
@given(data=st.data())
@FUZZ
def test_a_damaged_binary_file(tmp_path: Path, kind: str, data: st.DataObject) -> None:
    file, good = GOOD[kind]
    raw = bytearray(good)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, min(len(raw), 600) - 1))
        raw[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.one_of(st.just(len(raw)), st.integers(1, len(raw))))
    survives(tmp_path, bytes(raw[:cut]), file)


TOML_VALUES = st.one_of(
    st.text(max_size=20).map(lambda s: '"' + s.replace("\\", "").replace('"', "") + '"'),
    st.sampled_from(
        ["1", "1.5", "true", "[]", "{}", "[[]]", '["1 s", "2 s"]', "1979-05-27", "nan", "-inf"]
        + ['"4 L/min"', '"2 s"', '"a.csv"', '"V"', "{ a = 1 }", "0x10", '"""\n"""', "[[['a']]]"]
    ),
)
KEYS = st.sampled_from(
    "name file carrier_flow test_gas_flow commanded_on commanded_off signal drive signal_unit "
    "keep mask interval duration title x".split()
)


@given(st.lists(st.dictionaries(KEYS, TOML_VALUES, max_size=6), max_size=3), TOML_VALUES)
@FUZZ
def test_any_campaign_file(tmp_path: Path, tables: list[Mapping[str, str]], title: str) -> None:
    text = f"title = {title}\n" + "".join(entry(**table) for table in tables)
    (tmp_path / "a.csv").write_text(rows())
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8", errors="surrogatepass")
    message = "experiment"
    try:
        read_campaign(tmp_path / "campaign.toml")
    except CampaignError as error:
        message = str(error)
    assert "campaign.toml" in message or "experiment" in message


# --------------------------------------------------------------------------- real campaigns


@pytest.mark.parametrize(
    ("name", "n", "samples", "falls"),
    [("pid_flow_matrix", 32, 12_500, False), ("pid_dilution_steps", 9, 23_000, True)],
)
def test_real_campaigns(name: str, n: int, samples: int, falls: bool) -> None:
    path = REAL / name / "campaign.toml"
    if not path.is_file():
        pytest.skip(f"the real campaign {name} is not beside this checkout")
    found = read_campaign(path)
    assert len(found) == n and found.warnings == () and found.signal_unit == "V"
    for e in found:
        assert len(e.t) == samples and e.interval == 0.001 and e.used.all()
        assert e.has_fall is falls


def test_the_factors_kept_at_hand_are_those_of_pint(monkeypatch: pytest.MonkeyPatch) -> None:
    from bayes_sensor.io.readers import quantities

    known = dict(quantities.COMMON_FACTORS)
    assert ("L/min", "mL/s") in known
    monkeypatch.setattr(quantities, "COMMON_FACTORS", {})
    for (unit, target), factor in known.items():
        quantities.conversion_factor.cache_clear()
        assert quantities.conversion_factor(unit, target) == pytest.approx(factor, rel=4e-16)
    quantities.conversion_factor.cache_clear()
