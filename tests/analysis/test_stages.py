"""An analysis answers stage by stage: what it prints, and what it leaves when it is killed."""

import contextlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import bayes_sensor as bs
from bayes_sensor.analysis import gap_step, job, run_steps
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.workers import beside

pytestmark = pytest.mark.slow

QUICK = """
[fit]
swarms = 1
particles = 10
euler = false
[posterior]
n_chains = 2
target_ess = 100
[bounds]
methods = ["crlb_iid", "crlb_ar1", "posterior"]
step_study = false
explain = false
"""
STAGES = ["fit", "fast posterior", "checks", "posterior", "bounds", "gap", "report"]
FILES = {
    "fit": ["fit.json", "fit_record.npz", "campaign_record.npz"],
    "fast posterior": ["posterior.json", "posterior.nc"],
    "checks": ["residuals.json"],
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


@pytest.fixture(autouse=True, scope="module")
def no_diagnosis() -> Iterator[None]:
    """Takes the diagnosis away, which is long and has its own tests: records too short for it."""

    def too_short(*_: Any, **__: Any) -> None:
        raise CampaignError("gap: too short")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gap_step, "diagnosed", too_short)
        yield


def arguments(place: Path, out: Path, *more: str) -> list[str | Path]:
    campaign, config = place / "c" / "campaign.toml", place / "quick.toml"
    options = ["--out", out, "--config", config, "--jobs", "1", "--no-figures"]
    return ["analyze", campaign, *options, *more]


def contents(folder: Path) -> dict[str, bytes]:
    """What a run left, without its own record and the report, which hold times of day."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name not in ("run.json", "report.html")
        and not p.name.startswith(".") and "checkpoint" not in p.parts
    }  # fmt: skip


@dataclass(frozen=True)
class Whole:
    """What an uninterrupted run says and leaves."""

    out: str
    err: str
    left: dict[str, bytes]


@pytest.fixture(scope="module")
def whole(place: Path, no_diagnosis: None) -> Whole:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert run(*arguments(place, place / "whole")) == 0
    return Whole(out.getvalue(), err.getvalue(), contents(place / "whole"))


@pytest.fixture(scope="module")
def early(place: Path) -> Path:
    """What a process leaves that is killed once the fast posterior is there."""
    out = place / "early"
    command = [sys.executable, "-m", "bayes_sensor", *map(str, arguments(place, out, "--quiet"))]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 240
        while process.poll() is None and time.monotonic() < deadline:
            if (out / "posterior.json").is_file():
                break
            time.sleep(0.01)
        process.kill()
    return out


def test_every_stage_has_one_line_in_order_and_no_control_character(
    place: Path, whole: Whole
) -> None:
    assert not re.search(r"[^\n -\uffff]", whole.out) and "\x1b" not in whole.out + whole.err
    lines = whole.out.splitlines()
    assert re.fullmatch("stages, about: " + ", ".join(f"{s} \\d+ s" for s in STAGES), lines[0])
    found = [match for line in lines if (match := LINE.fullmatch(line))]
    assert [match[1] for match in found] == STAGES
    told = {match[1]: match[2] for match in found}
    assert re.match(r"tau = .*RMS residual", told["fit"]) and "interval" not in told["fit"]
    assert re.search(
        r"residuals: .*; (.* needed, and )?(one|two|three)\b.* suffice", told["checks"]
    )
    # tau with its interval, before what takes long
    for stage in ("fast posterior", "posterior"):
        assert re.search(r"tau = [\d.]+ ms, 95 % interval \[\d+, \d+\] ms", told[stage]), stage
    assert "emcee began from draws of independence and agrees with them" in told["posterior"]
    assert told["bounds"].startswith("3 methods side by side")
    assert told["gap"] == "not diagnosed: gap: too short"
    assert told["report"] == str(place / "whole" / "report.html")


class Killed(BaseException):
    """Stands for a process that ends here."""


def kill(*_: Any) -> None:
    raise Killed


def again(*_: Any) -> None:
    pytest.fail("what is there was computed again")


def has_the_first(n: int, out: Path) -> None:
    """Whether a folder holds the results of the first ``n`` stages, whole, and no others."""
    there = {p.name for p in out.iterdir()}
    for i, stage in enumerate(STAGES):
        assert set(FILES[stage]) <= there if i < n else not set(FILES[stage]) & there
    for path in out.glob("*.json"):
        json.loads(path.read_text())


def test_a_killed_process_leaves_the_fast_posterior(early: Path) -> None:
    has_the_first(2, early)
    found = json.loads((early / "posterior.json").read_text())
    assert found["converged"] and found["sampler"] in ("independence", "emcee")
    assert bs.load(early).posterior.sampler == found["sampler"]


def test_what_is_done_survives_and_resume_goes_on(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Whole, early: Path
) -> None:
    """Killed in one stage after the other."""
    out = tmp_path / "out"
    shutil.copytree(early, out)
    done = ["fit"]  # of the fast posterior, the other begins
    for n, step in ((4, "bounds"), (5, "gap")):
        with monkeypatch.context() as patch:
            for name in done:
                patch.setitem(run_steps.TAKE, name, again)
            patch.setitem(run_steps.TAKE, step, kill)
            with pytest.raises(Killed):
                run(*arguments(place, out, "--quiet", "--resume"))
        has_the_first(n, out)
        left = bs.load(out)
        assert left.fit is not None and left.posterior is not None
        assert (left.bounds is None) == (n < 5)
        assert run("report", out, "--quiet", "--no-figures") == 0
        (out / "report.html").unlink()
        done += ["fast", "lags", "residuals", "posterior"] if n == 4 else ["bounds"]
    for name in done:
        monkeypatch.setitem(run_steps.TAKE, name, again)
    assert run(*arguments(place, out, "--quiet", "--resume")) == 0
    assert contents(out) == whole.left
    entry = json.loads((out / "run.json").read_text())["commands"]["analyze"]
    assert entry["exit_code"] == 0 and entry["steps"][-1] == "gap"


def test_the_fit_alone_survives(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Whole
) -> None:
    out = tmp_path / "out"
    monkeypatch.setitem(run_steps.TAKE, "fast", kill)
    for more in ((), ("--resume",)):
        with pytest.raises(Killed):
            run(*arguments(place, out, "--quiet", *more))
        has_the_first(1, out)
        monkeypatch.setitem(run_steps.TAKE, "fit", again)
    left = bs.load(out)
    assert left.fit is not None and left.posterior is None
    assert left.fit.n_lags is None and left.fit.cost == bs.load(place / "whole").fit.cost


def test_earlier_results_stay_until_all_new_ones_are_there(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Whole
) -> None:
    out = tmp_path / "out"
    shutil.copytree(place / "whole", out)
    monkeypatch.setitem(run_steps.TAKE, "posterior", kill)
    with pytest.raises(Killed):  # the fast posterior of this seed is other than what is there
        run(*arguments(place, out, "--quiet", "--seed", "2"))
    assert contents(out) == whole.left


def test_another_seed_takes_nothing_over(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, early: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(early, out)
    monkeypatch.setitem(run_steps.TAKE, "fit", kill)
    with pytest.raises(Killed):
        run(*arguments(place, out, "--quiet", "--seed", "2", "--resume"))
    assert contents(out) == contents(early)


def test_quick_ends_with_the_fast_posterior_and_the_rest_can_follow(
    place: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    early: Path,
) -> None:
    out = tmp_path / "out"
    assert run(*arguments(place, out, "--quick")) == 0
    lines = capsys.readouterr().out.splitlines()
    found = [match[1] for line in lines if (match := LINE.fullmatch(line))]
    assert found == ["fit", "fast posterior", "checks", "report"]
    posterior = json.loads((out / "posterior.json").read_text())
    assert posterior["sampler"] == "independence" and posterior["began_from"] is None
    assert not {"bounds.json", "gap.json"} & {p.name for p in out.iterdir()}
    assert {p.name for p in out.glob("figures/*")} <= {"chain.svg"}
    assert "tau" in (out / "report.html").read_text(encoding="utf-8")
    # what a run that is not quick left at that point, which is known to go on; later the checks
    # add to the fit
    results = contents(early)
    left = {name: (out / name).read_bytes() for name in results}
    assert [name for name in results if left[name] != results[name]] == [
        "fit.json", "fit_record.npz",
    ]  # fmt: skip
    for name in ("fit", "lags", "residuals"):
        monkeypatch.setitem(run_steps.TAKE, name, again)
    monkeypatch.setitem(run_steps.TAKE, "fast", kill)
    # a quick run that goes on with a finished one computes nothing
    assert run(*arguments(place, out, "--quick", "--resume")) == 0
    assert (out / "posterior.json").read_bytes() == left.get("posterior.json")
    with pytest.raises(Killed):
        run(*arguments(place, out, "--quiet", "--resume"))


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
