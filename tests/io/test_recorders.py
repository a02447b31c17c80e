"""Every layout of ``recorder_layouts`` loads unchanged, with its times and values exact."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.density import log_likelihood, mean_and_variance, simulate
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.problem import as_problem
from tests.support.recorder_layouts import (
    LAYOUTS,
    NOON,
    ON,
    OTHER,
    POLLED,
    Layout,
    N,
    T,
    Y,
    lines,
    samples,
    stamps,
)


def read(folder: Path, content: str | bytes, file: str = "a.csv", **keys: str) -> Campaign:
    """The campaign of one file; ``keys`` are TOML."""
    raw = content.encode() if isinstance(content, str) else content
    (folder / file).write_bytes(raw)
    table = {
        "name": '"1"', "file": f'"{file}"', "carrier_flow": '"4 L/min"',
        "test_gas_flow": '"0.5 L/min"', "commanded_on": '"2 s"',
    } | keys  # fmt: skip
    toml = "\n".join(["[[experiment]]", *(f"{key} = {value}" for key, value in table.items())])
    (folder / "campaign.toml").write_text(toml, encoding="utf-8")
    return read_campaign(folder / "campaign.toml")


@pytest.mark.parametrize("name", LAYOUTS)
def test_layout(name: str, tmp_path: Path) -> None:
    layout: Layout = LAYOUTS[name]
    found = read(tmp_path, layout.text, layout.file, **layout.keys)
    (e,) = found
    np.testing.assert_allclose(e.t, layout.t, rtol=0, atol=2e-9)
    np.testing.assert_allclose(e.values, layout.y, rtol=1e-12, atol=1e-12)
    assert e.used.all() and found.signal_unit == layout.unit
    assert e.commanded_on == pytest.approx(0.0 if layout.t[0] == -2.0 else ON, abs=1e-9)
    if layout.remark:
        assert len(found.warnings) == 1 and layout.remark in found.warnings[0]
    else:
        assert found.warnings == ()


# --------------------------------------------------------------------------- time and interval


def test_the_columns_of_time_are_no_signal(tmp_path: Path) -> None:
    table = lines("time_s,time_ms,gas_V", *samples(T, np.rint(T * 1000), Y))
    (e,) = read(tmp_path, table)
    np.testing.assert_array_equal(e.values, Y)


def test_a_column_that_repeats_its_times_gives_way(tmp_path: Path) -> None:
    table = lines("time,clock_s,gas_V", *samples(stamps("%H:%M:%S"), T, Y))
    for keys in ({"time": '"clock_s"'}, {}):
        found = read(tmp_path, table, **keys)
        np.testing.assert_allclose(found["1"].t, T, atol=1e-9)
    assert "time is column 'clock_s', as 'time' does not increase" in found.warnings[0]


def test_an_interval_gives_the_times_of_a_file_without(tmp_path: Path) -> None:
    table = lines(*samples(Y, OTHER))
    with pytest.raises(CampaignError, match="there is no time column: .*write interval") as error:
        read(tmp_path, table)
    assert "drop" not in str(error.value) and "repeated" not in str(error.value)
    found = read(tmp_path, table, interval='"20 ms"')
    np.testing.assert_allclose(found["1"].t, T, atol=1e-12)
    np.testing.assert_array_equal(found["1"].values, Y)
    assert found.warnings == ()
    other = read(tmp_path, table, interval='"20 ms"', signal='"column 2"')
    np.testing.assert_array_equal(other["1"].values, OTHER)


def test_an_interval_mends_whole_seconds(tmp_path: Path) -> None:
    table = lines("stamp,gas_V", *samples(stamps("%H:%M:%S"), Y))
    with pytest.raises(CampaignError, match="or give the sampling interval as interval"):
        read(tmp_path, table)
    found = read(tmp_path, table, interval='"20 ms"')
    np.testing.assert_allclose(found["1"].t, T, atol=1e-12)
    assert "interval was used, not the times in column 'stamp'" in found.warnings[0]


def test_a_counter_is_neither_time_nor_signal(tmp_path: Path) -> None:
    table = lines("record,gas_V", *samples(range(N), Y))
    with pytest.raises(CampaignError, match="column 'record' only counts the samples"):
        read(tmp_path, table)
    np.testing.assert_array_equal(read(tmp_path, table, interval='"20 ms"')["1"].values, Y)


@pytest.mark.parametrize(
    ("on", "expected"),
    [("12:00:02", 2.0), ("2024-05-01 12:00:02.5", 2.5), ("2024-05-01T12:00:03", 3.0)],
)
def test_commands_on_the_recorders_clock(on: str, expected: float, tmp_path: Path) -> None:
    table = lines("when,gas_V", *samples(stamps("%Y-%m-%d %H:%M:%S.%f3"), Y))
    found = read(
        tmp_path, table, commanded_on=f'"{on}"', commanded_off='"12:00:07"',
        keep='["12:00:01", "7.5 s"]', mask='[["12:00:05", "12:00:06"]]',
    )  # fmt: skip
    e = found["1"]
    assert (e.commanded_on, e.commanded_off) == (expected, 7.0)
    assert (e.t[0], e.t[-1]) == (1.0, 7.5)
    assert (e.t[~e.used][0], e.t[~e.used][-1]) == (5.0, 6.0)


@pytest.mark.parametrize(
    ("header", "on", "message"),
    [
        ("time_s", "12:00:02", "are no times of day"),
        ("when", "11:00:00", "commanded_on = -3600 s lies outside the record"),
    ],
)
def test_commands_that_the_record_cannot_place(
    header: str, on: str, message: str, tmp_path: Path
) -> None:
    times = stamps("%H:%M:%S.%f3") if header == "when" else T
    with pytest.raises(CampaignError, match=message):
        read(tmp_path, lines(f"{header},gas_V", *samples(times, Y)), commanded_on=f'"{on}"')


@pytest.mark.parametrize("on", ["2025-05-01 12:00:02", "9e11 s"])
def test_a_command_of_another_year_is_told_the_dates_of_the_record(on: str, tmp_path: Path) -> None:
    table = lines("when,gas_V", *samples(stamps("%Y-%m-%d %H:%M:%S.%f3"), Y))
    with pytest.raises(CampaignError, match=r"outside the record, which runs from 0 s \(") as told:
        read(tmp_path, table, commanded_on=f'"{on}"')
    text = str(told.value)
    assert "from 0 s (2024-05-01 12:00:00) to 7.98 s (2024-05-01 12:00:07.980000);" in text
    assert ("commanded_on = 31536002 s (2025-05-01 12:00:02) lies" in text) == (on[-1] != "s")


def test_rows_in_messages_are_those_of_the_file(tmp_path: Path) -> None:
    rows = [f"{s} -> {y}" for s, y in zip(stamps("%H:%M:%S.%f3"), Y, strict=True)]
    rows[9] = rows[8]
    with pytest.raises(CampaignError, match=r"row 10 \(0.16 s\) follows row 9 \(0.16 s\)"):
        read(tmp_path, lines(*rows), "a.txt")


def test_the_end_of_summer_time_is_named(tmp_path: Path) -> None:
    early = stamps("%Y-%m-%d %H:%M:%S.%f3")
    late = stamps("%Y-%m-%d %H:%M:%S.%f3", start=NOON.replace(hour=11))
    table = lines("when,gas_V", *samples(early[:200] + late[200:], Y))
    with pytest.raises(CampaignError, match="goes back by an hour, as at the end of summer time"):
        read(tmp_path, table)


def test_slow_dated_logs_are_not_taken_for_milliseconds(tmp_path: Path) -> None:
    table = lines("when,gas_V", *samples(stamps("%Y-%m-%d %H:%M:%S", 1.0), Y))
    assert read(tmp_path, table, commanded_on='"100 s"').warnings == ()


def test_set_points_are_remarked_on(tmp_path: Path) -> None:
    first = lines("time_s,flow_setpoint,gas_V", *samples(T, OTHER, Y))
    found = read(tmp_path, first)
    np.testing.assert_array_equal(found["1"].values, Y)
    assert "'flow_setpoint' looks like a set point" in found.warnings[0]
    second = lines("time_s,gas_V,other_V,MFC_target", *samples(T, Y, OTHER, OTHER))
    found = read(tmp_path, second)
    np.testing.assert_array_equal(found["1"].values, Y)
    assert "'gas_V' was taken as the signal, the first of 'gas_V', 'other_V'" in found.warnings[0]


def test_a_gap_of_an_irregular_record(tmp_path: Path) -> None:
    t = POLLED + np.where(np.arange(N) > 300, 2.0, 0.0)
    table = lines("time_s,gas_V", *samples(t, Y))
    with pytest.raises(CampaignError, match="there is a gap of 2.0.* s in time") as error:
        read(tmp_path, table)
    mask = str(error.value).split("mask = ")[1]
    found = read(tmp_path, table, mask=mask)
    np.testing.assert_allclose(found["1"].t, t, atol=1e-12)
    assert not found["1"].regular


# --------------------------------------------------------------------------- other formats


def xlsx(*sheets: list[list[Any]]) -> bytes:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for rows in sheets:
        sheet = book.create_sheet()
        for row in rows:
            sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def test_excel(tmp_path: Path) -> None:
    about = [["Instrument", "X"], ["Operator", "Y"]]
    rows = [
        ["time (ms)", "gas (mV)"],
        *([t * 1000, y * 1000] for t, y in zip(T.tolist(), Y.tolist())),
    ]
    found = read(tmp_path, xlsx(about, [*about, [], *rows]), "a.xlsx")
    np.testing.assert_allclose(found["1"].t, T, atol=1e-12)
    np.testing.assert_allclose(found["1"].values, Y, rtol=1e-12)
    whole = [NOON.replace(second=i % 60, minute=i // 60) for i in range(N)]
    dated = [["when", "gas_V"], *map(list, zip(whole, Y.tolist()))]
    found = read(tmp_path, xlsx(dated), "a.xlsx", commanded_on='"12:01:40"')
    np.testing.assert_array_equal(found["1"].t, np.arange(N))
    assert found["1"].commanded_on == 100.0 and found.warnings == ()
    with pytest.raises(CampaignError, match="expected a sheet with columns of numbers"):
        read(tmp_path, xlsx(about), "a.xlsx")
    with pytest.raises(CampaignError, match="expected an Excel workbook"):
        read(tmp_path, b"PK\x03\x04" + bytes(50), "a.xlsx")


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns", "number"])
@pytest.mark.parametrize("suffix", ["parquet", "feather", "arrow"])
def test_arrow_timestamps(unit: str, suffix: str, tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.feather
    import pyarrow.parquet

    step = 10**9 if unit == "s" else 20 * 10**6
    ns = 1714564800 * 10**9 + step * np.arange(N, dtype=np.int64)
    kind = "ns" if unit == "number" else unit
    whole = ns // {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}[kind]
    time = pa.array(whole) if unit == "number" else pa.array(whole, pa.timestamp(unit))
    table = pa.table({"set_flow": OTHER, "gas_V": Y, "Time": time})
    path = tmp_path / f"b.{suffix}"
    if suffix == "parquet":
        pyarrow.parquet.write_table(table, path)
    elif suffix == "feather":
        pyarrow.feather.write_feather(table, path)
    else:
        with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
    on = 100 if unit == "s" else 2
    found = read(tmp_path, path.read_bytes(), f"a.{suffix}", commanded_on=f'"{1714564800 + on} s"')
    np.testing.assert_allclose(found["1"].t, np.arange(N) * step / 1e9, atol=1e-12)
    np.testing.assert_array_equal(found["1"].values, Y)
    assert found["1"].commanded_on == on
    assert any("'set_flow' looks like a set point" in w for w in found.warnings)


def test_arrays_of_dates_and_without_times(tmp_path: Path) -> None:
    stream = io.BytesIO()
    dates = np.datetime64("2024-05-01T12:00:00", "us") + (T * 1e6).round().astype("m8[us]")
    np.savez(stream, t=dates, y=Y)
    found = read(tmp_path, stream.getvalue(), "a.npz", commanded_on='"12:00:02"')
    np.testing.assert_allclose(found["1"].t, T, atol=1e-12)
    assert found["1"].commanded_on == 2.0
    stream = io.BytesIO()
    np.savez(stream, gas=Y)
    found = read(tmp_path, stream.getvalue(), "a.npz", interval='"20 ms"')
    np.testing.assert_allclose(found["1"].t, T, atol=1e-12)


def test_a_matlab_file_with_an_interval_or_a_variable_twice(tmp_path: Path) -> None:
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, {"gas": Y, "clock": T})
    for keys in ({"interval": '"20 ms"'}, {"time": '"clock"'}):
        found = read(tmp_path, stream.getvalue(), "a.mat", signal='"gas"', **keys)
        np.testing.assert_allclose(found["1"].t, T, atol=1e-12)
        np.testing.assert_array_equal(found["1"].values, Y)
    raw = stream.getvalue()
    with pytest.raises(CampaignError, match="expected each variable once, but 'gas' is in the"):
        read(tmp_path, raw + raw[128:], "a.mat", interval='"20 ms"')


# --------------------------------------------------------------------------- irregular times


def irregular() -> Campaign:
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.02, 0.09, N))
    used = np.ones(N, dtype=bool)
    used[100:110] = False
    uneven = Experiment(
        "1", t, np.zeros(N), 70.0, 8.0, float(np.median(np.diff(t))), 3.0, 14.0, used
    )
    even = Experiment("2", 0.05 * np.arange(N), np.zeros(N), 40.0, 8.0, 0.05, 3.0, 14.0)
    return Campaign("x", (uneven, even))


THETA = {
    "tau_s": 0.2, "tau_v_s": 0.5, "V_mL": 60.0, "phi": 0.6, "sigma0_V": 0.02, "sigma1_V": 0.01,
    "experiments": {
        name: {"y0_V": 0.2, "beta_V": 1.5, "t0_s": 3.1, "tf_s": 14.1} for name in ("1", "2")
    },
}  # fmt: skip


@pytest.mark.slow
def test_the_likelihood_of_irregular_times_is_that_of_a_dense_gaussian() -> None:
    campaign = simulate(irregular(), THETA, seed=2)
    problem = as_problem(campaign)
    vector = problem.flat(THETA)
    dense = 0.0
    for k, e in enumerate(campaign):
        mean, s2 = mean_and_variance(problem, vector, k)
        t, s, r = e.t[e.used], np.sqrt(s2[e.used]), (e.values - mean)[e.used]
        steps = np.abs(t[:, None] - t) / campaign.reference_interval
        dense += multivariate_normal(cov=0.6**steps * np.outer(s, s)).logpdf(r)
    assert log_likelihood(campaign, THETA) == pytest.approx(dense, abs=1e-8)
    fast = compress(campaign, THETA)
    assert fast.log_likelihood(THETA) == pytest.approx(dense, abs=1e-6)
    gradient = fast.gradient(vector)
    for i, value in enumerate(vector):
        step = np.zeros(len(vector))
        step[i] = 1e-5 * abs(value)
        up, down = log_likelihood(problem, vector + step), log_likelihood(problem, vector - step)
        assert gradient[i] == pytest.approx((up - down) / (2 * step[i]), rel=1e-4, abs=1e-2)
    assert fast.n_full_passes == 0
    vector[problem.layout.index("phi")] = -0.2  # it has no real power over such times
    assert fast.log_likelihood(vector) == -np.inf


def test_a_likelihood_of_irregular_times_visits_its_samples() -> None:
    uneven = Campaign("x", irregular().experiments[:1])
    theta = THETA | {"experiments": {"1": THETA["experiments"]["1"]}}
    problem = as_problem(simulate(uneven, theta, seed=2))
    assert compress(problem, theta).n_points >= uneven.experiments[0].used.sum()


def test_simulated_noise_of_irregular_times_decays_with_time() -> None:
    white = irregular()
    r = np.concatenate([simulate(white, THETA, seed=i)["1"].values[None] for i in range(1500)])
    z = (r - r.mean(axis=0)) / r.std(axis=0)
    found = (z[:, 1:] * z[:, :-1]).mean(axis=0)
    expected = 0.6 ** (np.diff(white["1"].t) / white.reference_interval)
    # a correlation of 1500 pairs has a standard error of at most 0.026; 5 of them for 399
    np.testing.assert_allclose(found, expected, atol=0.13)


def test_an_irregular_record_is_fitted_at_its_own_times() -> None:
    quiet = {**THETA, "sigma0_V": 0.002, "sigma1_V": 0.001}
    fit = fit_least_squares(simulate(irregular(), quiet, seed=3), seed=1)
    # the standard errors of both lags are about 2 ms at this noise
    found = sorted([fit.parameters["tau_s"], fit.parameters["tau_v_s"]])
    assert found == pytest.approx([0.2, 0.5], abs=0.01)


def test_a_record_is_irregular_or_refused() -> None:
    t = np.array([0.0, 1.0, 2.5, 3.0])
    e = Experiment("1", t, np.zeros(4), 1.0, 1.0, 1.0)
    assert not e.regular and "one every about 1 s" in repr(e)
    assert Experiment("1", np.arange(4.0), np.zeros(4), 1.0, 1.0, 1.0).regular
    with pytest.raises(CampaignError, match="expected times that increase strictly"):
        Experiment("1", t[::-1], np.zeros(4), 1.0, 1.0, 1.0)
