"""What survives: runs killed, disks full, folders read-only or in use, Ctrl-C, dead workers.

Every long command is killed (SIGKILL) at random moments and continued with ``--resume`` where it
has that, else run again.  What it then leaves must equal, bit for bit, what an undisturbed run
leaves; left out of the comparison are times of day, durations, memory, and the folders of
unfinished parts, by which a run goes on.  To save the time of loading the program two hundred
times, each of these runs is a fork of one process that has loaded it.

The other faults are met as a user meets them: on file systems of a few kilobytes and one mounted
read-only, where this program may mount; by a second run into the same folder; by the signal that
Ctrl-C sends, with the machine's load stated; by a worker's death; by a Dask worker and a Dask
scheduler that go away.  At last five hundred diagnoses in one process show what that keeps.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES

SEED = 1
SETTINGS = """\
[fit]
swarms = 1
particles = 10
euler = false
[posterior]
n_chains = 2
n_walkers = 32
burn_in = 60
chunk = 50
max_steps = 400
target_ess = 200
[bounds]
resamples = 40
"""
TIME_OF_DAY = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")
DURATION = re.compile(r'(TIME</td>(?:(?!</tr>).)*)<td data-v="[^"]*" class="num">[^<]*</td></tr>')
UNFINISHED = re.compile(r"(^|/)(checkpoint|\w+(-\w+)*-parts|\.[^/]*)(/|$)")
INTERRUPTED = (
    "posterior", "bounds (profile, bootstrap)", "gap --bootstrap 20", "analyze", "blind-check",
    "coverage --jobs 2", "fleet --jobs 2",
)  # fmt: skip
"""commands that Ctrl-C is pressed in"""
LEFT_OUT = "times of day, durations, memory; folders of unfinished parts"


@dataclass(frozen=True)
class Command:
    """A long command on a small campaign."""

    name: str
    arguments: tuple[str, ...]
    kills: int
    resumes: bool = True
    base: str = ""
    """a folder with results, which the command is run on"""

    def on(self, out: Path) -> tuple[str, ...]:
        """The arguments for results in ``out``."""
        place = (str(out),) if self.base else ("--out", str(out))
        return (*self.arguments, *place, "--quiet")

    def begin(self, out: Path) -> None:
        """Clear ``out``, but for what the command needs there."""
        shutil.rmtree(out, ignore_errors=True)
        if self.base:
            shutil.copytree(self.base, out)


def commands(place: Path) -> list[Command]:
    """Every long command; ``place`` holds the campaigns."""
    one, other = str(place / "a" / "campaign.toml"), str(place / "effect" / "campaign.toml")
    quick = ("--config", str(place / "quick.toml"))
    few = ("--setting", "iid", "--method", "crlb_ar1", "--method", "sandwich")
    goal = ("--target-tau", "10 ms", "--check", "0", "--duration", "20 s", "60 s")
    return [
        Command("report", ("report",), 24, False, str(place / "analysed")),
        Command("posterior --sampler hmc", ("posterior", one, *quick, "--sampler", "hmc"), 10),
        Command("posterior", ("posterior", one, *quick), 40),
        Command("bounds (profile, bootstrap)", ("bounds", one, *quick), 16),
        Command("fit", ("fit", one, *quick), 16, False),
        Command("coverage", ("coverage", "--campaigns", "80", *few), 24),
        Command("design", ("design", one, *goal, *quick), 16, False),
        Command("analyze", ("analyze", one, *quick), 20),
        Command("gap --bootstrap 20", ("gap", other, *quick, "--bootstrap", "20"), 12, False),
        Command("fleet", ("fleet", str(place / "list.txt"), *quick), 8),
        Command(
            "blind-check",
            ("blind-check", "--cases", "4", "--size", "small", "--setting", "study"),
            10,
        ),
        Command("posterior --jobs 2", ("posterior", one, *quick, "--jobs", "2"), 2),
        Command("coverage --jobs 2", ("coverage", "--campaigns", "80", *few, "--jobs", "2"), 2),
        Command("fleet --jobs 2", ("fleet", str(place / "list.txt"), *quick, "--jobs", "2"), 0),
    ]


def prepare(place: Path) -> None:
    """Small campaigns, settings and a list with one campaign that is not there."""
    small = ["--experiments", "1,6", "--duration", "12 s", "--interval", "20 ms"]
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV"]
    effect = ["--effect", "valve_asymmetry=0.2"]
    for name, more in (("a", ["--tau", "150 ms"]), ("b", ["--tau", "80 ms"]), ("effect", effect)):
        if not (place / name / "campaign.toml").is_file():
            done = call("simulate", "--out", str(place / name), *small, *noise, *more, "--quiet")
            assert done.returncode == 0, done.stderr
    (place / "quick.toml").write_text(SETTINGS)
    (place / "list.txt").write_text("a\nb/campaign.toml\nmissing/campaign.toml\n")
    if not (place / "analysed" / "report.html").is_file():
        options = ["--config", str(place / "quick.toml"), "--out", str(place / "analysed")]
        done = call("analyze", str(place / "a" / "campaign.toml"), *options, "--quiet")
        assert done.returncode in (0, 3), done.stderr


# --------------------------------------------------------------------------- processes


def environment() -> dict[str, str]:
    """One thread of linear algebra a process."""
    return {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def start(*arguments: str) -> subprocess.Popen[str]:
    """A command in a process group of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "bayes_sensor", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment(),
        start_new_session=True,
    )  # fmt: skip


def call(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command to its end."""
    with start(*arguments) as process:
        out, err = process.communicate()
    return subprocess.CompletedProcess(arguments, process.returncode, out, err)


@dataclass
class Fork:
    """A command in a fork of this process."""

    pid: int
    errors: Path
    code: int | None = None

    def ended(self, wait: bool = False) -> bool:
        """Whether it has; ``code`` is negative where a signal ended it."""
        if self.code is None:
            pid, status = os.waitpid(self.pid, 0 if wait else os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
        return self.code is not None


def fork(errors: Path, *arguments: str) -> Fork:
    """Start a command in a fork, in a process group of its own; its stderr goes to a file."""
    from bayes_sensor.cli import main

    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return Fork(pid, errors)
    code = 99
    try:
        os.setsid()
        descriptor = os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        sys.argv = ["bayes-sensor", *arguments]
        main(list(arguments))
    except SystemExit as end:
        code = int(end.code or 0)
    finally:
        os._exit(code)


def to_the_end(errors: Path, *arguments: str) -> tuple[int, str]:
    """Exit code and stderr of a command in a fork."""
    child = fork(errors, *arguments)
    child.ended(wait=True)
    assert child.code is not None
    return child.code, errors.read_text()


def comparable(file: Path) -> bytes:
    """A result's content without times of day and durations."""
    content = file.read_bytes()
    if file.name == "outcome.json":
        record = json.loads(content)
        record.pop("cost")
        return json.dumps(record).encode()
    if file.suffix in (".html", ".md", ".json", ".csv"):
        text = TIME_OF_DAY.sub("TIME", content.decode("utf-8"))
        return DURATION.sub(r"\1", text).encode()
    return content


def state(folder: Path) -> dict[str, str]:
    """Digest of every result in a folder."""
    found = {}
    for file in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = file.relative_to(folder).as_posix()
        if file.name not in ("run.json", "seconds.json") and not UNFINISHED.search(name):
            found[name] = hashlib.sha256(comparable(file)).hexdigest()
    return found


def half_written(folder: Path) -> list[str]:
    """Results that cannot be read, right after a kill."""
    bad = []
    for file in folder.rglob("*.json"):
        if not UNFINISHED.search(file.relative_to(folder).as_posix()):
            try:
                json.loads(file.read_text())
            except ValueError:
                bad.append(file.name)
    return bad


# --------------------------------------------------------------------------- faults


def killed(command: Command, place: Path, tell: Callable[[], None]) -> dict[str, Any]:
    """Kill at random moments, go on, compare; every second time only the main process."""
    out, whole, errors = place / "out", place / "whole", place / "stderr.txt"
    shutil.rmtree(whole, ignore_errors=True)
    spans = []
    arguments = command.on(out)
    for _ in range(2):  # the first compiles what is not in the cache, the second tells the time
        command.begin(out)
        begin = time.perf_counter()
        expected, said = to_the_end(errors, *arguments)
        if not (out / "run.json").exists():
            raise RuntimeError(f"{command.name}, undisturbed, left nothing: {said}")
        spans.append(time.perf_counter() - begin)
        if not whole.exists():
            shutil.copytree(out, whole)
    reference, again = state(whole), state(out)
    differing = [f"two whole runs: {k}" for k in reference if reference[k] != again.get(k)]
    rng = np.random.default_rng([SEED, len(command.name), command.kills])
    survived = n = half = started = 0
    while n < command.kills:
        command.begin(out)
        process = fork(errors, *arguments)
        time.sleep(float(rng.uniform(0.02, 0.98)) * spans[1])
        if process.ended():  # it was quicker than the one that told the time
            continue
        (os.kill if n % 2 else os.killpg)(process.pid, signal.SIGKILL)
        process.ended(wait=True)
        n += 1
        bad = half_written(out)
        half += bool(bad)
        started += any(UNFINISHED.search(p.name) for p in out.glob("*")) if out.exists() else 0
        code, said = to_the_end(errors, *arguments, *(["--resume"] if command.resumes else []))
        now = state(out)
        wrong = sorted(k for k in reference.keys() | now.keys() if reference.get(k) != now.get(k))
        if code != expected:
            wrong.append(f"exit {code}: {said.strip()[-200:]}")
        survived += not (wrong or bad)
        differing += [*wrong, *bad]
        tell()
    left = [f"left behind: {p.name}" for p in sorted(out.iterdir()) if p.name.startswith(".")]
    return {
        "fault": "killed at a random moment",
        "command": command.name,
        "trials": n,
        "survived": survived,
        "checked": f"{'--resume' if command.resumes else 'run again'}: {len(reference)} files "
        "bit for bit; none half-written after the kill",
        "note": "; ".join(
            [*[f"{started} with parts saved"] * command.resumes, *dict.fromkeys(differing), *left]
        ),
    }


@contextmanager
def mounted(place: Path, kilobytes: int, read_only: bool = False) -> Iterator[Path | None]:
    """A small file system in memory; None where mounting is not allowed."""
    place.mkdir(parents=True, exist_ok=True)
    make = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(place)]
    try:
        allowed = subprocess.run(make, capture_output=True).returncode == 0
    except FileNotFoundError:
        allowed = False
    try:
        if allowed and read_only:
            subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)
        yield place if allowed else None
    finally:
        if allowed:
            subprocess.run(["umount", "-l", str(place)], check=True)


def one_message(done: subprocess.CompletedProcess[str], code: int = 2) -> bool:
    """Whether a run ended with the exit code and one line on stderr, no traceback."""
    lines = [line for line in done.stderr.splitlines() if line]
    return done.returncode == code and len(lines) == 1 and "Traceback" not in done.stderr


def disk_full(command: Command, place: Path) -> dict[str, Any] | None:
    """The command on file systems of several sizes: one message, and nothing half-written."""
    good = n = 0
    said = ""
    for kilobytes in (4, 64, 512):
        with mounted(place / "tiny", kilobytes) as disk:
            if disk is None:
                return None
            out = disk / "out"
            done = call(*command.arguments, "--out", str(out), "--quiet")
            if done.returncode == 0 or (done.returncode == 3 and (out / "run.json").is_file()):
                continue  # it fitted
            n += 1
            bad = half_written(out) if out.exists() else []
            ok = one_message(done) and not bad
            good += ok
            if not ok or not said:
                said = done.stderr.strip()[-160:].replace(str(place), "..")
    return {
        "fault": "disk full", "command": command.name, "trials": n, "survived": good,
        "checked": "exit 2, one line on stderr, no result half-written", "note": said,
    }  # fmt: skip


def read_only(command: Command, place: Path) -> dict[str, Any] | None:
    """The command on a file system mounted read-only."""
    with mounted(place / "ro", 64, read_only=True) as disk:
        if disk is None:
            return None
        done = call(*command.arguments, "--out", str(disk / "out"), "--quiet")
    said = done.stderr.strip()[-160:].replace(str(place), "..")
    return {
        "fault": "read-only folder", "command": command.name, "trials": 1,
        "survived": int(one_message(done)), "checked": "exit 2, one line on stderr", "note": said,
    }  # fmt: skip


def in_use(command: Command, place: Path) -> dict[str, Any]:
    """A second run into the folder of the first: refused, named; the first is not harmed."""
    out = place / "out"
    shutil.rmtree(out, ignore_errors=True)
    with start(*command.arguments, "--out", str(out), "--quiet") as first:
        while not (out / ".lock").exists() and first.poll() is None:
            time.sleep(0.02)
        second = call(*command.arguments, "--out", str(out), "--quiet")
        first.communicate()
    whole = state(out)
    shutil.rmtree(out)
    call(*command.arguments, "--out", str(out), "--quiet")
    ok = one_message(second) and f"process {first.pid}" in second.stderr and whole == state(out)
    return {
        "fault": "two runs into one folder", "command": command.name, "trials": 1,
        "survived": int(ok),
        "checked": "second: exit 2, one line naming the first's process; first: bit for bit",
        "note": re.sub(r"process \d+ on \S+", "process N on HOST", second.stderr.strip())[-170:]
        .replace(str(place), ".."),
    }  # fmt: skip


def interrupted(command: Command, place: Path, n: int) -> dict[str, Any]:
    """Ctrl-C at random moments after the start: one line, exit 130, how soon."""
    out = place / "out"
    rng = np.random.default_rng([SEED, n])
    seconds: list[float] = []
    good, said, loads = 0, "", []
    for _ in range(10 * n):
        if len(seconds) == n:
            break
        shutil.rmtree(out, ignore_errors=True)
        process = start(*command.arguments, "--out", str(out), "--quiet")
        while not (out / ".lock").exists() and process.poll() is None:
            time.sleep(0.02)
        time.sleep(float(rng.uniform(0.0, 5.0)))
        loads.append(os.getloadavg()[0] if hasattr(os, "getloadavg") else np.nan)
        begin = time.perf_counter()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        stdout, stderr = process.communicate()
        if (out / "run.json").exists():
            continue  # too late: the results were in place before the interruption
        seconds.append(time.perf_counter() - begin)
        ended = subprocess.CompletedProcess([], process.returncode, stdout, stderr)
        ok = one_message(ended, 130) and (
            "--resume" in stderr if command.resumes else "run the same" in stderr
        )
        good += ok
        if not ok:
            said = stderr.strip()[-160:]
    return {
        "fault": "Ctrl-C", "command": command.name, "trials": len(seconds), "survived": good,
        "checked": "exit 130, one line that says how to go on",
        "note": f"median {np.median(seconds):.2f} s, longest {max(seconds):.2f} s until it had "
        f"ended, at a load of {np.mean(loads):.1f} on {os.cpu_count()} processors {said}".strip(),
    }  # fmt: skip


def workers_of(pid: int) -> list[int]:
    """Child processes that compute for ``pid``; only where /proc is."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            words = (entry / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields[1]) == pid and b"loky" in words and b"resource_tracker" not in words:
            found.append(int(entry.name))
    return found


def worker_killed(command: Command, place: Path, n: int) -> dict[str, Any]:
    """One worker of a parallel run killed: retried, reported, the numbers unchanged."""
    out = place / "out"
    shutil.rmtree(out, ignore_errors=True)
    call(*command.arguments, "--out", str(out), "--quiet")
    reference = state(out)
    rng = np.random.default_rng(SEED)
    good, hit, said = 0, 0, ""
    while hit < n:
        shutil.rmtree(out, ignore_errors=True)
        with start(*command.arguments, "--out", str(out), "--quiet") as process:
            while not (children := workers_of(process.pid)) and process.poll() is None:
                time.sleep(0.02)
            time.sleep(float(rng.uniform(0.5, 3.0)))
            children = workers_of(process.pid)
            if children:
                os.kill(int(rng.choice(children)), signal.SIGKILL)
                hit += 1
            _, stderr = process.communicate()
        if children:
            ok = process.returncode in (0, 3) and state(out) == reference
            reported = "ended unexpectedly" in stderr
            good += ok and reported
            if not (ok and reported):
                said = stderr.strip()[-160:] or "not reported"
    return {
        "fault": "a worker killed", "command": command.name, "trials": n, "survived": good,
        "checked": "run again and reported; results bit for bit", "note": said,
    }  # fmt: skip


@contextmanager
def cluster(place: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a Dask scheduler, and the processes: the scheduler, then its workers."""
    file = place / "scheduler.json"
    file.unlink(missing_ok=True)
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    parts = [
        ["dask_scheduler", *common, "--port", "0"],
        *[["dask_worker", *common, "--nthreads", "1", "--no-nanny"] for _ in range(workers)],
    ]
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{name}", *options],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment(),
        )
        for name, *options in parts
    ]  # fmt: skip
    try:
        while not file.exists():
            time.sleep(0.1)
        yield str(json.loads(file.read_text())["address"]), processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


def dask_dies(command: Command, place: Path, which: str, n: int) -> dict[str, Any]:
    """A Dask worker or the scheduler killed in the middle: gone on, or resumed to the same."""
    out, errors = place / "out", place / "stderr.txt"
    command.begin(out)
    to_the_end(errors, *command.on(out))
    reference = state(out)
    rng = np.random.default_rng([SEED, n])
    good, said, seconds = 0, "", []
    for _ in range(n):
        command.begin(out)
        with cluster(place, 2) as (address, processes):
            with start(*command.on(out), "--scheduler", address) as process:
                while not any(out.rglob("*.npz")) and process.poll() is None:
                    time.sleep(0.05)
                time.sleep(float(rng.uniform(0.0, 1.0)))
                begin = time.perf_counter()
                processes[-1 if which == "worker" else 0].kill()
                _, stderr = process.communicate()
                seconds.append(time.perf_counter() - begin)
        if which == "worker":
            ok = process.returncode in (0, 3) and "ended unexpectedly" in stderr
        else:
            ok = one_message(subprocess.CompletedProcess([], process.returncode, "", stderr))
            to_the_end(errors, *command.on(out), "--resume")
        same = state(out) == reference
        good += ok and same
        if not (ok and same):
            said = stderr.strip()[-200:] if not ok else "other results"
        elif not said:
            said = stderr.strip().splitlines()[-1][-200:]
    checked = {
        "worker": "goes on and says so; results bit for bit",
        "scheduler": "exit 2, one line on stderr; --resume without Dask: results bit for bit",
    }[which]
    return {
        "fault": f"the Dask {which} killed", "command": command.name, "trials": n,
        "survived": good, "checked": checked, "note": re.sub(r"tcp://[\d.:]+", "tcp://..", said),
    }  # fmt: skip


def many_diagnoses(place: Path, n: int) -> dict[str, Any]:
    """The same diagnosis again and again in one process: memory and open files afterwards."""
    code = (
        "import gc, json, os, sys\n"
        "import bayes_sensor as bs\n"
        "campaign = bs.read_campaign(sys.argv[1])\n"
        "def open_files(): return len(os.listdir('/proc/self/fd'))\n"
        "def megabytes():\n"
        "    gc.collect()\n"
        "    pages = int(open('/proc/self/statm').read().split()[1])\n"
        "    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6\n"
        "seen = []\n"
        "for i in range(int(sys.argv[2])):\n"
        "    fit = bs.fit_least_squares(campaign, seed=1, euler=False, swarms=1)\n"
        "    bs.diagnose_gap(campaign, fit, seed=1, bootstrap=0, separate=False, follow=False)\n"
        "    seen.append((megabytes(), open_files()))\n"
        "print(json.dumps(seen))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(place / "effect" / "campaign.toml"), str(n)],
        capture_output=True, text=True, env=environment(), check=True,
    )  # fmt: skip
    seen = json.loads(done.stdout)
    early = seen[n // 10]
    grown, files = seen[-1][0] - early[0], seen[-1][1] - early[1]
    return {
        "fault": f"{n} diagnoses in one process", "command": "gap", "trials": n,
        "survived": n if files == 0 and grown < 0.02 * early[0] else 0,
        "checked": f"from diagnosis {n // 10 + 1} on memory grows by less than 2 %, and no file "
        "stays open",
        "note": f"{early[0]:.0f} MB, {grown:+.1f} MB at the end; {seen[-1][1]} open files, "
        f"{files:+d}",
    }  # fmt: skip


def write(rows: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """The table; what it held and these rows do not have stays, as of earlier code."""
    table = pd.DataFrame(rows)
    table.insert(4, "share", [f"{s}/{t}" for s, t in zip(table["survived"], table["trials"])])
    TABLES.mkdir(parents=True, exist_ok=True)
    table["code"] = "now"
    file, same = TABLES / "faults.csv", ["fault", "command"]
    if file.exists():
        before = pd.read_csv(file, keep_default_na=False).assign(code="earlier")
        table = pd.concat([table, before]).drop_duplicates(same)
    first = {fault: i for i, fault in enumerate(dict.fromkeys(table["fault"]))}
    table = table.sort_values("fault", key=lambda fault: fault.map(first), kind="stable")
    table.to_csv(file, index=False, lineterminator="\n")
    return table


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> pd.DataFrame:
    """Every fault; rows so far are kept in ``folder``, and a later call goes on from there."""
    place = Path(folder) / "faults"
    place.mkdir(parents=True, exist_ok=True)
    prepare(place)
    every = commands(place)
    named = {c.name: c for c in every}
    kept = place / "rows.json"
    rows: dict[str, Any] = json.loads(kept.read_text()) if kept.exists() else {}
    total, done = sum(c.kills for c in every), 0

    def tell() -> None:
        nonlocal done
        done += 1
        progress(done, total)

    def keep(key: str, make: Callable[[], dict[str, Any] | None]) -> None:
        if key not in rows:
            rows[key] = make()
            kept.write_text(json.dumps(rows))
            write([row for row in rows.values() if row is not None])

    first = [c for c in every if c.kills][:8]
    for c in first:
        keep(f"killed {c.name}", lambda c=c: killed(c, place, tell))
    for name in ("posterior", "analyze", "coverage", "fleet"):
        keep(f"full {name}", lambda c=named[name]: disk_full(c, place))
        keep(f"read-only {name}", lambda c=named[name]: read_only(c, place))
    for name in ("posterior", "fleet"):
        keep(f"in use {name}", lambda c=named[name]: in_use(c, place))
    keep("diagnoses", lambda: many_diagnoses(place, 500))
    for which in ("worker", "scheduler"):
        for name in ("coverage", "fleet"):
            keep(f"dask {which} {name}", lambda c=named[name], w=which: dask_dies(c, place, w, 3))
    for name in INTERRUPTED:
        keep(f"ctrl-c {name}", lambda c=named[name]: interrupted(c, place, 8))
    for name in ("posterior --jobs 2", "coverage --jobs 2", "fleet --jobs 2"):
        keep(f"worker {name}", lambda c=named[name]: worker_killed(c, place, 2))
    for c in (c for c in every if c.kills and c not in first):
        keep(f"killed {c.name}", lambda c=c: killed(c, place, tell))
    return write([row for row in rows.values() if row is not None])
