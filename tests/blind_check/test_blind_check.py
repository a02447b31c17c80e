"""The blind check: size of a cause, the plan, scoring by hand-made verdicts, the card, one run."""

from __future__ import annotations

import importlib.util
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayes_sensor.blind_check import (
    LEVELS,
    card_table,
    make_card,
    make_plan,
    open_seals,
    score,
    table,
    wilson,
)
from bayes_sensor.blind_check.closed_shares import closed_shares
from bayes_sensor.blind_check.detectability import (
    IdealModel,
    bin_covariance,
    detectability,
    ideal_fit,
    strength_for,
)
from bayes_sensor.blind_check.diagnosing import no_verdict, trimmed
from bayes_sensor.blind_check.plan import HIDING, SHARES, Entry, counts, draw_truth
from bayes_sensor.blind_check.score import level_of, score_case
from bayes_sensor.blind_check.simulator import (
    CAUSES,
    HEAVY_TAILED,
    OPEN_LAWS,
    RESERVE_LAWS,
    Case,
    Component,
    NoiseLaw,
    autocorrelation,
    clean_signals,
    draw_case,
    draw_law,
    make_campaign,
    noise_scale,
)
from bayes_sensor.blind_check.statistics import Row, area
from bayes_sensor.blind_check.truth import complete_truth
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.figures import svg
from bayes_sensor.figures.plot_blind_check import opened_seal, score_card
from bayes_sensor.io.json_files import read_json
from bayes_sensor.io.readers import read_campaign

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
TABLES = ROOT / "paper" / "tables"


@pytest.fixture(scope="module")
def rig() -> Case:
    """A small rig with nothing wrong."""
    return draw_case(7, size="small")


# --------------------------------------------------------------------------- size of a cause


@pytest.mark.parametrize("name", [*OPEN_LAWS, *RESERVE_LAWS])
def test_covariance_of_bins_is_the_sum_over_samples(name: str) -> None:
    law = draw_law(name, np.random.default_rng(3), 1.0)
    n = 160
    R = autocorrelation(law, n, 4e-3)
    dense = R[np.abs(np.subtract.outer(np.arange(n), np.arange(n)))]
    edges = np.array([0, 1, 2, 5, 9, 40, 90, 160])
    mean = np.zeros((7, n))
    for b, (i, j) in enumerate(pairwise(edges)):
        mean[b, i:j] = 1.0 / (j - i)
    np.testing.assert_allclose(bin_covariance(edges, R), mean @ dense @ mean.T, atol=1e-11)


def test_nothing_is_seen_where_nothing_is_wrong(rig: Case) -> None:
    fit = ideal_fit(rig)
    assert fit.d < 0.02
    assert fit.tau == pytest.approx(rig.tau, rel=1e-3)


def test_jacobian_of_the_ideal_model(rig: Case) -> None:
    model = IdealModel(rig)
    theta = model.truth()
    jacobian = model.jacobian(theta)
    for j in range(7):
        h = 1e-5 * max(abs(theta[j]), 1e-2)
        up, down = theta.copy(), theta.copy()
        up[j] += h
        down[j] -= h
        numeric = (model.response(up) - model.response(down)) / (2 * h)
        assert np.abs(numeric - jacobian[:, j]).max() < 2e-4 * np.abs(jacobian[:, j]).max()


@pytest.mark.slow
def test_detectability_is_the_noncentrality_of_simulated_data() -> None:
    # with the refit's tangent space projected out, the mean of (whitened data)^2 is d^2 + dof
    rig = draw_case(7, {"wall_pockets": 0.1}, law="white", size="small")
    model = IdealModel(rig)
    fit = ideal_fit(rig, model)
    jacobian = model.jacobian(fit.theta)
    basis, sizes, _ = np.linalg.svd(
        jacobian / np.linalg.norm(jacobian, axis=0), full_matrices=False
    )
    basis = basis[:, sizes > 1e-9]
    rng = np.random.default_rng(1)
    clean = clean_signals(rig)
    excess = []
    for _ in range(40):
        parts = []
        for k, (step, edges) in enumerate(zip(model.steps, model.edges, strict=True)):
            y = clean[step.name]
            x = (y - step.y0) / step.beta
            y = y + noise_scale(rig, step, x) * rng.standard_normal(len(y))
            means = np.add.reduceat(y, edges[:-1]) / np.diff(edges)
            parts.append(np.linalg.solve(model.factors[k], means))
        r = np.concatenate(parts) - model.response(fit.theta)
        r -= basis @ (basis.T @ r)
        excess.append(float(r @ r) - (len(r) - basis.shape[1]))
    scatter = np.std(excess, ddof=1) / np.sqrt(len(excess))
    assert fit.d > 3.0
    # bins that cut across the steep rise average the signal by quadrature to a percent of sigma
    assert abs(np.mean(excess) - fit.d**2) < 4.0 * scatter + 0.03 * fit.d**2


@pytest.mark.slow
def test_strength_for_meets_its_target(rig: Case) -> None:
    for name in ("wall_pockets", "closing_spring", "mains_hum", "wild_samples"):
        strength, met = strength_for(rig, name, 8.0)
        assert met == pytest.approx(8.0, rel=0.06)
        assert 0 < strength < CAUSES[name].highest
        assert detectability(replace(rig, strengths={name: strength})) == pytest.approx(met)
    strength, met = strength_for(rig, "layered_coating", 8.0)
    assert strength == CAUSES["layered_coating"].highest and met < 2.0


def test_detectability_of_a_sine_is_its_energy_over_the_spectrum(rig: Case) -> None:
    # white noise: d^2 = sum A^2 sin^2 / sigma^2
    white = NoiseLaw("white", 0.03, 0.0, (Component(1.0),))
    hum = replace(rig, noise=white, strengths={"mains_hum": 0.01})
    ideal, loud = clean_signals(replace(hum, strengths={})), clean_signals(hum)
    energy = sum(float(np.sum((loud[k] - ideal[k]) ** 2)) for k in ideal) / 0.03**2
    assert detectability(hum) == pytest.approx(np.sqrt(energy), rel=0.01)


def test_the_right_effect_closes_what_others_do_not(rig: Case) -> None:
    strength, _ = strength_for(rig, "knocked_fibre", 16.0)
    shares = closed_shares(replace(rig, strengths={"knocked_fibre": strength}))
    assert set(shares) == {name for name, effect in CATALOGUE.items() if effect.on_mean}
    assert max(shares, key=shares.__getitem__) == "baseline_step"
    assert shares["baseline_step"] > 0.95
    assert 0.0 <= shares["daq_filter"] < 0.1 and shares["flow_error"] < 0.3


# --------------------------------------------------------------------------- the plan


def test_the_plan_holds_what_was_asked_for() -> None:
    plan = make_plan(600, 1)
    kinds = Counter(entry.kind for entry in plan)
    assert kinds == counts(600) and sum(SHARES.values()) == pytest.approx(1.0)
    assert kinds["null"] >= 200
    assert kinds["unlisted"] >= 0.2 * 600
    laws = Counter(entry.law in ("ar1", "white") for entry in plan if entry.kind == "null")
    assert abs(laws[True] - laws[False]) <= 1
    listed = {entry.causes[0] for entry in plan if entry.kind == "listed"}
    assert listed == {n for n, c in CAUSES.items() if c.listed} - set(HIDING[:2])
    levels = Counter(entry.level for entry in plan if entry.kind == "listed")
    assert set(levels) == set(LEVELS)
    # those that goals are set for come twice as often as the others, give or take a round
    assert min(levels[8.0], levels[16.0]) > 1.7 * max(levels[d] for d in (2.0, 4.0, 32.0))
    twins = {(e.seed, e.causes) for e in plan if e.kind == "listed"}
    assert all((e.seed, e.causes) in twins for e in plan if e.kind == "withheld")
    assert not any(CAUSES[name].reserve for entry in plan for name in entry.causes)
    assert not any(entry.law in RESERVE_LAWS for entry in plan)
    assert len({entry.name for entry in plan}) == 600
    assert make_plan(600, 1) == plan != make_plan(600, 2)


def test_reserved_causes_and_laws_come_only_when_asked_for() -> None:
    plan = make_plan(600, 1, reserve=True)
    unlisted = [entry for entry in plan if entry.kind == "unlisted"]
    kept = sum(CAUSES[entry.causes[0]].reserve for entry in unlisted)
    assert abs(kept - len(unlisted) / 2) <= 1
    assert {entry.law for entry in plan if entry.kind == "null"} == {*OPEN_LAWS, *RESERVE_LAWS}
    with pytest.raises(CampaignError, match="at least one case, got 0"):
        make_plan(0, 1)
    with pytest.raises(CampaignError, match="one of mixed, paper, varied, small, other, but got"):
        make_plan(4, 1, size="big")


def test_a_small_plan_has_what_it_can() -> None:
    for n in range(1, 8):
        assert Counter(entry.kind for entry in make_plan(n, 3)) == {
            kind: k for kind, k in counts(n).items() if k
        }


def test_a_drawn_truth_is_complete() -> None:
    entry = Entry("x", "hidden", ("layered_coating",), 1.0, "pink", "small", 4, 5)
    found = draw_truth(entry)
    assert found["d"] < 2.0 and found["listed_as"] == [["sensor_diffusion"]]
    assert found["is_ar1"] is False and found["tau_s"] > 0
    assert sum(row["share"] for row in found["acts"]) == pytest.approx(1.0)
    assert make_campaign(Case.from_json(found["recipe"])).n_samples > 0
    assert complete_truth(found, "x")["rivals"]
    assert all(0.0 <= d <= found["d"] + 1e-9 for d in found["rivals"].values())


def test_heavy_tails_are_no_wrong_answer_where_the_noise_has_them() -> None:
    for law in (*OPEN_LAWS, *RESERVE_LAWS):
        null = draw_truth(Entry("x", "null", (), 0.0, law, "small", 4, 5))
        assert null["near"] == (["heavy_tails"] if law in HEAVY_TAILED else [])


@pytest.mark.slow
def test_causes_kept_for_the_last_run_can_be_made_plain_to_see() -> None:
    kept = [name for name, cause in CAUSES.items() if cause.reserve]
    rigs = [draw_case(seed, size="paper") for seed in (31, 32, 33)]  # as most cases are
    for name in kept:
        strengths = {name: CAUSES[name].highest}
        seen = [detectability(replace(rig, strengths=strengths), starts=1) for rig in rigs]
        assert np.median(seen) > LEVELS[-1], name


# --------------------------------------------------------------------------- scoring


def verdict(
    rows: Mapping[str, float],
    kind: str = "none",
    effects: Sequence[str] = (),
    p: float = 0.6,
    family: str | None = None,
    **shrink: Any,
) -> dict[str, Any]:
    """gap.json of these probabilities."""
    which = [
        {
            "effect": name, "probability": value, "d": 1.0, "tau_s": 0.05, "fraction_closed": 0.5,
            "family": CATALOGUE[name].family if name in CATALOGUE else None, "bic": -100.0 * value,
        }
        for name, value in rows.items()
    ]  # fmt: skip
    return {
        "where": [{"experiment": "1", "phase": "rise", "share": 1.0, "p_value": 0.01}],
        "which": which,
        "verdict": {
            "kind": kind, "effects": list(effects), "family": family, "probability": p,
            "sentence": "",
        },
        "shrink": {"tau_before_s": 0.1, "tau_after_s": 0.05, **shrink},
        "budget": {"excess_d": 3.0, "p_value": 0.01},
        "hidden": {"effects": [], "tau_envelope_s": [0.01, 0.2]},
    }  # fmt: skip


def scored(true: Mapping[str, Any], said: Mapping[str, Any]) -> Row:
    """The row of a verdict as it would have been recorded."""
    return score_case(true, trimmed(said))


def truth(listed_as: Sequence[Sequence[str]] = (), **more: Any) -> dict[str, Any]:
    """A truth with what is not named left at its default."""
    return complete_truth({"listed_as": [list(names) for names in listed_as], **more}, "x")


def test_wilson_interval() -> None:
    # Wilson's quadratic: |p - k/n| = z sqrt(p (1 - p)/n) at both ends
    for k, n in ((0, 10), (3, 10), (197, 200)):
        for p in wilson(k, n):
            if 0.0 < p < 1.0:
                z = abs(p - k / n) / np.sqrt(p * (1 - p) / n)
                assert z == pytest.approx(1.96, abs=1e-3)
    assert wilson(0, 0) == (0.0, 1.0)


def test_levels() -> None:
    assert [level_of(d) for d in (None, 0.3, 1.9, 5.5, 9.0, 50.0)] == [None, 0.0, 2.0, 4.0, 8.0, 32]


def test_scores_of_single_cases() -> None:
    right = verdict({"none": 0.02, "unlisted": 0.03, "dead_volume": 0.95}, "effect",
                    ["dead_volume"], 0.95)  # fmt: skip
    row = scored(truth([["dead_volume"]], d=8.0), right)
    assert row["top_right"] and row["family_right"] and row["verdict_right"]
    assert not row["confident_wrong"] and row["set_size"] == 1 and row["in_set"]
    assert row["brier"] == pytest.approx(0.05**2 + 0.02**2 + 0.03**2)
    assert row["log_score"] == pytest.approx(-np.log(0.95))
    assert row["bic_says"] == "dead_volume"
    # the same words about other truths
    assert scored(truth(), right)["wrong_name"]
    assert scored(truth([[]], d=8.0), right)["confident_wrong"]
    other = scored(truth([["slow_sorption"]], d=8.0), right)
    assert other["confident_wrong"] and other["family_right"] and not other["wrong_outside_family"]
    near = scored(truth([[]], d=8.0, near=["dead_volume"]), right)
    assert not near["wrong_name"] and not near["top_right"]
    withheld = scored(truth([["slow_sorption"]], kind="withheld", d=8.0), right)
    assert withheld["confident_wrong"] and not withheld["wrong_outside_family"]
    quiet = verdict({"none": 0.7, "unlisted": 0.2, "dead_volume": 0.1}, "none", (), 0.7)
    assert scored(truth(d=0.0), quiet)["verdict_right"]
    assert not scored(truth([["dead_volume"]], d=8.0), quiet)["verdict_right"]
    assert scored(truth([["dead_volume"]], d=1.0), quiet)["verdict_right"]


def test_tails_that_the_noise_has_are_neither_right_nor_wrong() -> None:
    said = verdict({"none": 0.05, "unlisted": 0.05, "dead_volume": 0.3, "heavy_tails": 0.4,
                    "dead_volume+heavy_tails": 0.2}, "effect", ["heavy_tails"], 0.99)  # fmt: skip
    null = scored(truth(near=["heavy_tails"]), said)
    assert not null["named"] and not null["confident_wrong"] and null["verdict"] == "none"
    assert null["p_none"] == pytest.approx(0.45) and null["p_said"] == pytest.approx(0.45)
    assert scored(truth(), said)["confident_wrong"]
    pocket = scored(truth([["dead_volume"]], d=8.0, near=["heavy_tails"]), said)
    assert pocket["top"] == "dead_volume" and pocket["p_top"] == pytest.approx(0.5)
    assert not pocket["verdict_right"]  # what acts on the mean was not named
    both = verdict({"none": 0.0, "dead_volume+heavy_tails": 0.95, "unlisted": 0.05}, "effect",
                   ["dead_volume", "heavy_tails"], 0.95)  # fmt: skip
    assert scored(truth([["dead_volume"]], d=8.0, near=["heavy_tails"]), both)["verdict_right"]
    # a cause that is heavy tails itself has to be named
    assert scored(truth([["heavy_tails"]], d=8.0, near=["heavy_tails"]), said)["verdict_right"]


def test_abstaining_is_right_only_where_no_data_would_tell() -> None:
    said = verdict({"none": 0.0, "unlisted": 0.05, "dead_volume": 0.4, "slow_sorption": 0.55},
                   "family", ["slow_sorption", "dead_volume"], 0.95, "slow exchange")  # fmt: skip
    close = {"dead_volume": 0.1, "slow_sorption": 2.0, "flow_error": 6.0}
    far = {"dead_volume": 0.1, "slow_sorption": 5.0, "flow_error": 6.0}
    unsure = scored(truth([["dead_volume"]], d=8.0, rivals=close), said)
    sure = scored(truth([["dead_volume"]], d=8.0, rivals=far), said)
    assert not unsure["top_right"] and unsure["top_or_abstained"]
    assert not sure["top_right"] and not sure["top_or_abstained"]
    assert unsure["isolability"] == 2.0 and unsure["isolability_family"] == 6.0
    assert unsure["family_right"] and unsure["verdict_right"]


def test_an_unlisted_cause_may_stay_unnamed_only_where_it_has_a_look_alike() -> None:
    family = verdict({"none": 0.0, "unlisted": 0.3, "dead_volume": 0.4, "slow_sorption": 0.3},
                     "family", ["dead_volume", "slow_sorption"], 0.7, "slow exchange")  # fmt: skip
    named = verdict({"none": 0.0, "unlisted": 0.05, "dead_volume": 0.95}, "effect",
                    ["dead_volume"], 0.95)  # fmt: skip
    flagged = verdict({"none": 0.0, "unlisted": 0.9, "dead_volume": 0.1}, "unlisted", (), 0.9)
    near, far = ({"rivals": {"dead_volume": apart}} for apart in (2.9, 3.1))
    for rivals, said, found, fairly in (
        (near, family, 0, 1), (far, family, 0, 0), (near, named, 0, 0), (far, flagged, 1, 1),
    ):  # fmt: skip
        row = scored(truth([[]], d=8.0, **rivals), said)
        part = make_card([row])["unlisted"]["flagged"][2]
        assert part["d"] == 8.0
        assert (part["flagged"]["k"], part["flagged_or_unnamed"]["k"]) == (found, fairly)
        assert part["within_reach"]["k"] == (rivals is far)


def test_pairs_are_right_when_both_are_named() -> None:
    both = [["dead_volume"], ["gain_drift"]]
    rows = {"none": 0.0, "unlisted": 0.0, "dead_volume": 0.1, "dead_volume+gain_drift": 0.9}
    said = verdict(rows, "effect", ["dead_volume", "gain_drift"], 0.9)
    row = scored(truth(both, d=16.0), said)
    assert row["kind"] == "pair" and row["top_right"] and not row["wrong_name"]
    single = scored(truth(both[:1], d=16.0), said)
    assert not single["top_right"] and single["wrong_name"]


def places(shares: Mapping[str, float]) -> list[dict[str, Any]]:
    """Rows of one experiment, by phase."""
    return [{"experiment": "1", "phase": p, "share": s, "p_value": 1.0} for p, s in shares.items()]


def test_places_are_those_that_hold_nearly_all_of_the_misfit() -> None:
    true = truth([["dead_volume"]], d=16.0, acts=places({"rise": 0.5, "fall": 0.46, "tail": 0.04}))
    said = verdict({"none": 0.0, "unlisted": 0.0, "dead_volume": 1.0}, "effect", ["dead_volume"])
    said["where"] = places({"fall": 0.6, "onset": 0.2, "rise": 0.17, "tail": 0.03})
    row = scored(true, said)
    assert row["places"] == 2 and row["located"] == pytest.approx(0.77)
    assert row["place_precision"] == pytest.approx(2.0 / 3.0) and row["place_recall"] == 1.0
    said["where"] = places({"fall": 0.0, "rise": 0.0})
    silent = scored(true, said)
    assert silent["places"] == 2 and silent["located"] is silent["place_recall"] is None
    faint = scored(truth([["dead_volume"]], d=3.0, acts=true["acts"]), said)
    assert faint["places"] is None
    card = make_card([row, silent, faint])["localisation"]
    assert (card["n"], card["of"]) == (1, 2) and card["f1"] == pytest.approx(0.8)


def test_closed_fractions_and_errors_of_tau() -> None:
    said = verdict({"none": 0.0, "unlisted": 0.0, "dead_volume": 1.0}, "effect", ["dead_volume"],
                   1.0, fraction_closed=0.9, fraction_closed_lo=0.7, fraction_closed_hi=0.95,
                   held_out_fraction_closed=0.8)  # fmt: skip
    true = truth([["dead_volume"]], d=16.0, closed={"dead_volume": 0.97}, tau_s=0.04)
    row = scored(true, said)
    assert row["closed_oracle"] == 0.97 and row["envelope_holds"]
    assert row["log_error_before"] == pytest.approx(np.log(2.5))
    assert row["log_error_after"] == pytest.approx(np.log(1.25))
    card = make_card([row])
    closed = next(part for part in card["closed_fraction"] if part["d"] == 16.0)
    assert closed["median_error"] == pytest.approx(0.07) and closed["coverage"]["k"] == 0
    assert closed["median_error_held_out"] == pytest.approx(0.17)
    assert card["tau"]["ratio"] == pytest.approx(np.log(1.25) / np.log(2.5))


def test_a_refused_campaign_counts_as_a_wrong_answer() -> None:
    row = score_case(truth([["dead_volume"]], d=8.0), no_verdict("gap: no quiet stretch"))
    card = make_card([row])
    assert card["failed"]["k"] == 1 and not row["verdict_right"] and not row["named"]
    assert not row["top_or_abstained"] and svg(score_card(card))


def test_bic_names_an_effect_only_by_a_margin() -> None:
    rows = {"none": 0.5, "unlisted": 0.3, "dead_volume": 0.2, "flow_error": 0.55}
    assert scored(truth(), verdict(rows))["bic_says"] == "none"  # 5 below is not enough
    rows = {"none": 0.1, "unlisted": 0.3, "flow_error": 0.6, "dead_volume+gain_drift": 0.9}
    row = scored(truth(), verdict(rows))
    assert row["bic_says"] == "flow_error"
    assert make_card([row])["nulls"]["all"]["bic_named"]["k"] == 1
    assert score_case(truth(), no_verdict("too short"))["bic_says"] == "none"


# --------------------------------------------------------------------------- the card


def calibrated_rows(n: int, overconfident: float = 0.0) -> list[dict[str, Any]]:
    """Cases of which a stated p is right with probability p - overconfident."""
    rng = np.random.default_rng(8)
    rows = []
    for p in rng.uniform(0.5, 1.0, n):
        there = rng.random() < p - overconfident
        said = verdict({"none": 1.0 - p, "unlisted": 0.0, "dead_volume": p}, "effect",
                       ["dead_volume"], p)  # fmt: skip
        rows.append(scored(truth([["dead_volume"]] if there else (), d=8.0), said))
    return rows


def test_calibration_error_lies_in_its_band_only_when_calibrated() -> None:
    good = make_card(calibrated_rows(300))["calibration"]
    bad = make_card(calibrated_rows(300, overconfident=0.2))["calibration"]
    for name in ("verdict", "top_answer"):
        assert good[name]["inside"] and not bad[name]["inside"]
        assert bad[name]["ece"] == pytest.approx(0.2, abs=0.06)
    assert sum(b["right"]["n"] for b in good["verdict"]["bins"]) == 300
    for card, lost in ((good, 0.0), (bad, 0.2)):
        (said,) = card["by_verdict"].values()  # all of them name an effect
        assert said["said"] - said["right"]["rate"] == pytest.approx(lost, abs=0.06)


def test_each_kind_of_verdict_is_counted_apart() -> None:
    even = {"none": 0.5, "unlisted": 0.5}
    said = [
        verdict({"none": 0.8, "unlisted": 0.2}, p=0.8),
        verdict(even, "unlisted", p=0.7), verdict(even, "unlisted", p=0.5),
    ]  # fmt: skip
    causes = ((), [[]], ())
    rows = [scored(truth(c, d=8.0), v) for c, v in zip(causes, said, strict=True)]
    found = make_card(rows)["calibration"]["by_verdict"]
    assert {kind: (f["right"]["k"], f["right"]["n"]) for kind, f in found.items()} == {
        "none": (1, 1), "unlisted": (1, 2),
    }  # fmt: skip
    assert found["unlisted"]["said"] == pytest.approx(0.6)


def test_area_under_the_curve_is_the_share_of_pairs_in_order() -> None:
    rows = []
    for p, listed in ((0.9, [[]]), (0.4, [[]]), (0.5, []), (0.1, []), (0.05, [["dead_volume"]])):
        said = verdict({"none": 1.0 - p, "unlisted": p, "dead_volume": 0.0})
        rows.append(scored(truth(listed, d=8.0), said))
    roc = make_card(rows)["unlisted"]["roc"]
    assert roc["area"] == pytest.approx(5 / 6) and roc["area_n"] == 5
    assert roc["area_lo95"] < roc["area"] < roc["area_hi95"]
    assert area([1.0], [])["area"] is None


@pytest.fixture(scope="module")
def many() -> list[Row]:
    """Scored cases of every kind at every size, with verdicts drawn at random."""
    rng = np.random.default_rng(3)
    names = ["dead_volume", "slow_sorption", "gain_drift", "flow_error"]
    rows = []
    for i in range(240):
        kind = ("null", "listed", "pair", "unlisted", "withheld", "hidden")[i % 6]
        own = [[names[i % 4]], [names[(i + 1) % 4]]][: 2 if kind == "pair" else 1]
        listed = [] if kind == "null" else [[]] if kind == "unlisted" else own
        p = rng.dirichlet([0.5] * 4)
        shares = dict(zip(["none", "unlisted", own[0][0], names[(i + 2) % 4]], p, strict=True))
        best = max(shares, key=shares.__getitem__)
        said = (best, ()) if best in ("none", "unlisted") else ("effect", [best])
        if best not in ("none", "unlisted") and shares[best] < 0.7:
            said = ("family", [best])
        made = verdict(shares, *said, p=float(shares[best]), fraction_closed=0.9,
                       fraction_closed_lo=0.8, fraction_closed_hi=1.0,
                       held_out_fraction_closed=0.85, explanation=own[0][0])  # fmt: skip
        d = {"null": 0.0, "hidden": 1.0}.get(kind, LEVELS[(i // 6) % 5])
        true = truth(
            listed, kind=kind, d=d, name=f"case-{i:04d}", tau_s=0.05 * float(rng.lognormal()),
            is_ar1=bool(i % 2), law=("ar1", "pink")[i % 2], closed={own[0][0]: 0.97},
            acts=places({"rise": 0.7, "fall": 0.3}), rivals={names[(i + 3) % 4]: float(d / 2)},
        )  # fmt: skip
        rows.append(scored(true, made))
    return rows


def test_the_card_counts_its_rows(many: list[Row]) -> None:
    card = make_card(many)
    assert card["n"] == 240 and set(card["kinds"].values()) == {40}
    nulls = [r for r in many if r["kind"] == "null"]
    assert card["nulls"]["all"]["named"]["k"] == sum(r["verdict"] == "effect" for r in nulls)
    assert card["nulls"]["ar1"]["named"]["n"] + card["nulls"]["not_ar1"]["named"]["n"] == 40
    for part in card["accuracy"]:
        at = [r for r in many if r["kind"] == "listed" and r["d"] == part["d"]]
        assert part["family"]["k"] == sum(r["family_right"] for r in at)
        assert part["family_or_abstained"]["k"] >= part["family"]["k"]
        assert part["family_bic"]["k"] >= part["top_bic"]["k"]
    unlisted = [r for r in many if r["kind"] == "unlisted"]
    flagged = sum(part["flagged"]["k"] for part in card["unlisted"]["flagged"])
    assert flagged == sum(r["verdict"] == "unlisted" for r in unlisted)
    goals = {goal["goal"]: goal for goal in card["goals"]}
    assert len(goals) == len(card["goals"]) == 13
    named = card["nulls"]["all"]["named"]["rate"]
    assert goals["nulls named"]["reached"] == named and goals["nulls named"]["met"] == (
        named <= 0.02
    )
    assert card["envelope"]["drawn_to_hide"] == 40 and card["envelope"]["drawn_stronger"] == 0


def test_a_cause_that_does_not_hide_is_not_counted_as_hidden(many: list[Row]) -> None:
    first = next(row["case"] for row in many if row["kind"] == "hidden")
    rows = [{**row, "d": 7.0} if row["case"] == first else row for row in many]
    envelope = make_card(rows)["envelope"]
    assert envelope["drawn_to_hide"] == 40 and envelope["drawn_stronger"] == 1
    assert envelope["hidden"]["n"] == 39


def test_a_name_that_is_near_counts_as_wrong_without_the_excuse() -> None:
    said = verdict({"none": 0.0, "unlisted": 0.05, "dead_volume": 0.95}, "effect",
                   ["dead_volume"], 0.95)  # fmt: skip
    wrong = make_card([scored(truth([[]], d=8.0, near=["dead_volume"]), said)])["confident_wrong"]
    assert wrong["unlisted"]["k"] == 0 and wrong["unlisted_without_near"]["k"] == 1


def test_the_table_of_the_card_holds_every_number(many: list[Row]) -> None:
    card = make_card(many)
    rows = card_table({**card, "sealed_late": []}).set_index("quantity")
    assert rows.index.is_unique
    for name in (
        "scores.all.brier", "scores.all.log_score", "scores.listed.brier", "set95.mean_size",
        "unlisted.roc.area", "tau.before", "tau.after", "tau.ratio", "localisation.precision",
        "closed_fraction at d = 16.median_error",
    ):  # fmt: skip
        row = rows.loc[name]
        assert row.lo95 <= row.value <= row.hi95, name
    assert rows.value["calibration.verdict.ece"] == card["calibration"]["verdict"]["ece"]
    name = "accuracy at d = 8.family_or_abstained"
    assert rows.lo95[name] < rows.rate[name] < rows.hi95[name]


@pytest.mark.slow
def test_the_figure_has_the_same_bytes_each_time_and_says_where_it_is_empty(
    many: list[Row],
) -> None:
    assert len({svg(score_card(make_card(many))) for _ in range(4)}) == 1
    one = make_card([scored(truth(), verdict({"none": 1.0, "unlisted": 0.0}))])
    words = [text.get_text() for axes in score_card(one).axes for text in axes.texts]
    assert words.count("no case") == 3  # tau and both panels against d
    assert not [t for axes in score_card(make_card(many)).axes for t in axes.texts]


# --------------------------------------------------------------------------- earlier runs


@pytest.mark.tables
@pytest.mark.prose
def test_the_sums_of_the_earlier_runs_are_those_of_their_rows() -> None:
    runs = pd.read_csv(TABLES / "blind_check_runs.csv")
    together = pd.read_csv(TABLES / "blind_check_together.csv").set_index("what")
    old = runs[runs["note"].fillna("").str.startswith("made by earlier code")]
    assert len(old) == 24 and (old["campaigns"] == 600).all()
    ruled = runs["found_or_unnamed_d8"].notna() | runs["found_or_unnamed_d10"].notna()
    assert (~ruled).sum() == 5  # which the page says
    at = (8, 10, 16, 30)
    for what, count, of, some in (
        ("null hypotheses named", ["nulls_named"], ["nulls"], runs),
        ("wrong names", ["wrong_names"], ["with_a_cause"], runs),
        ("right family", [f"right_family_d{d}" for d in at], [f"listed_d{d}" for d in at], runs),
        ("unknown causes found", [f"found_d{d}" for d in at], [f"unlisted_d{d}" for d in at], runs),
        ("unknown causes found or rightly unnamed", [f"found_or_unnamed_d{d}" for d in at],
         [f"unlisted_d{d}" for d in at], runs[ruled]),
    ):  # fmt: skip
        k, n = int(some[count].sum().sum()), int(some[of].sum().sum())
        row = together.loc[what]
        assert (row["count"], row["of"], row["runs"]) == (k, n, len(some)), what
        assert (row["lo95"], row["hi95"]) == pytest.approx(wilson(k, n), rel=1e-3)
    page = (ROOT / "docs" / "blind_check.md").read_text(encoding="utf-8")
    assert len(page) <= 5000 and "after the first five runs" in page
    last = pd.read_csv(TABLES / "blind_check_last.csv").query("rig == 'all'").set_index("what")
    assert (
        last["count"]["null hypotheses named"] == 0
        and f"with {runs.campaigns.iloc[-1]} campaigns" in page
    )
    assert last["count"][["wrong names, listed causes", "wrong names, unlisted causes"]].sum() == 0
    told = [
        f"{last['count'][what]:.0f} of {last['of'][what]}"
        for what in (*(f"right effect first at d = {d}" for d in (10, 30)), "right phase at d = 30")
    ]
    assert "{} at d = 10 and in {} at d = 30, and the right phase in {}".format(*told) in page
    share = together.share["unknown causes found or rightly unnamed"]
    assert f"the last row is {100 * share:.0f} % ({ruled.sum()} runs)" in page


# --------------------------------------------------------------------------- the bundled campaign


def script(name: str) -> Any:
    """A module of data/, which is no package."""
    spec = importlib.util.spec_from_file_location(name, DATA / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_withheld_campaign_is_what_its_seal_says() -> None:
    folder = DATA / "withheld"
    true = script("open_seal").open_seal()
    assert sum(path.stat().st_size for path in folder.iterdir()) <= 3_000_000
    assert true["causes"][0] not in (folder / "campaign.toml").read_text()
    campaign, case = read_campaign(folder / "campaign.toml"), Case.from_json(true["recipe"])
    again = make_campaign(case)
    for e, step in zip(again, case.steps, strict=True):
        recorded = campaign[e.name]
        # the file holds single precision
        np.testing.assert_allclose(recorded.values, e.values, atol=1e-6)
        assert recorded.commanded_on == pytest.approx(step.commanded_on, abs=1.5 * step.interval)
    # the seal keeps its bytes when it is made again
    assert json.loads(json.dumps(case.to_json())) == true["recipe"]


def test_opening_the_seal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    opener = script("open_seal")
    true = opener.open_seal()
    right = true["listed_as"][0][0]
    for name, words in ((right, "the verdict is right"), ("carry_over", "the verdict is wrong")):
        said = verdict({"none": 0.0, "unlisted": 0.0, name: 1.0}, "effect", [name], 1.0,
                       fraction_closed=0.9, fraction_closed_lo=0.8, fraction_closed_hi=1.0,
                       explanation=name)  # fmt: skip
        text = opener.side_by_side(said, true)
        assert words in text and right in text and f"{1e3 * true['tau_s']:.1f} ms" in text
        row = score_case(true, trimmed(said))
        assert "gap closed" in svg(opened_seal(said, row))
    for file in ("sealed.json", "sealed.sha256"):
        (tmp_path / file).write_text((DATA / "withheld" / file).read_text())
    (tmp_path / "sealed.json").write_text("{}")
    with pytest.raises(CampaignError, match="sealed.json: expected the hash"):
        opener.open_seal(tmp_path)


# --------------------------------------------------------------------------- all of it


@pytest.mark.slow
def test_a_small_blind_check_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # the real diagnosis on small campaigns: everything is drawn, sealed, diagnosed, scored
    out = tmp_path / "out"
    command = ["blind-check", "--out", str(out), "--cases", "8", "--seed", "6", "--size", "small",
               "--setting", "study", "--quiet", "--no-keep"]  # fmt: skip
    assert exit_code(command) == 0
    card, rows = score(open_seals(out))
    assert read_json(out / "score.json")["n"] == card["n"] == 8
    assert len((out / "cases.csv").read_text().splitlines()) == 9
    assert (out / "score_card.png").stat().st_size > 10_000
    assert not (out / "blind-check-parts").exists()
    frame = table(rows)
    assert set(frame["kind"]) == {kind for kind, n in counts(8).items() if n}
    for row in rows:
        assert 0.0 <= row["p_right"] <= 1.0 and row["set_size"] >= 1
    assert len(card_table(card)) > 40
    # the halves, on what is there
    before = (out / "score.json").read_text()
    assert exit_code(["blind-check", "--out", str(out), "--score-only", "--quiet"]) == 0
    assert (out / "score.json").read_text() == before
    # the report, made with the score and again from what is saved
    page = (out / "report.html").read_text(encoding="utf-8")
    met = [goal["met"] for goal in card["goals"] if goal["met"] is not None]
    assert f"{sum(met)} of the {len(met)} goals that these cases can judge were met" in page
    assert 'id="f-blind-card"' in page and 'id="measured"' not in page
    assert all(f">{row['case']}<" in page for row in rows)
    (out / "report.html").unlink()
    assert exit_code(["report", str(out), "--quiet"]) == 0
    assert (out / "report.html").read_text(encoding="utf-8") == page
    (out / "cases.csv").write_text("case,kind\ncase-0001,null\n")
    assert exit_code(["report", str(out)]) == 2
    assert "cases.csv: expected the content of cases.csv" in capsys.readouterr().err
    # strong causes that are listed stand out against nothing at all
    strong = [r["p_none"] for r in rows if r["kind"] == "listed" and r["d"] > 12]
    assert strong and max(strong) < 0.5


@pytest.mark.tables
def test_the_study_counts_a_run_as_the_card_does(many: list[Row], import_study: Any) -> None:
    study = import_study("study_blind_check")
    found, card = study.counted(many, study.OF_EARLIER_RUNS), make_card(many)
    assert found["nulls_named"] == card["nulls"]["all"]["named"]["k"]
    for i, d in ((2, 8), (3, 16)):
        assert found[f"right_family_d{d}"] == card["accuracy"][i]["family_or_abstained"]["k"]
        part = card["unlisted"]["flagged"][i]
        assert found[f"found_or_unnamed_d{d}"] == part["flagged_or_unnamed"]["k"]
    # the goals' detectabilities are counted at the levels next to them
    near = study.counted(many)
    assert near["listed_d10"] == found["listed_d8"] > 0 and near["unlisted_d30"] > 0
    runs = pd.read_csv(TABLES / "blind_check_runs.csv", dtype=str, keep_default_na=False)
    assert {"run", "date", "code", *found, *near, "note"} == set(runs)
    kept = pd.read_csv(TABLES / "blind_check_together.csv")
    pd.testing.assert_frame_equal(study.together(runs), kept, rtol=1e-3, check_dtype=False)


def test_the_last_run_is_counted_on_each_rig_and_against_its_goals(import_study: Any) -> None:
    study = import_study("study_blind_check")
    rows = {"none": 0.02, "unlisted": 0.02, "dead_volume": 0.95, "gain_drift": 0.01}
    named = trimmed(verdict(rows, "effect", ["dead_volume"], 0.95))
    unlisted = trimmed({
        **verdict({"none": 0.0, "unlisted": 1.0}, "unlisted", p=0.99),
        "tau_with_discrepancy_s": {"q2.5": 0.03, "q50": 0.05, "q97.5": 0.06},
    })  # fmt: skip
    fall = places({"fall": 0.9, "tail": 0.1})
    rise = places({"rise": 0.85, "plateau": 0.15})
    pairs = [
        (truth([["dead_volume"]], d=30.0, size="paper", tau_s=0.05, acts=rise), named),
        (truth([["gain_drift"]], d=30.0, size="cell", tau_s=0.05, acts=fall), named),
        (truth([[]], d=10.0, size="train", tau_s=0.05), unlisted),
        (truth([[]], d=10.0, size="varied", tau_s=0.07), unlisted),
        (truth([], size="sensor", tau_s=0.05), named),
    ]
    found = study.last_run(pairs).set_index(["rig", "what"])

    def share(rig: str, what: str) -> tuple[int, int]:
        return int(found["count"][rig, what]), int(found["of"][rig, what])

    first = "right effect first at d = 30"
    assert [share(rig, first) for rig in study.RIGS] == [(1, 2), (1, 1), (0, 1)]
    assert share("all", "wrong names, listed causes") == (1, 2)
    assert (
        share("all", "null hypotheses named") == share("other", "null hypotheses named") == (1, 1)
    )
    assert share("all", "unlisted causes found at d = 10") == (2, 2)
    # the verdicts say the rise
    assert [share(rig, "right phase at d = 30") for rig in study.RIGS] == [(1, 2), (1, 1), (0, 1)]
    held = "tau held after an unlisted verdict, d from 8"
    assert [share(rig, held) for rig in study.RIGS] == [(1, 2), (0, 1), (1, 1)]
    goals = {goal["goal"]: goal for goal in study.reached(study.last_run(pairs))}
    assert goals[first]["wanted"] == ">= 0.95" and goals[first]["met"] is False
    assert goals["null hypotheses named"]["reached"] == 1.0
    spread = {"rise": 0.5, "fall": 0.5}
    assert study.phase_found((truth([["gain_drift"]], acts=places(spread)), named)) is None
