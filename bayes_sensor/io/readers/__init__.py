"""Reading a campaign: ``campaign.toml`` and its data files, one module per format.

Every error in the input raises :class:`CampaignError`.  Its message says where, what was expected,
what came and what to do.
"""

from __future__ import annotations

import difflib
import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.io.readers.arrow import read_feather, read_parquet
from bayes_sensor.io.readers.assembly import assemble, design, settled_unit
from bayes_sensor.io.readers.campaign_file import (
    LARGEST,
    Entry,
    read_entry,
    read_rig,
    read_sheet,
    read_side_information,
    read_toml,
)
from bayes_sensor.io.readers.matlab import read_matlab
from bayes_sensor.io.readers.npz import read_npz
from bayes_sensor.io.readers.quantities import conversion_factor
from bayes_sensor.io.readers.recording import DataFile, Recording, Selection
from bayes_sensor.io.readers.spreadsheet import read_xlsx
from bayes_sensor.io.readers.table import read_table
from bayes_sensor.io.readers.tdms import read_tdms

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
_LONGEST_MESSAGE = 2000

__all__ = ["FORMATS", "read_campaign"]


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
        raise CampaignError(_one_line(str(error))) from None


def _read(path: Path) -> Campaign:
    label = path.name or str(path)
    if path.suffix.casefold() in FORMATS and path.is_file():
        raise CampaignError(
            f"{label}: expected a campaign file in TOML, but this is a data file; put a "
            f'campaign.toml beside it, with an [[experiment]] that says file = "{label}", and give '
            "that"
        )
    where = label if path.exists() else str(path)
    content = _read_bytes(path, where, LARGEST, "a campaign file in TOML")
    sheet = read_sheet(read_toml(content, label), label)
    rig = read_rig(sheet.rig, label)
    side_information = read_side_information(sheet.side_information, label)
    entries = [read_entry(table, i, label) for i, table in enumerate(sheet.experiment, 1)]
    _check_entries(entries, label)
    experiments: list[Experiment] = []
    units: list[tuple[str, str]] = []
    warnings: list[str] = []
    for entry in entries:
        if entry.file is None:
            experiments.append(design(entry, label))
            units.append((entry.name, settled_unit(entry.signal_unit or "V")))
            continue
        file = _open(entry, path.parent, sheet.allow_outside)
        selection = Selection(entry.signal, entry.drive, entry.time, entry.interval)
        reader = FORMATS[Path(entry.file).suffix.casefold()]
        # damaged files hold numbers that overflow; what is not finite is told or masked
        with np.errstate(over="ignore", invalid="ignore"):
            recording = reader(file, selection)
            done = assemble(entry, file, recording)
        experiments.append(done.experiment)
        units.append((entry.name, done.unit))
        warnings += done.warnings
    return Campaign(
        title=sheet.title,
        experiments=tuple(experiments),
        side_information=side_information,
        signal_unit=_one_unit(units, label),
        warnings=tuple(_one_line(text) for text in warnings),
        source=str(path),
        sensor_is=rig.sensor_is,
        coating=sheet.coating,
    )


def _one_line(text: str) -> str:
    """The text without control characters, shortened to the length of a message."""
    shown = "".join(c if c.isprintable() else "\ufffd" for c in text)
    return shown if len(shown) <= _LONGEST_MESSAGE else shown[: _LONGEST_MESSAGE - 3] + "..."


def _check_entries(entries: list[Entry], label: str) -> None:
    """Check that names are unique, and that all experiments are measured or all planned."""
    seen: dict[str, int] = {}
    for number, entry in enumerate(entries, 1):
        if entry.name in seen:
            raise CampaignError(
                f"experiment '{entry.name}' ({label}): experiments number {seen[entry.name]} and "
                f"{number} share this name; expected each name once: rename one"
            )
        seen[entry.name] = number
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


def _one_unit(units: list[tuple[str, str]], label: str) -> str:
    first_name, first = units[0]
    for name, unit in units:
        if unit != first and conversion_factor(unit, first) != 1.0:
            raise CampaignError(
                f"experiment '{name}' ({label}): its signal is in '{unit}', but that of experiment "
                f"'{first_name}' in '{first}'; expected one unit: set the same signal_unit for all"
            )
    return first


def _open(entry: Entry, folder: Path, allow_outside: bool) -> DataFile:
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
    content = _read_bytes(target, where, LARGEST_FILE, "a data file")
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


def _read_bytes(path: Path, where: str, most: int, what: str) -> bytes:
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
