"""Cases are drawn and their truths sealed by hashes; after the verdicts the seals are opened.

A folder holds::

    plan.json                 what is to be diagnosed: name, seed, effects taken out (no truth)
    campaigns/NAME/           a campaign as a user has it
    sealed/NAME.json          its truth; sealed.json: SHA-256 of every one, written first
    verdicts/NAME.json        what the diagnosis said; verdicts.json: SHA-256 of every one
    campaigns.json            what each was made from: "files" or "recipe", and its SHA-256
    seconds.json              processor time of each; no part of what is hashed
    score.json, cases.csv     the card and one row a case, written once the seals are open

A truth of the user's own is sealed when the diagnosis begins.  One that is put in later is scored,
too, but nothing shows that it was not written to fit the verdict: ``sealed_late`` names it.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from bayes_sensor.blind_check.plan import Entry, draw_truth, make_plan
from bayes_sensor.blind_check.simulator import Case, make_campaign
from bayes_sensor.blind_check.truth import check_truth, complete_truth
from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.io.json_files import json_text, read_json, sha256, write_json
from bayes_sensor.io.result_schema import check_result, read_result
from bayes_sensor.io.results import Results
from bayes_sensor.io.untrusted import parse_json, refused

LOG = logging.getLogger(__name__)
PLAN, SEALED, VERDICTS, CAMPAIGNS = "plan.json", "sealed", "verdicts", "campaigns"


@dataclass(frozen=True)
class Sealing:
    """The task that draws case number i; its result is the text of the truth."""

    entries: tuple[Entry, ...]

    @property
    def key(self) -> str:
        """Everything that the truths depend on, beside the code."""
        return task_key("sealing", [asdict(entry) for entry in self.entries])

    def __call__(self, i: int) -> dict[str, Any]:
        """``truth``: JSON."""
        return {"truth": json_text(draw_truth(self.entries[i]))}


def contents(parts: Mapping[str, Any], key: str, folder: Path, schema: str) -> list[Any]:
    """The JSON texts of finished parts, each checked by a name of the result schema."""
    texts = parts.get(key)
    if texts is None or texts.dtype.kind != "U" or texts.ndim != 1:
        raise refused(folder, "finished parts of a blind check", f"they have no texts of {key}")
    found = (parse_json(text.encode(), folder) for text in texts.tolist())
    return [check_result(each, folder, schema) for each in found]


def task_key(*parts: Any) -> str:
    """A hash of the version and of what a task is made from."""
    from bayes_sensor import __version__

    return hashlib.sha256(repr((__version__, parts)).encode()).hexdigest()[:16]


def draw_cases(
    folder: Path,
    parts: Path,
    n: int,
    seed: int,
    *,
    reserve: bool = False,
    size: str = "mixed",
    keep: bool = True,
    jobs: int = 1,
    scheduler: str | None = None,
    chunk: int = 4,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Draw ``n`` cases, seal their truths and, with ``keep``, write their campaigns.

    Without ``keep`` the campaigns are made again from their recipes when they are diagnosed.
    ``parts`` holds what an interrupted run has drawn so far.
    """
    task = Sealing(tuple(make_plan(n, seed, reserve, size)))
    drawn = run_chunks(task, n, parts / "sealing", task.key, jobs, chunk, scheduler, progress)
    truths = contents(drawn, "truth", parts, "a drawn truth")
    (folder / SEALED).mkdir(parents=True, exist_ok=True)
    plan = []
    for truth in truths:
        write_json(folder / SEALED / f"{truth['name']}.json", truth)
        taken_out = truth["listed_as"] if truth["kind"] == "withheld" else []
        plan.append({
            "case": truth["name"], "seed": truth["diagnosis_seed"],
            "without": sorted({name for names in taken_out for name in names}),
        })  # fmt: skip
    write_hashes(folder, SEALED)
    write_json(folder / PLAN, {"cases": plan, "n": n, "seed": seed, "reserve": reserve})
    if keep:
        from bayes_sensor.io.writers import write_campaign

        for truth in truths:
            target = folder / CAMPAIGNS / truth["name"]
            if not (target / "campaign.toml").is_file():
                campaign = make_campaign(Case.from_json(truth["recipe"]))
                kinds = {e.name: "npz" if e.commands is None else "csv" for e in campaign}
                write_campaign(campaign, target, kinds)


# --------------------------------------------------------------------------- hashes


def digest(content: Any) -> str:
    """SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def files_digest(toml: Path) -> str:
    """SHA-256 over a campaign file and the data files that it names, in its order."""
    named = [toml.parent / str(table["file"]) for table in _tables(toml) if table.get("file")]
    # the reader reports a missing file
    found = [sha256(path) if path.is_file() else "nothing" for path in (toml, *named)]
    return hashlib.sha256("".join(found).encode()).hexdigest()


def write_hashes(folder: Path, what: str) -> None:
    """Write ``what``.json: the hash of every file in the folder ``what``."""
    hashes = {path.stem: sha256(path) for path in sorted((folder / what).glob("*.json"))}
    write_json(folder / f"{what}.json", hashes)


def _hashes(folder: Path, what: str) -> dict[str, Any]:
    return dict(Results(folder).json(f"{what}.json") or {})


def _tables(toml: Path) -> list[dict[str, Any]]:
    """The experiments of a campaign file, as they are written there."""
    from bayes_sensor.io.readers import read_bytes
    from bayes_sensor.io.readers.campaign_file import read_sheet
    from bayes_sensor.io.toml_text import LARGEST, read_toml

    label = f"{CAMPAIGNS}/{toml.parent.name}/{toml.name}"
    content = read_bytes(toml, label, LARGEST, "a campaign file in TOML")
    return read_sheet(read_toml(content, label), label).experiment


def _experiments(folder: Path, name: str) -> list[str] | None:
    """Names of the experiments of a user's campaign, None where it is not there."""
    toml = folder / CAMPAIGNS / name / "campaign.toml"
    return [str(table.get("name")) for table in _tables(toml)] if toml.is_file() else None


def seal_truths(folder: Path) -> None:
    """Record the hash of every truth that has none yet; a recorded one is never replaced.

    Raises CampaignError where a truth cannot be scored as it is.
    """
    known = _hashes(folder, SEALED)
    paths = sorted((folder / SEALED).glob("*.json"))
    new = {path.stem: path for path in paths if path.stem not in known}
    for name, path in new.items():
        check_truth(read_json(path), name, _experiments(folder, name))
    if new:
        hashes = {name: sha256(path) for name, path in new.items()}
        write_json(folder / f"{SEALED}.json", {**known, **hashes})


def sealed_late(folder: Path) -> list[str]:
    """Names of the truths that had no hash yet when their verdicts were recorded."""
    known = _hashes(folder, SEALED)
    names = (path.stem for path in sorted((folder / VERDICTS).glob("*.json")))
    return [n for n in names if n not in known and (folder / SEALED / f"{n}.json").is_file()]


# --------------------------------------------------------------------------- opening


def open_seals(folder: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """(truth, verdict) of every case with both, after their hashes were found unchanged.

    A warning in the log names the truths that were not sealed before their verdicts.

    Raises
    ------
    CampaignError
        If a file was changed after its hash was recorded, no verdict has a truth, or one that was
        not sealed is none.
    """
    _check_hashes(folder, SEALED)
    _check_hashes(folder, VERDICTS)
    _check_campaigns(folder)
    if late := sealed_late(folder):
        LOG.warning(
            "not sealed before the verdicts were recorded, so that nothing shows that they were "
            "not written to fit: the truths of %s", ", ".join(late),
        )  # fmt: skip
    both = []
    for path in sorted((folder / VERDICTS).glob("*.json")):
        file = folder / SEALED / path.name
        if file.is_file():
            truth = read_json(file)
            if path.stem in late:  # which can still be corrected
                check_truth(truth, path.stem, _experiments(folder, path.stem))
            both.append((complete_truth(truth, path.stem), read_result(path)))
    if not both:
        raise CampaignError(
            f"{folder}: expected verdicts/NAME.json and sealed/NAME.json of the same names, but "
            "no verdict has a truth; diagnose first, then put the truths into sealed/"
        )
    return both


def _check_hashes(folder: Path, what: str) -> None:
    hashes = _hashes(folder, what)
    for name, expected in hashes.items():
        file = folder / what / f"{name}.json"
        found = sha256(file) if file.is_file() else "nothing"
        if found != expected:
            raise CampaignError(
                f"{what}/{name}.json: expected the file whose SHA-256 was recorded before "
                f"({expected[:12]}..), but found {found[:12]}..; put the original back"
            )
    for path in sorted((folder / what).glob("*.json")):
        if what == VERDICTS and path.stem not in hashes:  # truths may come late, see sealed_late
            raise CampaignError(
                f"{what}/{path.name}: expected verdicts whose SHA-256 is in {what}.json, but this "
                "is not there; remove it, or diagnose again"
            )


def _check_campaigns(folder: Path) -> None:
    """CampaignError where a campaign that is still there is not what its verdict was made from."""
    for name, recorded in _hashes(folder, CAMPAIGNS).items():
        toml = folder / CAMPAIGNS / name / "campaign.toml"
        truth = folder / SEALED / f"{name}.json"
        if recorded["of"] == "files":
            found = files_digest(toml) if toml.is_file() else None
        else:  # cases drawn anew have other recipes under the same names
            sealed = complete_truth(read_json(truth), name) if truth.is_file() else {}
            recipe = sealed.get("recipe")
            found = digest(recipe) if recipe is not None else None
        if found not in (None, recorded["sha256"]):
            raise CampaignError(
                f"{CAMPAIGNS}/{name}: expected the campaign that its verdict was made from "
                f"(SHA-256 {recorded['sha256'][:12]}..), but its {recorded['of']} changed since "
                f"({found[:12]}..); put the original back, or diagnose again"
            )
