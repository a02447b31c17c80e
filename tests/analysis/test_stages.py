"""An analysis answers stage by stage: what it prints, and what it leaves when it is killed."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import bayes_sensor as bs
from bayes_sensor.analysis import gap_step, job, run_steps
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.workers import beside

QUICK = """
[fit]
swarms = 1
particles = 10
euler = false
[posterior]
n_chains = 2
target_ess = 400
[bounds]
methods = ["crlb_iid", "crlb_ar1", "posterior"]
step_study = false
explain = false
"""
STAGES = ["fit", "fast posterior", "posterior", "bounds", "gap", "report"]
FILES = {
    "fit": ["fit.json", "residuals.json", "fit_record.npz", "campaign_record.npz"],
    "fast posterior": ["posterior.json", "posterior.nc"],
    "posterior": ["predictive.json"],
    "bounds": ["bounds.json", "bounds.csv", "delays.json"],
    "gap": ["gap_record.npz"],
    "report": ["report.html"],
}
"""by stage, some of the files that it adds"""
LINE = re.compile(r"([a-z ]+) \(\d+\.\d s of about \d+ s\): (.+)")


def run(*arguments: str | Path) -> int:
    return exit_code([str(a) for a in arguments])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign and settings under which every stage takes a second or two."""
    place = tmp_path_factory.mktemp("stages")
    small = ["--experiments", "1,4,6", "--duration", "15 s", "--interval", "20 ms", "--quiet"]
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV", "--tau", "150 ms"]
    assert run("simulate", "--out", place / "c", *small, *noise) == 0
    (place / "quick.toml").write_text(QUICK)
    return place


@pytest.fixture(autouse=True)
def no_diagnosis(monkeypatch: pytest.MonkeyPatch) -> None:
    """Takes the diagnosis away, which is long and has its own tests: records too short for it."""

    def too_short(*_: Any, **__: Any) -> None:
        raise CampaignError("gap: too short")

    monkeypatch.setattr(gap_step, "diagnosed", too_short)


def arguments(place: Path, out: Path, *more: str) -> list[str | Path]:
    campaign, config = place / "c" / "campaign.toml", place / "quick.toml"
    return ["analyze", campaign, "--out", out, "--config", config, "--jobs", "1", *more]


def contents(folder: Path) -> dict[str, bytes]:
    """What a run left, without its own record and the report, which hold times of day."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name not in ("run.json", "report.html")
    }


@pytest.fixture(scope="module")
def whole(place: Path) -> dict[str, bytes]:
    """What an uninterrupted run leaves."""
    with pytest.MonkeyPatch.context() as patch:
        no_diagnosis.__wrapped__(patch)  # type: ignore[attr-defined]
        assert run(*arguments(place, place / "whole", "--quiet")) == 0
    return contents(place / "whole")


def test_every_stage_has_one_line_in_order_and_no_control_character(
    place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*arguments(place, tmp_path / "out")) == 0
    said = capsys.readouterr()
    assert not re.search(r"[^\n -\uffff]", said.out) and "\x1b" not in said.out + said.err
    lines = said.out.splitlines()
    assert re.fullmatch("stages, about: " + ", ".join(f"{s} \\d+ s" for s in STAGES), lines[0])
    found = [match for line in lines if (match := LINE.fullmatch(line))]
    assert [match[1] for match in found] == STAGES
    told = {match[1]: match[2] for match in found}
    assert re.match(r"tau = .*RMS residual", told["fit"]) and "interval" not in told["fit"]
    # tau with its interval, before what takes long
    for stage in ("fast posterior", "posterior"):
        assert re.search(r"tau = [\d.]+ ms, 95 % interval \[\d+, \d+\] ms", told[stage]), stage
    assert "emcee began from draws of hmc and agrees with them" in told["posterior"]
    assert told["bounds"].startswith("3 methods side by side")
    assert told["gap"] == "not diagnosed: gap: too short"
    assert told["report"] == str(tmp_path / "out" / "report.html")


class Killed(BaseException):
    """Stands for a process that ends here."""


def kill(*_: Any) -> None:
    raise Killed


@pytest.mark.parametrize(
    ("step", "place_of_death"), [("fast", 1), ("posterior", 2), ("bounds", 3), ("gap", 4)]
)
def test_what_is_done_survives_and_resume_goes_on(
    place: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    whole: dict[str, bytes],
    step: str,
    place_of_death: int,
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setitem(run_steps.TAKE, step, kill)
        with pytest.raises(Killed):
            run(*arguments(place, out, "--quiet"))
    there = {p.name for p in out.iterdir()}
    for i, stage in enumerate(STAGES):
        assert set(FILES[stage]) <= there if i < place_of_death else not set(FILES[stage]) & there
    for path in out.glob("*.json"):
        json.loads(path.read_text())
    left = bs.load(out)
    assert left.fit is not None and (left.posterior is None) == (place_of_death < 2)
    assert run("report", out, "--quiet") == 0
    # what is there is not computed again; the fast posterior is where the other begins
    with monkeypatch.context() as patch:
        for done in ("fit", "residuals", "posterior", "bounds")[: max(2, place_of_death)]:
            if done != step:
                patch.setitem(run_steps.TAKE, done, kill)
        assert run(*arguments(place, out, "--quiet", "--resume")) == 0
    assert contents(out) == whole
    entry = json.loads((out / "run.json").read_text())["commands"]["analyze"]
    assert entry["exit_code"] == 0 and entry["steps"][-1] == "gap"


def test_a_killed_process_leaves_the_fast_posterior(place: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-m", "bayes_sensor", *map(str, arguments(place, out, "--quiet"))]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 240
        while process.poll() is None and time.monotonic() < deadline:
            if (out / "posterior.json").is_file():
                break
            time.sleep(0.01)
        process.kill()
    found = json.loads((out / "posterior.json").read_text())
    assert found["converged"] and found["sampler"] in ("hmc", "emcee")
    assert bs.load(out).posterior.sampler == found["sampler"]


@pytest.mark.parametrize("seed", ["1", "2"])
def test_earlier_results_stay_until_all_new_ones_are_there(
    place: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    whole: dict[str, bytes],
    seed: str,
) -> None:
    out = tmp_path / "out"
    monkeypatch.setitem(run_steps.TAKE, "bounds", kill)
    out.mkdir()
    for path in (place / "whole").iterdir():
        if path.is_file():
            (out / path.name).write_bytes(path.read_bytes())
    with pytest.raises(Killed):
        run(*arguments(place, out, "--quiet", "--seed", seed))
    now = contents(out)
    assert {name: now[name] for name in whole if "/" not in name} == {
        name: content for name, content in whole.items() if "/" not in name
    }


def test_another_seed_takes_nothing_over(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setitem(run_steps.TAKE, "bounds", kill)
        with pytest.raises(Killed):
            run(*arguments(place, out, "--quiet"))
        before = (out / "posterior.json").read_bytes()
        patch.setitem(run_steps.TAKE, "fit", kill)
        with pytest.raises(Killed):
            run(*arguments(place, out, "--quiet", "--seed", "2", "--resume"))
    assert (out / "posterior.json").read_bytes() == before


def test_quick_ends_with_the_fast_posterior_and_the_rest_can_follow(
    place: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    whole: dict[str, bytes],
) -> None:
    out = tmp_path / "out"
    assert run(*arguments(place, out, "--quick", "--no-figures")) == 0
    lines = capsys.readouterr().out.splitlines()
    found = [match[1] for line in lines if (match := LINE.fullmatch(line))]
    assert found == ["fit", "fast posterior", "report"]
    posterior = json.loads((out / "posterior.json").read_text())
    assert posterior["sampler"] == "hmc" and posterior["began_from"] is None
    assert not {"bounds.json", "gap.json"} & {p.name for p in out.iterdir()}
    assert {p.name for p in (out / "figures").iterdir()} <= {"chain.svg"}
    assert "tau" in (out / "report.html").read_text(encoding="utf-8")
    assert run(*arguments(place, out, "--quiet", "--resume")) == 0
    after = contents(out)
    assert {n for n in after if "/" not in n} == {n for n in whole if "/" not in n}
    assert all(after[n] == whole[n] for n in whole if "/" not in n)


def test_quick_without_a_posterior_says_so(
    place: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def given_up(taken: job.Job) -> None:
        taken.fast = taken.posterior = None

    monkeypatch.setitem(run_steps.TAKE, "fast", given_up)
    assert run(*arguments(place, tmp_path / "out", "--quick")) == 3
    said = capsys.readouterr()
    assert re.search(r"fast posterior \(0\.0 s of about \d+ s\): none: ", said.out)
    assert said.err.startswith("not converged: no fast posterior") and "--resume" in said.err
    assert (tmp_path / "out" / "fit.json").is_file()


def square(x: int) -> int:
    return x * x


def test_what_another_process_computes_is_waited_for() -> None:
    with beside(square, (7,)) as wait:
        assert wait() == 49


def die(pid: int) -> int:
    """Ends the process, unless it is the one that asked."""
    if os.getpid() != pid:
        os.kill(os.getpid(), signal.SIGKILL)
    return 5


def test_what_a_process_died_of_is_computed_here(caplog: pytest.LogCaptureFixture) -> None:
    with beside(die, (os.getpid(),)) as wait:
        assert wait() == 5
    assert "ended unexpectedly" in caplog.text


def test_a_block_that_ends_early_ends_the_process() -> None:
    slow: Callable[[float], None] = time.sleep
    begin = time.monotonic()
    with pytest.raises(Killed), beside(slow, (600.0,)):
        raise Killed
    assert time.monotonic() - begin < 300.0
