"""Other rigs of the simulator: nothing wrong, what acts there, their ideal model, their files."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.blind_check.closed_shares import closed_shares
from bayes_sensor.blind_check.detectability import ideal_fit, ideal_model, strength_for
from bayes_sensor.blind_check.plan import HIDING, Entry, draw_truth, make_plan
from bayes_sensor.blind_check.sealing import draw_cases
from bayes_sensor.blind_check.simulator import (
    CAUSES,
    OTHER_RIGS,
    PHASES,
    RESERVE_LAWS,
    Case,
    acting_places,
    clean_signals,
    has_meaning,
    make_campaign,
    other_rig,
    phase_spans,
    sample_times,
)
from bayes_sensor.io.json_files import read_json
from bayes_sensor.io.readers import read_campaign
from tests.blind_check.test_simulator import step_response

EVERY = [(kind, seed) for kind in OTHER_RIGS for seed in (3, 4)]


@pytest.mark.parametrize(("kind", "seed"), EVERY)
def test_with_nothing_wrong_it_is_a_chain_of_lags(kind: str, seed: int) -> None:
    rig = other_rig(kind, seed)
    for step in rig.steps:
        lags = {"valve": rig.tau_v, "sensor": rig.tau, rig.volume: rig.V / step.total_flow}
        taus = [lags[name] for name in rig.stages]
        x, level = 0.0, 0.0
        for switch in step.switches:
            x += (switch.level - level) * step_response(sample_times(step) - switch.at, taus)
            level = switch.level
        y = clean_signals(rig)[step.name]
        # a command without a valve's lag goes up within the first node, 0.1 ms
        assert np.abs(y - step.y0 - step.beta * x).max() < 2e-3 * step.beta, step.name


@pytest.mark.parametrize(("kind", "seed"), EVERY)
def test_a_rig_is_the_same_after_json_and_says_what_it_is(kind: str, seed: int) -> None:
    rig = other_rig(kind, seed, "pink")
    assert Case.from_json(rig.to_json()) == rig
    campaign = make_campaign(rig)
    assert campaign.stages == rig.stages and not rig.is_published
    assert campaign.flows_known == (kind != "sensor")
    for e, step in zip(campaign, rig.steps, strict=True):
        spans = phase_spans(rig, step)
        assert {phase for phase, _, _ in spans} == set(PHASES)
        assert spans[0][1] == 0.0 and spans[-1][2] == step.duration
        assert all(a[2] == b[1] for a, b in pairwise(spans))
        if step.programme:
            assert e.commands is not None and e.commanded_off is None
            assert e.commands.levels.tolist() == [each.level for each in step.programme]
            assert e.commands.delays == ("shared" if len(step.programme) > 4 else "free")
            assert all(each.at > each.commanded for each in step.programme)


def test_flows_are_told_where_a_stage_needs_them_and_programmes_have_many_switches() -> None:
    rigs = {kind: [other_rig(kind, seed) for seed in range(8)] for kind in OTHER_RIGS}
    assert {len(step.switches) for rig in rigs["staircase"] for step in rig.steps} == {3, 4}
    assert {len(step.switches) for rig in rigs["train"] for step in rig.steps} > {4, 6}
    for kind in ("staircase", "train"):
        assert {rig.has_valve for rig in rigs[kind]} == {True, False}
        assert other_rig(kind, 5, needs_valve=True).has_valve
    for step in (step for some in rigs.values() for rig in some for step in rig.steps):
        assert 300 < step.n_samples < 100_000


def test_a_cause_acts_only_where_its_part_is() -> None:
    meant = {kind: {n for n, c in CAUSES.items() if has_meaning(c, kind)} for kind in OTHER_RIGS}
    assert not any(CAUSES[n].place in ("valve", "flow", "manifold") for n in meant["sensor"])
    assert {"wall_pockets", "controller_settling", "silicone_hose"} <= meant["cell"]
    assert {"closing_spring", "wall_pockets", "pilot_stage"} <= meant["train"] == meant["staircase"]
    assert "grain_in_seat" not in meant["train"] and "mains_hum" not in set().union(*meant.values())
    kept = [name for name, cause in CAUSES.items() if cause.reserve]
    assert all(any(name in some for some in meant.values()) for name in kept)


@pytest.mark.parametrize("kind", OTHER_RIGS)
def test_every_cause_with_a_meaning_changes_the_signal(kind: str) -> None:
    free, valved = other_rig(kind, 6), other_rig(kind, 6, needs_valve=True)
    for name, cause in CAUSES.items():
        if cause.noise or not has_meaning(cause, kind):
            continue
        rig = valved if cause.place == "valve" else free
        ideal = clean_signals(rig)
        real = clean_signals(replace(rig, strengths={name: cause.highest}))
        assert all(np.isfinite(real[k]).all() for k in ideal), name
        assert max(np.abs(real[k] - ideal[k]).max() for k in ideal) > 5e-3 * rig.mean_step, name


@pytest.mark.parametrize(
    ("name", "phases"),
    [("pilot_stage", "rise plateau"), ("pent_up_line", "rise plateau"),
     ("closing_spring", "fall tail"), ("warming_coil", "rise plateau fall tail")],
)  # fmt: skip
def test_each_pulse_of_a_train_has_the_cause(name: str, phases: str) -> None:
    rig = replace(other_rig("train", 6, needs_valve=True), strengths={name: CAUSES[name].highest})
    shares = acting_places(rig)
    assert sum(v for (_, phase), v in shares.items() if phase in phases.split()) > 0.98
    ideal, real = clean_signals(replace(rig, strengths={})), clean_signals(rig)
    step = rig.steps[0]
    t, difference = sample_times(step), np.abs(real["1"] - ideal["1"])
    ups = [each.at for each in step.switches if each.level > 0.0]
    assert len(ups) > 1
    ends = [*ups[1:], step.duration]
    tops = [difference[(t >= a) & (t < b)].max() for a, b in zip(ups, ends, strict=True)]
    assert min(tops) > 0.3 * max(tops)


@pytest.mark.parametrize(("kind", "seed"), [("sensor", 3), ("cell", 3), ("train", 9)])
def test_the_ideal_model_finds_nothing_where_nothing_is_and_its_slopes_hold(
    kind: str, seed: int
) -> None:
    rig = other_rig(kind, seed)
    fit = ideal_fit(rig)
    assert fit.d < 0.02 and fit.tau == pytest.approx(rig.tau, rel=1e-3)
    model = ideal_model(rig)
    theta = model.truth()
    jacobian = model.jacobian(theta)
    for j in range(len(theta)):
        h = 1e-6 * max(abs(theta[j]), 1e-2)
        up, down = (theta + sign * h * (np.arange(len(theta)) == j) for sign in (1.0, -1.0))
        numeric = (model.response(up) - model.response(down)) / (2.0 * h)
        assert np.abs(numeric - jacobian[:, j]).max() <= 1e-4 * np.abs(jacobian[:, j]).max()


def test_a_strength_meets_its_detectability_on_another_rig() -> None:
    rig = other_rig("sensor", 3)
    strength, met = strength_for(rig, "slow_sites", 10.0)
    assert met == pytest.approx(10.0, rel=0.06) and 0.0 < strength < CAUSES["slow_sites"].highest
    assert closed_shares(replace(rig, strengths={"slow_sites": strength})) == {}


def test_a_quarter_of_a_run_with_the_reserve_is_on_other_rigs() -> None:
    plan = make_plan(400, 1, reserve=True)
    other = [entry for entry in plan if entry.size in OTHER_RIGS]
    assert len(other) == 100 and {entry.size for entry in other} == set(OTHER_RIGS)
    kinds = Counter(entry.kind for entry in other)
    assert kinds["null"] >= 33 and kinds["listed"] >= 26 and kinds["unlisted"] >= 20
    assert {"closing_spring", "wall_pockets", "slow_sites", "thermal_drift"} <= {
        entry.causes[0] for entry in other if entry.kind == "listed"
    }
    for entry in other:
        assert all(has_meaning(CAUSES[name], entry.size) for name in entry.causes)
    levels = {entry.level for entry in plan if entry.kind == "listed"}
    assert levels == {10.0, 30.0}
    assert {name for e in plan if e.kind == "unlisted" for name in e.causes} >= {
        name for name, cause in CAUSES.items() if cause.reserve
    }
    assert set(RESERVE_LAWS) <= {entry.law for entry in plan if entry.kind == "null"}
    assert not any(entry.size in OTHER_RIGS for entry in make_plan(400, 1))
    alone = make_plan(40, 1, size="other")
    assert all(entry.size in OTHER_RIGS for entry in alone)
    assert {e.causes[0] for e in alone if e.kind == "hidden"} <= set(HIDING)


def test_a_truth_on_another_rig_is_complete() -> None:
    found = draw_truth(Entry("x", "listed", ("seat_creep",), 10.0, "ar1", "staircase", 4, 5))
    rig = Case.from_json(found["recipe"])
    assert rig.has_valve and found["d"] == pytest.approx(10.0, rel=0.06)
    assert found["listed_as"] == [["two_rate_valve"]] and found["rivals"] == {}
    assert sum(row["share"] for row in found["acts"]) == pytest.approx(1.0)


@pytest.mark.slow
def test_the_files_of_other_rigs_say_the_rig_and_read_back(tmp_path: Path) -> None:
    draw_cases(tmp_path, tmp_path / "parts", 6, 5, size="other")
    stages = set()
    for case in read_json(tmp_path / "plan.json")["cases"]:
        folder = tmp_path / "campaigns" / case["case"]
        truth = read_json(tmp_path / "sealed" / f"{case['case']}.json")
        assert "[rig]\nstages = " in (folder / "campaign.toml").read_text() or (
            truth["recipe"].get("stages") == ["valve", "manifold", "sensor"]
        )
        read, made = (
            read_campaign(folder / "campaign.toml"), make_campaign(Case.from_json(truth["recipe"]))
        )  # fmt: skip
        stages.add(read.stages)
        assert read.stages == made.stages and read.sensor_is == made.sensor_is
        for a, b in zip(read, made, strict=True):
            assert np.allclose(a.values, b.values, atol=1e-8)
            assert (a.commands is None) == (b.commands is None)
            assert a.commanded_on == pytest.approx(b.commanded_on)
            if a.commands is not None and b.commands is not None:
                assert np.allclose(a.commands.times, b.commands.times)
                assert np.allclose(a.commands.levels, b.commands.levels)
                assert a.commands.delays == b.commands.delays
    assert len(stages) >= 2
