"""Records to a file and back, to the last digit; what others put there is not run."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError, SideInformation
from bayes_sensor.io.array_archive import load_archive, save_archive
from bayes_sensor.io.record_archive import load_record, save_record
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.rig.named_values import unit_of
from tests.support.campaigns import paper_design, small_problem


def same(a: Any, b: Any) -> bool:
    """Whether two trees are the same, types, order and bits."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return repr(a) == repr(b)


def test_every_kind_of_value(tmp_path: Path) -> None:
    value = {
        "text": "tau $", "none": None, "flags": (True, False), "numbers": [1, 0.1, -3.5e-300],
        "special": [float("nan"), float("inf"), -float("inf")],
        3: "three", (1, "a"): np.float32(0.1),
        "arrays": [np.arange(5), np.array([[0.1, np.nan]]), np.array(["a", "bc"]), np.zeros(0)],
        "records": [Noise("constant"), SideInformation(1.0, 0.1)], "function": unit_of,
        "$": {"$": "known"}, "set": frozenset({"a"}), "np": np.int64(7),
    }  # fmt: skip
    save_record(tmp_path / "r.npz", value)
    assert same(load_record(tmp_path / "r.npz", "thing"), value)


def test_times_on_a_grid_are_kept_as_three_numbers(tmp_path: Path) -> None:
    campaign = paper_design()
    assert len(campaign["1"].t) == 120_000
    save_record(tmp_path / "r.npz", campaign)
    again = load_record(tmp_path / "r.npz", "campaign")
    for ours, theirs in zip(again, campaign, strict=True):
        np.testing.assert_array_equal(ours.t, theirs.t)
    assert (tmp_path / "r.npz").stat().st_size < 20_000
    uneven = np.cumsum(np.random.default_rng(1).random(5000))
    save_record(tmp_path / "u.npz", uneven)
    np.testing.assert_array_equal(load_record(tmp_path / "u.npz", "times"), uneven)


def test_what_both_sides_have_is_not_written(tmp_path: Path) -> None:
    problem, _ = small_problem()
    known = {"experiments": problem.campaign.experiments}
    save_record(tmp_path / "r.npz", problem, known)
    again = load_record(tmp_path / "r.npz", "problem", known)
    assert again.campaign.experiments is problem.campaign.experiments
    assert (tmp_path / "r.npz").stat().st_size < 3000
    with pytest.raises(CampaignError, match="cannot be read"):
        load_record(tmp_path / "r.npz", "problem")


def test_what_is_not_ours_is_not_written(tmp_path: Path) -> None:
    @dataclass
    class Foreign:
        a: int = 1

    for value in (Foreign(), lambda: 1, os, np.array([object()]), 1 + 2j):
        with pytest.raises(TypeError):
            save_record(tmp_path / "r.npz", value)
        assert not (tmp_path / "r.npz").exists()


@pytest.mark.parametrize(
    "tree",
    [
        {"$": "function", "of": "os:system"},
        {"$": "record", "of": "subprocess:Popen", "fields": {"args": ["true"]}},
        {"$": "record", "of": "bayes_sensor.campaign:np", "fields": {}},
        {"$": "function", "of": "bayes_sensor.io.disk:shutil.rmtree"},
        {"$": "record", "of": "bayes_sensor.io.results:Results", "fields": {"folder": "x"}},
        {"$": "record", "of": "bayes_sensor.nothing:Here", "fields": {}},
        {"$": "record", "of": "bayes_sensor.likelihood.noise:Noise", "fields": {"colour": "pink"}},
        {"$": "record", "of": "bayes_sensor.likelihood.noise:Noise", "fields": {"variance": "x"}},
        {"$": "array", "name": "none"},
        {"$": "magic"},
        {"no": "kind"},
        {"$": "mapping", "items": [[1]]},
        {"$": "even", "is": [0.0]},
    ],
)
def test_what_others_wrote_is_refused(tmp_path: Path, tree: Any) -> None:
    save_archive(tmp_path / "r.npz", {"version": 1, "record": tree}, {})
    with pytest.raises(CampaignError, match=r"expected a saved thing of this version, but it"):
        load_record(tmp_path / "r.npz", "thing")


def test_damage_is_told(tmp_path: Path) -> None:
    path = tmp_path / "r.npz"
    save_record(path, [np.random.default_rng(1).random(1000)])
    facts, _ = load_archive(path, "thing")
    assert json.dumps(facts)
    content = path.read_bytes()
    for n in (0, 10, len(content) // 2, len(content) - 5):
        path.write_bytes(content[:n])
        with pytest.raises(CampaignError, match="cannot be read"):
            load_record(path, "thing")
    for at in range(40, len(content), 301):  # a bit is turned over
        path.write_bytes(content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :])
        try:
            load_record(path, "thing")
        except CampaignError:
            continue
    save_archive(path, {"version": 99, "record": None}, {})
    with pytest.raises(CampaignError, match="version 99"):
        load_record(path, "thing")
