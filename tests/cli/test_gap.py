"""The command gap and what simulate and posterior know of effects; the effects' full model."""

import json
import pickle
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.diagnosis import CATALOGUE, Strength, own_effect
from bayes_sensor.diagnosis.data.preparation import prepare
from bayes_sensor.diagnosis.diagnose import diagnose_gap
from bayes_sensor.diagnosis.effects.effect_model import (
    EffectModel,
    Scales,
    find_form,
    parameter_name,
    prior_of,
    with_effects,
)
from bayes_sensor.diagnosis.evidence.coordinate_priors import Part
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from tests.support.planted_effects import design, measured, theta

ROOT = Path(__file__).resolve().parents[2]
SMALL = ["--duration", "60 s", "--interval", "10 ms", "--experiments", "1,3,4"]
QUIET_NOISE = ["--sigma0", "12 mV", "--sigma1", "12 mV", "--phi", "0.4"]
RATIO = 1.25


def run(*arguments: str | Path) -> int:
    """The exit code of a command, in this process."""
    return exit_code([str(a) for a in arguments])


def simulate(folder: Path, *options: str) -> int:
    """The exit code of a small simulation."""
    return run("simulate", "--out", folder, *SMALL, *QUIET_NOISE, *options, "--seed", 2, "--quiet")


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a campaign whose valve shuts more slowly than it opens."""
    folder = tmp_path_factory.mktemp("gap")
    assert simulate(folder, "--effect", f"valve_asymmetry={RATIO}") == 0
    return folder / "campaign.toml"


@pytest.fixture(scope="module")
def diagnosed(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of its diagnosis, the nominal simulation given."""
    out = tmp_path_factory.mktemp("diagnosed")
    nominal = out / "nominal.json"
    nominal.write_text(json.dumps({**read(campaign.parent / "truth.json"), "V_mL": 75.0}))
    assert run("gap", campaign, "--out", out, "--nominal", nominal, "--bootstrap", 0,
               "--quiet") == 0  # fmt: skip
    return out


# --- simulate --effect


def test_the_truth_holds_the_effect_and_its_strength(campaign: Path) -> None:
    truth = read(campaign.parent / "truth.json")
    assert truth["effects"] == {"valve_asymmetry": {"closing_ratio": RATIO}}
    run_record = read(campaign.parent / "run.json")
    assert f"valve_asymmetry={RATIO}" in json.dumps(run_record)


def test_an_effect_changes_what_it_should_and_nothing_before(
    campaign: Path, tmp_path: Path
) -> None:
    assert simulate(tmp_path / "plain") == 0
    assert "effects" not in read(tmp_path / "plain" / "truth.json")
    plain, changed = read_campaign(tmp_path / "plain" / "campaign.toml"), read_campaign(campaign)
    truth = read(tmp_path / "plain" / "truth.json")
    for a, b in zip(plain, changed, strict=True):
        before = a.t < truth["experiments"][a.name]["tf_s"]
        # the same noise, so records agree until the valve shuts; the files keep microvolts
        assert np.allclose(a.values[before], b.values[before], atol=2e-6)
        assert np.max(np.abs(a.values - b.values)) > 0.02


def test_strengths_of_every_experiment_are_written_by_name(tmp_path: Path) -> None:
    assert simulate(tmp_path, "--effect", "flow_error", "--effect", "mains_pickup=0.02") == 0
    effects = read(tmp_path / "truth.json")["effects"]
    assert set(effects["flow_error"]["flow_factor"]) == {"1", "3", "4"}
    assert effects["mains_pickup"]["mains_V"] == 0.02
    assert effects["mains_pickup"]["mains_Hz"] == CATALOGUE["mains_pickup"].plausible["mains_Hz"]


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        ("valve_asymetry=1.2", "did you mean 'valve_asymmetry'?"),
        ("wobble", "known are flow_switching, "),
        ("valve_asymmetry=fast", "such as valve_asymmetry=1.1, but 'fast' is no number"),
        ("valve_asymmetry=", "'' is no number"),
        ("valve_asymmetry=nan", "expected a finite number"),
        ("valve_asymmetry=1.2 mL", "closing_ratio is in no unit, not in 'mL'"),
        ("finite_stroke=200 ms", "stroke is in s, not in 'ms'"),
        ("valve_asymmetry=-1", "expected closing_ratio between 0.1 and 10"),
        ("axial_dispersion=0.9", "expected tank_share between 0.001 and 0.5"),
        ("heavy_tails=1", "more than 2 degrees of freedom"),
        ("heavy_tails:long=3", "heavy_tails acts on the noise and has no forms"),
        ("carry_over:fast", "has no form 'fast'; known are 'common', 'own', 'slow'"),
        ("sensor_diffusion:full=1", "this form has no strength; give sensor_diffusion:full alone"),
        ("carry_over:slow=much", "such as carry_over:slow=0.02, but 'much' is no number"),
    ],
)
def test_a_bad_effect_is_one_message_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], effect: str, message: str
) -> None:
    out = tmp_path / "out"
    assert simulate(out, "--effect", effect) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: --effect") and error.count("\n") == 1
    assert message in error
    assert not out.exists()


def test_a_strength_may_name_its_own_unit(tmp_path: Path) -> None:
    assert simulate(tmp_path, "--effect", "finite_stroke=0.5 s") == 0
    assert read(tmp_path / "truth.json")["effects"]["finite_stroke"] == {"stroke": 0.5}


def test_an_effect_acts_in_the_form_that_is_asked_for(tmp_path: Path) -> None:
    assert simulate(tmp_path, "--effect", "carry_over:of the record before, slow=0.3") == 0
    truth = read(tmp_path / "truth.json")
    assert truth["effects"]["carry_over"]["carry_over"] == 0.3
    assert truth["effects"]["carry_over"]["carry_time"] > 0.0
    begins = [
        (float(np.mean(e.values[e.t < 0.5])) - truth["experiments"][e.name]["y0_V"])
        / truth["experiments"][e.name]["beta_V"]
        for e in read_campaign(tmp_path / "campaign.toml")
    ]
    # nothing is left of a record before the first
    assert abs(begins[0]) < 0.02 and min(begins[1:]) > 0.1


@pytest.mark.parametrize("second", ["carry_over=0.2", "carry_over:slow"])
def test_an_effect_that_is_given_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], second: str
) -> None:
    out = tmp_path / "out"
    assert simulate(out, "--effect", "carry_over=0.1", "--effect", second) == 2
    assert "given twice; leave one out" in capsys.readouterr().err
    assert not out.exists()


# --- gap


def test_the_cause_is_named_and_everything_is_written(diagnosed: Path) -> None:
    gap = read(diagnosed / "gap.json")
    assert gap["verdict"]["effects"][0] == "valve_asymmetry"
    row = next(r for r in gap["which"] if r["effect"] == "valve_asymmetry")
    assert row["strength"]["closing_ratio"] == pytest.approx(RATIO, abs=0.03)
    where = pd.read_csv(diagnosed / "gap_where.csv")
    which = pd.read_csv(diagnosed / "gap_which.csv")
    # the tables say what the record says
    assert list(which["effect"]) == [r["effect"] for r in gap["which"]]
    assert which["probability"].to_numpy() == pytest.approx(
        [r["probability"] for r in gap["which"]], abs=1e-12
    )
    assert list(where["phase"]) == [r["phase"] for r in gap["where"]]
    assert where["share"].sum() == pytest.approx(1.0)
    fall = where.loc[where["phase"].isin(["fall", "tail"]), "share"].sum()
    assert fall > where.loc[where["phase"].isin(["baseline", "plateau"]), "share"].sum()


def test_nominal_parameters_stand_in_the_budget(diagnosed: Path) -> None:
    budget = read(diagnosed / "gap.json")["budget"]
    assert budget["nominal_rms_V"] > budget["calibrated_rms_V"] > budget["noise_floor_rms_V"]


@pytest.mark.slow
def test_a_withheld_effect_is_not_in_the_record(campaign: Path, tmp_path: Path) -> None:
    assert run("gap", campaign, "--out", tmp_path, "--bootstrap", 0, "--without",
               "valve_asymmetry", "--without", "flow_settling", "--quiet") == 0  # fmt: skip
    gap = read(tmp_path / "gap.json")
    names = {row["effect"] for row in gap["which"]}
    assert not {"valve_asymmetry", "flow_settling"} & names and "flow_switching" in names
    assert not {"valve_asymmetry", "flow_settling"} & set(gap["verdict"]["effects"])


OWN = """
import numpy as np
from bayes_sensor.diagnosis import Strength, own_effect

def mean(t, strength, rig):
    return rig.mean(t, closing_ratio=1.0 + strength["lateness"])

EFFECT = own_effect("sticky_plunger", [Strength("lateness", "1", "normal", 0.0, 0.3)], mean,
                    plausible={"lateness": 0.2}, starts=({"lateness": 0.2},))
"""


@pytest.mark.slow
def test_an_effect_of_ones_own_is_named_from_a_file(campaign: Path, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(OWN)
    out = tmp_path / "out"
    assert run("gap", campaign, "--out", out, "--bootstrap", 0, "--own-effects", path,
               "--without", "valve_asymmetry", "--quiet") == 0  # fmt: skip
    gap = read(out / "gap.json")
    assert gap["verdict"]["effects"] == ["sticky_plunger"]
    row = next(r for r in gap["which"] if r["effect"] == "sticky_plunger")
    assert row["strength"]["lateness"] == pytest.approx(RATIO - 1.0, abs=0.03)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--without", "valve_asymetry"], "--without: no effect 'valve_asymetry' in the catalogue; "
                                          "did you mean 'valve_asymmetry'?"),
        (["--own-effects", "none.py"], "none.py: there is no such file"),
        (["--own-effects", "empty.py"], "empty.py: it defines no effect"),
        (["--own-effects", "broken.py"], "broken.py: the code of the effect stops with ZeroDiv"),
        (["--nominal", "nominal.json"], "nominal.json: expected parameters as in fit.json"),
        (["--bootstrap", "-1"], "--bootstrap"),
    ],
)  # fmt: skip
def test_bad_requests_are_one_message(
    campaign: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.py").write_text("x = 1\n")
    (tmp_path / "broken.py").write_text("1 / 0\n")
    (tmp_path / "nominal.json").write_text('{"V_mL": 60}')
    out = tmp_path / "out"
    assert run("gap", campaign, "--out", out, *options) == 2
    error = capsys.readouterr().err
    assert message in error and error.startswith("error: ") and error.count("\n") == 1
    assert not out.exists()


# --- posterior --with-effect


@pytest.mark.slow
def test_the_posterior_with_the_effect_recovers_its_strength(
    campaign: Path, tmp_path: Path
) -> None:
    common = ["posterior", campaign, "--out", tmp_path, "--sampler", "independence", "--quiet"]
    assert run(*common) == 0
    plain = read(tmp_path / "posterior.json")
    assert plain["with_effects"] == []
    assert not (tmp_path / "posterior_without_effects.json").exists()
    assert (tmp_path / "predictive.json").exists()
    assert run(*common, "--with-effect", "valve_asymmetry") == 0
    # its replicates were drawn from the other posterior
    assert not (tmp_path / "predictive.json").exists()
    record = read(tmp_path / "posterior.json")
    assert record["with_effects"] == ["valve_asymmetry"] and record["converged"]
    ratio = record["parameters"]["closing_ratio"]
    # 3.5 standard deviations, and far from no effect at all
    assert abs(ratio["mean"] - RATIO) < 3.5 * ratio["sd"] and ratio["sd"] < 0.02
    assert ratio["q0.5"] > 1.1
    kept = read(tmp_path / "posterior_without_effects.json")
    assert kept == plain
    tau = record["parameters"]["tau_s"]
    truth = read(campaign.parent / "truth.json")["tau_s"]
    assert tau["q0.5"] < truth < tau["q99.5"]
    # with nothing to stand beside, the kept one goes
    assert run(*common) == 0
    assert not (tmp_path / "posterior_without_effects.json").exists()


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        (["heavy_tails"], "heavy_tails acts on the noise, not on the mean"),
        (["valve_asymetry"], "--with-effect: no effect 'valve_asymetry' in the catalogue; did you"),
        (["two_rate_valve:fast"], "no form 'fast'; it has one only: give two_rate_valve alone"),
        (["valve_asymmetry:slow"], "no form 'slow'; known are 'spring' and, given alone, valve_as"),
        (["baseline_step:slow"], "no form 'slow'; known are 'common', 'own', 'common, slow'"),
        (["carry_over", "carry_over"], "carry_over is given twice"),
    ],
)
def test_effects_that_no_posterior_can_have(
    campaign: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    effects: list[str],
    message: str,
) -> None:
    out = tmp_path / "out"
    options = [part for name in effects for part in ("--with-effect", name)]
    assert run("posterior", campaign, "--out", out, *options, "--quiet") == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not out.exists()


def test_an_effect_of_ones_own_is_put_into_the_posterior_by_name(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, config, out = tmp_path / "mine.py", tmp_path / "quick.toml", tmp_path / "out"
    path.write_text(OWN)
    config.write_text("[fit]\nswarms = 1\n[posterior]\nn_draws = 50\ntarget_ess = 50.0\n")
    common = ["posterior", campaign, "--out", out, "--own-effects", path, "--quiet"]
    assert run(*common) == 2
    assert "--with-effect: expected one of your own effects: sticky_plunger" in (
        capsys.readouterr().err
    )
    assert run(*common, "--with-effect", "sticky_plunger", "--config", config, "--sampler",
               "independence") == 0  # fmt: skip
    record = read(out / "posterior.json")
    assert record["with_effects"] == ["sticky_plunger"]
    assert record["parameters"]["lateness"]["mean"] == pytest.approx(RATIO - 1.0, abs=0.06)


# --- the model with effects


@pytest.fixture(scope="module")
def problem_and_sketch() -> tuple[Problem, np.ndarray, Any]:
    """A problem, the flat truth of its mean, and the diagnosis's sketch around it."""
    recorded = measured({}, seed=3)
    flat = Problem(recorded).layout.flat(theta(recorded))[: 3 + 4 * len(recorded)]
    return Problem(recorded), flat, prepare(recorded, flat).binned


STRENGTHS: dict[str, dict[str, float]] = {
    "flow_switching:partial": {"flow_switching": 0.7},
    "valve_asymmetry": {"closing_ratio": 1.3},
    "valve_second_order": {"inertia": 0.3},
    "two_rate_valve": {"slow_valve_share": 0.05, "slow_valve_time": 4.0},
    "finite_stroke": {"stroke": 0.6},
    "dead_volume:exchange by diffusion": {"pocket_share": 0.1, "pocket_time": 3.0},
    "axial_dispersion": {"tank_share": 0.2},
    "flow_error": {"flow_factor": 1.07},
    "sensor_diffusion:full": {},
    "sorption_asymmetry": {"release_ratio": 2.0},
    "slow_sorption": {"slow_site_share": 0.04, "slow_site_time": 9.0},
    "optical_nonlinearity": {"curvature": 0.03},
    "baseline_drift": {"drift": 2e-4},
    "baseline_step": {"step": 0.02},
    "gain_drift": {"gain_drift": 3e-4},
    "carry_over": {"carry_over": 0.04},
    "daq_filter": {"filter": 0.05},
}


@pytest.mark.parametrize("text", STRENGTHS)
def test_the_full_model_is_the_diagnosis_rig(
    problem_and_sketch: tuple[Problem, np.ndarray, Any], text: str
) -> None:
    problem, flat, binned = problem_and_sketch
    name, _, form_name = text.partition(":")
    form = find_form(CATALOGUE[name], form_name or None)
    given = STRENGTHS[text]
    made = with_effects(problem, [text], flat)
    model = made.model
    assert isinstance(model, EffectModel)
    full = np.zeros(len(made.layout))
    full[: len(flat)] = flat
    for part in model.strengths:
        for s in part:
            for e in made.campaign if s.per_experiment else [None]:
                key = parameter_name(s) + ("" if e is None else f"[{e.name}]")
                full[made.layout.index(key)] = given[s.name]
    plan = Coordinates(binned, (Part(CATALOGUE[name], form),), held=given)
    x = plan.start(binned.base, {})
    plain = Coordinates(binned)
    away = 0.0
    for k, e in enumerate(made.campaign):
        t = np.linspace(e.t[0], e.t[-1], 700)
        mixed = np.random.default_rng(1).permutation(t)  # any times, in any order
        ours = model.mean(mixed, full, made.layout, e)[np.argsort(mixed)]
        assert np.allclose(ours, plan.mean(x, k, t), atol=1e-9)
        away = max(away, float(np.max(np.abs(ours - plain.mean(binned.base, k, t)))))
        both = model.mean_and_response(t, full, made.layout, e)
        assert np.array_equal(both[1], model.response(t, full, made.layout, e))
    assert away > 1e-3  # the effect is there at all


def test_names_carry_units_and_priors_are_the_effects(
    problem_and_sketch: tuple[Problem, np.ndarray, Any],
) -> None:
    problem, flat, _ = problem_and_sketch
    made = with_effects(problem, ["finite_stroke", "baseline_drift:own", "flow_switching:partial"],
                        flat)  # fmt: skip
    model = made.model
    assert isinstance(model, EffectModel)
    drifts = tuple(f"drift_V_per_s[{e.name}]" for e in made.campaign)
    assert model.extra == ("stroke_s", *drifts, "flow_switching")
    assert set(model.priors) == set(model.extra)
    assert set(made.given_priors) >= set(model.extra)
    assert model.priors["stroke_s"].kind == "log_normal"
    assert model.priors[drifts[0]].kind == "normal"
    assert model.priors["flow_switching"].kind == "uniform"
    (stroke,) = model.strengths[0]
    # the prior's median is the strength's centre, its spread that of the logarithm
    assert model.priors["stroke_s"].law.median() == pytest.approx(stroke.centre)
    one, sixth = (model.priors["stroke_s"].law.ppf(p) for p in (0.5, 0.8413447))
    assert np.log(sixth / one) == pytest.approx(stroke.sd, rel=1e-4)


def test_priors_of_limited_and_of_free_strengths() -> None:
    assert prior_of(Strength("a", "1", "normal", 0.0, 0.5, limits=(0.0, 1.3))).law.ppf(1) == 1.0
    assert prior_of(Strength("b", "V", "normal", 0.1, 0.5)).law.mean() == pytest.approx(0.1)
    never_negative = prior_of(Strength("c", "1", "normal", 0.0, 0.03, limits=(0.0, 2.0)))
    assert never_negative == Prior("half_normal", 0.03)


def test_the_model_travels_to_other_processes(
    problem_and_sketch: tuple[Problem, np.ndarray, Any],
) -> None:
    problem, flat, _ = problem_and_sketch
    made = with_effects(problem, ["dead_volume", "valve_asymmetry"], flat)
    assert made.model.extra  # fills what is cached, which must not travel
    other = pickle.loads(pickle.dumps(made.model))
    assert other == made.model and other.extra == made.model.extra
    assert repr(other) == repr(made.model)
    full = np.full(len(made.layout), 1.1)
    full[: len(flat)] = flat
    e = made.campaign.experiments[0]
    one, two = (m.mean(e.t[::50], full, made.layout, e) for m in (made.model, other))
    assert np.array_equal(one, two)


def test_a_jump_of_the_baseline_is_told_to_the_compression(
    problem_and_sketch: tuple[Problem, np.ndarray, Any],
) -> None:
    problem, flat, _ = problem_and_sketch
    e = problem.campaign.experiments[0]
    late = flat.copy()
    late[3:] += 0.3  # all switch times later, among others

    def stretches(name: str, *moved: float) -> list[tuple[float, float]]:
        made = with_effects(problem, [name], flat)
        assert isinstance(made.model, EffectModel)
        extra = np.zeros(len(made.layout) - len(flat))
        extra[len(extra) - len(moved) :] = moved
        low, high = np.concatenate([flat, extra]), np.concatenate([late, 1.1 * extra])
        return made.model.kinks(low, high, made.layout, e)

    ((begin, end),) = stretches("baseline_step")
    tf = float(flat[Problem(problem.campaign).layout.local[0][3]])
    assert begin == pytest.approx(tf - e.interval) and end == pytest.approx(tf + 0.3 + e.interval)
    ((begin, end),) = stretches("baseline_step:at any time", 0.4)
    places = e.t[0] + np.array([0.4, 0.44]) * np.ptp(e.t)
    assert (begin, end) == pytest.approx((places[0] - e.interval, places[1] + e.interval))
    ((begin, end),) = stretches("baseline_step:some time after the fall", 5.0)
    assert (begin, end) == pytest.approx((tf + 5.0 - e.interval, tf + 0.3 + 5.5 + e.interval))
    assert stretches("valve_asymmetry") == []


def test_scales_come_from_the_fit_or_from_the_records() -> None:
    recorded = measured({}, seed=3)
    flat = Problem(recorded).layout.flat(theta(recorded))
    fitted, guessed = Scales.of(recorded, flat), Scales.of(recorded)
    assert fitted.time_scale == pytest.approx(max(0.8577, 58.23 / fitted.reference_flow))
    assert fitted.duration == guessed.duration == pytest.approx(60.0)
    assert guessed.time_scale == pytest.approx(fitted.time_scale, rel=0.3)
    assert guessed.signal_scale == pytest.approx(fitted.signal_scale, rel=0.2)


def leak(t: np.ndarray, strength: Mapping[str, float], rig: Any) -> np.ndarray:
    """A jump of the signal when the gas arrives."""
    return rig.mean(t) + strength["leak_V"] * (t > rig.t0)


def test_an_effect_of_ones_own_enters_the_model() -> None:
    plan = design(1)
    effect = own_effect("leak", [Strength("leak_V", "V", "normal", 0.0, 0.02)], leak,
                        plausible={"leak_V": 0.02})  # fmt: skip
    made = with_effects(Problem(plan), [effect])
    assert made.model.extra == ("leak_V",) and not made.model.affine
    flat = Problem(plan).layout.flat(theta(plan))[:7]
    full = np.zeros(len(made.layout))
    full[:7] = flat
    full[made.layout.index("leak_V")] = 0.05
    e = made.campaign.experiments[0]
    away = made.model.mean(e.t, full, made.layout, e)
    full[made.layout.index("leak_V")] = 0.0
    away = away - made.model.mean(e.t, full, made.layout, e)
    assert np.allclose(away, 0.05 * (e.t > flat[5]), atol=1e-12)
    with pytest.raises(CampaignError, match="given twice"):
        with_effects(made, ["carry_over", "carry_over"])


def test_diagnose_gap_explains_a_name_that_is_nearly_right(campaign: Path) -> None:
    with pytest.raises(CampaignError, match="did you mean 'carry_over'"):
        diagnose_gap(read_campaign(campaign), without="cary_over")


# --- what the docs say


def test_the_docs_list_every_effect_with_its_family() -> None:
    page = (ROOT / "docs" / "gap_catalogue.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| [^|]+ \| ([\w ]+) \|$", page, re.MULTILINE))
    assert rows == {name: effect.family for name, effect in CATALOGUE.items()}
