"""The disk: files whole, and nothing outside a results folder read, changed or removed by it."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bayes_sensor
from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.cli import exit_code
from bayes_sensor.fit.samples import save_samples
from bayes_sensor.fit.traces import save_traces
from bayes_sensor.io.disk import remove, replacing, write_bytes, write_text
from bayes_sensor.io.json_files import read_json, write_json
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import VOID, Results
from bayes_sensor.io.writers import write_campaign
from bayes_sensor.likelihood.mesh.node_sums import one_process
from bayes_sensor.posterior import sample_posterior, save_draws
from bayes_sensor.posterior.checkpoints import Checkpoint
from tests.support.campaigns import small_problem

PACKAGE = Path(bayes_sensor.__file__).parent


def run(*arguments: str | Path) -> int:
    return exit_code([str(a) for a in arguments])


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A folder of the user's that no results folder may reach."""
    folder = tmp_path / "outside"
    (folder / "figures").mkdir(parents=True)
    for name in ("thesis.tex", "figures/a.svg", "run.json", "ensemble-0-00000.npz"):
        (folder / name).write_text("mine")
    return folder


def whole(outside: Path) -> bool:
    files = [p for p in outside.rglob("*") if p.is_file()]
    return len(files) == 4 and all(p.read_text() == "mine" for p in files)


def links(folder: Path) -> list[Path]:
    return [p for p in folder.rglob("*") if p.is_symlink()]


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A results folder with a complete stage, as a killed run leaves it."""
    folder = tmp_path / "out"
    (folder / ".complete").mkdir(parents=True)
    (folder / ".complete" / "fit.json").write_text('"new"')
    return folder


# --- what a folder says


@pytest.mark.parametrize(
    "content",
    [
        json.dumps(["{outside}/thesis.tex", "../outside/thesis.tex", "notes.txt", "fit.json",
                    "figures/../../outside/thesis.tex", ".lock", "", ".", 3, None, ["gap.json"]]),
        '{"../outside/thesis.tex": 1}', '"../outside/thesis.tex"', "[", "",
    ],
)  # fmt: skip
def test_only_results_that_a_run_makes_void_are_removed(
    out: Path, outside: Path, content: str
) -> None:
    (out / "notes.txt").write_text("mine")
    (out / ".complete" / ".drop.json").write_text(content.replace("{outside}", str(outside)))
    with Results(out).locked():
        pass
    assert whole(outside) and (out / "notes.txt").read_text() == "mine"
    assert read_json(out / "fit.json") == "new"
    assert not [p for p in out.iterdir() if p.name.startswith(".")]


def test_results_that_are_void_are_removed_and_links_of_their_names_not_followed(
    out: Path, outside: Path
) -> None:
    (out / ".complete").rename(out.parent / "later")
    with Results(out).writing() as stage:
        for name in VOID[2:-1]:
            stage.text(name, "old")
        put_run(stage, "fit", CommandClock(), seed=1, settings={})
    (out / VOID[-1]).write_text("mine")  # no run wrote it
    (out.parent / "later").rename(out / ".complete")
    (out / VOID[0]).symlink_to(outside / "thesis.tex")
    (out / VOID[1]).mkdir()  # no result
    (out / ".complete" / ".drop.json").write_text(json.dumps(VOID))
    with Results(out).locked():
        pass
    kept = sorted(["fit.json", "run.json", VOID[0], VOID[1], VOID[-1]])
    assert whole(outside) and sorted(p.name for p in out.iterdir()) == kept


def test_a_run_that_would_remove_or_replace_anything_else_is_a_mistake(tmp_path: Path) -> None:
    results = Results(tmp_path)
    with pytest.raises(ValueError, match=r"notes\.txt: not in VOID"), results.writing() as stage:
        stage.drop.append("notes.txt")
    with pytest.raises(ValueError, match="thesis: not in VOID"), results.writing() as stage:
        stage.path("thesis").mkdir()
    assert list(tmp_path.iterdir()) == []


def test_links_on_a_complete_stage_are_not_followed(out: Path, outside: Path) -> None:
    complete = out / ".complete"
    (complete / "posterior.json").symlink_to(outside / "thesis.tex")
    (complete / "figures").mkdir()
    (complete / "figures" / "b.svg").write_text("new")
    (complete / "figures" / "deep").symlink_to(outside)
    (complete / "figures" / "c.svg").symlink_to(outside / "thesis.tex")
    (complete / "verdicts").symlink_to(outside)
    with Results(out).locked():
        pass
    assert whole(outside) and not links(out)
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*")) == [
        "figures", "figures/b.svg", "fit.json",
    ]  # fmt: skip


def test_what_no_run_makes_is_not_moved(out: Path) -> None:
    complete = out / ".complete"
    for folder in (out, complete):
        (folder / "thesis").mkdir()
        (folder / "thesis" / folder.name).write_text("")
    for name in (".complete", ".stage-a"):  # they would be moved onto what they lie in
        (complete / name).mkdir()
        (complete / name / "fit.json").write_text('"nested"')
    (complete / ".lock").write_text("{}")
    with Results(out).locked():
        assert json.loads((out / ".lock").read_text())["pid"] == os.getpid()
    assert [p.name for p in (out / "thesis").iterdir()] == ["out"]
    assert read_json(out / "fit.json") == "new"
    assert sorted(p.name for p in out.iterdir()) == ["fit.json", "thesis"]


@pytest.mark.parametrize("name", [".complete", ".stage-a", ".old-a", ".old-figures", "figures"])
@pytest.mark.parametrize("leads", ["outside", "nowhere"])
def test_a_link_in_place_of_a_folder_of_ours_is_not_followed(
    tmp_path: Path, outside: Path, name: str, leads: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(tmp_path / leads)

    def save(text: str) -> None:
        with Results(out).locked(), Results(out).writing() as stage:
            stage.json("fit.json", text)
            stage.path("figures").mkdir()
            (stage.path("figures") / f"{text}.svg").write_text(text)
            put_run(stage, "fit", CommandClock(), seed=1, settings={})

    if name == "figures":  # somebody's own
        with pytest.raises(CampaignError, match="figures that no run wrote"):
            save("old")
        assert (out / name).is_symlink() and whole(outside)
        return
    save("old")
    save("new")
    assert whole(outside) and not (tmp_path / "nowhere").exists()
    assert read_json(out / "fit.json") == "new"
    assert not (out / "figures").is_symlink()
    assert [p.name for p in (out / "figures").iterdir()] == ["new.svg"]


# --- the lock


@pytest.mark.parametrize("kind", ["link", "dangling", "hard link", "pipe"])
def test_a_lock_is_written_to_no_other_file(
    tmp_path: Path, outside: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, lock = tmp_path / "out", tmp_path / "out" / ".lock"
    out.mkdir()
    if kind == "hard link":
        os.link(outside / "thesis.tex", lock)
    elif kind == "pipe":
        os.mkfifo(lock)
    else:
        lock.symlink_to(outside / ("thesis.tex" if kind == "link" else "new.tex"))
    assert run("diffusion", "--out", out) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and f"{lock}: expected the lock file of a run" in said
    assert "remove it" in said
    assert whole(outside) and os.path.lexists(lock)


def test_the_lock_of_compiled_code_truncates_nothing(tmp_path: Path, outside: Path) -> None:
    (tmp_path / "kernels.lock").symlink_to(outside / "thesis.tex")
    with one_process(tmp_path):
        assert whole(outside)
    assert whole(outside)


def test_compiled_code_waits_for_the_process_that_compiles(tmp_path: Path) -> None:
    code = (
        "import sys; from bayes_sensor.likelihood.mesh.node_sums import one_process\n"
        "with one_process(sys.argv[1]):\n    print('held', flush=True)"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with one_process(tmp_path):
        other = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        with pytest.raises(subprocess.TimeoutExpired):
            other.communicate(timeout=4.0)
    assert other.communicate(timeout=60.0)[0] == "held\n"


# --- writers


def _save_posterior(path: Path) -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    save_draws.save_posterior(sample_posterior(problem, theta, sampler="independence"), path)


def _one(i: int) -> dict[str, Any]:
    return {"i": i}


WRITERS: dict[str, Callable[[Path], Any]] = {
    "a.txt": lambda path: write_text(path, "new"),
    "a.bin": lambda path: write_bytes(path, b"new"),
    "a.json": lambda path: write_json(path, "new"),
    "traces.npz": lambda path: save_traces(path, []),
    "samples.npz": lambda path: save_samples(path, []),
    "ensemble-0-00001.npz": lambda path: Checkpoint(path.parent, "d", False).write(
        0, 1, np.ones(1), (np.ones(1), np.ones(1), ("MT19937", np.ones(1), 0, 0, 0.0)), 0.5
    ),
    "chunk-000000-000002.npz": lambda path: run_chunks(_one, 2, path.parent, "key"),
    "posterior.nc": _save_posterior,
    "campaign.toml": lambda path: write_campaign(small_problem()[0].campaign, path.parent),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_no_writer_writes_through_a_link(tmp_path: Path, outside: Path, name: str) -> None:
    path = tmp_path / "out" / name
    path.parent.mkdir()
    # the result itself, and the names that could be foreseen, those of markers beside it too
    foreseen = [f".{n}.{os.getpid()}" for n in (name, "run.json", "study.json")]
    for own in (name, *foreseen, *(f"{n}.part" for n in foreseen)):
        (path.parent / own).symlink_to(outside / "thesis.tex")
    WRITERS[name](path)
    assert whole(outside)
    assert path.is_file() and not path.is_symlink()


def test_all_files_are_replaced_in_one_way() -> None:
    text = {p.relative_to(PACKAGE).as_posix(): p.read_text() for p in PACKAGE.rglob("*.py")}
    assert {name for name in text if "os.replace(" in text[name]} == {"io/disk.py", "io/results.py"}
    assert not [name for name in text if ".part" in text[name] and "getpid" in text[name]]


def test_a_write_that_fails_leaves_what_was(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def half() -> None:
        with replacing(path) as new:
            new.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        half()
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("a.txt", "old")]


def test_a_file_has_the_permissions_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "usual").touch()
    write_text(tmp_path / "ours", "")
    modes = [(tmp_path / name).stat().st_mode for name in ("usual", "ours")]
    assert modes[0] == modes[1]


def test_a_link_is_removed_and_not_what_it_leads_to(tmp_path: Path, outside: Path) -> None:
    (tmp_path / "link").symlink_to(outside)
    remove(tmp_path / "link")
    assert whole(outside) and not os.path.lexists(tmp_path / "link")


# --- folders that commands keep inside


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("campaign")
    options = ["--experiments", "1,4", "--duration", "15 s", "--interval", "20 ms"]
    assert run("simulate", "--out", folder, *options, "--quiet") == 0
    return folder / "campaign.toml"


@pytest.mark.parametrize(
    ("command", "folder"),
    [
        ("posterior", "checkpoint"), ("coverage", "coverage-parts"),
        ("blind-check", "blind-check-parts"), ("fleet", "campaigns"),
    ],
)  # fmt: skip
def test_a_link_in_place_of_a_kept_folder_is_refused(
    tmp_path: Path, outside: Path, campaign: Path, command: str, folder: str,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    out = tmp_path / "out"
    out.mkdir()
    (out / folder).symlink_to(outside)
    (tmp_path / "list.txt").write_text(f"{campaign}\n")
    given = {"posterior": [campaign], "fleet": [tmp_path / "list.txt"]}.get(command, [])
    few = {"coverage": ["--campaigns", "1"], "blind-check": ["--cases", "1"]}.get(command, [])
    assert run(command, *given, "--out", out, "--quiet", *few) == 2
    said = capsys.readouterr().err
    assert f"{out / folder}: expected a folder, but it is a symbolic link" in said
    assert said.count("\n") == 1 and whole(outside)


def test_a_link_in_place_of_a_campaigns_results_fails_that_campaign_alone(
    tmp_path: Path, outside: Path, campaign: Path
) -> None:
    (tmp_path / "list.toml").write_text(f'[[campaign]]\nname = "a"\nfile = "{campaign}"\n')
    (tmp_path / "out" / "campaigns").mkdir(parents=True)
    (tmp_path / "out" / "campaigns" / "a").symlink_to(outside)
    assert run("fleet", tmp_path / "list.toml", "--out", tmp_path / "out", "--quiet") == 3
    (row,) = Results(tmp_path / "out").json("fleet.json")["campaigns"]
    assert row["status"] == "failed" and "symbolic link" in row["message"]
    assert whole(outside)


def test_a_simulation_takes_no_link_for_a_free_name(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "campaign.toml").symlink_to(tmp_path / "unmounted" / "campaign.toml")
    options = ["--experiments", "1", "--duration", "15 s", "--interval", "20 ms", "--quiet"]
    assert run("simulate", "--out", out, *options) == 2
    assert (out / "campaign.toml").is_symlink()


def test_a_results_folder_may_itself_be_reached_by_a_link(tmp_path: Path) -> None:
    (tmp_path / "large").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "large")
    with Results(tmp_path / "out").locked(), Results(tmp_path / "out").writing() as stage:
        stage.json("fit.json", "new")
    assert [p.name for p in (tmp_path / "large").iterdir()] == ["fit.json"]


def test_the_message_names_where_a_link_leads(tmp_path: Path, outside: Path) -> None:
    (tmp_path / "checkpoint").symlink_to(outside)
    with pytest.raises(CampaignError, match=f"link to {outside}.*remove the link"):
        Results(tmp_path).own_folder("checkpoint")
