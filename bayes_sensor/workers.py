"""Many calls of one function on many processes, where a process may die.

On this machine joblib runs them; elsewhere a Dask scheduler does.  The results depend on neither,
nor on how many processes there are.  A process that ends without a word (killed, out of memory, a
fault in compiled code) is replaced: what it held is run again, at last alone, and is given up only
after it has ended :data:`MOST_DEATHS` processes.  Every death is logged as a warning, which Python
shows on stderr unless told otherwise.
"""

from __future__ import annotations

import io
import logging
import os
import pickle
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TypeVar

from bayes_sensor.campaign import CampaignError

LOG = logging.getLogger(__name__)
MOST_DEATHS = 3
"""processes that one call may end before it is given up"""
NO_WORKER_SECONDS = 120.0
"""how long to wait for a Dask cluster that has lost all its workers"""
PARENT_SECONDS = 0.25
"""how often a worker looks whether the process that it works for is still there"""


P = ParamSpec("P")
R = TypeVar("R")


def one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function, with linear algebra in one thread while it runs.

    Matrices are small here: threads only wait for each other, and where something else is running,
    ten times as long.  The command says so before numpy is loaded; scripts and notebooks cannot.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


class WorkerDied(BrokenExecutor):
    """A call that ended every process that ran it."""


@contextmanager
def dask_client(scheduler: str) -> Iterator[Any]:
    """A client of the Dask scheduler at ``tcp://host:port``.

    CampaignError where none answers, and in the block where it goes away.
    """
    from importlib import import_module

    try:
        client: Any = import_module("distributed").Client  # untyped, and an extra
    except ModuleNotFoundError:
        raise CampaignError(
            f"--scheduler {scheduler}: expected the package distributed to be installed, but it is "
            "not; install it (pip install 'bayes-sensor[cluster]') or use --jobs"
        ) from None
    try:
        connected = client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise CampaignError(
            f"--scheduler {scheduler}: expected a Dask scheduler there, but none answered "
            f"({error}); check the address, tcp://host:port"
        ) from None
    with _quiet("distributed.client"), connected:  # a lost connection is said here, in one line
        try:
            yield connected
        except (CancelledError, OSError) as error:
            if connected.status == "running":
                raise
            raise CampaignError(
                f"--scheduler {scheduler}: the Dask scheduler went away; what is done is kept: go "
                "on with --resume, with another scheduler or with --jobs"
            ) from error


@contextmanager
def _quiet(name: str) -> Iterator[None]:
    log = logging.getLogger(name)
    before = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(before)


def completed(
    function: Callable[[Any], Any],
    items: Sequence[Any],
    jobs: int = 1,
    client: Any = None,
) -> Iterator[tuple[int, Any]]:
    """``(i, function(items[i]))`` as they come, in ``jobs`` processes or on a Dask ``client``.

    In place of a result stands a :class:`WorkerDied` where a call was given up.  Whatever the
    function raises is raised here.

    >>> sorted(completed(abs, [-2, 3]))
    [(0, 2), (1, 3)]
    """
    if client is not None:
        yield from _on_dask(function, items, client)
    elif jobs == 1:
        for i, item in enumerate(items):
            yield i, function(item)
    else:
        yield from _on_joblib(function, items, jobs)


def in_order(function: Callable[..., Any], arguments: Sequence[Sequence[Any]], jobs: int) -> Any:
    """``[function(*a) for a in arguments]``, in ``jobs`` processes of this machine.

    Raises WorkerDied where one call ended every process that ran it.

    >>> in_order(pow, [(2, 3), (3, 2)], 1)
    [8, 9]
    """
    found: dict[int, Any] = {}
    for i, result in completed(_Spread(function), arguments, min(jobs, len(arguments)) or 1):
        if isinstance(result, WorkerDied):
            raise result
        found[i] = result
    return [found[i] for i in range(len(arguments))]


@contextmanager
def beside(function: Callable[P, R], arguments: Sequence[Any]) -> Iterator[Callable[[], R]]:
    """Let another process compute ``function(*arguments)`` while the block goes on.

    What is yielded waits for the result, or computes it here where that process died.  A block that
    ends early ends the process, too.
    """
    from joblib.externals.loky.process_executor import ProcessPoolExecutor

    executor: Any = None
    answer: Any = None

    def wait() -> Any:
        try:
            return answer.result()
        except BrokenExecutor:
            _report(1, "a worker process")
            return _Spread(function)(arguments)

    try:
        with _children_deaf_to_ctrl_c():
            executor = ProcessPoolExecutor(1, initializer=_end_with, initargs=(os.getpid(),))
            answer = executor.submit(_Spread(function), arguments)
        yield wait
    finally:
        if executor is not None:
            executor.shutdown(kill_workers=answer is None or not answer.done())


def packed(record: Any, known: Mapping[str, Any]) -> bytes:
    """A record as bytes for :func:`unpacked`, with the objects of ``known`` by their names.

    >>> shared = object()
    >>> unpacked(packed([shared, 2], {"it": shared}), {"it": 1})
    [1, 2]
    """
    names = {id(value): name for name, value in known.items()}

    class Pickler(pickle.Pickler):
        def persistent_id(self, value: Any) -> str | None:
            return names.get(id(value))

    buffer = io.BytesIO()
    Pickler(buffer).dump(record)
    return buffer.getvalue()


def unpacked(content: bytes, known: Mapping[str, Any]) -> Any:
    """The record, with this process's objects of ``known`` in their places.

    For what a worker of this package has sent: it is made by running what the bytes say.
    """

    class Unpickler(pickle.Unpickler):
        def persistent_load(self, name: str) -> Any:
            return known[name]

    return Unpickler(io.BytesIO(content)).load()


class _Spread:
    """The function of one tuple of arguments."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function

    def __call__(self, arguments: Sequence[Any]) -> Any:
        return self.function(*arguments)


# --------------------------------------------------------------------------- joblib


def _on_joblib(
    function: Callable[[Any], Any], items: Sequence[Any], jobs: int
) -> Iterator[tuple[int, Any]]:
    deaths = [0] * len(items)
    todo = set(range(len(items)))
    while todo:
        # what was twice in a process that died runs alone, so that only the culprit is blamed
        alone = [i for i in sorted(todo) if deaths[i] >= 2]
        batch = [i for i in sorted(todo) if deaths[i] < 2] or alone[:1]
        held: set[int] = set()
        for i, result in _round(function, items, batch, jobs, held):
            held.discard(i)
            todo.discard(i)
            yield i, result
        for i in held:  # these were being computed when a process died
            deaths[i] += 1
        if not held:
            continue
        _report(len(held), "a worker process")
        for i in held:
            if deaths[i] >= MOST_DEATHS and held == {i}:
                todo.discard(i)
                yield i, _given_up(deaths[i])


def _round(
    function: Callable[[Any], Any],
    items: Sequence[Any],
    batch: Sequence[int],
    jobs: int,
    held: set[int],
) -> Iterator[tuple[int, Any]]:
    """What comes back until a process dies; ``held``: what had been handed out."""
    import joblib
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    def tasks() -> Iterator[Any]:
        for i in batch:
            held.add(i)
            yield joblib.delayed(_call)(function, i, items[i])

    results: Any = None
    try:
        # one call a process at a time, no more in advance: else a death would blame the innocent
        with (
            joblib.parallel_config("loky", initializer=_end_with, initargs=(os.getpid(),)),
            _children_deaf_to_ctrl_c(),
        ):
            parallel = joblib.Parallel(
                n_jobs=jobs, batch_size=1, pre_dispatch=jobs, return_as="generator_unordered"
            )
            results = parallel(tasks())
        # a Ctrl-C that came meanwhile is heard here
        for result in results:  # noqa: UP028, 'yield from' would close them in our place
            yield result
    except TerminatedWorkerError:
        return
    finally:
        if results is not None:
            # who stops early, as by Ctrl-C, need not be told that work under way is given up
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                results.close()


def _call(function: Callable[[Any], Any], i: int, item: Any) -> tuple[int, Any]:
    return i, function(item)


def _end_with(parent: int) -> None:
    """End this worker soon after ``parent`` has: nobody else would take its results."""
    if os.name != "posix":
        return

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()


@contextmanager
def _children_deaf_to_ctrl_c() -> Iterator[None]:
    """Processes started inside do not hear Ctrl-C: who started them ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # whoever starts these unblocks the signal afterwards: they are there before it is blocked
    from multiprocessing.resource_tracker import ensure_running

    from joblib.externals.loky.backend import resource_tracker

    ensure_running()
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _report(n: int, who: str) -> None:
    LOG.warning(
        "%s ended unexpectedly (killed, or out of memory); what it did is run again (%d %s)",
        who, n, "call" if n == 1 else "calls at most",
    )  # fmt: skip


def _given_up(n: int) -> WorkerDied:
    return WorkerDied(
        f"it ended {n} worker processes one after the other (killed, or out of memory); "
        "expected a process that lives to the end: use fewer --jobs or a machine with more memory"
    )


# --------------------------------------------------------------------------- Dask


def _on_dask(
    function: Callable[[Any], Any], items: Sequence[Any], client: Any
) -> Iterator[tuple[int, Any]]:
    suspects: list[int] = []
    for i, result in _on_workers(function, items, range(len(items)), client):
        if isinstance(result, WorkerDied):
            suspects.append(i)  # perhaps only because it sat beside the culprit
        else:
            yield i, result
    for i in suspects:
        yield from _on_workers(function, items, [i], client)


def _on_workers(
    function: Callable[[Any], Any], items: Sequence[Any], batch: Iterable[int], client: Any
) -> Iterator[tuple[int, Any]]:
    from importlib import import_module

    distributed: Any = import_module("distributed")
    futures = {client.submit(_call, function, i, items[i], pure=False): i for i in batch}
    # asked again and again, distributed.wait would leave a waiter behind at every future each time,
    # gigabytes in an hour
    ended = distributed.as_completed(list(futures))
    waiting = set(futures)
    workers, seen_at = _workers(client), time.monotonic()
    try:
        while waiting:
            done = _some_done(ended)
            now = _workers(client)
            for address in sorted(workers - now) if client.status == "running" else ():
                _report(len(waiting), f"the Dask worker {address}")
            workers = now
            if workers or done:
                seen_at = time.monotonic()
            elif time.monotonic() - seen_at > NO_WORKER_SECONDS:
                raise CampaignError(
                    "--scheduler: expected workers, but the cluster has had none for "
                    f"{NO_WORKER_SECONDS:.0f} s; start some and go on with --resume"
                )
            for future in done:
                waiting.discard(future)
                try:
                    result = future.result()
                except distributed.KilledWorker as error:
                    result = futures[future], _given_up(1 + error.allowed_failures)
                future.release()
                yield result
    finally:
        if client.status == "running":
            client.cancel(list(waiting))


def _workers(client: Any) -> set[str]:
    return set(client.scheduler_info(n_workers=-1)["workers"])


def _some_done(ended: Any) -> list[Any]:
    """The futures that have ended, after a wait of at most half a second."""
    until = time.monotonic() + 0.5
    while not ended.has_ready() and time.monotonic() < until:
        time.sleep(0.01)
    found: list[Any] = ended.next_batch(block=False)
    return found
