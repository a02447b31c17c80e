"""A lock file that says who holds a folder, and is written to no file but its own.

The lock itself is filelock's, on every system.  Added are the owner's name, for whoever is refused,
and that a link, a second name of another file or a pipe in the lock's place is left as it is.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import stat
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from filelock import lock_descriptor

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.run_record import now

OPEN_FILES_STAY = os.name == "nt"
"""whether the system removes no file that is open"""


class Lock:
    """A lock file with the name of its owner; ``held`` says whether it is ours.

    Where the file system knows locks, the system gives them up when their owner ends, however it
    ends.  Where it does not, a lock is stale when its owner ran on this machine and is no more.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.handle: IO[str] | None = _open_lock(path)
        self.advice = ""
        try:
            self.held = self._take(self.handle)
            if self.held:
                self._sign(self.handle)
        except BaseException:
            self.handle.close()
            raise
        if not self.held:
            self.owner = self._owner()
            self.handle.close()
            self.handle = None

    def _take(self, handle: IO[str]) -> bool:
        with suppress(OSError):  # a file system without locks
            if not lock_descriptor(handle.fileno(), blocking=False):
                return False
            # the file may have been removed by its last owner since it was opened
            return os.fstat(handle.fileno()).st_nlink > 0
        record = self._record()
        if not record or record.get("pid") == os.getpid():
            return True
        self.advice = f"; if that run has ended, remove {self.path}"
        return record.get("host") == platform.node() and not _alive(int(record.get("pid", 0)))

    def _record(self) -> dict[str, Any]:
        from bayes_sensor.io.result_schema import read_result  # slow to import

        try:
            return dict(read_result(self.path))
        except CampaignError:  # not signed yet, or not ours
            return {}

    def _owner(self) -> str:
        record = self._record()
        if not record:
            return "it has not signed yet"
        return (
            f"process {record.get('pid')} on {record.get('host')}, "
            f"{record.get('command')}, since {record.get('since')}"
        )

    def _sign(self, handle: IO[str]) -> None:
        record = {
            "pid": os.getpid(),
            "host": platform.node(),
            "since": now(),
            "command": " ".join(["bayes-sensor", *sys.argv[1:2]]),
        }
        handle.truncate(0)
        handle.write(json.dumps(record))
        handle.flush()

    def release(self) -> None:
        """Give the folder free."""
        if self.handle is None:
            return
        if OPEN_FILES_STAY:
            self.handle.close()
        with suppress(PermissionError):  # there, too, while another process looks into it
            self.path.unlink(missing_ok=True)
        self.handle.close()
        self.handle = None


def _open_lock(path: Path) -> IO[str]:
    """A lock file open for appending; CampaignError where writing to it would change another."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT
    for name in ("O_NOFOLLOW", "O_NONBLOCK"):  # Windows has neither
        flags |= getattr(os, name, 0)
    found = ""
    try:
        descriptor = os.open(path, flags, 0o666)
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        found = f"a symbolic link to {os.readlink(path)}"
    else:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            found = "not a regular file"
        elif state.st_nlink > 1:
            found = "a hard link to another file"
        if not found:
            return os.fdopen(descriptor, "a+", encoding="utf-8")
        os.close(descriptor)
    raise CampaignError(
        f"{path}: expected the lock file of a run, but it is {found}, and a lock is written to no "
        "file but its own; remove it"
    )


def _alive(pid: int) -> bool:
    """Whether a process of this machine exists; where that cannot be known: yes."""
    if os.name != "posix" or pid <= 0:
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
