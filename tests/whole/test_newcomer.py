"""What a first user meets: exports as they come from the lab, slips of the pen, wrong folders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.analysis.analyze import analyze
from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.run_steps import TAKE
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.cli.terminal import muted, progress_bar
from bayes_sensor.display import shown
from bayes_sensor.io.check import campaign_remarks
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.report import read_results
from bayes_sensor.report.notices import alerts

INTERVAL = 0.01
T = np.round(INTERVAL * np.arange(2000), 6)
ON, OFF = 5.0, 15.0
U = np.where((T >= ON) & (T < OFF), 5.0, 0.0)
Y = 0.2 + 1.5 * np.where(T > ON, 1 - np.exp(-(T - ON)), 0) - 1.5 * np.where(
    T > OFF, 1 - np.exp(-(T - OFF)), 0
)  # fmt: skip

ENTRY = """
[[experiment]]
name = "1"
file = "{file}"
carrier_flow = "4 L/min"
test_gas_flow = "0.5 L/min"
{more}
"""

LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t,
Operator\tMeier
Date\t2024/03/05
Time\t14:03:22,5312
***End_of_Header***\t
\t
Channels\t2\t
Samples\t2000\t2000
Date\t2024/03/05\t2024/03/05
Time\t14:03:22,53\t14:03:22,53
X_Dimension\tTime\tTime
X0\t0,0000000000000000E+0\t0,0000000000000000E+0
Delta_X\t0,010000\t0,010000
***End_of_Header***\t\t
X_Value\tUntitled\tUntitled 1\tComment
"""


def comma(value: float, digits: int = 6) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def clock(seconds: float, start: float, mark: str = ".", form: str = "{h:02d}:{m:02d}:") -> str:
    s = (start + seconds) % 86400
    whole, thousandths = divmod(round(1000 * s), 1000)
    head = form.format(h=whole // 3600 % 24, m=whole // 60 % 60)
    return f"{head}{whole % 60:02d}{mark}{thousandths:03d}"


def labview() -> str:
    rows = (f"{comma(t)}\t{comma(y)}\t{comma(u)}\n" for t, y, u in zip(T, Y, U, strict=True))
    return LABVIEW + "".join(rows)


def excel() -> str:
    rows = (
        f"{comma(t + 100, 3)};{comma(1000 * y, 3)};{comma(u, 1)}\r\n"
        for t, y, u in zip(T, Y, U, strict=True)
    )
    head = "\ufeffMessung vom 05.03.2024;;\r\nBearbeiter: Müller;;\r\n\r\n"
    return head + "Zeit [s];Signal [mV];Ventil [V]\r\n" + "".join(rows)


def timed(head: str, start: float, **how: str) -> str:
    rows = (
        f"{clock(t, start, **how)};{1000 * y:.3f};{u:.0f}\n"
        for t, y, u in zip(T, Y, U, strict=True)
    )
    return head + "".join(rows)


EXPORTS = {
    "LabVIEW": ("a.lvm", labview(), "Untitled 1", 0.0),
    "Excel in German": ("a.csv", excel(), "Ventil", 100.0),
    "clock": ("a.csv", timed("Time;Signal (mV);Valve\n", 50000.0), "Valve", 0.0),
    "clock past midnight": (
        "a.csv", timed("logger 7\nTime;Signal (mV);Valve\n", 86390.0), "Valve", 0.0,
    ),
    "clock past the hour": (
        "a.csv", timed("Time;Signal (mV);Valve\n", 3590.0, form="{m:02d}:"), "Valve", 0.0,
    ),
    "date and clock": (
        "a.csv",
        timed("Time;Signal (mV);Valve\n", 50000.0, form="2024-03-05T{h:02d}:{m:02d}:"),
        "Valve", 0.0,
    ),
    "date beside clock": (
        "a.csv",
        timed("Date;Time;Signal (mV);Valve\n", 50000.0, form="05.03.2024;{h:02d}:{m:02d}:"),
        "Valve", 0.0,
    ),
}  # fmt: skip


def written(folder: Path, name: str, text: str, more: str = "") -> Path:
    (folder / name).write_text(text, encoding="utf-8", newline="")
    path = folder / "campaign.toml"
    path.write_text(ENTRY.format(file=name, more=more))
    return path


@pytest.mark.parametrize("name", EXPORTS)
def test_exports_as_they_come_are_read(name: str, tmp_path: Path) -> None:
    file, text, drive, start = EXPORTS[name]
    campaign = read_campaign(written(tmp_path, file, text, f'drive = "{drive}"'))
    (e,) = campaign
    assert campaign.warnings == ()
    assert e.interval == pytest.approx(INTERVAL, rel=1e-9)
    # exports round to a microvolt, clocks to a millisecond
    np.testing.assert_allclose(e.t - start, T, atol=1e-6)
    np.testing.assert_allclose(e.y, Y, atol=1.1e-6)
    assert e.commanded_on == pytest.approx(start + ON, abs=INTERVAL)
    assert e.commanded_off == pytest.approx(start + OFF, abs=INTERVAL)


def test_afternoon_and_morning_are_told_apart(tmp_path: Path) -> None:
    stamps = ["11:59:59.8 AM", "11:59:59.9 AM", "12:00:00.0 PM", "12:00:00.1 PM"]
    text = "Time,U (V)\n" + "".join(f"{stamp},0.{i}\n" for i, stamp in enumerate(stamps))
    (e,) = read_campaign(written(tmp_path, "a.csv", text))
    np.testing.assert_allclose(e.t, [0, 0.1, 0.2, 0.3], atol=1e-9)


PLAIN = "time_s,U_V,valve\n" + "".join(
    f"{t:.3f},{y:.5f},{u:.1f}\n" for t, y, u in zip(T, Y, U, strict=True)
)
UNITLESS = "t,U\n" + "".join(f"{t:.3f},{1000 * y:.3f}\n" for t, y in zip(T, Y, strict=True))
THOUSANDS = "t (ms);U (mV)\n800,0;1,5\n900,0;1,6\n1.000,0;1,5\n"
BROKEN_CLOCK = timed("Time;Signal (mV);Valve\n", 50000.0).replace("13:53:24.000", "noon")
MISTAKES = {
    "signal is the drive": (PLAIN, 'signal = "U"\ndrive = "U_V"', "signal and drive are both"),
    "thousands": (THOUSANDS, "", "without marks between the thousands"),
    "clock that stops": (BROKEN_CLOCK, "", "row 402.*time of day as above, but got 'noon'"),
    "time of another axis": (PLAIN, 'commanded_on = "99 s"', "a time on the record's own axis"),
    "test gas in percent": (
        PLAIN, 'commanded_on = "5 s"\n#', "a concentration as concentration, beside total",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_slips_get_the_message_that_helps(name: str, tmp_path: Path) -> None:
    text, more, message = MISTAKES[name]
    path = written(tmp_path, "a.csv", text, more)
    if name == "test gas in percent":
        path.write_text(path.read_text().replace("0.5 L/min", "11 %"))
    with pytest.raises(CampaignError, match=message):
        read_campaign(path)


@pytest.mark.parametrize(
    ("file", "message"),
    [
        ("A.CSV", "did you mean 'a.csv'"),
        ("data\\\\a.csv", "write / between folders"),
        ("nowhere/a.csv", "there is no folder"),
        ("a.xls", "in Excel, save as .xlsx or CSV"),
    ],
)
def test_a_file_that_is_not_there(file: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, "a.csv", PLAIN)
    path.write_text(ENTRY.format(file=file, more=""))
    with pytest.raises(CampaignError, match=message):
        read_campaign(path)


def test_a_data_file_in_place_of_the_campaign(tmp_path: Path) -> None:
    written(tmp_path, "a.csv", PLAIN)
    with pytest.raises(CampaignError, match=r'this is a data file; .*file = "a.csv"'):
        read_campaign(tmp_path / "a.csv")


def test_the_signal_is_not_the_drive_in_archives_either(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", t=T, y=Y, drive=U)
    path = written(tmp_path, "a.csv", PLAIN, 'signal = "y"\ndrive = "y"')
    path.write_text(path.read_text().replace("a.csv", "a.npz"))
    with pytest.raises(CampaignError, match="signal and drive are both 'y'"):
        read_campaign(path)


def test_single_brackets(tmp_path: Path) -> None:
    path = written(tmp_path, "a.csv", PLAIN)
    path.write_text(path.read_text().replace("[[", "[").replace("]]", "]"))
    with pytest.raises(CampaignError, match="double the brackets"):
        read_campaign(path)


def test_a_structure_gets_the_line_that_unpacks_it(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "a.mat", {"data": {"time": T, "U": Y}})
    path = tmp_path / "campaign.toml"
    path.write_text(ENTRY.format(file="a.mat", more=""))
    with pytest.raises(CampaignError, match="'data' is no vector .*'-struct', 's'"):
        read_campaign(path)


def test_forgotten_and_slipped_units_are_questioned(tmp_path: Path) -> None:
    path = written(tmp_path, "a.csv", UNITLESS)
    path.write_text(path.read_text().replace("L/min", "mL/min"))
    unit, flow = read_campaign(path).warnings
    assert "1700 was taken as volts" in unit and 'signal_unit = "mV"' in unit
    assert "0.0045 L/min (4.5 mL/min)" in flow
    path = written(tmp_path, "a.csv", UNITLESS, 'signal_unit = "mV"')
    told = path.read_text()
    for flow in ("4 lpm", "4 LPM", "4000 MLPM"):
        path.write_text(told.replace("4 L/min", flow))
        (e,) = (campaign := read_campaign(path))
        assert campaign.warnings == () and e.carrier_flow == pytest.approx(4000 / 60)
    np.testing.assert_allclose(e.y, Y, atol=1.1e-6)


def test_a_fall_without_its_command_is_noticed(tmp_path: Path) -> None:
    whole = written(tmp_path, "a.csv", PLAIN, 'commanded_on = "5 s"')
    (remark,) = campaign_remarks(read_campaign(whole))
    assert "ends where it began" in remark and "commanded_off" in remark
    for more in ('drive = "valve"', 'commanded_on = "5 s"\nkeep = ["0 s", "14.9 s"]'):
        path = written(tmp_path, "a.csv", PLAIN, more)
        assert campaign_remarks(read_campaign(path)) == ()


def test_what_is_printed_is_short() -> None:
    import bayes_sensor as bs
    from tests.support.campaigns import small_problem

    campaign = small_problem(phi=0.3)[0].campaign
    fit = bs.fit_least_squares(campaign, seed=1, swarms=1, euler=False)
    bounds = bs.compare_bounds(campaign, fit, None, ["crlb_iid", "crlb_ar1"])
    text = repr(campaign)
    assert len(text.splitlines()) == 1 + len(campaign) and max(map(len, text.splitlines())) < 120
    assert f"tau_s {fit.parameters['tau_s']:.4g}" in repr(fit) and fit.status in repr(fit)
    assert repr(bounds) == "Bounds(crlb_iid, crlb_ar1)"
    gap = bs.diagnose_gap(campaign, fit, bootstrap=0, hidden=False, separate=False)
    assert repr(gap).startswith(f"Gap({gap.verdict.kind}") and len(repr(gap)) < 200
    assert f"tau {1e3 * gap.shrink.tau_before_s:.4g} ms without" in repr(gap)


def test_a_recording_that_stands_twice_is_remarked_on(tmp_path: Path) -> None:
    path = written(tmp_path, "a.csv", PLAIN, 'drive = "valve"')
    once = path.read_text()
    entry = once[once.index("[[experiment]]") :]
    (tmp_path / "copy.csv").write_bytes((tmp_path / "a.csv").read_bytes())
    again = entry.replace("a.csv", "copy.csv").replace('name = "1"', 'name = "2"')
    path.write_text(once + again)
    campaign = read_campaign(path)
    first, second = (e.name for e in campaign)
    twice = [text for text in campaign_remarks(campaign) if "count twice" in text]
    assert len(twice) == 1 and twice[0].startswith(f"experiment '{second}' (copy.csv)")
    assert f"'{first}' (a.csv)" in twice[0]


def test_a_command_written_late_is_named_as_what_to_check() -> None:
    import bayes_sensor as bs
    from tests.support.campaigns import small_problem

    campaign = small_problem(phi=0.3)[0].campaign
    late = [replace(e, commanded_off=e.commanded_off + 0.5) for e in campaign]
    fit = bs.fit_least_squares(replace(campaign, experiments=tuple(late)), seed=1, swarms=1,
                               euler=False)  # fmt: skip
    told = [text for text in fit.warnings if text.startswith("tf_s")]
    assert told and all("the fall seems to begin no later" in text for text in told)
    assert all("written too late makes tau too small" in text for text in told)


@pytest.mark.parametrize(("value", "words"), [(363.4, "363"), (13.2, "13"), (4.26, "4.3")])
def test_an_envelope_has_no_exponent(value: float, words: str) -> None:
    assert shown(value, 2) == words


# --------------------------------------------------------------------------- commands


def test_a_simulation_never_replaces_a_measurement(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "exp1.csv", PLAIN, 'drive = "valve"')
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    small = ["--experiments", "1", "--duration", "20 s", "--interval", "50 ms"]
    assert exit_code(["simulate", "--out", str(tmp_path), *small]) == 2
    assert "that no run wrote" in capsys.readouterr().err
    assert {p.name: p.read_bytes() for p in path.parent.iterdir()} == before
    trial = str(tmp_path / "trial")
    for seed in "12":  # its own it replaces
        assert exit_code(["simulate", "--out", trial, "--seed", seed, *small]) == 0
    assert capsys.readouterr().out.startswith("1 experiment with tau = 48.1 ms")


def test_a_campaign_given_as_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(written(tmp_path, "a.csv", PLAIN, 'drive = "valve"'))
    out = str(tmp_path / "out")
    assert exit_code(["fit", path, "--out", out, "--config", path]) == 2
    assert "this is a campaign file; expected settings" in capsys.readouterr().err


def test_results_of_another_campaign_are_pointed_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ["--out", str(tmp_path / "out"), "--seed", "1"]
    path = str(written(tmp_path, "a.csv", PLAIN, 'drive = "valve"'))
    assert exit_code(["fit", path, *out]) in (0, 3)
    assert exit_code(["delays", path, *out]) in (0, 3)
    assert "of other data" not in capsys.readouterr().out
    path = str(written(tmp_path, "a.csv", PLAIN, 'drive = "valve"\nmask = [["1 s", "2 s"]]'))
    assert exit_code(["delays", path, *out]) in (0, 3)
    assert "also holds fit of other data or settings" in capsys.readouterr().out


@pytest.mark.parametrize("out", [[], ["out"]])
def test_a_late_command_is_told_before_the_error_that_it_may_cause(
    out: list[str], tmp_path: Path, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    def fails(job: Job) -> None:
        raise CampaignError("experiment '1': nothing can be told")

    monkeypatch.setitem(TAKE, "fit", fails)
    path = written(tmp_path, "a.csv", PLAIN, f'commanded_on = "{ON + 2} s"')
    with pytest.raises(CampaignError, match="nothing can be told"):
        analyze(path, out=tmp_path / out[0] if out else None)
    assert any("comes after the step that it commands" in r.getMessage() for r in caplog.records)


def test_results_of_another_campaign_are_not_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shorter = PLAIN[: PLAIN.rindex("\n", 0, -1) + 1]
    out = tmp_path / "out"
    for name in "ab":
        (tmp_path / name).mkdir()
    path = str(written(tmp_path / "a", "a.csv", PLAIN, 'drive = "valve"'))
    assert exit_code(["delays", path, "--out", str(out)]) in (0, 3)
    before = {file.name: file.read_bytes() for file in out.iterdir()}
    other = str(written(tmp_path / "b", "a.csv", shorter, 'drive = "valve"'))
    capsys.readouterr()
    assert exit_code(["fit", other, "--resume", "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert f"holds results of another campaign ({path})" in said and said.count("\n") == 1
    assert {file.name: file.read_bytes() for file in out.iterdir()} == before
    Path(path).rename(tmp_path / "a" / "moved.toml")  # the same data
    moved = str(tmp_path / "a" / "moved.toml")
    assert exit_code(["fit", moved, "--resume", "--out", str(out)]) in (0, 3)
    (tmp_path / "a" / "a.csv").write_text(shorter)  # recorded anew
    assert exit_code(["fit", moved, "--resume", "--out", str(out)]) in (0, 3)


def test_a_simulation_is_not_taken_for_results_of_other_data(tmp_path: Path) -> None:
    # what it made is analysed beside it
    small = ["--duration", "20 s", "--interval", "20 ms", "--experiments", "1,4", "--quiet"]
    out = ["--out", str(tmp_path), "--quiet"]
    assert exit_code(["simulate", *small, "--out", str(tmp_path)]) == 0
    assert exit_code(["fit", str(tmp_path / "campaign.toml"), *out]) in (0, 3)
    told = [text for _, text in alerts(read_results(tmp_path))]
    assert not any("rest on other data" in text for text in told)


def test_without_takes_a_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(written(tmp_path, "a.csv", PLAIN, 'drive = "valve"'))
    words = ["gap", path, "--out", str(tmp_path / "out"), "--without", "dead_volume, flow_eror"]
    assert exit_code(words) == 2
    assert "no effect 'flow_eror'" in capsys.readouterr().err


def test_a_log_gets_no_progress(capfd: pytest.CaptureFixture[str]) -> None:
    for quiet in (True, False):
        with progress_bar("posterior", quiet) as tell, muted():
            for i in range(100):
                tell(i / 100, f"step {i}")
        assert capfd.readouterr().err == ""
