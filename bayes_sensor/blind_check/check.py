"""The blind check itself: cases drawn and sealed, diagnosed, verdicts recorded, seals opened.

A folder holds::

    plan.json                 what is to be diagnosed: name, seed, effects taken out (no truth)
    campaigns/NAME/           a campaign as a user has it
    sealed/NAME.json          its truth; sealed.json: SHA-256 of every one, written first
    verdicts/NAME.json        what the diagnosis said; verdicts.json: SHA-256 of every one
    campaigns.json            what each was made from: "files" or "recipe", and its SHA-256
    seconds.json              processor time of each; no part of what is hashed
    score.json, cases.csv     the card and one row a case, written once the seals are open

A truth of the user's own is sealed when the diagnosis begins.  One that is put in later counts,
too, but nothing can show that it was not written to fit: ``sealed_late`` names it.
"""

from __future__ import annotations

import hashlib
import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.blind_check.baselines import whiteness_p_value
from bayes_sensor.blind_check.plan import Entry, draw_truth, make_plan
from bayes_sensor.blind_check.truth import check_truth, complete_truth
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.io.disk import write_text
from bayes_sensor.io.json_files import json_text, plain, read_json, sha256, write_json
from bayes_sensor.reality import Case, make_campaign

Diagnose = Callable[[Campaign, int, Sequence[str], str], Mapping[str, Any]]
"""campaign, seed, effects taken out, setting -> content of gap.json"""
Progress = Callable[[int, int], None]
LOG = logging.getLogger(__name__)
SETTINGS = ("full", "study")
PLAN, SEALED, VERDICTS, CAMPAIGNS = "plan.json", "sealed", "verdicts", "campaigns"
KEPT = {
    "where": ("experiment", "phase", "share", "p_value"),
    "which": (
        "effect",
        "family",
        "probability",
        "d",
        "misfit_left_sd",
        "tau_s",
        "fraction_closed",
        "rss_V2",
        "bic",
    ),
}
"""what is kept of the tables of gap.json; traces and sentences are not scored"""


def diagnose(campaign: Campaign, seed: int, without: Sequence[str], setting: str) -> dict[str, Any]:
    """gap.json of a campaign, and ``whiteness_p`` of the fit.

    ``full`` is what ``bayes-sensor gap`` does; ``study`` leaves out what only the report shows and
    takes linearised instead of bootstrapped intervals.
    """
    from bayes_sensor.diagnosis import diagnose_gap
    from bayes_sensor.fit import fit_least_squares

    if setting == "full":
        fit = fit_least_squares(campaign, seed=seed, euler=False)
        gap = diagnose_gap(campaign, fit, seed=seed, without=without)
    else:
        fit = fit_least_squares(campaign, seed=seed, euler=False, swarms=1)
        gap = diagnose_gap(
            campaign, fit, seed=seed, without=without, bootstrap=0, separate=False, follow=False
        )
    record = gap.to_json()
    record["whiteness_p"] = whiteness_p_value(campaign, fit.theta_hat)
    return record


def trimmed(gap: Mapping[str, Any]) -> dict[str, Any]:
    """The parts of gap.json that are scored."""
    kept: dict[str, Any] = {
        name: [{key: row.get(key) for key in keys} for row in gap[name]]
        for name, keys in KEPT.items()
    }
    verdict = gap["verdict"]
    kept["verdict"] = {k: verdict[k] for k in ("kind", "effects", "family", "probability")}
    kept["shrink"] = {
        k: v
        for k, v in gap["shrink"].items()
        if v is None or isinstance(v, bool | int | float | str)
    }
    kept["families"] = dict(gap.get("families") or {})
    kept["unlisted"] = dict(gap.get("unlisted") or {})
    of_budget = ("excess_d", "p_value", "p_value_of_size")
    kept["budget"] = {k: gap["budget"].get(k) for k in of_budget}
    kept["tau_envelope_s"] = gap["hidden"]["tau_envelope_s"] or [None, None]
    kept["whiteness_p"] = gap.get("whiteness_p")
    result: dict[str, Any] = plain(kept)
    return result


def no_verdict(reason: str) -> dict[str, Any]:
    """What is recorded where the diagnosis refused a campaign."""
    rows = [{"effect": name, "probability": 0.0, "family": None} for name in ("none", "unlisted")]
    return {
        "where": [],
        "which": rows,
        "verdict": {"kind": "failed", "effects": [], "family": None, "probability": None},
        "shrink": {},
        "families": {},
        "budget": {},
        "tau_envelope_s": [None, None],
        "whiteness_p": None,
        "reason": reason,
    }


def verdict_on(
    campaign: Campaign,
    seed: int,
    without: Sequence[str],
    setting: str,
    diagnose: Diagnose = diagnose,
) -> dict[str, Any]:
    """What is scored of a diagnosis, or that it refused the campaign."""
    try:
        return trimmed(diagnose(campaign, seed, without, setting))
    except CampaignError as error:  # no answer is a result, too: it counts as wrong
        return no_verdict(str(error))


# --------------------------------------------------------------------------- tasks


@dataclass(frozen=True)
class Sealing:
    """The task that draws case number i; its result is the text of the truth."""

    entries: tuple[Entry, ...]

    @property
    def key(self) -> str:
        """Everything that the truths depend on, beside the code."""
        return _key("sealing", [asdict(entry) for entry in self.entries])

    def __call__(self, i: int) -> dict[str, Any]:
        """``truth``: JSON."""
        return {"truth": json_text(draw_truth(self.entries[i]))}


@dataclass(frozen=True)
class Diagnosing:
    """The task that diagnoses case number i, from its files or from its recipe.

    Only the campaign, the seed and the names taken out reach the diagnosis.
    """

    cases: tuple[tuple[str, int, tuple[str, ...]], ...]
    """name, seed, effects taken out"""
    sources: tuple[str, ...]
    """path of a campaign.toml, or the recipe as JSON"""
    setting: str
    diagnose: Diagnose = diagnose
    digest: str = ""
    """of the campaigns"""

    @property
    def key(self) -> str:
        """Everything that the verdicts depend on, beside the code."""
        name = getattr(self.diagnose, "__qualname__", repr(self.diagnose))
        return _key("diagnosing", self.cases, self.setting, self.digest, name)

    def __call__(self, i: int) -> dict[str, Any]:
        """``verdict``: JSON; ``seconds``: of the diagnosis, processor time."""
        name, seed, without = self.cases[i]
        source = self.sources[i]
        if source.startswith("{"):
            campaign = make_campaign(Case.from_json(json.loads(source)))
        else:
            from bayes_sensor.io.readers import read_campaign

            campaign = read_campaign(source)
        begin = time.process_time()
        verdict = verdict_on(campaign, seed, without, self.setting, self.diagnose)
        seconds = time.process_time() - begin
        record = {"case": name, "seed": seed, "without": list(without), "setting": self.setting}
        return {"verdict": json_text({**record, **verdict}), "seconds": seconds}


def _key(*parts: Any) -> str:
    from bayes_sensor import __version__

    return hashlib.sha256(repr((__version__, parts)).encode()).hexdigest()[:16]


# --------------------------------------------------------------------------- sealing


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
    progress: Progress | None = None,
) -> None:
    """Draw ``n`` cases, seal their truths and, with ``keep``, write their campaigns.

    Without ``keep`` the campaigns are made again from their recipes when they are diagnosed.
    ``parts`` holds what an interrupted run has drawn so far.
    """
    entries = make_plan(n, seed, reserve, size)
    task = Sealing(tuple(entries))
    drawn = run_chunks(task, n, parts / "sealing", task.key, jobs, chunk, scheduler, progress)
    truths = [json.loads(text) for text in drawn["truth"].tolist()]
    sealed = folder / SEALED
    sealed.mkdir(parents=True, exist_ok=True)
    for truth in truths:
        write_json(sealed / f"{truth['name']}.json", truth)
    _write_hashes(folder, SEALED)
    plan = [
        {
            "case": truth["name"],
            "seed": truth["diagnosis_seed"],
            "without": sorted({n for names in truth["listed_as"] for n in names})
            if truth["kind"] == "withheld"
            else [],
        }
        for truth in truths
    ]
    write_json(folder / PLAN, {"cases": plan, "n": n, "seed": seed, "reserve": reserve})
    if keep:
        from bayes_sensor.io.writers import write_campaign

        for truth in truths:
            target = folder / CAMPAIGNS / truth["name"]
            if not (target / "campaign.toml").is_file():
                case = Case.from_json(truth["recipe"])
                write_campaign(make_campaign(case), target, "npz")


def _write_hashes(folder: Path, what: str) -> None:
    hashes = {path.stem: sha256(path) for path in sorted((folder / what).glob("*.json"))}
    write_json(folder / f"{what}.json", hashes)


def _hashes(folder: Path, what: str) -> dict[str, Any]:
    path = folder / f"{what}.json"
    return dict(read_json(path)) if path.is_file() else {}


def seal_truths(folder: Path) -> None:
    """Record the hash of every truth that has none yet; a recorded one is never replaced.

    Raises CampaignError where one cannot be scored as it is: it could not be mended any more.
    """
    known = _hashes(folder, SEALED)
    new = {
        path.stem: path
        for path in sorted((folder / SEALED).glob("*.json"))
        if path.stem not in known
    }
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


def _tables(toml: Path) -> list[dict[str, Any]]:
    """The experiments of a campaign file, as they are written there."""
    from bayes_sensor.io.readers.campaign_file import read_sheet, read_toml

    label = f"{CAMPAIGNS}/{toml.parent.name}/{toml.name}"
    return read_sheet(read_toml(toml.read_bytes(), label), label).experiment


def _experiments(folder: Path, name: str) -> list[str] | None:
    """Names of the experiments of a user's campaign, None where it is not there."""
    toml = folder / CAMPAIGNS / name / "campaign.toml"
    return [str(table.get("name")) for table in _tables(toml)] if toml.is_file() else None


def _files_digest(toml: Path) -> str:
    """SHA-256 over a campaign file and the data files that it names, in its order."""
    named = [toml.parent / str(table["file"]) for table in _tables(toml) if table.get("file")]
    # what is missing is told by whoever reads it
    found = [sha256(path) if path.is_file() else "nothing" for path in (toml, *named)]
    return hashlib.sha256("".join(found).encode()).hexdigest()


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _check_campaigns(folder: Path) -> None:
    """CampaignError where a campaign that is still there is not what its verdict was made from."""
    for name, recorded in _hashes(folder, CAMPAIGNS).items():
        toml = folder / CAMPAIGNS / name / "campaign.toml"
        truth = folder / SEALED / f"{name}.json"
        if recorded["of"] == "files":
            found = _files_digest(toml) if toml.is_file() else None
        else:  # cases drawn anew have other recipes under the same names
            recipe = read_json(truth).get("recipe") if truth.is_file() else None
            found = _digest(recipe) if recipe is not None else None
        if found not in (None, recorded["sha256"]):
            raise CampaignError(
                f"{CAMPAIGNS}/{name}: expected the campaign that its verdict was made from "
                f"(SHA-256 {recorded['sha256'][:12]}..), but its {recorded['of']} changed since "
                f"({found[:12]}..); put the original back, or diagnose again"
            )


# --------------------------------------------------------------------------- diagnosing


def diagnose_cases(
    folder: Path,
    target: Path,
    parts: Path,
    setting: str = "full",
    *,
    diagnosis: Diagnose = diagnose,
    jobs: int = 1,
    scheduler: str | None = None,
    chunk: int = 4,
    progress: Progress | None = None,
) -> np.ndarray:
    """Diagnose every case of the plan and every campaign found; returns the seconds of each (n,).

    Before that the truths in ``folder`` that have no hash yet get one.  Verdicts, their hashes,
    those of the campaigns and the seconds go to ``target``.  Campaigns that a user put into
    ``campaigns/`` are diagnosed with the full catalogue unless plan.json says otherwise.

    Raises
    ------
    CampaignError
        If there is nothing to diagnose, the setting is not known or a truth is none.
    """
    if setting not in SETTINGS:
        raise CampaignError(f"--setting: expected one of {', '.join(SETTINGS)}, got '{setting}'")
    planned = read_json(folder / PLAN)["cases"] if (folder / PLAN).is_file() else []
    names = {case["case"] for case in planned}
    found = sorted((folder / CAMPAIGNS).glob("*/campaign.toml"))
    planned += [
        {"case": path.parent.name, "seed": 1, "without": []}
        for path in found
        if path.parent.name not in names
    ]
    if not planned:
        raise CampaignError(
            f"{folder}: expected cases to diagnose, but there is neither {PLAN} nor "
            "campaigns/NAME/campaign.toml; draw cases with --cases-only or put campaigns there"
        )
    seal_truths(folder)
    sources: list[str] = []
    made_from: dict[str, dict[str, str]] = {}
    for case in planned:
        toml = folder / CAMPAIGNS / case["case"] / "campaign.toml"
        if toml.is_file():
            sources.append(str(toml))
            made_from[case["case"]] = {"of": "files", "sha256": _files_digest(toml)}
        else:
            truth = read_json(folder / SEALED / f"{case['case']}.json")
            if "recipe" not in truth:
                raise CampaignError(
                    f"campaigns/{case['case']}: expected campaign.toml there, because the sealed "
                    "truth has no recipe to make the campaign from; put the campaign back"
                )
            sources.append(json.dumps(truth["recipe"]))
            digest = _digest(truth["recipe"])
            made_from[case["case"]] = {"of": "recipe", "sha256": digest}
    task = Diagnosing(
        tuple((case["case"], int(case["seed"]), tuple(case["without"])) for case in planned),
        tuple(sources), setting, diagnosis, _digest(made_from),
    )  # fmt: skip
    done = run_chunks(
        task, len(planned), parts / "diagnosing", task.key, jobs, chunk, scheduler, progress
    )
    verdicts = target / VERDICTS
    verdicts.mkdir(parents=True, exist_ok=True)
    for case, text in zip(planned, done["verdict"].tolist(), strict=True):
        write_text(verdicts / f"{case['case']}.json", text)
    _write_hashes(target, VERDICTS)
    write_json(target / f"{CAMPAIGNS}.json", made_from)
    seconds = np.asarray(done["seconds"], dtype=float)
    each = {case["case"]: s for case, s in zip(planned, seconds, strict=True)}
    write_json(target / "seconds.json", {"setting": setting, "seconds": each})
    return seconds


# --------------------------------------------------------------------------- opening


def open_seals(folder: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """(truth, verdict) of every case with both, after their hashes were found unchanged.

    Truths that were not sealed before their verdicts are named in a warning in the log.

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
            if path.stem in late:  # which can be mended still
                check_truth(truth, path.stem, _experiments(folder, path.stem))
            both.append((complete_truth(truth, path.stem), read_json(path)))
    if not both:
        raise CampaignError(
            f"{folder}: expected verdicts/NAME.json and sealed/NAME.json of the same names, but "
            "no verdict has a truth; diagnose first, then put the truths into sealed/"
        )
    return both
