"""Reading a campaign: ``campaign.toml`` and its data files, one module per format.

Every error in the input raises :class:`CampaignError`.  Its message says where, what was expected,
what came and what to do.
"""

from __future__ import annotations

import difflib
import os
import stat
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.io.readers.arrow import read_feather, read_parquet
from bayes_sensor.io.readers.assembly import Assembled, assemble, design, settled_unit
from bayes_sensor.io.readers.campaign_file import (
    ExperimentTable,
    read_entry,
    read_rig,
    read_sheet,
)
from bayes_sensor.io.readers.flow_settings import settle_all_flows
from bayes_sensor.io.readers.joined import by_sensor, join, one_line, one_unit, side_information_of
from bayes_sensor.io.readers.left_open import check_filled_in
from bayes_sensor.io.readers.matlab import read_matlab
from bayes_sensor.io.readers.npz import read_npz
from bayes_sensor.io.readers.other_channels import column_remarks, signal_remarks
from bayes_sensor.io.readers.other_times import time_remarks
from bayes_sensor.io.readers.recording import DataFile, Recording, Selection
from bayes_sensor.io.readers.spreadsheet import read_xlsx
from bayes_sensor.io.readers.table import read_table
from bayes_sensor.io.readers.tdms import read_tdms
from bayes_sensor.io.toml_text import LARGEST, read_toml
from bayes_sensor.names import appearance

Reader = Callable[[DataFile, Selection], Recording]

FORMATS: dict[str, Reader] = {
    ".csv": read_table,
    ".txt": read_table,
    ".tsv": read_table,
    ".lvm": read_table,
    ".dat": read_table,
    ".mat": read_matlab,
    ".parquet": read_parquet,
    ".feather": read_feather,
    ".arrow": read_feather,
    ".npz": read_npz,
    ".tdms": read_tdms,
    ".xlsx": read_xlsx,
}
"""suffix to reader; a format of your own is one more entry"""
LARGEST_FILE = 256 << 20
"""bytes of a data file"""

__all__ = [
    "FORMATS",
    "one_line",
    "one_unit",
    "read_campaign",
    "read_experiment",
    "read_recording",
]


def read_campaign(path: str | os.PathLike[str]) -> Campaign:
    """The campaign of a TOML file: measured experiments with their samples, or a design.

    Parameters
    ----------
    path
        The campaign's TOML file; data files are found relative to its folder.

    Returns
    -------
    Campaign
        Times in s, flows in mL/s, samples in V or in ``signal_unit``; ``warnings`` holds what was
        noticed.  Entries with ``interval`` and ``duration`` instead of ``file`` make a design.

    Raises
    ------
    CampaignError
        If anything cannot be read or used.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> _ = (folder / "plan.toml").write_text('''
    ... [[experiment]]
    ... name = "1"
    ... carrier_flow = "4.0 L/min"
    ... test_gas_flow = "0.5 L/min"
    ... commanded_on = "24 s"
    ... interval = "1 ms"
    ... duration = "120 s"
    ... ''')
    >>> campaign = read_campaign(folder / "plan.toml")
    >>> campaign.is_design, round(campaign["1"].total_flow, 9), len(campaign["1"].t)
    (True, 75.0, 120000)
    """
    try:
        return _read(Path(path))
    except CampaignError as error:
        # names and cells from the files may hold line ends or terminal codes
        raise CampaignError(one_line(str(error))) from None


def _read(path: Path) -> Campaign:
    label = path.name or str(path)
    if path.suffix.casefold() in FORMATS and path.is_file():
        raise CampaignError(
            f"{label}: expected a campaign file in TOML, but this is a data file; put a "
            f'campaign.toml beside it, with an [[experiment]] that says file = "{label}", and give '
            "that"
        )
    where = label if path.exists() else str(path)
    content = read_bytes(path, where, LARGEST, "a campaign file in TOML")
    tables = read_toml(content, label)
    check_filled_in(tables, label)
    sheet = read_sheet(tables, label)
    rig = read_rig(sheet.rig, label)
    settled, warnings = settle_all_flows(sheet.experiment, sheet.conditions, label)
    entries = [read_entry(table, i, label) for i, table in enumerate(settled, 1)]
    _check_entries(entries, label)
    warnings += column_remarks(entries)
    experiments: list[Experiment] = []
    units: list[tuple[str, str]] = []
    for entry in entries:
        for own, record, sensor in by_sensor(entry):
            if entry.file is None:
                made = design(own, label)
                unit = settled_unit(own.signal_unit or "V")
            else:
                done = _measured(own, path.parent, sheet.allow_outside)
                made, unit = done.experiment, done.unit
                warnings += [text for text in done.warnings if text not in warnings]
            experiments.append(replace(made, record=record, sensor=sensor))
            units.append((own.name, unit))
    known = side_information_of(sheet.side_information, label)
    found = join(sheet.title, experiments, units, warnings, rig, known, label, str(path))
    return replace(found, coating=sheet.coating)


def _measured(entry: ExperimentTable, folder: Path, allow_outside: bool) -> Assembled:
    """The experiment of an entry with a file."""
    file = _open(entry, folder, allow_outside)
    selection = Selection(entry.signal, entry.drive or entry.input, entry.time, entry.interval)
    reader = FORMATS[Path(entry.file or "").suffix.casefold()]
    # damaged files hold numbers that overflow; what is not finite is told or masked
    with np.errstate(over="ignore", invalid="ignore"):
        recording = reader(file, selection)
        said = [
            *time_remarks(entry, recording, lambda other: reader(file, other)),
            *signal_remarks(entry, recording, lambda other: reader(file, other)),
        ]
        return assemble(entry, file, replace(recording, notes=(*recording.notes, *said)))


def read_recording(path: Path, where: str, selection: Selection) -> Recording:
    """The recording in one data file, as its format's reader gives it.

    ``where`` is the file's name in messages.  Raises CampaignError as :func:`read_campaign` does.
    """
    reader = FORMATS[path.suffix.casefold()]
    file = DataFile(path, where, read_bytes(path, where, LARGEST_FILE, "a data file"))
    with np.errstate(over="ignore", invalid="ignore"):
        return reader(file, selection)


def read_experiment(table: Mapping[str, Any], folder: Path, label: str) -> Assembled:
    """The experiment of one table ``[[experiment]]`` with a file, in ``folder``.

    Raises CampaignError as :func:`read_campaign` does.
    """
    return _measured(read_entry(dict(table), 1, label), folder, False)


def _check_entries(entries: list[ExperimentTable], label: str) -> None:
    """Check that names are unique, and that all experiments are measured or all planned."""
    seen: dict[str, int] = {}
    for number, entry in enumerate(entries, 1):
        before = seen.setdefault(appearance(entry.name), number)
        if before != number:
            same = entry.name == entries[before - 1].name
            raise CampaignError(
                f"experiment '{entry.name}' ({label}): experiments number {before} and {number} "
                f"{'share this name' if same else 'have names that look the same'}; expected each "
                "name once: rename one"
            )
        if entry.file is not None:
            if entry.duration is not None:
                raise CampaignError(
                    f"experiment '{entry.name}' ({label}): duration belongs to a design, but "
                    "there is a file; remove duration or file"
                )
        if (entry.file is None) != (entries[0].file is None):
            first, other = ("a file", "none") if entries[0].file else ("no file", "one")
            raise CampaignError(
                f"experiment '{entry.name}' ({label}): experiment '{entries[0].name}' has {first}, "
                f"but this has {other}; expected all measured or all planned: split the campaign"
            )


def _open(entry: ExperimentTable, folder: Path, allow_outside: bool) -> DataFile:
    """The data file of an entry, read once."""
    assert entry.file is not None
    where = f"experiment '{entry.name}' ({entry.file})"
    suffix = Path(entry.file).suffix
    if suffix.casefold() not in FORMATS:
        fix = (
            "in Excel, save as .xlsx or CSV"
            if suffix.casefold().startswith(".xls")
            else "export it so"
        )
        raise CampaignError(
            f"{where}: expected a data file ending in {', '.join(FORMATS)}, but it ends in "
            f"'{suffix}'; {fix}"
        )
    try:
        target = (folder / entry.file).resolve()
        inside = target.is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a name too long
        raise CampaignError(f"{where}: the path cannot be followed ({error}); correct it") from None
    if not inside and not allow_outside:
        raise CampaignError(
            f"{where}: the file lies outside the campaign's folder; move it there, or write "
            "allow_outside = true at the top of the campaign file"
        )
    content = read_bytes(target, where, LARGEST_FILE, "a data file")
    return DataFile(target, where, content)


def _where_else(path: Path) -> str:
    """Advice for a missing file."""
    if "\\" in path.name:
        return "write / between folders, not \\"
    try:
        beside = [entry.name for entry in path.parent.iterdir() if entry.is_file()]
    except OSError:
        return f"there is no folder {path.parent} either; check the path"
    folded = {name.casefold(): name for name in beside}
    close = difflib.get_close_matches(path.name.casefold(), folded, n=1, cutoff=0.75)
    if close:
        return f"did you mean '{folded[close[0]]}'?"
    return "check the name and the folder"


def read_bytes(path: Path, where: str, most: int, what: str) -> bytes:
    """The content of a regular file, with a message for every possible fault."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            inside = path / "campaign.toml"
            hint = f"give {inside}" if inside.is_file() else "give the file in it"
            raise CampaignError(f"{where}: expected {what}, but it is a folder; {hint}")
        if not stat.S_ISREG(status.st_mode):
            raise CampaignError(
                f"{where}: expected {what}, but it is not a regular file; copy its content into one"
            )
        if status.st_size > most:
            raise CampaignError(
                f"{where}: expected {what} of at most {most >> 20} MB, but it has "
                f"{status.st_size >> 20} MB; crop or average it"
            )
        with path.open("rb") as stream:
            content = stream.read(most + 1)
    except FileNotFoundError:
        raise CampaignError(
            f"{where}: there is no such file; expected {what}: {_where_else(path)}"
        ) from None
    except (OSError, ValueError) as error:  # no permission, vanished, a zero byte in the name
        reason = getattr(error, "strerror", None) or str(error)
        if isinstance(error, CampaignError):
            raise
        raise CampaignError(
            f"{where}: the file cannot be read ({reason}); check its name and permissions"
        ) from None
    if not content:
        raise CampaignError(f"{where}: the file is empty; expected {what}: export it again")
    if len(content) > most:
        raise CampaignError(f"{where}: the file grew while it was read; try again when it is done")
    return content
