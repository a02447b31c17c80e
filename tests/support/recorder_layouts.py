"""The layouts in which recorders export their samples, each made here from the same step.

A layout is a text with the times :data:`T` and the values :data:`Y`; what differs is said in its
:class:`Layout`.  Vendors are named for the form of their text, known from their manuals or from
public files; no one's data is in here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta

import numpy as np

N = 400
INTERVAL = 0.02
T = np.round(np.arange(N) * INTERVAL, 9)
ON = 2.0
Y = np.round(
    0.2
    + 1.5 * (1 - np.exp(-np.clip(T - ON, 0, None) / 0.4))
    + 0.02 * np.random.default_rng(11).standard_normal(N),
    4,
)
OTHER = np.round(12.5 + 0.01 * np.sin(T), 3)
NOON = datetime(2024, 5, 1, 12, 0, 0)


@dataclass(frozen=True)
class Layout:
    """A file's text and what must be read from it."""

    text: str
    file: str = "a.csv"
    keys: dict[str, str] = field(default_factory=dict)
    t: np.ndarray = field(default_factory=lambda: T)
    y: np.ndarray = field(default_factory=lambda: Y)
    unit: str = "V"
    remark: str = ""
    """part of the one remark; empty where there must be none"""


def lines(*rows: Sequence[object] | str, separator: str = ",", end: str = "\n") -> str:
    """The text of rows; a row that is text already stays."""
    text = [row if isinstance(row, str) else separator.join(map(str, row)) for row in rows]
    return end.join(text) + end


def stamps(form: str, step: float = INTERVAL, start: datetime = NOON) -> list[str]:
    """(n,) the moments of the samples; %f3 is milliseconds."""
    found = []
    for i in range(N):
        at = start + timedelta(microseconds=round(i * step * 1e6))
        found.append(at.strftime(form.replace("%f3", f"{at.microsecond // 1000:03d}")))
    return found


def samples(*columns: Sequence[object]) -> list[tuple[object, ...]]:
    """The rows of some columns."""
    return list(zip(*columns, strict=True))


def tek_tds() -> Layout:
    """Oscilloscope: what is known of the record in the first columns of the data rows."""
    told = [
        ("Record Length", "4.000000e+02", ""), ("Sample Interval", "2.000000e-02", ""),
        ("Trigger Point", "1.000000000000e+02", ""), ("", "", ""), ("Source", "CH1", ""),
        ("Vertical Units", "V", ""), ("Vertical Scale", "5.000000e-01", ""),
        ("Horizontal Units", "s", ""), ("Model Number", "TDS 2012B", ""),
    ]  # fmt: skip
    told += [("", "", "")] * (N - len(told))
    rows = [
        (*told[i], f"{T[i]:018.12f}", f"{Y[i]:9.5f}", "") for i in range(N)
    ]  # fmt: skip
    return Layout(lines(*rows))


def tek_dpo() -> Layout:
    """Oscilloscope: a preamble of unequal lines and two blank ones."""
    head = ["Model,DPO4054", "Firmware Version,2.68", "", "Waveform Type,ANALOG", "Point Format,Y",
            "Horizontal Units,s", "Horizontal Scale,0.8", "Sample Interval,0.02",
            "Record Length,400", "Vertical Units,V,V", "Vertical Offset,0.0,0.0", "", "",
            "TIME,CH1,CH2"]  # fmt: skip
    return Layout(lines(*head, *samples([f"{t:.5e}" for t in T], Y, OTHER)))


def rigol_start_increment() -> Layout:
    """Oscilloscope: sample numbers, with start and increment in the second row."""
    head = ["X,CH1,CH2,Start,Increment,", "Sequence,Volt,Volt,0.000000e+00,2.000000e-02"]
    rows = samples(range(N), Y, OTHER, [""] * N, [""] * N, [""] * N)
    return Layout(lines(*head, *rows), remark="by the interval that the file states, 0.02 s")


def rigol_t0_tinc() -> Layout:
    """Oscilloscope: start and increment as texts in the header."""
    head = "CH1(V),CH2(V),t0 = -2.0s, tInc = 2.000000e-02,"
    rows = samples(Y, OTHER, [""] * N, [""] * N)
    return Layout(
        lines(head, *rows),
        keys={"commanded_on": '"0 s"'},
        t=T - 2.0,
        remark="by the interval that the file states",
    )


def keysight() -> Layout:
    """Oscilloscope: ``x-axis`` and channel numbers as names, units in words."""
    return Layout(lines("x-axis,1", "second,Volt", *samples([f"{t:+.8E}" for t in T], Y)))


def lecroy() -> Layout:
    """Oscilloscope: segments above the header."""
    head = ["LECROYHDO4034,12345,Waveform", "Segments,1,SegmentSize,400",
            "Segment,TrigTime,TimeSinceSegment1", "#1,01-May-2024 12:00:00,0",
            "Time,Ampl"]  # fmt: skip
    return Layout(lines(*head, *samples(T, Y)))


def siglent() -> Layout:
    """Oscilloscope: keys with colons in the preamble, ``Second,Value`` as names."""
    head = ["Record Length,Analog:400", "Sample Interval,Analog:2.0E-02", "Vertical Units,CH1:V",
            "Vertical Scale,CH1:0.50", "Horizontal Units,s", "Model Number,SDS1104X-E",
            "Serial Number,SDSMMEBX3R0000", "Source,CH1", "Second,Value"]  # fmt: skip
    return Layout(lines(*head, *samples([f"{t:.10E}" for t in T], Y)))


def rohde_schwarz() -> Layout:
    """Oscilloscope: units as ``in s`` and ``C1 in V``."""
    return Layout(lines("in s,C1 in mV", *samples([f"{t:.6E}" for t in T], Y * 1000)))


def yokogawa() -> Layout:
    """Recorder: no times, but resolution and offset of the axis in the preamble."""
    head = ['"Header Size",8', '"Model Name","DL850"', '"TraceName","CH1"', '"BlockSize",400',
            '"VUnit","V"', '"HResolution",2.0E-02', '"HOffset",0.0', '"HUnit","s"', ""]  # fmt: skip
    rows = samples([""] * N, [f"{v:.4f}" for v in Y])
    return Layout(lines(*head, *rows), remark="by the interval that the file states")


def owon() -> Layout:
    """Oscilloscope: the unit line above, a nameless counter, a voltage in millivolts."""
    head = ["Save Time:2024-05-01 12:00:00", "Sample rate:50Hz", ", CH1_Voltage(mV)"]
    rows = samples(range(1, N + 1), [f" {1000 * v:.1f}" for v in Y])
    return Layout(lines(*head, *rows), remark="by the interval that the file states")


def waveforms() -> Layout:
    """USB oscilloscope: comments above the header."""
    head = ["#Digilent WaveForms Oscilloscope Acquisition", "#Device Name: Discovery2",
            "#Sample rate: 50Hz", "#Samples: 400", "", "Time (s),Channel 1 (V)"]  # fmt: skip
    return Layout(lines(*head, *samples([f"{t:.12g}" for t in T], Y)))


def moku() -> Layout:
    """Oscilloscope: the names in the last comment."""
    head = ["% Moku:Lab Oscilloscope", "% Channel 1 - AC coupling, 50 Ohm",
            "% Acquired 2024-05-01 T 12:00:00", "% Time (s), Input 1 (V), Input 2 (V)"]  # fmt: skip
    rows = samples([f"{t:.10e}" for t in T], [f" {v}" for v in Y], [f" {v}" for v in OTHER])
    return Layout(lines(*head, *rows))


def hantek() -> Layout:
    """Oscilloscope: a counter before the times, raw codes behind the volts."""
    codes = np.rint(Y * 100).astype(int)
    return Layout(lines("nr,time,ch1,ch1s", *samples(range(N), T, Y, codes)))


def hantek_tabs() -> Layout:
    """The same, aligned with blanks."""
    rows = [f"{i:<7d} {T[i]:<13.9g} {Y[i]:>8.4f}" for i in range(N)]
    return Layout(lines("nr      time              ch1", *rows), file="a.txt")


def campbell() -> Layout:
    """Logger (TOA5): four header rows, units in the third, a record counter."""
    head = ['"TOA5","CR1000","CR1000","12345","CR1000.Std.32","CPU:prog.CR1","1234","Table1"',
            '"TIMESTAMP","RECORD","CO2_ppm","batt"', '"TS","RN","ppm","Volts"',
            '"","","Smp","Smp"']  # fmt: skip
    times = [f'"{s}"' for s in stamps("%Y-%m-%d %H:%M:%S.%f3")]
    return Layout(lines(*head, *samples(times, range(N), Y, OTHER)), unit="ppm")


def campbell_one_column() -> Layout:
    """The same with one channel, which the program calls by its unit."""
    head = ['"TOA5","CR6","CR6","1","CR6.Std.10","CPU:p.CR6","1","Fast"', '"TIMESTAMP","Gas"',
            '"TS","mV"', '"","Smp"']  # fmt: skip
    times = [f'"{s}"' for s in stamps("%Y-%m-%d %H:%M:%S.%f3")]
    return Layout(lines(*head, *samples(times, Y * 1000)), file="a.dat")


def graphtec() -> Layout:
    """Logger: whole seconds and milliseconds in columns of their own, blanks after signs."""
    head = ["Vendor, GRAPHTEC Corporation", "Model, GL840", "Sampling interval, 20ms",
            "Total data points, 400", "AMP settings", "CH, Signal name, Input, Range, Span,,",
            "CH1, gas, DC, 5V, 0, 5, V", "Number,Date&Time,ms,CH1,CH2,Alarm1-10,AlarmOut",
            "NO.,Time,ms,V,degC,A1234567890,A1234"]  # fmt: skip
    ms = [f"{round(1000 * t) % 1000}" for t in T]
    rows = samples(range(1, N + 1), stamps("%Y/%m/%d %H:%M:%S"), ms, [f"+ {v:7.4f}" for v in Y],
                   [f"+ {v:6.3f}" for v in OTHER], ["LLLLLLLLLL"] * N, ["LLLL"] * N)  # fmt: skip
    return Layout(lines(*head, *rows))


def milliseconds_beside() -> Layout:
    """Logging module: the comma of the milliseconds is the separator, too; no header."""
    stamp = stamps("%Y-%m-%d %H:%M:%S")
    ms = [f"{round(1000 * t) % 1000:03d}" for t in T]
    epoch = [f"{1714564800 + t:.6f}" for t in T]
    return Layout(lines(*samples(stamp, ms, epoch, Y, OTHER)))


def milliseconds_without_a_name() -> Layout:
    """The same under a header that does not count the milliseconds, and with a last comment."""
    times = stamps("%Y-%m-%d %H:%M:%S.%f3")
    rows = [f"{s[:-4]},{s[-3:]},{y}" for s, y in zip(times, Y, strict=True)]
    return Layout(lines("time,gas_V", *rows, "# stopped"))


def spreadsheet_days() -> Layout:
    """Days since 1900, to a tenth of a millisecond."""
    return Layout(
        lines("Date,gas_V", *samples([f"{45413.5 + t / 86400:.10f}" for t in T], Y)),
        remark="column 'Date' was read in days",
    )


def hobo() -> Layout:
    """Logger: a plot title, a counter called ``#``, commas within quoted names."""
    head = ['"Plot Title: gas"',
            '"#","Date Time, GMT+01:00","Voltage, V (LGR S/N: 1, SEN S/N: 2)","Host Connected"',
            ]  # fmt: skip
    rows = samples(range(1, N + 1), stamps("%m/%d/%y %I:%M:%S.%f3 %p"), Y, [""] * N)
    return Layout(lines(*head, *rows))


def benchlink() -> Layout:
    """Logger: scans, a colon before the milliseconds, channel numbers with alarms beside."""
    head = ["Scan,Time,101 <gas> (VDC),Alarm 101"]
    rows = samples(range(1, N + 1), stamps("%m/%d/%Y %H:%M:%S:%f3"), Y, [0] * N)
    return Layout(lines(*head, *rows))


def mcc() -> Layout:
    """Logger: a 12-hour clock beside an empty column."""
    head = ["Device Serial Number,01ABCDEF", "Data File Name,test",
            "First Sample Date/Time,5/1/2024 12:00:00 PM", "Sample Rate,50", "",
            "Sample,Date/Time,CHAN0,Events"]  # fmt: skip
    times = [s.replace("05/01", "5/1") for s in stamps("%m/%d/%Y %I:%M:%S.%f3 %p")]
    rows = samples(range(N), times, Y, [""] * N)
    return Layout(lines(*head, *rows))


def licor_7500() -> Layout:
    """Gas analyser: ``Name:<tab>value`` above, units in brackets, a colon before the ms."""
    head = ["Model:\t LI-7500", "SN:\t75D-0000", "Timestamp:\tMay 1 2024 at 12:00:00",
            "DATAH\tTime\tDate\tSequence Number\tCO2 (umol/mol)\tDew Point (C)"]  # fmt: skip
    rows = samples(["DATA"] * N, stamps("%H:%M:%S:%f3"), ["2024-05-01"] * N,
                   range(123540, 123540 + 6 * N, 6), Y, OTHER)  # fmt: skip
    return Layout(lines(*head, *rows, separator="\t"), file="a.txt", unit="umol/mol")


def licor_840() -> Layout:
    """Gas analyser: date and time in columns of their own, blanks in the header."""
    head = ["(2024-05-01, 12:00:00)", "Date(Y-M-D)\tTime(H:M:S)\tCO2(ppm)\tH2O(ppt)"]
    rows = samples(["2024-05-01"] * N, stamps("%H:%M:%S.%f3"), Y, OTHER)
    return Layout(lines(*head, *rows, separator="\t"), file="a.txt", unit="ppm")


def picarro() -> Layout:
    """Gas analyser: columns by blanks, epoch seconds between others."""
    day = 122.5 + T / 86400
    head = "DATE        TIME            FRAC_DAYS_SINCE_JAN1  EPOCH_TIME          CO2_dry"
    rows = [
        f"2024-05-01  {s}    {day[i]:.8f}          {1714564800 + T[i]:.3f}      {Y[i]:.4f}"
        for i, s in enumerate(stamps("%H:%M:%S.%f3"))
    ]
    return Layout(lines(head, *rows), file="a.dat", keys={"signal": '"CO2_dry"'})


def los_gatos() -> Layout:
    """Gas analyser: a banner, names and times padded with blanks, the spread beside the value."""
    head = [
        "VC:2f90 BD:Jan 16 2014 SN:",
        "                     Time,      [CO2]_ppm,   [CO2]_ppm_sd",
    ]
    rows = [
        f"  {s},  {Y[i]:.6e},  {0.001:.6e}"
        for i, s in enumerate(stamps("%d/%m/%Y %H:%M:%S.%f3", start=datetime(2024, 5, 13, 12)))
    ]
    return Layout(lines(*head, *rows), file="a.txt", unit="ppm")


def sensirion() -> Layout:
    """Sensor viewer: ``sep=,``, comments, epoch and local time side by side."""
    head = [
        "sep=,",
        "# EditorName=viewer",
        "# SerialNumber=1",
        "Epoch_UTC,Local_Date_Time,SCD30_CO2",
    ]
    rows = samples([f"{1714564800 + t:.2f}" for t in T], stamps("%Y-%m-%dT%H:%M:%S.%f3"), Y)
    return Layout(lines(*head, *rows))


def picolog() -> Layout:
    """Logger: a nameless first column of ISO times with their offset."""
    rows = samples(stamps("%Y-%m-%dT%H:%M:%S.%f3+02:00"), Y * 1000)
    return Layout(lines(',"CH1 Last (mV)"', *rows))


def lvm(columns: str = "One", absolute: bool = False) -> str:
    """The header of a LabVIEW measurement file."""
    return lines(
        "LabVIEW Measurement\t", "Writer_Version\t2", "Reader_Version\t2", "Separator\tTab",
        "Decimal_Separator\t.", "Multi_Headings\tNo", f"X_Columns\t{columns}",
        "Time_Pref\tAbsolute", "Operator\tx", "Date\t2024/05/01", "Time\t12:00:00.0000",
        "***End_of_Header***\t", "\t", "Channels\t1\t", f"Samples\t{N}\t", "Date\t2024/05/01\t",
        "Time\t12:00:00.0000\t", "X_Dimension\tTime\t", "X0\t0.0000000000000000E+0\t",
        "Delta_X\t0.020000\t", "***End_of_Header***\t\t",
    )  # fmt: skip


def lvm_one() -> Layout:
    """LabVIEW: one column of times, and a comment in the first row."""
    rows = ["\t".join([f"{T[i]:.6f}", f"{Y[i]:.6f}"] + ([""] if i else ["no comment"]))
            for i in range(N)]  # fmt: skip
    return Layout(lvm() + lines("X_Value\tVoltage\tComment", *rows), file="a.lvm")


def lvm_no() -> Layout:
    """LabVIEW: no column of times, which is empty; Delta_X in the header."""
    rows = [f"\t{Y[i]:.6f}" for i in range(N)]
    return Layout(
        lvm("No") + lines("X_Value\tVoltage\tComment", *rows),
        file="a.lvm",
        remark="by the interval that the file states, 0.02 s",
    )


def lvm_multi() -> Layout:
    """LabVIEW: a column of times for each channel."""
    rows = samples([f"{t:.6f}" for t in T], Y, [f"{t:.6f}" for t in T], OTHER)
    head = "X_Value\tVoltage\tX_Value\tVoltage 1\tComment"
    return Layout(lvm("Multi") + lines(head, *rows, separator="\t"), file="a.lvm")


def serial_monitor() -> Layout:
    """Serial monitor: a time of day and an arrow, and a line of the board's start."""
    rows = [f"{s} -> {Y[i]:.4f}" for i, s in enumerate(stamps("%H:%M:%S.%f3"))]
    return Layout(lines("11:59:59.900 -> ready", *rows), file="a.txt")


def serial_monitor_values() -> Layout:
    """The same with several values in a line, which are named by labels."""
    rows = [f"{s} -> CO2: {Y[i]:.4f} ppm, T: {OTHER[i]:.3f} degC"
            for i, s in enumerate(stamps("%H:%M:%S.%f3"))]  # fmt: skip
    return Layout(lines(*rows), file="a.txt", unit="ppm")


def serial_monitor_names() -> Layout:
    """The same where the board sends the names first."""
    head = "12:00:00.000 -> gas_mV,temperature"
    rows = [f"{s} -> {1000 * Y[i]:.1f},{OTHER[i]:.3f}"
            for i, s in enumerate(stamps("%H:%M:%S.%f3"))]  # fmt: skip
    return Layout(lines(head, *rows), file="a.txt")


def terminal() -> Layout:
    """Terminal program: the time in square brackets."""
    rows = [f"[{s}] {Y[i]:.4f}" for i, s in enumerate(stamps("%Y-%m-%d %H:%M:%S.%f3"))]
    return Layout(lines(*rows), file="a.log.txt")


def gamry() -> Layout:
    """Potentiostat: a separator in front of each row, units under the names."""
    head = ["EXPLAIN", "TAG\tCHRONOA", "TITLE\tLABEL\ttest\tTest &Identifier", "CURVE\tTABLE\t400",
            "\tPt\tT\tIm\tOver", "\t#\ts\tA\tbits"]  # fmt: skip
    rows = samples([""] * N, range(N), T, Y, ["..........."] * N)
    return Layout(lines(*head, *rows, separator="\t"), file="a.txt", unit="A",
                  keys={"signal": '"Im"'})  # fmt: skip


def biologic() -> Layout:
    """Potentiostat: decimal commas with tabs, names with their unit behind a slash."""
    head = ["EC-Lab ASCII FILE", "Nb header lines : 4", "", "time/s\tEwe/V\tI/mA"]
    rows = [f"{T[i]:.9E}\t{Y[i]:.4f}\t{OTHER[i]:.3f}".replace(".", ",") for i in range(N)]
    return Layout(lines(*head, *rows), file="a.txt")


def r_table() -> Layout:
    """Statistics program: no name for the column of row numbers."""
    rows = [f'"{i + 1}" {T[i]:.9g} {Y[i]}' for i in range(N)]
    return Layout(lines('"time" "signal"', *rows), file="a.txt")


def pandas_index() -> Layout:
    """Data frame: a nameless index before the columns."""
    return Layout(lines(",time_s,gas_V", *samples(range(N), T, Y)))


def header_twice() -> Layout:
    """A header that the logger wrote at each start, and the first row twice."""
    rows = samples(T, Y)
    return Layout(
        lines("time_s,gas_V", "time_s,gas_V", rows[0], *rows),
        remark="row 4 repeats the first",
    )


def long_preamble() -> Layout:
    """A preamble longer than most records."""
    head = [f"Setting {i}: {i * 3} of channel" for i in range(3000)]
    return Layout(lines(*head, "Time [ms];Signal [mV]", *samples(np.rint(T * 1000), Y * 1000),
                        separator=";"))  # fmt: skip


def epoch(unit: str) -> Layout:
    """Numbers since 1970 in a column without a unit, and a command on the same clock."""
    factor = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    start = 1714564800
    times = [str(start * factor + round(t * factor)) if unit != "s" else f"{start + t:.2f}"
             for t in T]  # fmt: skip
    return Layout(
        lines("unixtime,gas_V", *samples(times, Y)),
        keys={"commanded_on": f'"{start + 2} s"'},
        remark="" if unit == "s" else f"was read in {unit} since 1970, by its size",
    )


def dated(form: str, on: str = '"12:00:02"', start: datetime = NOON) -> Layout:
    """Dates in some form, and a command as a time of day."""
    return Layout(lines("when;gas_V", *samples(stamps(form, start=start), Y), separator=";"),
                  keys={"commanded_on": on})  # fmt: skip


def merged() -> Layout:
    """Two channels in one file, a row a message."""
    rows = []
    for i in range(N):
        rows += [(f"{T[i]:.3f}", Y[i], ""), (f"{T[i] + 0.007:.3f}", "", OTHER[i])]
    return Layout(lines("time_s,a_V,b_V", *rows), remark="400 of 800 rows hold no 'a_V'")


POLLED = np.round(np.cumsum(np.random.default_rng(3).uniform(0.012, 0.03, N)), 6)


def polled() -> Layout:
    """A logger that reads, sleeps, and reads again."""
    return Layout(lines("time_s,gas_V", *samples(POLLED, Y)), t=POLLED,
                  remark="the sampling is irregular, one sample every")  # fmt: skip


def summer_time(local: bool) -> Layout:
    """The offset from UTC changes during the record; with the clock, or as a label alone."""
    rows = []
    start = datetime(2026, 3, 29, 1, 59, 58)
    for i, t in enumerate(T):
        late = t >= 2.0
        at = start + timedelta(microseconds=round(t * 1e6), hours=int(late and local))
        stamp = at.strftime("%Y-%m-%dT%H:%M:%S.%f") + ("+02:00" if late else "+01:00")
        rows.append((stamp, Y[i]))
    return Layout(
        lines("time,gas_V", *rows),
        keys={"commanded_on": '"2 s"'},
        remark="" if local else "the offset from UTC changes at row 102, but the time of day goes",
    )


def quoted_rows(separator: str, decimal: str) -> Layout:
    """A spreadsheet's export in which each row is quoted as a whole."""
    rows = [separator.join(("time_s", "flow", "gas (V)"))]
    rows += [separator.join(map(str, row)).replace(".", decimal) for row in samples(T, OTHER, Y)]
    return Layout(lines(*(f'"{row}"' for row in rows)), keys={"signal": '"gas (V)"'})


LAYOUTS = {
    "Tektronix TDS": tek_tds(),
    "Tektronix DPO": tek_dpo(),
    "Rigol, start and increment": rigol_start_increment(),
    "Rigol, t0 and tInc": rigol_t0_tinc(),
    "Keysight": keysight(),
    "LeCroy": lecroy(),
    "Siglent": siglent(),
    "Rohde & Schwarz": rohde_schwarz(),
    "Yokogawa": yokogawa(),
    "Owon": owon(),
    "WaveForms": waveforms(),
    "Moku": moku(),
    "Hantek": hantek(),
    "Hantek, aligned": hantek_tabs(),
    "Campbell TOA5": campbell(),
    "Campbell TOA5, one channel": campbell_one_column(),
    "Graphtec": graphtec(),
    "milliseconds beside, no header": milliseconds_beside(),
    "milliseconds without a name": milliseconds_without_a_name(),
    "spreadsheet's days": spreadsheet_days(),
    "HOBO": hobo(),
    "BenchLink": benchlink(),
    "MCC": mcc(),
    "LI-COR 7500": licor_7500(),
    "LI-COR 840": licor_840(),
    "Picarro": picarro(),
    "Los Gatos": los_gatos(),
    "Sensirion": sensirion(),
    "PicoLog": picolog(),
    "LVM, one X": lvm_one(),
    "rows quoted, tabs": quoted_rows("\t", "."),
    "rows quoted, semicolons": quoted_rows(";", ","),
    "LVM, no X": lvm_no(),
    "LVM, an X each": lvm_multi(),
    "serial monitor": serial_monitor(),
    "serial monitor, labels": serial_monitor_values(),
    "serial monitor, names": serial_monitor_names(),
    "terminal": terminal(),
    "Gamry": gamry(),
    "BioLogic": biologic(),
    "R": r_table(),
    "pandas": pandas_index(),
    "header and first row twice": header_twice(),
    "preamble of 3000 lines": long_preamble(),
    "epoch s": epoch("s"),
    "epoch ms": epoch("ms"),
    "epoch us": epoch("us"),
    "epoch ns": epoch("ns"),
    "ten decimals": dated("%Y-%m-%d %H:%M:%S.%f0000"),
    "date, T and Z": dated("%Y-%m-%dT%H:%M:%S.%fZ", '"2024-05-01 12:00:02"'),
    "month name": dated("%d-%b-%Y %H:%M:%S.%f3", '"2024-05-01 12:00:02"'),
    "points and comma": dated("%d.%m.%Y %H:%M:%S,%f3"),
    "over midnight": dated("%H:%M:%S.%f3", '"00:00:01"', datetime(2024, 5, 1, 23, 59, 59)),
    "over midnight, month first": dated(
        "%m/%d/%Y %I:%M:%S.%f3 %p", '"00:00:01"', datetime(2024, 5, 1, 23, 59, 59)
    ),
    "compact, underscore": dated("%Y%m%d_%H%M%S.%f3"),
    "compact, one number": dated("%Y%m%d%H%M%S%f3"),
    "merged log": merged(),
    "polled": polled(),
    "summer time": summer_time(True),
    "offset relabelled": summer_time(False),
}
"""name to layout"""
