"""Damaged results folders: refused with one message, or used as they stand; nothing is executed."""

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.io.result_schema import SCHEMAS, read_result
from bayes_sensor.io.results import Results
from tests.support import bad_folders
from tests.support.bad_folders import (
    BYTES,
    JSON,
    NC,
    NPZ,
    PLACES,
    Case,
    Damage,
    files_of,
    kinds_of,
    try_case,
)

KINDS = [
    *((".json", kind) for kind in (*JSON, *BYTES)),
    *((".npz", kind) for kind in (*NPZ, *PLACES)),
    *((".nc", kind) for kind in NC),
]
"""every damage once, to a file of such an ending"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign, and the results of three commands on it."""
    place = tmp_path_factory.mktemp("folders")
    small = ["--experiments", "1,6", "--duration", "12 s", "--interval", "20 ms", "--quiet"]
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV", "--tau", "150 ms"]
    assert exit_code(["simulate", "--out", str(place / "c"), *small, *noise]) == 0
    (place / "quick.toml").write_text(
        "[fit]\nswarms = 1\nparticles = 10\neuler = false\n[posterior]\nn_chains = 2\n"
        "n_walkers = 32\nburn_in = 40\nchunk = 20\nmax_steps = 120\n"
    )
    for command in ("fit", "posterior", "delays"):
        options = ["--config", str(place / "quick.toml"), "--out", str(place / "analysed")]
        campaign = str(place / "c" / "campaign.toml")
        assert exit_code([command, campaign, *options, "--quiet"]) in (0, 3)
    return place


def test_a_damaged_folder_is_refused_or_used_as_it_stands(
    place: Path,
    tmp_path: Path,
    import_study: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bad_folders, "ZEROS", 3_000_000)  # still more than any archive may hold
    run = import_study("study_folders").runner(place)
    bases = {"analysed": place / "analysed"}
    files = files_of(bases["analysed"])
    ended: dict[str, int] = {}
    failures = []
    for i, (ending, kind) in enumerate(KINDS):
        rng = np.random.default_rng([7, i])
        file = str(rng.choice([file for file in files if file.endswith(ending)]))
        case = Case("analysed", "report" if i % 3 else "bs.load", file, kind)
        try:
            outcome = try_case(case, bases, run, tmp_path / "x", rng)
        except Damage as error:
            failures.append(f"{case}: {error}")
            continue
        ended[outcome] = ended.get(outcome, 0) + 1
    assert not failures, "\n".join(failures)
    assert ended["refused"] > len(KINDS) / 4 and ended["used"] > len(KINDS) / 10


@pytest.mark.parametrize("kind", ["pickled", "bomb", "lying", "reshaped", "facts_edited"])
@pytest.mark.parametrize("file", ["traces.npz", "fit_record.npz"])
def test_an_archive_is_not_unpacked_before_it_is_looked_at(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, file: str
) -> None:
    import bayes_sensor as bs

    monkeypatch.setenv("BAD_FOLDERS", str(tmp_path))
    monkeypatch.setattr(bad_folders, "ZEROS", 3_000_000)
    out = tmp_path / "out"
    out.mkdir()
    for each in (place / "analysed").iterdir():
        if each.is_file():
            (out / each.name).write_bytes(each.read_bytes())
    content = kinds_of(file)[kind]((out / file).read_bytes(), np.random.default_rng(2))
    (out / file).write_bytes(content)
    with pytest.raises(CampaignError, match=rf"{file}: expected") as told:
        bs.load(out)
    assert "pickle" not in str(told.value) and not (tmp_path / "executed").exists()


@pytest.mark.parametrize("version", [999, 0, None, "1"])
def test_a_folder_of_another_version_is_refused(
    place: Path, tmp_path: Path, version: object, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("run.json", "campaign.json"):
        (tmp_path / name).write_bytes((place / "analysed" / name).read_bytes())
    run = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps({**run, "version": version}))
    assert exit_code(["report", str(tmp_path), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "run.json: expected" in said and "version: input should be 1" in said


def test_everything_that_a_run_writes_has_its_schema(place: Path) -> None:
    results = Results(place / "analysed")
    names = {p.name for p in results.folder.glob("*.json")}
    assert len(names) > 5 and names <= {*SCHEMAS}
    for name in names:
        assert read_result(results.path(name)) == json.loads(results.path(name).read_text())
