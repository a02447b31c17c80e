"""What a terminal shows: lines, tables, progress bars, and silence."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout

Progress = Callable[[float, str], None]


@contextmanager
def progress_bar(label: str, quiet: bool) -> Iterator[Progress]:
    """A bar on stderr; nothing if stderr is not a terminal."""
    if quiet or not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    # a descriptor of its own: it goes on while everything else is muted; names of experiments may
    # hold letters that it cannot show
    screen = os.fdopen(os.dup(2), "w", encoding=sys.stderr.encoding, errors="backslashreplace")
    bar = Progress(
        TextColumn("{task.description:<12}"),
        BarColumn(),
        TextColumn("{task.fields[word]}"),
        TimeElapsedColumn(),
        console=Console(file=screen),
        transient=True,
    )
    with screen, bar:
        task = bar.add_task(label, total=1.0, word="")
        yield lambda fraction, text: bar.update(task, completed=fraction, word=escape(text[:40]))


@contextmanager
def muted() -> Iterator[None]:
    """Suppresses output of this process and of those it starts; exceptions pass.

    emcee prints the arguments of any call that was stopped, also by Ctrl-C, in every process.
    """
    sink = io.StringIO()
    sys.stdout.flush()
    sys.stderr.flush()
    kept, null = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 1)
        os.dup2(null, 2)
        with redirect_stdout(sink), redirect_stderr(sink):
            yield
    finally:
        for descriptor, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(null)


def say(text: str, quiet: bool) -> None:
    """A line on stdout unless quiet."""
    if not quiet:
        print(text, flush=True)


def lined_up(rows: Sequence[Sequence[str]], left: int = 0) -> list[str]:
    """Rows of cells as lines with aligned columns; the first ``left`` columns stand to the left.

    >>> lined_up([["Q", "tau"], ["12", "5 ms"]], left=1)
    ['Q    tau', '12  5 ms']
    """
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines
