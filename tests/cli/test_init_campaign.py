"""``init`` and ``check --plot`` as commands: files, exit codes, and what a terminal is told."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from bayes_sensor.cli import exit_code

T = np.round(0.05 * np.arange(800), 6)


def run(*arguments: str | Path) -> int:
    """The exit code of a command, in this process."""
    return exit_code([str(a) for a in arguments])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three exports of a pulse."""
    rng = np.random.default_rng(5)
    for i in range(3):
        x = np.where((T > 10.0) & (T < 25.0), 1.0, 0.0) + rng.normal(0.0, 0.02, len(T))
        rows = [f"{t:.6g},{y:.6g}" for t, y in zip(T, x)]
        (tmp_path / f"run{i}.csv").write_text("\n".join(["time_s,s_V", *rows]) + "\n")
    return tmp_path


def test_three_exports_become_a_campaign_that_is_checked_and_drawn(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "campaign.toml"
    assert run("init", folder) == 0
    said = capsys.readouterr().out
    assert said.count("run") >= 3 and "6 missing values, each marked in it" in said
    assert f"bayes-sensor check {path} --plot" in said
    assert run("check", path) == 2
    assert "carrier_flow, test_gas_flow of experiments 'run0'" in capsys.readouterr().err
    path.write_text(re.sub(r'"\? L/min"', '"2 L/min"', path.read_text()))
    assert run("check", path, "--plot") == 0
    assert f"drawn: {folder / 'check.png'}" in capsys.readouterr().out
    assert imread(folder / "check.png").shape[0] > 500
    assert run("check", path, "--plot", "--quiet") == 0
    (folder / "check.png").write_bytes(b"a photograph")
    assert run("check", path, "--plot", "--quiet") == 2
    assert (folder / "check.png").read_bytes() == b"a photograph"


@pytest.mark.parametrize(
    ("levels", "told"),
    [
        ((0, 1, 3, 2, 0), r"4 steps from 7\.\d+ s on"),
        ((0, 1, 0, 1, 0), r"on 7\.\d+ s and 1 more, off 15\.\d+ s and 1 more"),
    ],
)
def test_several_switches_are_told(
    levels: tuple[float, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x = np.repeat(levels, len(T) // len(levels))
    x = x + 0.002 * np.random.default_rng(1).standard_normal(len(T))
    rows = [f"{t:.6g},{y:.6g}" for t, y in zip(T, x)]
    (tmp_path / "a.csv").write_text("\n".join(["time_s,s_V", *rows]) + "\n")
    assert run("init", tmp_path) == 0
    assert re.search(f"a.csv, {told}", capsys.readouterr().out)


def test_what_is_there_is_replaced_only_when_told(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "campaign.toml"
    path.write_text("mine")
    assert run("init", folder) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "--overwrite" in said and path.read_text() == "mine"
    assert run("init", folder, "--overwrite", "--quiet") == 0
    assert capsys.readouterr().out == "" and "[[experiment]]" in path.read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_terminal_is_asked(folder: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "bayes_sensor", "init", folder], stdin=theirs, stdout=theirs,
        stderr=theirs, env={**os.environ, "NO_COLOR": "1"},
    )  # fmt: skip
    os.close(theirs)
    answers = ["1", "4 L/min", "0.5 L/min", "", "", "", "1 L/min", "", "faster"]
    os.write(ours, "".join(f"{answer}\n" for answer in answers).encode())
    assert process.wait(60) == 0
    said = os.read(ours, 100_000).decode()
    os.close(ours)
    assert "run0: carrier flow (such as 4.0 L/min)" in said and "run1: test gas flow [0.5" in said
    text = (folder / "campaign.toml").read_text()
    assert 'sensor_is = "faster"' in text and "MISSING:" in text.splitlines()[1]
    assert '"?' not in "".join(line.split("#")[0] for line in text.splitlines())
    assert text.count('carrier_flow = "4 L/min"') == 3
    assert text.count('test_gas_flow = "1 L/min"') == 1
    assert run("check", folder / "campaign.toml", "--quiet") == 0


@pytest.mark.slow
def test_no_colour_is_written_where_there_is_no_terminal(folder: Path) -> None:
    environment = {**os.environ, "FORCE_COLOR": "1", "TERM": "xterm-256color"}
    for arguments in (["init", folder], ["init", folder], ["--help"], ["gap", "--help"]):
        done = subprocess.run(
            [sys.executable, "-m", "bayes_sensor", *arguments], capture_output=True,
            env=environment,
        )  # fmt: skip
        assert b"\x1b" not in done.stdout + done.stderr


def test_a_shell_is_told_how_to_complete() -> None:
    environment = {
        **os.environ, "_BAYES_SENSOR_COMPLETE": "complete_bash", "COMP_WORDS": "bayes-sensor in",
        "COMP_CWORD": "1",
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "bayes_sensor"], capture_output=True, text=True, env=environment
    )
    assert done.stdout.split() == ["init"]
