"""The campaigns of a fleet.

A list is one of

- a text file with one ``campaign.toml`` a line, or a folder that holds one, or a pattern such as
  ``lab/*/campaign.toml``; ``#`` begins a comment;
- a TOML file with ``[[campaign]]`` tables of ``file`` and, if wanted, ``name``;
- a folder: every ``campaign.toml`` in it and below, hidden folders left out;
- a pattern, in quotes, so that it reaches the program.

Paths in a file are relative to that file.  Whether a campaign exists is checked when it is read.  A
missing one is a failed row of the table and does not stop the others.
"""

from __future__ import annotations

import glob
import os
import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.readers import read_bytes
from bayes_sensor.io.toml_text import read_toml

CAMPAIGN = "campaign.toml"
MOST = 1_000_000
"""campaigns of a list"""
LARGEST = 256 << 20
"""bytes of a list"""
LONGEST_NAME = 80


@dataclass(frozen=True)
class FleetEntry:
    """One campaign of a fleet."""

    name: str
    """unique; also the name of its results folder"""
    file: Path


def read_list(path: str | os.PathLike[str]) -> list[FleetEntry]:
    """The campaigns of a list, in its order (of a folder or a pattern: sorted).

    Raises CampaignError for a list that cannot be read, is empty, or names a campaign twice.
    """
    where = Path(path)
    found: list[tuple[str | None, Path, str]]
    if where.is_dir():
        found = [(None, file, "") for file in _below(where)]
        label = f"{where}: a folder without any {CAMPAIGN}"
    elif glob.has_magic(str(path)) and not where.exists():
        found = [(None, file, "") for file in _matching(str(path))]
        label = f"{path}: a pattern that matches nothing"
    else:
        text = _text(where)
        found = _from_toml(text, where) if where.suffix == ".toml" else _from_lines(text, where)
        label = f"{where}: a list without any campaign"
    if not found:
        raise CampaignError(f"{label}; expected at least one campaign: check LIST")
    if len(found) > MOST:
        raise CampaignError(
            f"{where}: expected at most {MOST} campaigns, but got {len(found)}; split the list"
        )
    return _named(found)


def _text(path: Path) -> str:
    content = read_bytes(path, str(path), LARGEST, "a list of campaigns, a folder or a pattern")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise CampaignError(
            f"{path}: expected UTF-8 text with one path a line; save it so"
        ) from None
    if "\0" in text:
        raise CampaignError(f"{path}: expected text with one path a line, but it is binary data")
    return text


def _from_lines(text: str, path: Path) -> list[tuple[str | None, Path, str]]:
    found: list[tuple[str | None, Path, str]] = []
    for number, line in enumerate(text.splitlines(), 1):
        entry = re.sub(r"(^|\s)#.*", "", line).strip()
        if not entry:
            continue
        place = f"{path}, line {number}"
        whole = os.path.join(path.parent, entry)
        if glob.has_magic(entry) and not os.path.exists(whole):
            files = _matching(whole)
            if not files:
                raise CampaignError(
                    f"{place}: the pattern '{entry[:80]}' matches nothing; expected a "
                    f"{CAMPAIGN} at least: correct or remove it"
                )
            found += [(None, file, place) for file in files]
        else:
            found.append((None, _file(Path(whole)), place))
    return found


def _from_toml(text: str, path: Path) -> list[tuple[str | None, Path, str]]:
    tables = read_toml(text.encode(), str(path), "a list", LARGEST)
    if "experiment" in tables:
        raise CampaignError(
            f"{path}: this is one campaign, but fleet takes a list of them; expected "
            f'[[campaign]] with file = "lab1/{CAMPAIGN}": use analyze for a single one'
        )
    unknown = set(tables) - {"campaign"}
    entries = tables.get("campaign", [])
    if unknown or not isinstance(entries, list):
        what = f"the key '{min(unknown)[:80]}'" if unknown else "one table"
        raise CampaignError(
            f"{path}: expected nothing but [[campaign]] tables, but got {what}; write "
            f'[[campaign]] and file = "lab1/{CAMPAIGN}"'
        )
    found: list[tuple[str | None, Path, str]] = []
    for number, entry in enumerate(entries, 1):
        place = f"{path}: campaign number {number}"
        wrong = sorted(set(entry) - {"file", "name"}) if isinstance(entry, dict) else ["entry"]
        if wrong:
            raise CampaignError(
                f"{place}: unknown key '{wrong[0][:80]}'; expected file and, if wanted, name"
            )
        file, name = entry.get("file"), entry.get("name")
        if not isinstance(file, str) or not file or "\0" in file:
            raise CampaignError(f'{place}: expected file = "lab1/{CAMPAIGN}"; add it')
        if name is not None and not (isinstance(name, str) and name.strip()):
            raise CampaignError(f'{place}: expected name = "sensor 12", a text; correct it')
        found.append((name, _file(path.parent / file), place))
    return found


def _file(path: Path) -> Path:
    """The campaign's file where a folder was given."""
    try:
        return path / CAMPAIGN if path.is_dir() else path
    except (OSError, ValueError):  # a name too long: said when it is read
        return path


def _below(folder: Path) -> list[Path]:
    found = []
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if CAMPAIGN in files:
            found.append(Path(place) / CAMPAIGN)
    return found


def _matching(pattern: str) -> list[Path]:
    return [
        file
        for name in sorted(glob.glob(pattern, recursive=True))
        if (file := _file(Path(name))).suffix == ".toml"
    ]


def _named(found: Sequence[tuple[str | None, Path, str]]) -> list[FleetEntry]:
    """Entries with unique names for folders: as given, else from the path."""
    seen: dict[str, str] = {}
    for _, file, place in found:
        same = os.path.abspath(file)
        if same in seen:
            raise CampaignError(
                f"{place or file}: {file} stands in the list twice"
                f"{f' (also {seen[same]})' if seen[same] else ''}; expected each campaign once: "
                "remove one"
            )
        seen[same] = place
    taken: dict[str, str] = {}
    for name, _, place in found:
        if name is not None:
            folded = _safe(name).casefold()
            if folded in taken:
                raise CampaignError(
                    f"{place}: the name '{name[:80]}' is taken by {taken[folded]}; expected each "
                    "name once: rename one"
                )
            taken[folded] = place
    entries = []
    short = _short_names([file for name, file, _ in found if name is None])
    for name, file, place in found:
        if name is not None:
            entries.append(FleetEntry(_safe(name), file))
            continue
        base = _safe(short[os.path.abspath(file)])
        own, number = base, 1
        while own.casefold() in taken:
            number += 1
            own = f"{base}-{number}"
        taken[own.casefold()] = place or str(file)
        entries.append(FleetEntry(own, file))
    return entries


def _short_names(files: Iterable[Path]) -> dict[str, str]:
    """The shortest end of each path that is unique."""
    parts = {}
    for file in files:
        whole = os.path.abspath(file)
        stem = Path(whole).parent if file.name == CAMPAIGN else Path(whole).with_suffix("")
        parts[whole] = stem.parts[1:] or ("campaign",)
    depth = dict.fromkeys(parts, 1)
    while True:
        ends: dict[str, list[str]] = {}
        for whole, words in parts.items():
            ends.setdefault("-".join(words[-depth[whole] :]), []).append(whole)
        again = [w for same in ends.values() if len(same) > 1 for w in same]
        again = [w for w in again if depth[w] < len(parts[w])]
        if not again:
            return {whole: end for end, same in ends.items() for whole in same}
        for whole in again:
            depth[whole] += 1


def _safe(name: str) -> str:
    """A name that any file system accepts.

    >>> _safe("sensor 12/µ:b"), _safe("..")
    ('sensor 12-µ-b', 'campaign')
    """
    # composed: some file systems take both spellings of an accent for one name
    composed = unicodedata.normalize("NFC", name.strip())
    kept = "".join(c if c.isalnum() or c in " ._-+=()," else "-" for c in composed)
    return kept.strip(" .")[:LONGEST_NAME].rstrip(" .") or "campaign"
