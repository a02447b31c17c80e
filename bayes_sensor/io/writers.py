"""Campaigns out to files, as a recorder would have exported them.

The same samples give the same bytes: no date, host or platform is written.  Compressed MATLAB
and NPZ files depend on the zlib library as well; uncompressed ones do not.  A file appears under
its name only when it is complete.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bayes_sensor.campaign import STAGES, Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.experiment import runs_of
from bayes_sensor.io.disk import write_bytes
from bayes_sensor.rig.ties import tie_texts

FORMATS = ("csv", "picoscope-csv", "mat", "npz")
"""what :func:`write_campaign` can write"""

_MAT_TEXT = 116
"""bytes of free text that open a version 5 MATLAB file"""


def drive_signal(experiment: Experiment, high: float = 5.0) -> FloatArray:
    """(n_t,) V, the valve's drive: ``high`` from commanded_on until commanded_off, else 0."""
    drive = np.zeros(len(experiment.t))
    if experiment.commanded_on is not None:
        slack = 1e-6 * experiment.interval
        open_ = experiment.t >= experiment.commanded_on - slack
        if experiment.commanded_off is not None:
            open_ &= experiment.t < experiment.commanded_off - slack
        drive[open_] = high
    return drive


def write_picoscope_mat(
    path: str | os.PathLike[str],
    channels: Mapping[str, FloatArray],
    interval: float,
    start: float = 0.0,
    compress: bool = True,
    lsb: float | None = None,
) -> None:
    """Write a PicoScope-style MATLAB file (version 5).

    Parameters
    ----------
    path
        The file to write.
    channels
        ``A``, ``B``, ... to samples (n,); stored in single precision as column vectors.
    interval, start
        s, sampling interval and time of the first sample (``Tinterval``, ``Tstart``).
    compress
        Whether to deflate; the bytes then depend on the zlib library.
    lsb
        The converter's step in the channels' unit: samples are rounded to multiples of it, as a
        recorder does, which also makes the file compress better.
    """
    from scipy.io import savemat

    lengths = {len(values) for values in channels.values()}
    if len(lengths) != 1:
        raise CampaignError(
            f"{os.fspath(path)}: expected channels of one length, but got {sorted(lengths)}"
        )
    content: dict[str, object] = {"Tstart": float(start), "Tinterval": float(interval)}
    content["Length"] = float(lengths.pop())
    for name, values in channels.items():
        rounded = np.asarray(values) if lsb is None else np.rint(np.asarray(values) / lsb) * lsb
        content[name] = rounded.astype(np.float32)
    stream = io.BytesIO()
    savemat(stream, content, do_compression=compress, oned_as="column")
    text = b"MATLAB 5.0 MAT-file, PicoScope layout, written by bayes_sensor"
    _write(path, text.ljust(_MAT_TEXT) + stream.getvalue()[_MAT_TEXT:])


def write_picoscope_csv(
    path: str | os.PathLike[str],
    t: FloatArray,
    channels: Mapping[str, FloatArray],
    time_unit: str = "ms",
    units: Sequence[str] | None = None,
    decimals: int = 6,
    time_decimals: int = 4,
) -> None:
    """Write a PicoScope-style CSV export: header row, unit row, blank line, samples.

    Parameters
    ----------
    path
        The file to write.
    t
        (n,) s
    channels
        ``A``, ``B``, ... to samples (n,), in V; a channel with another unit stays as it is.
    time_unit
        ``s`` or ``ms``
    units
        One per channel; ``mV`` converts from volts, any other is only written. Default V.
    decimals, time_decimals
        Digits after the point.
    """
    units = ["V"] * len(channels) if units is None else list(units)
    if time_unit not in ("s", "ms") or len(units) != len(channels):
        raise CampaignError(
            f"{os.fspath(path)}: expected time_unit 's' or 'ms' and one unit per channel, "
            f"got '{time_unit}' and {len(units)} units for {len(channels)} channels"
        )
    head = ",".join(["Time", *(f"Channel {name}" for name in channels)]) + "\r\n"
    head += ",".join(f"({unit})" for unit in [time_unit, *units]) + "\r\n\r\n"
    columns = [np.asarray(t) * (1e3 if time_unit == "ms" else 1.0)]
    for values, unit in zip(channels.values(), units, strict=True):
        columns.append(np.asarray(values) * (1e3 if unit == "mV" else 1.0))
    pattern = ",".join([f"%.{time_decimals}f"] + [f"%.{decimals}f"] * len(channels)) + "\r\n"
    _write(path, (head + _rows(pattern, columns)).encode("utf-8"))


def write_csv(
    path: str | os.PathLike[str],
    columns: Mapping[str, FloatArray],
    separator: str = ",",
    decimal: str = ".",
    digits: int = 9,
) -> None:
    """Write a plain table with a header, such as ``time_s,voltage_V``.

    Parameters
    ----------
    path
        The file to write.
    columns
        Names to values (n,), time first.
    separator, decimal
        ``,`` ``;`` or tab, and ``.`` or ``,`` (not both commas).
    digits
        Significant digits; more for the first column where its steps need them, as the seconds
        since an epoch do, and for others that are far from zero.
    """
    if separator == decimal:
        raise CampaignError(
            f"{os.fspath(path)}: separator and decimal mark are both '{decimal}'; "
            "use semicolons with decimal commas"
        )
    values = [np.asarray(column) for column in columns.values()]
    pattern = separator.join(
        [
            f"%.{max(digits, _digits(values[0]))}g",
            *(f"%.{digits + _far_from_zero(column)}g" for column in values[1:]),
        ]
    )
    rows = _rows(pattern + "\n", values)
    if decimal != ".":
        rows = rows.replace(".", decimal)
    _write(path, (separator.join(columns) + "\n" + rows).encode("utf-8"))


def write_npz(
    path: str | os.PathLike[str],
    t: FloatArray,
    y: FloatArray,
    drive: FloatArray | None = None,
    compress: bool = True,
) -> None:
    """Write a NumPy archive with ``t`` (s), ``y`` and optionally ``drive``, each (n,)."""
    arrays = {"t": np.asarray(t), "y": np.asarray(y)}
    if drive is not None:
        arrays["drive"] = np.asarray(drive)
    stream = io.BytesIO()
    (np.savez_compressed if compress else np.savez)(stream, allow_pickle=False, **arrays)
    _write(path, stream.getvalue())


def campaign_text(campaign: Campaign, files: Mapping[str, Mapping[str, str]]) -> str:
    """The text of ``campaign.toml`` for a campaign.

    Parameters
    ----------
    campaign
        Flows, commanded times, masks, side information and unit are taken from it.
    files
        Experiment name to the keys that say where its samples are: ``file`` and, where needed,
        ``signal``, ``drive``.  An experiment that is left out is written as a design.

    Examples
    --------
    >>> from bayes_sensor.campaign import Campaign, Experiment
    >>> t = np.arange(4) * 0.001
    >>> one = Experiment("1", t, None, 200 / 3, 25 / 3, 0.001, commanded_on=0.002)
    >>> print(campaign_text(Campaign("plan", (one,)), {}))
    title = "plan"
    <BLANKLINE>
    [[experiment]]
    name = "1"
    carrier_flow = "4 L/min"
    test_gas_flow = "0.5 L/min"
    commanded_on = "0.002 s"
    interval = "0.001 s"
    duration = "0.004 s"
    <BLANKLINE>
    """
    lines = [f"title = {_quoted(campaign.title)}"]
    lines += [f'coating = "{campaign.coating}"', ""] if campaign.coating else [""]
    rig = []
    if campaign.stages != STAGES:
        rig.append(f"stages = [{', '.join(map(_quoted, campaign.stages))}]")
    if campaign.sensor_is != "unknown":
        rig.append(f'sensor_is = "{campaign.sensor_is}"')
    if campaign.ties:
        ties = (f"{_quoted(name)} = {_quoted(to)}" for name, to in tie_texts(campaign.ties).items())
        rig.append(f"tie = {{{', '.join(ties)}}}")
    if rig:
        lines += ["[rig]", *rig, ""]
    if campaign.side_information:
        lines.append("[side_information]")
        for name, known in campaign.side_information.items():
            kind, bracket, rest = name.partition("[")
            key, _, unit = kind.rpartition("_")
            key = _quoted(f"{key}[{rest}") if bracket else key
            lines.append(f'{key} = "{known.mean:.12g} +- {known.sd:.12g} {unit}"')
        lines.append("")
    for together in _records(campaign):
        experiment = together[0]
        lines += ["[[experiment]]", f"name = {_quoted(experiment.record_name)}"]
        keys = files.get(experiment.record_name, {})
        lines += [f"{key} = {_quoted(value)}" for key, value in keys.items()]
        if experiment.sensor:
            own = [f"{_quoted(e.sensor)} = {_quoted(e.sensor)}" for e in together]
            lines.append(f"signals = {{{', '.join(own)}}}")
        if campaign.signal_unit != "V":
            lines.append(f"signal_unit = {_quoted(campaign.signal_unit)}")
        for key in ("carrier_flow", "test_gas_flow"):
            flow = getattr(experiment, key)
            if flow is not None:
                lines.append(f'{key} = "{flow * 0.06:.12g} L/min"')
        lines += _command_lines(experiment)
        if experiment.commands is None and experiment.commanded_on is not None:
            lines.append(f'commanded_on = "{_seconds(experiment.commanded_on)} s"')
        if experiment.commanded_off is not None:
            lines.append(f'commanded_off = "{_seconds(experiment.commanded_off)} s"')
        if "file" not in keys:
            duration = len(experiment.t) * experiment.interval
            lines.append(f'interval = "{experiment.interval:.12g} s"')
            lines.append(f'duration = "{duration:.12g} s"')
        lines += _mask_lines(experiment)
        lines.append("")
    return "\n".join(lines)


def _records(campaign: Campaign) -> list[list[Experiment]]:
    """The experiments of each record: several where several sensors share it."""
    found: dict[str, list[Experiment]] = {}
    for e in campaign:
        found.setdefault(e.record_name, []).append(e)
    return list(found.values())


def _command_lines(e: Experiment) -> list[str]:
    """The keys of a programme of more than one pulse."""
    done = e.commands
    if done is None or done.recorded:
        return []
    if done.rest:
        raise CampaignError(
            f"experiment '{e.name}': its input does not begin at zero, which only a recorded drive "
            "can say; expected a programme from rest"
        )
    steps = [
        f'{{at = "{_seconds(at)} s", to = {to:.12g}}}' for at, to in zip(done.times, done.levels)
    ]
    return [f"steps = [{', '.join(steps)}]", f'delays = "{done.delays}"']


def write_campaign(
    campaign: Campaign,
    folder: str | os.PathLike[str],
    formats: str | Mapping[str, str] = "csv",
    drive: bool = False,
) -> Path:
    """Write the data files and ``campaign.toml``; returns the path of the latter.

    Parameters
    ----------
    campaign
        A design is written as ``campaign.toml`` alone.
    folder
        Made where it is missing.
    formats
        One of :data:`FORMATS` for all experiments, or experiment name to format.
    drive
        Whether to record the valve's drive signal as a second channel.

    Raises
    ------
    CampaignError
        If a format is not known or the folder cannot be written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CampaignError(
            f"{folder}: the folder cannot be made ({error.strerror}); choose another"
        ) from None
    files: dict[str, Mapping[str, str]] = {}
    taken: set[str] = set()
    for number, together in enumerate(_records(campaign), 1):
        experiment = together[0]
        if experiment.y is None:
            continue
        kind = formats if isinstance(formats, str) else formats.get(experiment.name, "csv")
        if kind not in FORMATS:
            raise CampaignError(
                f"experiment '{experiment.name}': the format '{kind}' cannot be written; "
                f"choose one of {', '.join(FORMATS)}"
            )
        stem = "exp" + re.sub(r"[^A-Za-z0-9.-]+", "_", experiment.record_name)[:60].strip(".")
        if stem.casefold() in taken:
            stem = f"{stem}_{number}"
        taken.add(stem.casefold())
        if experiment.sensor or experiment.commands is not None:
            keys = _write_columns(together, folder / f"{stem}.csv", kind)
        else:
            keys = _write_experiment(experiment, folder, stem, kind, drive, campaign.signal_unit)
        files[experiment.record_name] = keys
    path = folder / "campaign.toml"
    _write(path, campaign_text(campaign, files).encode("utf-8"))
    return path


def _write_experiment(
    experiment: Experiment, folder: Path, stem: str, kind: str, with_drive: bool, unit: str
) -> Mapping[str, str]:
    """Write one data file; returns its keys for ``campaign.toml``."""
    name = stem + {"csv": ".csv", "picoscope-csv": ".csv", "mat": ".mat", "npz": ".npz"}[kind]
    path = folder / name
    t, y = experiment.t, experiment.values
    drive = drive_signal(experiment) if with_drive else None
    keys = {"file": name}
    if kind == "npz":
        write_npz(path, t, y, drive)
        return keys
    if kind == "csv":
        columns = {"time_s": t, ("voltage_V" if unit == "V" else "signal"): y}
        if drive is not None:
            columns["drive_V"] = drive
            keys["drive"] = "drive_V"
        write_csv(path, columns)
        return keys
    channels = {"A": y} if drive is None else {"A": y, "B": drive}
    keys["signal"] = "A"
    if drive is not None:
        keys["drive"] = "B"
    if kind == "mat" and not experiment.regular:
        raise CampaignError(
            f"experiment '{experiment.name}': its sampling is irregular, but a PicoScope file has "
            "one interval; expected another format: write csv or npz"
        )
    if kind == "mat":
        write_picoscope_mat(path, channels, experiment.interval, float(t[0]))
    else:
        write_picoscope_csv(path, t, channels, units=[unit, "V"][: len(channels)])
    return keys


def _write_columns(together: list[Experiment], path: Path, kind: str) -> Mapping[str, str]:
    """Write a record of several sensors or with a recorded input as a table of columns."""
    first = together[0]
    if kind != "csv":
        raise CampaignError(
            f"experiment '{first.record_name}': several sensors, longer programmes and recorded "
            f"inputs are written as csv only, but the format is '{kind}'; choose csv"
        )
    columns = {"time_s": first.t}
    for e in together:
        columns[e.sensor or "signal"] = e.values
    keys = {"file": path.name}
    if not first.sensor:
        keys["signal"] = "signal"
    if first.commands is not None and first.commands.recorded:
        columns["input"] = np.interp(first.t, first.commands.times, first.commands.levels)
        keys["input"] = "input"
    write_csv(path, columns)
    return keys


def _mask_lines(experiment: Experiment) -> list[str]:
    left_out = runs_of(~experiment.used)
    if not len(left_out):
        return []
    lines = ["mask = ["]
    for start, end in left_out:
        # half an interval wide: a range of one sample needs its end after its start
        a = experiment.t[start] - 0.25 * experiment.interval
        b = experiment.t[end - 1] + 0.25 * experiment.interval
        lines.append(f'  ["{_seconds(a)} s", "{_seconds(b)} s"],')
    return [*lines, "]"]


def _seconds(time: float) -> str:
    """The time, to microseconds on any clock."""
    return f"{time:.12g}" if abs(time) < 1e5 else f"{time:.6f}"


def _quoted(text: str) -> str:
    """The text as a TOML basic string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + re.sub(r"[\x00-\x1f\x7f]", lambda m: f"\\u{ord(m[0]):04x}", escaped) + '"'


def _far_from_zero(y: FloatArray) -> int:
    """Digits that all values (n,) share, about; no more than any float has.

    >>> _far_from_zero(np.array([1.5e6, 1.5e6 + 1.5])), _far_from_zero(np.array([0.3, 1.8]))
    (6, 0)
    """
    spread, largest = float(np.ptp(y)), float(np.abs(y).max())
    if not 0.0 < spread < largest < np.inf:
        return 0
    return min(int(np.floor(np.log10(largest / spread))), 8)


def _digits(t: FloatArray) -> int:
    """Significant digits that tell hundredths of the steps of ``t`` (n,); 17 hold any float."""
    steps = np.abs(np.diff(t))
    if not (steps > 0).any():
        return 0
    ratio = float(np.abs(t).max() / steps[steps > 0].min())
    return min(int(np.ceil(np.log10(ratio))) + 2, 17)


def _rows(pattern: str, columns: Sequence[FloatArray]) -> str:
    lengths = {len(column) for column in columns}
    if len(lengths) != 1:
        raise CampaignError(f"expected columns of one length, but got {sorted(lengths)}")
    return "".join(map(pattern.__mod__, zip(*(column.tolist() for column in columns))))


def _write(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file whole; CampaignError where that cannot be."""
    try:
        write_bytes(path, content)
    except OSError as error:
        raise CampaignError(
            f"{path}: cannot be written ({error.strerror}); check the folder, its permissions and "
            "the free space"
        ) from None
