"""Results folders: complete files or none, one writer, envelopes that keep the extremes."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.fit.traces import BINS_WHOLE, envelope, load_traces, make_traces, save_traces
from bayes_sensor.io.json_files import plain, read_json, write_json
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import Results, StagingFolder
from bayes_sensor.io.run_record import run_record
from bayes_sensor.rig.layout import Layout


def test_json_holds_neither_nan_nor_infinity(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"x": [np.nan, np.inf, 1.5], "n": np.int64(3), "flag": np.bool_(True), "β": 1})
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == {"x": [None, None, 1.5], "n": 3, "flag": True, "β": 1}
    assert "β" in text
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_what_json_cannot_hold_is_named() -> None:
    with pytest.raises(TypeError, match=r"result\.a\[1\]: a object"):
        plain({"a": [1, object()]})


@pytest.mark.parametrize("content", [None, "{", '{"a": '])
def test_a_damaged_result_is_reported_with_its_file(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "fit.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(CampaignError, match=r"fit\.json: .*expected a saved result"):
        read_json(path)


def _half(stage: StagingFolder) -> None:
    stage.json("fit.json", {"n": 2})
    stage.json("bad.json", object())


def test_results_are_replaced_together_or_not_at_all(tmp_path: Path) -> None:
    results = Results(tmp_path / "out")
    with results.writing() as stage:
        stage.json("fit.json", {"n": 1})
        stage.path("figures").mkdir()
        (stage.path("figures") / "a.svg").write_text("old")
        put_run(stage, "fit", CommandClock(), seed=1, settings={})
    with pytest.raises(TypeError, match="no place in JSON"), results.writing() as stage:
        _half(stage)
    assert read_json(tmp_path / "out" / "fit.json") == {"n": 1}
    with results.writing() as stage:
        stage.json("fit.json", {"n": 3})
        stage.path("figures").mkdir()
        (stage.path("figures") / "b.svg").write_text("new")
    assert read_json(tmp_path / "out" / "fit.json") == {"n": 3}
    assert sorted(p.name for p in results.path("figures").iterdir()) == ["b.svg"]
    assert sorted(p.name for p in results.folder.iterdir()) == ["figures", "fit.json", "run.json"]


OTHERS = ("written by hand", "changed since", "a link", "a folder", "inside")


@pytest.mark.parametrize("kind", OTHERS)
def test_what_no_run_wrote_is_neither_replaced_nor_removed(tmp_path: Path, kind: str) -> None:
    results, outside = Results(tmp_path / "out"), tmp_path / "thesis.tex"
    outside.write_text("mine")

    def save() -> None:
        with results.locked(), results.writing() as stage:
            stage.json("fit.json", {"n": 1})
            stage.path("figures").mkdir()
            (stage.path("figures") / "a.svg").write_text("ours")
            stage.drop.append("gap.json")
            put_run(stage, "fit", CommandClock(), seed=1, settings={})

    with results.writing() as stage:
        stage.json("gap.json", "ours" if kind == "inside" else "")
        put_run(stage, "gap", CommandClock(), seed=1, settings={})
    path = results.path("fit.json")
    if kind != "written by hand":
        save()
        assert not results.has("gap.json")
    if kind == "inside":
        path = results.path("figures") / "photo.png"
    elif kind != "written by hand":
        path.unlink()
    if kind == "a link":
        path.symlink_to(outside)
    elif kind == "a folder":
        path.mkdir()
        (path / "deep.txt").write_text("mine")
    else:
        path.write_text("mine")
    before = (path / "deep.txt" if kind == "a folder" else path).read_text()
    with pytest.raises(CampaignError, match=r"that no run wrote, or that was changed since"):
        save()
    steps = ("fit", "report")
    with pytest.raises(CampaignError, match="choose another"), results.locked(steps=steps):
        pass
    assert (path / "deep.txt" if kind == "a folder" else path).read_text() == before == "mine"
    assert not [p.name for p in results.folder.iterdir() if p.name.startswith(".")]


def test_unfinished_parts_are_cleared_and_nothing_else(tmp_path: Path) -> None:
    results, parts = Results(tmp_path), tmp_path / "checkpoint" / "sealing"
    mine = tmp_path / "checkpoint" / "model.pt"
    parts.mkdir(parents=True)
    for name in ("study.json", "chunk-000000-000004.npz", ".chunk-x.part"):
        (parts / name).write_text("")
    mine.write_text("mine")
    results.clear("checkpoint")
    assert [p.name for p in mine.parent.iterdir()] == ["model.pt"]
    mine.unlink()
    results.clear("checkpoint")
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_run_left_on_its_stage_is_cleared(tmp_path: Path) -> None:
    (tmp_path / ".stage-dead").mkdir()
    (tmp_path / ".stage-dead" / "fit.json").write_text("{")
    with Results(tmp_path).writing() as stage:
        stage.json("fit.json", {})
    assert [p.name for p in tmp_path.iterdir()] == ["fit.json"]


def test_a_failure_leaves_no_empty_folder_behind(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="bad"), Results(tmp_path / "a" / "b").locked():
        raise CampaignError("bad")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    code = (
        "import sys; from bayes_sensor.io.results import Results\n"
        "with Results(sys.argv[1]).locked():\n    print('held', flush=True); sys.stdin.read()"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    with holder:
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        with (
            pytest.raises(CampaignError, match="another bayes-sensor is writing there"),
            Results(tmp_path).locked(),
        ):
            pass
        holder.communicate("")
    with Results(tmp_path).locked():
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    with (
        pytest.raises(
            CampaignError, match=r"--out .*out: .*cannot be written there \(it is a file\)"
        ),
        Results(tmp_path / "out").locked(),
    ):
        pass


@given(
    n=st.integers(1, 400),
    bins=st.integers(1, 50),
    seed=st.integers(0, 100),
)
def test_an_envelope_keeps_extremes_and_mean(n: int, bins: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, y, model = np.arange(n) * 0.1, rng.standard_normal(n), rng.standard_normal(n)
    e = envelope(t, y, model, np.ones(n), bins)
    assert len(e.t) <= bins if n > bins else len(e.t) == n
    assert e.low.min() == y.min() and e.high.max() == y.max()
    assert e.residual_low.min() == (y - model).min()
    assert (np.diff(e.t) > 0).all()
    assert (e.low <= e.high).all()


def small_campaign() -> tuple[Campaign, dict]:
    t = np.arange(2000) * 0.01
    up = Experiment("up", t, np.zeros(2000), 60.0, 15.0, 0.01, commanded_on=4.5)
    both = Experiment("both", t, np.ones(2000), 90.0, 15.0, 0.01, 4.5, 12.0)
    own = {"y0_V": 0.1, "beta_V": 1.0, "t0_s": 5.0}
    theta = {
        "tau_s": 0.05, "tau_v_s": 0.5, "V_mL": 60.0, "phi": 0.2, "sigma0_V": 0.01, "sigma1_V": 0.0,
        "experiments": {"up": own, "both": {**own, "tf_s": 12.5}},
    }  # fmt: skip
    return Campaign("two", (up, both)), theta


def test_traces_come_back_as_they_were_saved(tmp_path: Path) -> None:
    campaign, theta = small_campaign()

    class Fit:
        theta_hat = Layout.of(campaign).flat(theta)

    traces = make_traces(campaign, Fit())
    save_traces(tmp_path / "traces.npz", traces)
    back = load_traces(tmp_path / "traces.npz")
    assert [b.name for b in back] == ["up", "both"]
    assert back[0].fall is None and back[1].fall is not None
    assert back[1].tf == 12.5 and len(back[0].whole.t) <= BINS_WHOLE
    # single precision: seven digits
    np.testing.assert_allclose(back[0].rise.model, traces[0].rise.model, rtol=2e-7, atol=1e-9)
    assert back[0].rise.t[0] <= 4.5 < 5.0 < back[0].rise.t[-1]


def test_traces_keep_their_times_on_any_clock(tmp_path: Path) -> None:
    campaign, theta = small_campaign()
    later = 1.7e9
    both = campaign["both"]
    moved = replace(
        both, t=both.t + later, commanded_on=4.5 + later, commanded_off=12.0 + later
    )  # fmt: skip

    class Fit:
        theta_hat = Layout.of(campaign).flat(theta)

    # tau, tau_v, V; up: y0, beta, t0; both: y0, beta, t0, tf; noise
    Fit.theta_hat = np.delete(Fit.theta_hat, [3, 4, 5])
    Fit.theta_hat[5:7] += later
    (trace,) = make_traces(Campaign("one", (moved,)), Fit())
    save_traces(tmp_path / "traces.npz", [trace])
    (back,) = load_traces(tmp_path / "traces.npz")
    assert back.fall is not None and trace.fall is not None
    for found, made in ((back.rise, trace.rise), (back.fall, trace.fall)):
        np.testing.assert_allclose(found.t, made.t, rtol=0, atol=1e-5)


def test_damaged_traces_are_reported(tmp_path: Path) -> None:
    (tmp_path / "traces.npz").write_bytes(b"PK\x03\x04 cut off")
    with pytest.raises(CampaignError, match=r"traces\.npz: expected saved traces"):
        load_traces(tmp_path / "traces.npz")


def test_the_record_keeps_the_newest_run_of_each_command() -> None:
    record = None
    for command, seed in (("fit", 1), ("posterior", 2), ("fit", 3)):
        record = run_record(
            record, command, basis="b", seed=seed, settings={}, campaign="c.toml", files={},
            started="now", seconds={"fit": 0.1234567}, exit_code=0, warnings=[],
        )  # fmt: skip
    assert record is not None and record["last"] == "fit"
    assert {k: v["seed"] for k, v in record["commands"].items()} == {"fit": 3, "posterior": 2}
    assert {"python", "bayes-sensor", "numpy"} <= set(record["commands"]["fit"]["versions"])
