"""Seals of the blind check: what was changed or put in later is told; old code has no say."""

from __future__ import annotations

import json
import logging
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bayes_sensor.checks.study_chunks as study_chunks
from bayes_sensor.blind_check import diagnose_cases, draw_cases, open_seals, sealed_late
from bayes_sensor.blind_check.truth import KEYS
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.checks.study_chunks import code_digest, run_chunks
from bayes_sensor.cli import _guarded, run_blind_check
from bayes_sensor.io.json_files import read_json, sha256
from bayes_sensor.io.writers import write_campaign
from bayes_sensor.reality import draw_case, make_campaign

ROOT = Path(__file__).resolve().parent.parent


def refuses(campaign: Campaign, seed: int, without: Any, setting: str) -> Any:
    """A stand-in that gives no verdict, which is recorded as one."""
    raise CampaignError("gap: not asked")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command, with the stand-in as its diagnosis."""
    monkeypatch.setattr(
        run_blind_check, "diagnose_cases", partial(diagnose_cases, diagnosis=refuses)
    )


@pytest.fixture(scope="module")
def one_campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A small one with nothing wrong."""
    return make_campaign(draw_case(3, size="small"))


@pytest.fixture
def own(tmp_path: Path, one_campaign: Campaign) -> Path:
    """A folder with one campaign of a user's own and its truth."""
    write_campaign(one_campaign, tmp_path / "campaigns" / "mine", "npz")
    (tmp_path / "sealed").mkdir()
    (tmp_path / "sealed" / "mine.json").write_text('{"listed_as": ["dead_volume"]}')
    return tmp_path


def command(out: Path, *arguments: str) -> int:
    """The exit code of the blind check in ``out``."""
    return _guarded(["blind-check", "--out", str(out), *arguments])


# --------------------------------------------------------------------------- truths


@pytest.mark.usefixtures("quick")
def test_a_truth_of_ones_own_is_sealed_before_its_verdict(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = own / "sealed" / "mine.json"
    assert command(own, "--diagnose-only") == 0
    assert read_json(own / "sealed.json") == {"mine": sha256(truth)}
    assert command(own, "--score-only", "--quiet") == 0
    assert read_json(own / "score.json")["sealed_late"] == []
    kept = truth.read_text()
    truth.write_text(kept.replace("dead_volume", "carry_over"))
    capsys.readouterr()
    assert command(own, "--score-only") == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "sealed/mine.json: expected the file whose SHA-256 was recorded before" in line
    # nor does a second diagnosis take the changed one for the first
    assert command(own, "--diagnose-only", "--quiet") == 0
    assert command(own, "--score-only", "--quiet") == 2
    truth.write_text(kept)
    assert command(own, "--score-only", "--quiet") == 0


@pytest.mark.usefixtures("quick")
def test_a_truth_that_comes_after_the_verdict_counts_and_is_marked(
    own: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    # an earlier test may have handed the log to the command
    monkeypatch.setattr(logging.getLogger("bayes_sensor"), "propagate", True)
    truth = own / "sealed" / "mine.json"
    kept = truth.read_text()
    truth.unlink()
    assert command(own, "--diagnose-only") == 0
    assert "too late to seal one: mine" in capsys.readouterr().out
    truth.write_text(kept)
    assert sealed_late(own) == ["mine"]
    assert command(own, "--score-only") == 0
    assert "truths not sealed before the verdicts: mine" in capsys.readouterr().out
    assert [r.getMessage() for r in caplog.records if "not sealed before" in r.getMessage()]
    assert read_json(own / "score.json")["sealed_late"] == ["mine"]


@pytest.mark.usefixtures("quick")
def test_a_truth_dropped_among_drawn_ones_is_sealed_with_them(
    tmp_path: Path, one_campaign: Campaign, capsys: pytest.CaptureFixture[str]
) -> None:
    small = ["--cases", "2", "--seed", "5", "--size", "small", "--quiet"]
    assert command(tmp_path, "--cases-only", *small) == 0
    drawn = read_json(tmp_path / "sealed.json")
    write_campaign(one_campaign, tmp_path / "campaigns" / "mine", "npz")
    (tmp_path / "sealed" / "mine.json").write_text('{"listed_as": []}')
    assert command(tmp_path, "--diagnose-only", "--quiet") == 0
    sealed = read_json(tmp_path / "sealed.json")
    assert set(sealed) == {*drawn, "mine"} and sealed.items() >= drawn.items()
    # cases drawn anew would take its place
    for arguments in (small, ["--cases-only", *small]):
        assert command(tmp_path, *arguments) == 2
        assert "campaigns of your own" in capsys.readouterr().err
    assert command(tmp_path, "--score-only", "--quiet") == 0
    assert read_json(tmp_path / "score.json")["n"] == 3


@pytest.mark.parametrize("content", ['{"cause": "pocket"}', '{"listed_as": [3]}', "[]"])
@pytest.mark.usefixtures("quick")
def test_what_is_no_truth_is_told_before_it_is_sealed(
    own: Path, content: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (own / "sealed" / "mine.json").write_text(content)
    assert command(own, "--diagnose-only") == 2
    assert 'sealed/mine.json: expected {"listed_as"' in capsys.readouterr().err
    assert not (own / "sealed.json").exists() and not (own / "verdicts").exists()


WRONG_TRUTHS = [
    ('"tau_s": "48 ms"', 'tau_s: expected a positive number of seconds such as 0.048, or null, but '
     'got "48 ms"; correct it'),
    ('"tau_s": -1', "tau_s: expected a positive number of seconds"),
    ('"d": "big"', 'd: expected a number from 0 on, in standard deviations of the noise, .*"big"'),
    ('"d": true', "d: expected a number"),
    ('"d": NaN', "d: expected a number"),
    ('"acts": ["fall"]', r'acts: expected a list of places such as .* got \["fall"\]'),
    ('"acts": [{"experiment": "1", "phase": "decay", "share": 1}]', "a phase of baseline, onset"),
    ('"acts": [{"experiment": "77", "phase": "fall", "share": 1}]',
     r'acts: expected experiments of campaigns/mine \(.*\), but got "77"'),
    ('"closed": {"dead_volume": "all"}', "closed: expected shares such as"),
    ('"closed": {"dead_vol": 0.5}', "closed: expected effects of the .* but got 'dead_vol'"),
    ('"rivals": [3]', "rivals: expected distances such as"),
    ('"near": "carry_over"', "near: expected a list of names such as"),
    ('"near": ["carry_ovr"]', "near: .* but got 'carry_ovr'; known are .* carry_over, "),
    ('"taus_s": 0.048', "but got 'taus_s', which none has; did you mean 'tau_s'"),
    ('"colour": 1', "but got 'colour', which none has; known are listed_as, name, kind"),
    ('"kind": "nil"', "kind: expected one of null, listed"),
    ('"kind": "null"', "kind: expected one that agrees with listed_as = "),
    ('"name": "yours"', "name: expected the name of the campaign's folder, 'mine', but got "),
    ('"is_ar1": "yes"', "is_ar1: expected true or false"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "said"), WRONG_TRUTHS)
@pytest.mark.usefixtures("quick")
def test_a_wrong_key_of_a_truth_is_told_before_it_is_sealed(
    own: Path, key: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (own / "sealed" / "mine.json").write_text(f'{{"listed_as": [["dead_volume"]], {key}}}')
    assert command(own, "--diagnose-only") == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert re.search(f"sealed/mine.json: .*{said}", line), line
    assert not (own / "sealed.json").exists() and not (own / "verdicts").exists()


@pytest.mark.parametrize(
    ("listed", "said"),
    [('[["drift"]]', "listed_as: expected effects of the catalogue, but got 'drift'; known are"),
     ('[["dead_volumee"]]', "but got 'dead_volumee'; known are flow_switching, "),
     ('["unlisted"]', "([[]] for a cause that is none of them)"),
     ('[["dead_volume"], []]', "a cause outside the catalogue is scored alone only")],
)  # fmt: skip
@pytest.mark.usefixtures("quick")
def test_a_cause_that_no_verdict_can_name_is_told_before_it_is_sealed(
    own: Path, listed: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (own / "sealed" / "mine.json").write_text(f'{{"listed_as": {listed}}}')
    assert command(own, "--diagnose-only") == 2
    assert said in capsys.readouterr().err
    assert not (own / "sealed.json").exists()


@pytest.mark.usefixtures("quick")
def test_a_truth_with_every_key_is_scored(own: Path, one_campaign: Campaign) -> None:
    place = {"experiment": one_campaign.names_of_experiments[0], "phase": "fall", "share": 1}
    truth = {
        "listed_as": [["dead_volume"]], "name": "mine", "kind": "listed", "causes": ["a pocket"],
        "near": ["carry_over"], "level": 16, "d": 15.2, "law": "ar1", "is_ar1": True,
        "tau_s": 0.048, "tau_refit_s": None, "rivals": {"carry_over": 5}, "acts": [place],
        "visible": [place], "closed": {"dead_volume": 0.9}, "size": "own", "reserve": False,
    }  # fmt: skip
    assert set(truth) == {"listed_as", *KEYS}
    (own / "sealed" / "mine.json").write_text(json.dumps(truth))
    assert command(own, "--diagnose-only", "--quiet") == 0
    assert command(own, "--score-only", "--quiet") == 0
    assert read_json(own / "score.json")["n"] == 1
    page = (ROOT / "docs" / "blind_check.md").read_text(encoding="utf-8")
    assert not [key for key in truth if f"`{key}`" not in page]


@pytest.mark.usefixtures("quick")
def test_a_late_truth_is_checked_and_can_be_mended(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = own / "sealed" / "mine.json"
    truth.unlink()
    assert command(own, "--diagnose-only", "--quiet") == 0
    truth.write_text('{"listed_as": [["drift"]]}')
    assert command(own, "--score-only", "--quiet") == 2
    assert "but got 'drift'; known are" in capsys.readouterr().err
    truth.write_text('{"listed_as": [["baseline_drift"]]}')
    assert command(own, "--score-only", "--quiet") == 0


# --------------------------------------------------------------------------- campaigns


@pytest.mark.usefixtures("quick")
def test_a_campaign_changed_after_its_verdict_is_told(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(own, "--diagnose-only", "--quiet") == 0
    (own / "campaigns" / "mine" / "notes.txt").write_text("no part of the campaign")
    assert command(own, "--score-only", "--quiet") == 0
    files = [own / "campaigns" / "mine" / "campaign.toml"]
    files += sorted(files[0].parent.glob("*.npz"))
    assert len(files) > 1
    capsys.readouterr()
    for file in (files[0], files[-1]):
        kept = file.read_bytes()
        file.write_bytes(kept + b"\n")
        assert command(own, "--score-only") == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "campaigns/mine: expected the campaign that its verdict was made from" in line
        file.write_bytes(kept)
    files[-1].unlink()
    assert command(own, "--score-only", "--quiet") == 2
    # a folder without the campaign, or of a time when none was recorded, is scored
    for file in files[:-1]:
        file.unlink()
    assert command(own, "--score-only", "--quiet") == 0
    (own / "campaigns.json").unlink()
    assert command(own, "--score-only", "--quiet") == 0


def test_verdicts_on_recipes_do_not_stand_for_cases_drawn_anew(tmp_path: Path) -> None:
    parts = tmp_path / "parts"
    draw_cases(tmp_path, parts, 1, 5, size="small", keep=False)
    diagnose_cases(tmp_path, tmp_path, parts, "study", diagnosis=refuses)
    assert len(open_seals(tmp_path)) == 1
    draw_cases(tmp_path, parts, 1, 6, size="small", keep=False)
    with pytest.raises(CampaignError, match=r"campaigns/case-\w+: .* but its recipe changed since"):
        open_seals(tmp_path)


@pytest.mark.usefixtures("quick")
def test_a_verdict_that_was_not_recorded_is_told(
    own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(own, "--diagnose-only", "--quiet") == 0
    verdicts = own / "verdicts"
    (verdicts / "other.json").write_text((verdicts / "mine.json").read_text())
    assert command(own, "--score-only") == 2
    assert "verdicts/other.json: expected verdicts whose SHA-256 is" in capsys.readouterr().err


@pytest.mark.usefixtures("quick")
def test_the_seconds_of_every_case_are_kept_and_not_hashed(own: Path) -> None:
    assert command(own, "--diagnose-only", "--setting", "study", "--quiet") == 0
    kept = read_json(own / "seconds.json")
    assert kept["setting"] == "study" and list(kept["seconds"]) == ["mine"]
    assert 0.0 <= kept["seconds"]["mine"] < 60.0
    (own / "seconds.json").write_text("{}")
    assert command(own, "--score-only", "--quiet") == 0


# --------------------------------------------------------------------------- parts of other code


class Squares:
    """A task that counts its calls."""

    calls = 0

    def __call__(self, i: int) -> dict[str, Any]:
        Squares.calls += 1
        return {"x": i * i}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of two sources that stands for this one, in a process that has run nothing."""
    folder = tmp_path / "package"
    for room in ("gap", "figures"):
        (folder / room).mkdir(parents=True)
        (folder / room / "one.py").write_text("A = 1\n")
    monkeypatch.setattr(study_chunks, "PACKAGE", folder)
    monkeypatch.setattr(study_chunks, "_BEGUN", {})
    monkeypatch.setattr(logging.getLogger("bayes_sensor"), "propagate", True)
    monkeypatch.setattr(Squares, "calls", 0)
    return folder


def test_parts_of_other_code_are_not_used(
    tmp_path: Path, package: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    def run() -> int:
        """How many results were computed."""
        monkeypatch.setattr(study_chunks, "_BEGUN", {})  # as a new process would begin
        before = Squares.calls
        found = run_chunks(Squares(), 4, tmp_path / "parts", "key", chunk=2)
        np.testing.assert_array_equal(found["x"], np.arange(4) ** 2)
        return Squares.calls - before

    assert (run(), run()) == (4, 0) and not caplog.records
    digest = code_digest(Squares())
    (package / "figures" / "one.py").write_text("A = 2\n")  # no number depends on it
    (package / "gap" / ".#one.py").symlink_to("nobody@nowhere")  # an editor's lock
    assert code_digest(Squares()) == digest and run() == 0
    (package / "gap" / "one.py").write_text("A = 2\n")
    assert code_digest(Squares()) != digest and run() == 4
    (said,) = (record.getMessage() for record in caplog.records)
    assert "2 finished parts are of other code and are not used" in said
    (package / "gap" / "one.py").rename(package / "gap" / "two.py")
    assert run() == 4


def test_a_digest_has_the_source_of_the_task_as_well(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = code_digest(Squares())
    monkeypatch.setattr(Squares, "__module__", "bayes_sensor.checks.study_chunks")
    assert code_digest(Squares()) != digest


def test_code_changed_while_it_ran_is_told_and_its_parts_are_not_used(
    tmp_path: Path, package: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    def change(done: int, n: int) -> None:
        if done == n:
            (package / "gap" / "one.py").write_text("A = 3\n")

    run_chunks(Squares(), 2, tmp_path / "a", "key", progress=change)
    (said,) = (record.getMessage() for record in caplog.records)
    assert "the code was changed while this ran" in said
    run_chunks(Squares(), 2, tmp_path / "b", "key")  # by what this process has loaded before
    monkeypatch.setattr(study_chunks, "_BEGUN", {})
    for folder in "ab":
        run_chunks(Squares(), 2, tmp_path / folder, "key")
    assert Squares.calls == 8


# --------------------------------------------------------------------------- the bundled campaign


def test_the_readme_shows_the_seal_that_the_demo_opens() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    demo = re.search(r"^demo:.*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert demo is not None
    steps = demo.group(1)
    job, diagnosis, opening = (
        steps.index(words)
        for words in ("analyze data/reference", "gap data/withheld", "data/open_seal.py")
    )
    assert job < diagnosis < opening
    begin, end = readme.index("## Two commands"), readme.index("## On your own data")
    about = readme[begin:end]
    assert "data/withheld/" in about and "](paper/figures/opened_seal.png)" in about
    # what verdict and truth are is drawn with the study, and not typed here
    truth = json.loads((ROOT / "data" / "withheld" / "sealed.json").read_text(encoding="utf-8"))
    names = {*truth["causes"], *(name for names in truth["listed_as"] for name in names)}
    assert not [name for name in names if name in about or name.replace("_", " ") in about]
