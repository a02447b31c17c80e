"""Seals of the blind check: what was changed or put in later is told; users' own campaigns."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_sensor.blind_check import diagnose_cases, draw_cases, open_seals, sealed_late
from bayes_sensor.blind_check.simulator import draw_case, make_campaign
from bayes_sensor.blind_check.truth import KEYS
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.cli import exit_code, run_blind_check
from bayes_sensor.io.json_files import read_json, sha256
from bayes_sensor.io.writers import write_campaign

ROOT = Path(__file__).resolve().parents[2]


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
    return exit_code(["blind-check", "--out", str(out), *arguments])


# --------------------------------------------------------------------------- truths


@pytest.mark.slow
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
    own: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
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


@pytest.mark.slow
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
    ('"tau_s": "48 ms"', r'tau_s: expected something like 0.048 \(s, positive\), but got "48 ms"; '
     "correct it or leave it out"),
    ('"tau_s": -1', "tau_s: expected something like 0.048"),
    ('"tau_s": 0', "tau_s: expected something like 0.048"),
    ('"d": "big"', r'd: expected something like 8.0 \(standard deviations of the noise\).*"big"'),
    ('"d": true', "d: expected something like 8.0"),
    ('"d": NaN', "cannot be read"),
    ('"acts": ["fall"]', r'acts: expected something like \[{"experiment": "1".* got \["fall"\]'),
    ('"acts": [{"experiment": "1", "phase": "decay", "share": 1}]', "phases: baseline, onset"),
    ('"acts": [{"experiment": "77", "phase": "fall", "share": 1}]',
     r'acts: expected experiments of campaigns/mine \(.*\), but got "77"'),
    ('"closed": {"dead_volume": "all"}', 'closed: expected something like {"dead_volume": 0.97}'),
    ('"closed": {"dead_vol": 0.5}', "closed: expected effects of the .* but got 'dead_vol'"),
    ('"rivals": [3]', 'rivals: expected something like {"carry_over": 5.0}'),
    ('"near": "carry_over"', r'near: expected something like \["carry_over"\]'),
    ('"near": ["carry_ovr"]', "near: .* but got 'carry_ovr'; known are .* carry_over, "),
    ('"taus_s": 0.048', "but got 'taus_s', which none has; did you mean 'tau_s'"),
    ('"colour": 1', "but got 'colour', which none has; known are listed_as, name, kind"),
    ('"kind": "nil"', r"kind: expected something like .* \(one of null, listed"),
    ('"kind": "null"', "kind: expected one that agrees with listed_as = "),
    ('"name": "yours"', "name: expected the name of the campaign's folder, 'mine', but got "),
    ('"is_ar1": "yes"', "is_ar1: expected something like true"),
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


@pytest.mark.slow
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


# --------------------------------------------------------------------------- drawn cases


@pytest.mark.slow
def test_seals_hold(tmp_path: Path) -> None:
    parts = tmp_path / "parts"
    draw_cases(tmp_path, parts, 3, 5, size="small")
    hashes = read_json(tmp_path / "sealed.json")
    assert len(hashes) == 3
    plan = (tmp_path / "plan.json").read_text()
    for name in hashes:
        truth = read_json(tmp_path / "sealed" / f"{name}.json")
        assert all(cause not in plan for cause in truth["causes"])
        campaign = tmp_path / "campaigns" / name / "campaign.toml"
        assert campaign.is_file()
        assert all(cause not in campaign.read_text() for cause in truth["causes"])
    seen: list[tuple[list[str], int]] = []

    def spy(campaign: Campaign, seed: int, without: Any, setting: str) -> Any:
        seen.append((campaign.names_of_experiments, seed))
        return refuses(campaign, seed, without, setting)

    diagnose_cases(tmp_path, tmp_path, parts, "study", diagnosis=spy)
    assert len(seen) == 3
    cases = open_seals(tmp_path)
    assert [truth["name"] for truth, _ in cases] == sorted(hashes)
    # a verdict that is touched afterwards, or a truth, is refused
    for folder in ("verdicts", "sealed"):
        file = tmp_path / folder / f"{min(hashes)}.json"
        kept = file.read_text()
        file.write_text(kept.replace("0", "1", 1))
        with pytest.raises(CampaignError, match=f"{folder}/{min(hashes)}.json: expected the file"):
            open_seals(tmp_path)
        file.write_text(kept)
    assert len(open_seals(tmp_path)) == 3


@pytest.mark.slow
def test_a_campaign_from_its_recipe_is_diagnosed_like_the_one_on_disk(tmp_path: Path) -> None:
    def level(campaign: Campaign, seed: int, without: Any, setting: str) -> Any:
        raise CampaignError(f"{np.mean([e.values.mean() for e in campaign]):.9g}")

    found = []
    for keep in (True, False):
        folder = tmp_path / str(keep)
        draw_cases(folder, folder / "parts", 2, 5, size="small", keep=keep)
        assert (folder / "campaigns").is_dir() == keep
        diagnose_cases(folder, folder, folder / "parts", "study", diagnosis=level)
        found.append([verdict["reason"] for _, verdict in open_seals(folder)])
    assert found[0] == found[1]


def test_what_is_withheld_is_taken_out_of_the_catalogue(tmp_path: Path) -> None:
    taken_out = []

    def spy(campaign: Campaign, seed: int, without: Any, setting: str) -> Any:
        taken_out.append(tuple(without))
        raise CampaignError("gap: not asked")

    draw_cases(tmp_path, tmp_path / "parts", 6, 3, size="small", keep=False)
    diagnose_cases(tmp_path, tmp_path, tmp_path / "parts", "study", diagnosis=spy)
    truths = [truth for truth, _ in open_seals(tmp_path)]
    expected = [
        tuple(sorted(truth["listed_as"][0])) if truth["kind"] == "withheld" else ()
        for truth in truths
    ]
    assert taken_out == expected and any(expected)


@pytest.mark.slow
def test_numbers_do_not_depend_on_jobs_or_interruptions(tmp_path: Path) -> None:
    told: list[int] = []

    class StopError(Exception):
        """Raised half way."""

    def stop(done: int, n: int) -> None:
        told.append(done)
        if done >= 1:
            raise StopError

    a, b = tmp_path / "a", tmp_path / "b"
    with pytest.raises(StopError):
        draw_cases(a, a / "parts", 2, 9, size="small", keep=False, chunk=1, progress=stop)
    assert not (a / "sealed").exists()
    draw_cases(a, a / "parts", 2, 9, size="small", keep=False, chunk=1, progress=told_by(told))
    assert told[-2:] == [1, 2]  # the first half was not drawn again
    draw_cases(b, b / "parts", 2, 9, size="small", keep=False, jobs=2, chunk=1)
    assert (a / "sealed.json").read_bytes() == (b / "sealed.json").read_bytes()


def told_by(told: list[int]) -> Any:
    """A progress that writes down what is done."""
    return lambda done, n: told.append(done)


def test_user_errors_of_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "x")
    for arguments, words in (
        (["--setting", "quick"], "--setting: expected one of full, study"),
        (["--score-only"], "no verdict has a truth"),
        (["--diagnose-only"], "neither plan.json nor"),
        (["--cases-only", "--score-only"], "at most one of --cases-only"),
        (["--size", "big"], "--size: expected one of mixed"),
    ):
        assert exit_code(["blind-check", "--out", out, *arguments]) == 2
        assert words in capsys.readouterr().err
    (tmp_path / "own" / "campaigns").mkdir(parents=True)
    assert exit_code(["blind-check", "--out", str(tmp_path / "own")]) == 2
    assert "campaigns of your own" in capsys.readouterr().err


# --------------------------------------------------------------------------- the bundled campaign


def test_the_docs_show_the_seal_that_the_demo_opens() -> None:
    page = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    demo = re.search(r"^demo:.*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    assert demo is not None
    steps = demo.group(1)
    job, diagnosis, opening = (
        steps.index(words)
        for words in ("analyze data/reference", "gap data/withheld", "data/open_seal.py")
    )
    assert job < diagnosis < opening
    begin, end = page.index("## First analysis"), page.index("For your own data")
    about = page[begin:end]
    assert "data/withheld/" in about and "](../paper/figures/opened_seal.png)" in about
    # what verdict and truth are is drawn with the study, and not typed here
    truth = json.loads((ROOT / "data" / "withheld" / "sealed.json").read_text(encoding="utf-8"))
    names = {*truth["causes"], *(name for names in truth["listed_as"] for name in names)}
    assert not [name for name in names if name in about or name.replace("_", " ") in about]
