"""Many calls on many processes: in order, retried where a process dies, given up at last."""

import asyncio
import gc
import json
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.workers import WorkerDied, completed, dask_client, in_order, one_thread
from tests.support.dying_tasks import Dying, DyingStudy


def test_linear_algebra_is_done_in_one_thread() -> None:
    from threadpoolctl import threadpool_info, threadpool_limits

    def threads() -> set[int]:
        """Threads of every library of linear algebra."""
        return {found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas"}

    with threadpool_limits(limits=2, user_api="blas"):
        assert threads() == {2}
        limited = one_thread(threads)
        assert limited() == {1} and limited.__doc__ == threads.__doc__
        assert threads() == {2}  # and is the caller's own again


def test_the_command_asks_for_one_thread_unless_told_otherwise() -> None:
    code = (
        "import os, sys, bayes_sensor.cli as cli, bayes_sensor.__main__ as entry\n"
        "assert 'numpy' not in sys.modules, 'too late to say it'\n"
        "cli.main = lambda: print(*[os.environ[name] for name in entry.THREADS])\n"
        "entry.run()\n"
    )
    kept = {k: v for k, v in os.environ.items() if not k.endswith("_THREADS")}
    for given, said in (({}, "1 1 1 1"), ({"OPENBLAS_NUM_THREADS": "3"}, "1 3 1 1")):
        done = subprocess.run(
            [sys.executable, "-c", code], env={**kept, **given}, capture_output=True, text=True
        )
        assert done.stdout.split() == said.split(), done.stderr


def test_a_dead_worker_is_replaced_and_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "bayes_sensor"):
        found = dict(completed(Dying(tmp_path, once=3), range(8), 2))
    assert found == {i: i * i for i in range(8)}
    assert (tmp_path / "died-3").exists()
    assert len(caplog.records) == 1 and "run again" in caplog.records[0].getMessage()


def test_calls_come_back_in_order_and_what_cannot_be_done_is_raised(tmp_path: Path) -> None:
    assert in_order(pow, [(i, 2) for i in range(5)], 2) == [0, 1, 4, 9, 16]
    with pytest.raises(WorkerDied, match=r"3 worker processes.*fewer --jobs"):
        in_order(Dying(tmp_path, always=1), [(i,) for i in range(4)], 2)


def test_what_a_call_raises_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        dict(completed((1).__truediv__, [1, 0, 2], 2))


def test_who_stops_early_is_not_warned(recwarn: pytest.WarningsRecorder) -> None:
    found = completed(time.sleep, [0.0, 5.0, 5.0], 2)
    assert next(found) == (0, None)
    found.close()  # as Ctrl-C does between two results
    assert not [str(w.message) for w in recwarn if "cancelled" in str(w.message)]


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be held back")
def test_ctrl_c_while_the_workers_start_is_no_warning(recwarn: pytest.WarningsRecorder) -> None:
    class Interrupting(list[float]):
        def __getitem__(self, i: Any) -> Any:
            signal.pthread_kill(threading.get_ident(), signal.SIGINT)
            return super().__getitem__(i)

    # a shell that starts the tests in the background has them ignore the signal
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            next(completed(time.sleep, Interrupting([5.0, 5.0]), 2))
    finally:
        signal.signal(signal.SIGINT, before)
    gc.collect()
    assert not [str(w.message) for w in recwarn if "cancelled" in str(w.message)]


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be held back")
def test_workers_do_not_hear_ctrl_c() -> None:
    # in a process of its own: the first workers of a process start more than themselves
    code = (
        "import signal\n"
        "from bayes_sensor.workers import completed\n"
        "def deaf(_):\n"
        "    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())\n"
        "print([found for _, found in completed(deaf, [0, 1, 2], 2)], deaf(0))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("[True, True, True] False\n", "")


def test_a_study_keeps_the_rest_of_what_killed_its_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def died(function: Any, items: Any, jobs: int, client: Any) -> Any:
        yield 1, WorkerDied("it ended 3 worker processes")
        yield from ((i, function(items[i])) for i in (0, 2))

    with monkeypatch.context() as patch:
        patch.setattr("bayes_sensor.checks.study_chunks.completed", died)
        with pytest.raises(CampaignError, match="campaigns 2 to 3 of the study: it ended 3"):
            run_chunks(DyingStudy(tmp_path), 6, tmp_path / "b", "key", jobs=2, chunk=2)
    assert len(list((tmp_path / "b").glob("chunk-*.npz"))) == 2
    found = run_chunks(DyingStudy(tmp_path), 6, tmp_path / "b", "key", chunk=2)
    np.testing.assert_array_equal(found["x"], np.arange(6) ** 2)


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 cut", None])
def test_a_damaged_part_is_computed_again(tmp_path: Path, damage: bytes | None) -> None:
    first = run_chunks(DyingStudy(tmp_path), 4, tmp_path / "c", "key", chunk=2)
    part = tmp_path / "c" / "chunk-000002-000004.npz"
    part.write_bytes(part.read_bytes()[:-30] if damage is None else damage)
    (tmp_path / "c" / ".chunk-000000-000002.npz.99").write_bytes(b"rest of a killed run")
    again = run_chunks(DyingStudy(tmp_path), 4, tmp_path / "c", "key", chunk=2)
    np.testing.assert_array_equal(first["x"], again["x"])
    assert sorted(p.name for p in (tmp_path / "c").iterdir()) == [
        "chunk-000000-000002.npz", "chunk-000002-000004.npz", "study.json",
    ]  # fmt: skip


@pytest.mark.skipif(os.name != "posix", reason="parents are watched by their process number")
def test_workers_end_soon_after_who_started_them(tmp_path: Path) -> None:
    code = (
        "import os, sys, time\nfrom pathlib import Path\n"
        "from bayes_sensor.workers import completed\n"
        "def wait(i):\n"
        "    Path(sys.argv[1] if len(sys.argv) > 1 else i, f'{os.getpid()}').touch()\n"
        "    time.sleep(60)\n"
        "list(completed(wait, [sys.argv[1]] * 2, 2))\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) as process:
        deadline = time.monotonic() + 60
        while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
        process.kill()
    pids = [int(p.name) for p in tmp_path.iterdir()]
    assert len(pids) == 2 and process.pid not in pids
    deadline = time.monotonic() + 30  # a quarter of a second on an idle machine
    while any(Path(f"/proc/{pid}").exists() for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


@pytest.mark.filterwarnings("ignore")  # distributed warns about ports and its own shutdown
def test_a_dask_worker_that_dies_is_replaced(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
        ) as cluster,
        dask_client(cluster.scheduler_address) as client,
    ):
        found = dict(completed(Dying(tmp_path, once=2), range(4), client=client))
    assert found == {i: i * i for i in range(4)}
    assert (tmp_path / "died-2").exists()


def test_a_scheduler_that_does_not_answer_is_one_message() -> None:
    pytest.importorskip("distributed")
    with (
        pytest.raises(CampaignError, match=r"--scheduler nonsense: expected a Dask scheduler"),
        dask_client("nonsense"),
    ):
        pass


def _long(i: int) -> int:
    time.sleep(60.0)
    return i


@pytest.mark.slow  # a client tries for ten seconds to come back
@pytest.mark.filterwarnings("ignore")  # distributed warns about its own shutdown
def test_a_scheduler_that_goes_away_is_one_message(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--no-dashboard"]
    command += ["--port", "0", "--scheduler-file", str(file)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + 60.0
            while not (file.exists() and file.read_text().strip()) and time.monotonic() < deadline:
                time.sleep(0.05)
            address = json.loads(file.read_text())["address"]
            threading.Timer(3.0, process.kill).start()
            with (
                pytest.raises(CampaignError, match=r"the Dask scheduler went away; .*--resume"),
                dask_client(address) as client,
            ):
                list(completed(_long, range(2), client=client))
        finally:
            process.kill()


def wait_a_little(i: int) -> int:
    time.sleep(0.05)
    return i


@pytest.mark.filterwarnings("ignore")  # distributed warns about ports and its own shutdown
def test_waiting_for_dask_leaves_nothing_behind() -> None:
    distributed = pytest.importorskip("distributed")
    local = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    )
    left = []
    with local as cluster, distributed.Client(cluster) as client:
        for n, (i, result) in enumerate(completed(wait_a_little, range(40), client=client), 1):
            assert i == result
            left.append(len(asyncio.all_tasks(client.loop.asyncio_loop)) + n)
    assert len(left) == 40
    assert left[20] < left[1] + 40  # a waiter for each call, not one each time it was asked about
