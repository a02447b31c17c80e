"""The coverage study: what is simulated, how hits are counted, the command, what is in paper/."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayes_sensor.bounds import LEVELS, METHODS
from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks import coverage
from bayes_sensor.checks.counted_coverage import binomial_interval
from bayes_sensor.checks.coverage import (
    SETTINGS,
    BoundsStudy,
    CoverageSetting,
    chosen_settings,
    coverage_limits,
    coverage_of_methods,
    run_coverage,
    simulate_setting,
    small_design,
)
from bayes_sensor.cli import main
from bayes_sensor.likelihood.density import mean_and_variance, simulate
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import cascade_response

ROOT = Path(__file__).resolve().parents[2]
QUICK = ("crlb_iid", "crlb_ar1", "sandwich")


def residuals(setting: CoverageSetting, n: int) -> np.ndarray:
    """(n, n_experiments, n_t) simulated data minus the truth's mean, over the truth's scale."""
    design, theta = small_design()
    vector = np.concatenate([theta, [setting.phi, setting.sigma0, setting.sigma1]])
    problem = Problem(design)
    parts = [mean_and_variance(problem, vector, k) for k in range(len(design))]
    campaigns = [simulate_setting(design, theta, setting, seed) for seed in range(n)]
    return np.array(
        [[(e.values - m) / np.sqrt(v) for e, (m, v) in zip(c, parts)] for c in campaigns]
    )


@pytest.mark.parametrize("name", ["iid", "ar1_0.5", "ar1_0.9", "arma"])
def test_noise_has_the_size_and_correlation_that_its_setting_says(name: str) -> None:
    setting = SETTINGS[name]
    z = residuals(setting, 8)
    # 8 x 3 x 2700 samples, fewer independent ones: 3 sd of a variance at phi = .9 is 5 %
    assert z.var() == pytest.approx(1.0, abs=0.06)
    lags = np.arange(1, 6)
    found = [np.mean(z[..., :-k] * z[..., k:]) / z.var() for k in lags]
    # white noise adds to lag zero alone: an ARMA(1, 1) falls as phi^k from (1 - white) phi
    np.testing.assert_allclose(found, (1.0 - setting.white) * setting.phi**lags, atol=0.05)


def test_one_size_of_noise_is_the_models_own_simulation() -> None:
    design, theta = small_design()
    setting = SETTINGS["ar1_0.5"]
    vector = np.concatenate([theta, [setting.phi, setting.sigma0, setting.sigma1]])
    ours = simulate_setting(design, theta, setting, 4)
    for mine, other in zip(ours, simulate(design, vector, 4), strict=True):
        np.testing.assert_allclose(mine.values, other.values, atol=1e-10)


def test_a_slowly_closing_valve_falls_as_its_differential_equation_says() -> None:
    from scipy.integrate import solve_ivp

    design, theta = small_design()
    silent = replace(SETTINGS["slow_closing"], sigma0=0.0, sigma1=0.0, closing=1.2)
    e = simulate_setting(design, theta, silent, 1).experiments[0]
    tau, tau_v, V = theta[:3]
    y0, beta, t0, tf = theta[3:7]

    def rates(t: float, x: np.ndarray) -> list[float]:
        u, slow = (1.0, tau_v) if t < tf else (0.0, 1.2 * tau_v)
        return [(u - x[0]) / slow, (x[0] - x[1]) * e.total_flow / V, (x[1] - x[2]) / tau]

    some = e.t[(e.t > t0)][::50]
    rise = solve_ivp(rates, (t0, tf), np.zeros(3), "Radau", some[some < tf], rtol=1e-9, atol=1e-11)
    top = solve_ivp(rates, (t0, tf), np.zeros(3), "Radau", rtol=1e-9, atol=1e-11).y[:, -1]
    fall = solve_ivp(rates, (tf, 27.0), top, "Radau", some[some >= tf], rtol=1e-9, atol=1e-11)
    x = np.concatenate([rise.y[2], fall.y[2]])
    at = np.searchsorted(e.t, some - 1e-9)
    # at rest within 2e-5 of the step when it is shut
    np.testing.assert_allclose(e.values[at], y0 + beta * x, atol=5e-5 * beta)
    symmetric = cascade_response(e.t, (tau, tau_v, V / e.total_flow), t0, tf)
    assert np.abs(e.values - y0 - beta * symmetric).max() > 0.01 * beta


def fake(study: BoundsStudy, n: int = 200) -> dict[str, np.ndarray]:
    """Results in which the first method is right at every level, the second always too narrow."""
    rng = np.random.default_rng(1)
    z = {"68": 0.994, "95": 1.96, "997": 2.97}
    low = np.full((n, 2, len(study.names), 3), np.nan)
    high = low.copy()
    for j, width in enumerate((1.0, 0.2)):
        centre = study.theta + rng.standard_normal((n, len(study.names)))
        for level, factor in enumerate(z.values()):
            low[:, j, :, level] = centre - factor * width
            high[:, j, :, level] = centre + factor * width
    low[:10, 0, 0] = np.nan  # ten intervals of tau were not given
    return {"low": low, "high": high}


def test_coverage_is_counted_pooled_and_judged() -> None:
    study = BoundsStudy(SETTINGS["iid"], methods=("crlb_ar1", "crlb_iid"))
    table = coverage_of_methods("iid", study, fake(study))
    assert set(table["parameter"]) == {"tau_s", "tau_v_s", "V_mL", "y0_V", "beta_V", "t0_s", "tf_s"}
    at = table.set_index(["method", "parameter", "level"])
    tau, pooled = at.loc[("crlb_ar1", "tau_s", "95")], at.loc[("crlb_ar1", "t0_s", "95")]
    assert (tau["n"], tau["failures"], tau["campaigns"]) == (190, 10, 200)
    assert (pooled["n"], pooled["failures"]) == (600, 0)
    assert tau["coverage"] == tau["covered"] / 190
    assert (tau["coverage_lo95"], tau["coverage_hi95"]) == binomial_interval(tau["covered"], 190)
    assert tau["median_width"] == pytest.approx(2 * 1.96)
    right = table[table["method"] == "crlb_ar1"]
    inside = (right["coverage_lo95"] <= right["nominal"]) & (
        right["nominal"] <= right["coverage_hi95"]
    )
    assert inside.mean() > 0.85  # 21 limits at 95 %
    narrow = table[table["method"] == "crlb_iid"]
    assert (narrow["coverage_hi95"] < narrow["nominal"]).all()


def test_intervals_of_one_campaign_count_as_dependent() -> None:
    study = BoundsStudy(SETTINGS["iid"], methods=("crlb_ar1", "crlb_iid"))
    results = fake(study)
    alone = coverage_of_methods("iid", study, results)
    kinds = [name.split("[")[0] for name in study.names]
    same = [i for i, kind in enumerate(kinds) if kind == "t0_s"]
    for ends in results.values():
        offset = ends[:, :, same[0]] - study.theta[same[0]]
        for i in same:
            ends[:, :, i] = study.theta[i] + offset
    together = coverage_of_methods("iid", study, results)
    width = [
        t.set_index(["method", "parameter", "level"]).loc[("crlb_ar1", "t0_s", "95")]
        for t in (alone, together)
    ]
    spans = [row["coverage_hi95"] - row["coverage_lo95"] for row in width]
    # three copies of one interval are worth one: limits sqrt(3) wider
    assert spans[1] / spans[0] == pytest.approx(3**0.5, rel=0.15)


def test_a_study_resumes_and_depends_on_its_seed_alone(tmp_path: Path) -> None:
    settings = chosen_settings(["ar1_0.5"])
    first = run_coverage(tmp_path / "a", settings, 2, QUICK, seed=3)
    seen: list[tuple[int, int]] = []
    more = run_coverage(
        tmp_path / "a", settings, 2, QUICK, seed=3, progress=lambda a, b: seen.append((a, b))
    )
    assert seen == [(2, 2)]
    pd.testing.assert_frame_equal(first, more)
    again = BoundsStudy(settings["ar1_0.5"], methods=QUICK, seed=3)
    other = BoundsStudy(settings["ar1_0.5"], methods=QUICK, seed=4)
    assert again.key != other.key
    with np.load(next((tmp_path / "a" / "ar1_0.5").glob("chunk*.npz"))) as saved:
        np.testing.assert_array_equal(saved["low"][1], again(1)["low"])
        assert (saved["low"][1] != other(1)["low"]).any()


@pytest.mark.slow
def test_every_method_takes_part_and_the_iid_bound_is_narrow_under_correlation() -> None:
    study = BoundsStudy(SETTINGS["ar1_0.9"], n_resamples=40)
    found = study(0)
    assert found["low"].shape == (len(METHODS), len(study.names), len(LEVELS))
    shared = found["high"][:, :3] - found["low"][:, :3]
    assert np.isfinite(shared).all() and (shared > 0).all()
    of = {method: shared[j, 2, 1] for j, method in enumerate(study.methods)}  # V, 95 %
    # sqrt((1 + phi)/(1 - phi)) = 4.4 for slow sensitivities
    assert of["crlb_ar1"] / of["crlb_iid"] == pytest.approx(4.4, rel=0.25)
    assert of["posterior"] == pytest.approx(of["crlb_ar1"], rel=0.25)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(CampaignError, match="no setting 'ar2'; expected some of iid"):
        chosen_settings(["iid", "ar2"])
    with pytest.raises(CampaignError, match="no bound method 'crlb'"):
        BoundsStudy(SETTINGS["iid"], methods=("crlb",))
    assert list(chosen_settings([])) == list(SETTINGS)


def test_the_command_writes_a_table_and_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["coverage", "--out", str(out), "--setting", "iid", "--seed", "5",
               "--methods", "crlb_iid", "--methods", "sandwich"]  # fmt: skip
    for n, more in ((2, []), (3, ["--resume"])):
        with pytest.raises(SystemExit) as ended:
            main([*command, "--campaigns", str(n), *more])
        assert ended.value.code == 0
        table = pd.read_csv(out / "coverage.csv", dtype={"level": str})
        assert (table["campaigns"] == n).all()
        assert set(table["method"]) == {"crlb_iid", "sandwich"}
    said = capsys.readouterr().out
    assert "95 % of tau" in said and "coverage.csv" in said
    record = json.loads((out / "coverage.json").read_text())
    assert record["settings"] == {"iid": SETTINGS["iid"].words}
    assert (out / "coverage.png").stat().st_size > 1000
    with pytest.raises(SystemExit) as ended:
        main(["coverage", "--out", str(tmp_path / "no"), "--setting", "white"])
    assert ended.value.code == 2
    assert "no setting 'white'" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


# --- what is committed


@pytest.fixture(scope="module")
def committed() -> pd.DataFrame:
    return pd.read_csv(ROOT / "paper" / "tables" / "coverage_bounds.csv", dtype={"level": str})


@pytest.mark.tables
def test_the_committed_study_is_complete_and_says_what_it_should(committed: pd.DataFrame) -> None:
    assert (committed["campaigns"] >= 1000).all()
    assert list(dict.fromkeys(committed["setting"])) == list(SETTINGS)
    assert set(committed["method"]) == set(METHODS)
    assert (committed["failures"] <= 0.03 * (committed["n"] + committed["failures"])).all()
    at = committed.set_index(["setting", "method", "parameter", "level"])["coverage"]
    # under its own noise law a method holds what it promises: 95 % of 1000 is known to 1.4 %
    for setting in ("iid", "ar1_0.5", "ar1_0.9"):
        for method in ("crlb_ar1", "profile", "posterior"):
            assert 0.92 < at[setting, method, "V_mL", "95"] < 0.98, (setting, method)
    # correlation breaks the iid bounds; what no law describes, the resampled ones bear best
    assert at["ar1_0.9", "crlb_iid", "V_mL", "95"] < 0.6
    assert at["arma", "crlb_ar1", "V_mL", "95"] < at["arma", "sandwich", "V_mL", "95"]
    # an unmodelled effect makes every interval of what it touches wrong
    assert at["slow_closing", "crlb_ar1", "tau_v_s", "95"] < 0.5


def test_delays_of_the_design_of_the_coverage_study_are_the_published_lines() -> None:
    design, theta = coverage.small_design()
    layout = Problem(design).layout
    for e, (_, _, on, off) in zip(design, layout.local):
        inverse = 1000.0 / e.total_flow  # s/L
        assert theta[on] - e.commanded_on == pytest.approx(0.1340 + 0.1125 * inverse)
        assert theta[off] - e.commanded_off == pytest.approx(0.0161 + 0.0745 * inverse)


def test_a_coverage_study_tries_the_methods_that_were_asked_for(monkeypatch, tmp_path) -> None:
    tried = []

    def note(study: coverage.BoundsStudy, *_: object, **__: object) -> None:
        tried.append(study.methods)
        raise CampaignError("far enough")

    monkeypatch.setattr(coverage, "run_chunks", note)
    some = tuple(coverage.METHODS)[:2]
    for asked in (some, None, ()):
        with pytest.raises(CampaignError, match="far enough"):
            coverage.run_coverage(tmp_path, coverage.chosen_settings(["iid"]), 1, asked)
    assert tried == [some, tuple(coverage.METHODS), tuple(coverage.METHODS)]


def test_coverage_of_no_interval_has_no_limits() -> None:
    none = np.zeros((5, 1), dtype=bool)
    assert np.isnan(coverage_limits(none, none)).all()
    low, high = coverage_limits(~none, ~none)
    assert 0.4 < low < 0.8 and high == 1.0


def test_a_setting_without_a_step_down_stays_up() -> None:
    design, theta = small_design()
    up = replace(
        design, experiments=tuple(replace(e, commanded_off=None) for e in design.experiments)
    )
    kept = np.array([i for i in range(len(theta)) if i < 3 or (i - 3) % 4 != 3])
    e = simulate_setting(up, theta[kept], SETTINGS["iid"], 1).experiments[0]
    y0, beta = theta[3], theta[4]
    # noise of 14 mV in a thousand samples
    assert e.values[-100:].mean() == pytest.approx(y0 + beta, abs=0.01)
    down = simulate_setting(design, theta, SETTINGS["iid"], 1).experiments[0]
    assert down.values[-100:].mean() < y0 + 0.5 * beta
