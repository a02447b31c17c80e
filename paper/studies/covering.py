"""A pytest plugin that notes which test runs which line, and how long each test takes.

Load it with ``-p covering`` under ``coverage run``.  Each test is a context of the measurement;
what a fixture shared by several tests runs is a context ``fixture NAME``, and the tests that ask
for it are noted.  ``COVERING_NOTES`` names the file for the notes (JSON: per test its seconds, its
outcome and its shared fixtures), ``COVERING_LIMIT`` the CPU seconds after which a test is left (it
counts as skipped: without compilation some take minutes).
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import coverage
import pluggy
import pytest

_notes: dict[str, dict[str, Any]] = {}
_running = ""


def _switch(context: str) -> None:
    measured = coverage.Coverage.current()
    if measured is not None:
        measured.switch_context(context)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Every test its own context, and at most so many seconds."""
    global _running
    _running = item.nodeid
    _notes[item.nodeid] = {
        "seconds": 0.0, "outcome": "passed", "fixtures": list(getattr(item, "fixturenames", ())),
    }  # fmt: skip
    _switch(item.nodeid)
    try:
        return (yield)
    finally:
        _running = ""
        _switch("")


def _within_coverage(frame: FrameType | None) -> bool:
    """Whether what a test runs at the moment is coverage.py itself."""
    own, hooks = (os.path.dirname(module.__file__) for module in (coverage, pluggy))
    while frame is not None and not frame.f_code.co_filename.startswith(hooks):
        if frame.f_code.co_filename.startswith(own):
            return True
        frame = frame.f_back  # up to where pytest called the test: below is coverage.py again
    return False


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """The test itself, left when its time is over."""
    limit = float(os.environ.get("COVERING_LIMIT", "0"))

    def leave(_number: int, frame: FrameType | None) -> None:
        if _within_coverage(frame):  # it may hold a lock, which nobody would give back
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.05)
        else:
            pytest.skip(f"left after {limit:g} s")

    before = signal.signal(signal.SIGVTALRM, leave) if limit else None
    signal.setitimer(signal.ITIMER_VIRTUAL, limit)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        if limit:
            signal.signal(signal.SIGVTALRM, before)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: Any) -> Iterator[Any]:
    """What is made once for several tests belongs to all of them."""
    shared = fixturedef.scope != "function"
    if shared:
        _switch(f"fixture {fixturedef.argname}")
    try:
        return (yield)
    finally:
        if shared:
            _switch(_running)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Seconds of set-up, call and tear-down together; the worst outcome."""
    note = _notes[report.nodeid]
    note["seconds"] += report.duration
    if report.outcome != "passed":
        note["outcome"] = report.outcome


def pytest_sessionfinish() -> None:
    """The notes, written once."""
    path = os.environ.get("COVERING_NOTES")
    if path:
        Path(path).write_text(json.dumps(_notes, indent=1), encoding="utf-8")
