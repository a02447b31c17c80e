"""Residual diagnostics against statsmodels and against noise whose law is known."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2
from statsmodels.stats.diagnostic import acorr_ljungbox, het_breuschpagan, het_white
from statsmodels.tsa.stattools import acf

from bayes_sensor.bounds import compare_bounds
from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.noise import Noise, simulate_noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import sample_posterior
from bayes_sensor.residuals import (
    TAKE_AS_THEY_ARE,
    TOO_COARSE,
    autocorrelation,
    diagnose_residuals,
    noise_doubt,
    whiten,
)
from bayes_sensor.residuals.autocorrelation import DIRECT_LAGS, LAGS, ljung_box
from bayes_sensor.residuals.converter_step import lattice_step
from bayes_sensor.residuals.series import FittedNoise
from bayes_sensor.residuals.spread import HISTOGRAM_BIN, breusch_pagan, histogram
from bayes_sensor.residuals.variance_check import check_variance
from bayes_sensor.rig.layout import Layout
from tests.support.campaigns import small_problem

EXPERIMENTS = {
    "a": {"y0_V": 0.2, "beta_V": 1.5, "t0_s": 3.0, "tf_s": 11.0},
    "b": {"y0_V": 0.25, "beta_V": 1.8, "t0_s": 3.2, "tf_s": 11.3},
}
MEAN = {"tau_s": 0.05, "tau_v_s": 0.8, "V_mL": 58.0, "experiments": EXPERIMENTS}


@dataclass(frozen=True)
class Known:
    """A fit that ended at the truth."""

    theta_hat: np.ndarray


def plan(interval=0.002, duration=20.0, mask=None):
    t = interval * np.arange(round(duration / interval))
    return Campaign(
        "two",
        (
            Experiment("a", t, None, 60.0, 10.0, interval, 2.5, 10.5, mask),
            Experiment("b", t, None, 100.0, 25.0, interval, 2.5, 10.5, mask),
        ),
        sensor_is="faster",
    )


def diagnosed(phi=0.8, sigma0=0.045, sigma1=0.05, seed=1, scale=1.0, change=None, mask=None):
    theta = {**MEAN, "phi": phi, "sigma0_V": scale * sigma0, "sigma1_V": scale * sigma1}
    campaign = simulate(plan(mask=mask), theta, seed=seed)
    if change is not None:
        campaign = campaign.with_data({e.name: e.values + change(e.t) for e in campaign})
    return diagnose_residuals(campaign, Known(Problem(campaign).layout.flat(theta)))


@pytest.fixture(scope="module")
def adequate():
    return diagnosed()


@pytest.mark.parametrize("n_lags", [50, DIRECT_LAGS + 1])
def test_autocorrelation_is_that_of_statsmodels(n_lags):
    r = np.random.default_rng(1).standard_normal(2001).cumsum()
    expected = acf(r, nlags=n_lags, fft=False)
    assert autocorrelation(r, n_lags) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("n_lags", [50, DIRECT_LAGS + 1])
def test_autocorrelation_with_gaps_is_that_of_statsmodels(n_lags):
    # statsmodels forms all n^2 products for it; ours counts a pair more or less where lags are long
    rng = np.random.default_rng(8)
    r, used = rng.standard_normal(2001).cumsum(), rng.random(2001) > 0.3
    gaps = np.where(used, r, np.nan)
    expected = acf(gaps, adjusted=True, nlags=n_lags, missing="conservative")
    biased = expected * (1.0 - np.arange(n_lags + 1) / len(r))
    assert autocorrelation(r[used], n_lags, used) == pytest.approx(biased, abs=1e-12)


def test_autocorrelation_of_a_constant_and_of_few_samples():
    assert autocorrelation(np.full(10, 3.0), 3).tolist() == [1.0, 0.0, 0.0, 0.0]
    assert len(autocorrelation(np.array([1.0, 2.0, 4.0]), 50)) == 3


def test_portmanteau_is_that_of_statsmodels():
    r = np.random.default_rng(2).standard_normal(400)
    expected = acorr_ljungbox(r, lags=[1, 5, 20])
    found = ljung_box(r, [1, 5, 20])
    assert found["statistic"] == pytest.approx(expected["lb_stat"].to_numpy(), rel=1e-10)
    assert found["p_value"] == pytest.approx(expected["lb_pvalue"].to_numpy(), rel=1e-8)
    fitted = acorr_ljungbox(r, lags=[1, 5, 20], model_df=1)
    first, *others = ljung_box(r, [1, 5, 20], 1)["p_value"]
    assert first is None
    assert others == pytest.approx(fitted["lb_pvalue"].to_numpy()[1:], rel=1e-8)


REFERENCE = Path(__file__).resolve().parents[2] / "data" / "reference"


@pytest.mark.parametrize("masked", [False, True])
def test_numbers_of_the_bundled_campaign_are_those_of_the_formulas(masked):
    campaign = read_campaign(REFERENCE / "campaign.toml")
    if masked:
        rng = np.random.default_rng(3)
        kept = [e.used & (rng.random(len(e.t)) > 0.1) for e in campaign]
        for mask in kept:
            mask[2000:8000] = False
        experiments = tuple(replace(e, mask=m) for e, m in zip(campaign, kept, strict=True))
        campaign = replace(campaign, experiments=experiments)
    problem = Problem(campaign)
    theta = problem.layout.flat(json.loads((REFERENCE / "truth.json").read_text()))
    found = diagnose_residuals(problem, Known(theta)).to_json()
    noise = FittedNoise.of(problem, theta)
    r, used, z, white = (noise.joined(name) for name in ("r", "used", "z", "e"))

    # autocorrelation: sums over pairs of used samples, as many as there would be without gaps
    d, n = np.zeros(len(used)), len(used)
    d[used] = r - r.mean()
    shown = np.rint(np.array(found["acf"]["lag_s"]) / campaign.reference_interval).astype(int)
    for i in (0, 1, 7, 200, len(shown) // 2, len(shown) - 1):
        k = shown[i]
        share = np.mean(used[k:] & used[: n - k]) / np.mean(used)
        expected = d[k:] @ d[: n - k] / (d @ d) / share
        assert found["acf"]["value"][i] == pytest.approx(expected, rel=1e-9, abs=1e-12)

    for label, series, fitted in (("before", z, 0), ("after", white, 1)):
        difference = np.diff(series)
        statistic = difference @ difference / (series @ series)
        assert found["durbin_watson"][label] == pytest.approx(statistic, rel=1e-12)
        d, m = series - series.mean(), len(series)
        rho = np.array([d[k:] @ d[:-k] / (d @ d) for k in range(1, max(LAGS) + 1)])
        q = m * (m + 2) * np.cumsum(rho**2 / (m - np.arange(1, max(LAGS) + 1)))[np.array(LAGS) - 1]
        assert found["ljung_box"][label]["statistic"] == pytest.approx(q, rel=1e-10)
        p_values = found["ljung_box"][label]["p_value"]
        assert [p is None for p in p_values] == [k <= fitted for k in LAGS]
        p = chi2.sf(q[fitted:], np.array(LAGS[fitted:]) - fitted)  # LAGS begins with 1
        assert p_values[fitted:] == pytest.approx(p, rel=1e-8)

    test = found["variance_vs_concentration"]["breusch_pagan"]
    thin = slice(None, None, test["every"])
    squares = np.concatenate([s.r[thin] for s in noise.series]) ** 2
    gas = np.concatenate([s.concentration * s.x[thin] for s in noise.series])
    statistic = len(squares) * np.corrcoef(squares, gas)[0, 1] ** 2
    assert test["n"] == len(squares)
    assert test["statistic"] == pytest.approx(statistic, rel=1e-9)
    assert test["p_value"] == pytest.approx(chi2.sf(statistic, 1), rel=1e-8)


def test_the_variance_in_bins_agrees_with_breusch_pagan_and_white_where_these_hold():
    # white normal residuals about zero: all three see the same, a line and a bow against the gas
    rng = np.random.default_rng(9)
    gas, edges = rng.random(20_000), np.linspace(0.0, 1.0, 6)
    regressors = np.column_stack([np.ones_like(gas), gas])
    for scale, line in (
        (np.ones_like(gas), False), (1.0 + gas, True), (2.0 - np.abs(2.0 * gas - 1.0), False),
    ):  # fmt: skip
        e = scale * rng.standard_normal(len(gas))
        same = np.ptp(scale) == 0.0
        assert check_variance([e], [gas], edges).adequate == same
        assert (het_white(e, regressors)[1] > 1e-3) == same
        assert (het_breuschpagan(e, regressors)[1] < 1e-3) == line


def test_what_breusch_pagan_and_white_take_for_variance_and_bins_do_not():
    rng = np.random.default_rng(10)
    gas, edges = np.linspace(0.0, 1.0, 4000), np.linspace(0.0, 1.0, 6)
    regressors = np.column_stack([np.ones_like(gas), gas])
    correlated = {"bins": 0, "white": 0, "breusch-pagan": 0}
    for _ in range(100):
        z = simulate_noise(np.ones(len(gas)), 0.9, rng)
        e = whiten(z, np.arange(len(z)), 0.9)
        correlated["bins"] += not check_variance([e], [gas], edges).adequate
        correlated["white"] += het_white(z, regressors)[1] < 1e-3
        correlated["breusch-pagan"] += het_breuschpagan(z, regressors)[1] < 1e-3
    assert correlated["bins"] <= 1
    assert min(correlated["white"], correlated["breusch-pagan"]) > 20
    misfit = rng.standard_normal(len(gas)) + 3.0 * np.exp(-(((gas - 0.9) / 0.05) ** 2))
    assert check_variance([misfit], [gas], edges).adequate
    for test in (het_white, het_breuschpagan):
        assert test(misfit, regressors)[1] < 1e-6


def test_autocorrelation_counts_lags_through_gaps():
    rng = np.random.default_rng(7)
    r = simulate_noise(np.ones(40_000), 0.8, rng)
    whole = autocorrelation(r, 12)
    few, second = rng.random(len(r)) > 0.3, np.arange(len(r)) % 2 == 0
    assert autocorrelation(r, 12, np.ones(len(r), dtype=bool)) == pytest.approx(whole)
    assert autocorrelation(r[few], 12, few) == pytest.approx(whole, abs=0.03)
    thinned = autocorrelation(r[second], 12, second)
    assert np.isnan(thinned[1::2]).all()
    assert thinned[::2] == pytest.approx(whole[::2], abs=0.03)


@pytest.mark.parametrize(("every", "phi"), [(2, 0.8), (3, 0.8), (3, -0.7), (2, 0.0)])
def test_correlation_is_found_where_no_two_neighbours_are_used(every, phi):
    mask = np.arange(4000) % every == 0
    theta = {**MEAN, "phi": phi, "sigma0_V": 0.045, "sigma1_V": 0.05}
    measured = simulate(plan(0.01, 40.0, mask), theta, seed=4)
    fit = fit_least_squares(measured, seed=1)
    layout = Layout.of(measured)
    assert fit.theta_hat[layout.index("phi")] == pytest.approx(phi, abs=0.07)
    found = diagnose_residuals(measured, fit)
    assert found.adequate
    assert found.acf["lag_s"][1] == pytest.approx(every * 0.01)
    assert found.acf["value"][1] == pytest.approx(phi**every, abs=0.12)
    assert found.experiments["a"]["lag_one"] is None


@pytest.mark.parametrize("phi", [-0.4, 0.0, 0.9])
def test_whitening_undoes_ar1_across_gaps(phi):
    rng = np.random.default_rng(4)
    z = simulate_noise(np.ones(60_000), phi, rng)
    index = np.flatnonzero(rng.random(60_000) > 0.2)
    e = whiten(z[index], index, phi)
    # 48 000 samples: sd of a correlation is 0.0046
    assert np.abs(autocorrelation(e, 20)[1:]).max() < 0.02
    assert np.std(e) == pytest.approx(1.0, abs=0.02)


def test_ar1_noise_is_found_adequate(adequate):
    assert adequate.adequate and "describes the residuals" in adequate.verdict
    lag, value, curve = (np.array(adequate.acf[key]) for key in ("lag_s", "value", "ar1"))
    assert lag[:3] == pytest.approx([0.0, 0.002, 0.004]) and value[0] == 1.0
    assert curve[1] == pytest.approx(0.8)
    # long-lag sd of the sample autocorrelation near 0.015
    assert np.abs(value - curve)[:100].max() < 0.06
    assert max(adequate.ljung_box["before"]["p_value"]) < 1e-10
    first, *others = adequate.ljung_box["after"]["p_value"]
    assert first is None and min(others) > 1e-3  # one correlation was fitted
    # 2 (1 - phi) before, 2 after
    assert adequate.durbin_watson["before"] == pytest.approx(0.4, abs=0.03)
    assert adequate.durbin_watson["after"] == pytest.approx(2.0, abs=0.05)
    assert adequate.spectrum["slow_to_ar1"] == pytest.approx(
        1.0, abs=4 * adequate.spectrum["expected_sd"]
    )


def test_slow_noise_is_sought_below_one_frequency_whatever_the_interval():
    # noise of one correlation time, 0.1 s: a record at ten times the rate has as many ordinates
    # below a tenth of the frequency at which its spectrum bends
    own = {name: EXPERIMENTS["a"] for name in "abc"}
    theta = {**MEAN, "experiments": own, "phi": np.exp(-0.02), "sigma0_V": 0.05, "sigma1_V": 0.0}
    counts = []
    for last in (0.002, 0.0002):
        campaign = Campaign(
            "three",
            tuple(
                Experiment(name, h * np.arange(round(140.0 / h)), None, 60.0, 10.0, h, 2.5, 10.5)
                for name, h in zip("abc", (0.002, 0.002, last), strict=True)
            ),
        )
        campaign = simulate(campaign, theta, seed=4)
        found = diagnose_residuals(campaign, Known(Problem(campaign).layout.flat(theta)))
        counts.append(found.spectrum["expected_sd"] ** -2)
    assert counts[0] > 65  # above the least of twenty a record
    assert counts[1] == pytest.approx(counts[0], abs=1)


def test_slow_noise_on_top_is_found_inadequate():
    found = diagnosed(change=lambda t: 0.06 * np.sin(2 * np.pi * t / 6.0))
    assert not found.adequate and "too narrow" in found.verdict
    assert found.spectrum["slow_to_ar1"] > 1.5


def test_ripple_left_after_whitening_is_found():
    found = diagnosed(phi=0.3, change=lambda t: 0.1 * np.sin(2 * np.pi * 50.0 * t))
    assert not found.adequate and "left after whitening" in found.verdict


def test_white_noise_passes_before_and_after():
    found = diagnosed(phi=0.0, sigma1=0.0)
    assert found.adequate
    assert min(found.ljung_box["before"]["p_value"]) > 1e-3
    assert found.durbin_watson["before"] == pytest.approx(2.0, abs=0.05)


def test_spread_grows_with_concentration_where_it_does(adequate):
    table = adequate.variance_vs_concentration
    filled = [i for i, n in enumerate(table["count"]) if n > 1000]
    assert len(filled) >= 2 and sum(table["count"]) == 20_000
    for i in filled:
        # about 1000/9 independent squares at least: 10 %, and twice that allowed
        assert table["sd_V"][i] == pytest.approx(table["law_sd_V"][i], rel=0.2)
    assert table["sd_V"][filled[-1]] > 1.2 * table["sd_V"][filled[0]]
    assert table["breusch_pagan"]["p_value"] < 1e-6
    constant = diagnosed(sigma1=0.0).variance_vs_concentration["breusch_pagan"]
    assert constant["p_value"] > 1e-3
    assert constant["every"] > 1 and constant["n"] > 500


def test_breusch_pagan_keeps_its_level_on_correlated_noise():
    p_values = [
        diagnosed(sigma1=0.0, seed=seed).variance_vs_concentration["breusch_pagan"]["p_value"]
        for seed in range(30)
    ]
    # at level 0.1 three of thirty are expected; without thinning more than ten would be below
    assert sum(p < 0.1 for p in p_values) <= 8
    rng = np.random.default_rng(0)
    r = simulate_noise(np.ones(20_000), 0.8, rng)
    x = np.repeat([0.0, 1.0], 10_000)
    assert 0.0 <= het_breuschpagan(r, np.column_stack([np.ones_like(x), x]))[1] <= 1.0


def test_histogram_has_the_papers_bins(adequate):
    found = adequate.histogram
    edges = np.array(found["edges_V"])
    assert found["bin_V"] == HISTOGRAM_BIN
    assert np.diff(edges) == pytest.approx(0.05)
    assert edges / 0.05 == pytest.approx(np.round(edges / 0.05), abs=1e-9)
    assert sum(found["count"]) == 20_000


def test_histogram_adapts_and_says_so():
    r = 1e-3 * np.random.default_rng(0).standard_normal(5000)
    r[7] = 50.0  # a spike must not make fifty thousand bins
    found = histogram(np.delete(r, 7))
    assert 5 < len(found["count"]) < 20 and "does not suit" in found["note"]
    found = histogram(r)
    assert len(found["count"]) <= 202 and sum(found["count"]) == 5000
    assert sum(histogram(np.zeros(5))["count"]) == 5


def test_noise_of_each_experiment(adequate):
    own = adequate.experiments
    assert set(own) == {"a", "b"}
    assert own["a"]["baseline_sd_V"] == pytest.approx(0.045, rel=0.15)
    # b has the highest concentration: sqrt(0.045^2 + 0.05^2)
    assert own["b"]["plateau_sd_V"] == pytest.approx(0.0673, rel=0.15)
    assert own["a"]["lag_one"] == pytest.approx(0.8, abs=0.03)


def test_masked_samples_are_left_out():
    mask = np.ones(10_000, dtype=bool)
    mask[2000:2600] = False
    mask[::700] = False
    found = diagnosed(mask=mask, change=lambda t: np.where(mask, 0.0, np.nan))
    assert found.experiments["a"]["n"] == int(mask.sum())
    assert found.adequate


def test_json_follows_the_contract(adequate):
    result = json.loads(json.dumps(adequate.to_json(), allow_nan=False))
    assert {"acf", "ljung_box", "ar1", "variance_vs_concentration"} <= set(result)
    assert set(result["acf"]) >= {"lag_s", "value"}
    assert len(result["acf"]["lag_s"]) == len(result["acf"]["value"]) == len(result["acf"]["ar1"])
    assert result["ar1"]["phi"] == 0.8 and result["ar1"]["sigma0_V"] == 0.045
    assert result["ar1"]["sigma1_V"] == pytest.approx(0.05)


def test_residuals_of_zero_do_not_break_anything():
    theta = {**MEAN, "phi": 0.0, "sigma0_V": 0.01, "sigma1_V": 0.0}
    clean = simulate(plan(), {**MEAN, "phi": 0.0, "sigma0_V": 0.0, "sigma1_V": 0.0})
    found = diagnose_residuals(clean, Known(Problem(clean).layout.flat(theta)))
    json.dumps(found.to_json(), allow_nan=False)


@pytest.mark.parametrize("slow", [0.0, 0.03])
def test_the_doubt_of_the_noise_is_the_diagnosis(slow):
    rng = np.random.default_rng(5)
    theta = {**MEAN, "phi": 0.5, "sigma0_V": 0.045, "sigma1_V": 0.05}
    campaign = simulate(plan(), theta, seed=3)
    added = {
        e.name: e.values + slow * simulate_noise(np.ones(len(e.t)), 0.995, rng) for e in campaign
    }
    campaign = campaign.with_data(added)
    fit = fit_least_squares(campaign, seed=1)
    found = diagnose_residuals(campaign, fit)
    doubt = noise_doubt(Problem(campaign), fit.theta_hat)
    assert found.adequate == (slow == 0.0) == (doubt == "")
    assert slow == 0.0 or doubt.startswith(found.verdict)


def test_slow_noise_is_told_wherever_intervals_rest_on_ar1():
    rng = np.random.default_rng(5)
    theta = {**MEAN, "phi": 0.5, "sigma0_V": 0.045, "sigma1_V": 0.05}
    campaign = simulate(plan(), theta, seed=3)
    campaign = campaign.with_data(
        {e.name: e.values + 0.03 * simulate_noise(np.ones(len(e.t)), 0.995, rng) for e in campaign}
    )
    fit = fit_least_squares(campaign, seed=1)
    posterior = sample_posterior(campaign, fit, sampler="independence", seed=1)
    doubt = noise_doubt(Problem(campaign), fit.theta_hat)
    assert "too narrow" in doubt and doubt in posterior.warnings
    bounds = compare_bounds(
        campaign, fit, posterior, methods=["crlb_ar1", "profile", "sandwich", "posterior"]
    )
    for method in ("crlb_ar1", "profile", "posterior"):
        assert doubt in bounds[method].status
    assert doubt not in bounds["sandwich"].status


def of_two_memories(phis, per_experiment):
    """A fit to two experiments with coefficients of their own, its problem, what is said of it."""
    measured = plan(duration=40.0)
    measured = measured.with_data({
        e.name: simulate(measured, {**MEAN, "phi": phi, "sigma0_V": 0.045, "sigma1_V": 0.0},
                         seed=3)[e.name].values
        for e, phi in zip(measured, phis, strict=True)
    })  # fmt: skip
    problem = Problem(measured, noise=Noise(per_experiment=per_experiment))
    fit = fit_least_squares(problem, swarms=1, seed=1, euler=False)
    vector = problem.layout.flat(fit.theta_hat)
    return diagnose_residuals(problem, fit), noise_doubt(problem, vector)


def test_experiments_with_noise_of_their_own_are_set_beside_their_own_law():
    found, doubt = of_two_memories((0.6, 0.98), per_experiment=True)
    assert found.adequate and doubt == ""
    low, high = (float(v) for v in re.findall(r"phi = ([\d.]+) to ([\d.]+) at", found.verdict)[0])
    assert (low, high) == pytest.approx((0.6, 0.98), abs=0.02)
    # all residuals together: the mean of both curves, which no single coefficient gives
    lag = np.rint(np.array(found.acf["lag_s"]) / 0.002)
    mean = 0.5 * (0.6**lag + 0.98**lag)
    assert np.abs(np.array(found.acf["ar1"]) - mean).max() < 0.06
    assert np.abs(np.array(found.acf["ar1"]) - 0.79**lag).max() > 0.2


def test_noise_of_their_own_is_advised_where_experiments_differ():
    found, doubt = of_two_memories((0.6, 0.98), per_experiment=False)
    assert not found.adequate
    advice = (
        r"correlate by ([\d.]+) in experiment a and by ([\d.]+) in b: with `per_experiment = true`"
    )
    for said in (found.verdict, doubt):
        low, high = (float(v) for v in re.findall(advice, said)[0])
        assert (low, high) == pytest.approx((0.6, 0.975), abs=0.012)
    # not where they are alike and something else is wrong, in both or in one, nor where nothing is
    for change in (None, lambda t: 0.06 * np.sin(2 * np.pi * t / 6.0)):
        assert "per_experiment" not in diagnosed(change=change).verdict
    theta = {**MEAN, "phi": 0.3, "sigma0_V": 0.045, "sigma1_V": 0.0}
    measured = simulate(plan(), theta, seed=1)
    raised = measured.with_data({"a": measured["a"].values, "b": measured["b"].values + 0.06})
    found = diagnose_residuals(raised, Known(Problem(raised).layout.flat(theta)))
    assert not found.adequate and "per_experiment" not in found.verdict


def test_experiments_of_other_intervals_have_the_law_at_their_own():
    own = {name: EXPERIMENTS["a"] for name in "abc"}
    theta = {**MEAN, "experiments": own, "phi": 0.6, "sigma0_V": 0.05, "sigma1_V": 0.0}
    campaign = Campaign(
        "three",
        tuple(
            Experiment(name, h * np.arange(round(60.0 / h)), None, 60.0, 10.0, h, 2.5, 10.5)
            for name, h in zip("abc", (0.02, 0.02, 0.002), strict=True)
        ),
    )
    # one interval is one, though the reference is rounded
    assert not campaign.same_interval and plan(1.0 / 3000.0, 2.0).same_interval
    campaign = simulate(campaign, theta, seed=4)
    found = diagnose_residuals(campaign, Known(Problem(campaign).layout.flat(theta)))
    assert found.adequate
    lag = np.rint(np.array(found.acf["lag_s"]) / 0.02)
    slow, few = 0.6**0.1, 3000 / 36000  # ten times as many samples are ten times as close
    expected = 2.0 * few * 0.6**lag + (1.0 - 2.0 * few) * slow**lag
    assert np.abs(np.array(found.acf["ar1"]) - expected).max() < 0.05


# --- what adequate asks of the variance


def scaled_noise(scale, phi=0.8, seed=1, interval=0.01):
    """A campaign of 18 s records whose noise is ``scale(x3, slope)`` V times an AR(1), its truth.

    ``slope``: |dx3/dt| over the largest.
    """
    design = plan(interval, 18.0)
    problem, rng = Problem(design), np.random.default_rng(seed)
    theta = problem.layout.flat({**MEAN, "phi": 0.0, "sigma0_V": 1.0, "sigma1_V": 0.0})
    values = {}
    for e in design:
        x = problem.model.response(e.t, theta, problem.layout, e)
        slope = np.abs(np.gradient(x, e.t))
        noise = simulate_noise(scale(x, slope / slope.max()), phi, rng)
        values[e.name] = problem.model.mean(e.t, theta, problem.layout, e) + noise
    return design.with_data(values)


def judged(campaign, law="concentration"):
    problem = Problem(campaign, noise=Noise(law))
    fit = fit_least_squares(problem, seed=1, swarms=1, euler=False)
    return problem, fit, diagnose_residuals(problem, fit)


@pytest.mark.parametrize("law", ["concentration", "signal", "constant", "levels"])
def test_the_right_variance_law_is_adequate(law):
    for seed in range(12):
        theta = {**MEAN, "phi": (0.0, 0.5, 0.9)[seed % 3], "sigma0_V": 0.03, "sigma1_V": 0.02}
        theta.update(Noise(law).fixed)
        interval, duration = (0.01, 18.0) if seed % 2 else (0.002, 13.0)
        problem = Problem(plan(interval, duration), noise=Noise(law))
        problem = replace(problem, campaign=simulate(problem, theta, seed=seed))
        found = diagnose_residuals(problem, Known(problem.layout.flat(theta)))
        assert found.adequate and found.recommendation == found.doubt == "", found.verdict
        assert set(found.checks) == {
            "correlation", "variance_concentration", "variance_slope", "rounding",
        }  # fmt: skip
        assert "variance is" in found.verdict


def test_p_values_of_the_variance_are_not_small_too_often_where_nothing_is_wrong():
    rng = np.random.default_rng(3)
    place = np.clip(np.cumsum(rng.standard_normal(2000)) / 50.0, 0.0, 1.0)
    edges = np.linspace(0.0, 1.0, 6)
    p = np.array([
        check_variance([rng.standard_normal(2000)], [place], edges).p_value for _ in range(400)
    ])  # fmt: skip
    # Bonferroni's bound is 20 expected, sd 4.4
    assert np.sum(p < 0.05) <= 34 and np.sum(p < 0.2) > 20


def test_heavy_tails_do_not_pass_for_another_variance():
    rng = np.random.default_rng(4)
    place, edges = np.repeat([0.1, 0.9], [1900, 100]), np.array([0.0, 0.5, 1.0])
    failed = 0
    for _ in range(200):
        e = rng.standard_t(3.0, 2000)
        failed += not check_variance([e], [place], edges).adequate
    assert failed <= 4


def test_a_small_difference_of_variance_is_no_doubt_however_certain():
    rng = np.random.default_rng(5)
    place, edges = np.repeat([0.1, 0.9], 100_000), np.array([0.0, 0.5, 1.0])
    for factor, adequate in ((1.15, True), (2.0, False)):
        e = rng.standard_normal(200_000) * np.where(place > 0.5, np.sqrt(factor), 1.0)
        found = check_variance([e], [place], edges)
        assert found.p_value < 1e-6 and found.adequate == adequate
        assert found.trend == pytest.approx(factor, rel=0.03)


def test_a_misfit_does_not_pass_for_variance():
    rng = np.random.default_rng(6)
    place, edges = np.linspace(0.0, 1.0, 4000), np.array([0.0, 0.4, 0.6, 1.0])
    e = rng.standard_normal(4000) + 3.0 * np.exp(-(((place - 0.5) / 0.05) ** 2))
    assert check_variance([e], [place], edges).adequate
    assert np.mean(e[1600:2400] ** 2) > 2.0  # though the squares themselves would say so


def test_empty_bins_join_the_one_below_and_few_samples_say_nothing():
    rng = np.random.default_rng(7)
    place = np.repeat([0.05, 0.5, 0.95], [500, 10, 60])
    found = check_variance([rng.standard_normal(570)], [place], np.array([0.0, 0.1, 0.6, 0.9, 1.0]))
    assert found.low.tolist() == [0.0, 0.9] and found.high.tolist() == [0.9, 1.0]
    assert found.count.tolist() == [508.0, 58.0]  # two at either end have no neighbours
    for n in (0, 3, 30):
        few = check_variance([rng.standard_normal(n)], [np.zeros(n)], np.array([0.0, 0.5, 1.0]))
        assert few.adequate and few.p_value is None and few.worst is None
        json.dumps(few.to_json(), allow_nan=False)


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_noise_that_rises_with_the_slope_is_told_and_not_trusted(phi):
    campaign = scaled_noise(lambda x, slope: 0.004 + 0.03 * slope, phi)
    problem, fit, found = judged(campaign)
    assert not found.adequate and found.checks["correlation"]["adequate"]
    check = found.checks["variance_slope"]
    assert not check["adequate"] and check["p_value"] < 1e-6
    assert "rises with the slope of the response" in found.verdict
    assert found.doubt == noise_doubt(problem, problem.layout.flat(fit.theta_hat))
    assert found.doubt.endswith(TAKE_AS_THEY_ARE)
    table = found.variance_vs_slope
    filled = [i for i, n in enumerate(table["count"]) if n > 50]
    ratio = [table["sd_V"][i] / table["law_sd_V"][i] for i in filled]
    assert ratio[-1] > 2.0 * ratio[0]
    if phi:
        return  # the independence sampler gives up, and emcee takes two minutes
    posterior = sample_posterior(problem, fit, sampler="independence", seed=1)
    assert found.doubt in posterior.warnings and found.doubt in posterior.status
    assert posterior.convergence in posterior.status
    methods = ["crlb_iid", "crlb_iid_one_percent_step", "crlb_ar1", "profile", "sandwich"]
    bounds = compare_bounds(problem, fit, posterior, methods=[*methods, "posterior"])
    for method in (*methods[:4], "posterior"):
        assert bounds[method].status.count(found.doubt) == 1, method
    assert "variance" not in bounds["sandwich"].status


def test_noise_that_falls_with_gas_fails_under_the_usual_law_and_not_under_levels():
    top = 25.0 / 125.0

    def falling(experiment):
        share = experiment.concentration / top
        return lambda x: np.sqrt(0.02**2 * (1.0 - share * x) + 0.005**2 * share * x)

    design, rng = plan(0.01, 18.0), np.random.default_rng(2)
    theta = Problem(design).layout.flat({**MEAN, "phi": 0.5, "sigma0_V": 1.0, "sigma1_V": 0.0})
    layout, model = Problem(design).layout, Problem(design).model
    campaign = design.with_data({
        e.name: model.mean(e.t, theta, layout, e)
        + simulate_noise(falling(e)(model.response(e.t, theta, layout, e)), 0.5, rng)
        for e in design
    })  # fmt: skip
    _, _, usual = judged(campaign)
    assert not usual.checks["variance_concentration"]["adequate"]
    assert "falls with gas" in usual.verdict
    assert "The law 'levels' describes them" in usual.verdict and 'Noise("levels")' in usual.verdict
    assert not judged(campaign, "constant")[2].adequate
    problem, fit, found = judged(campaign, "levels")
    assert found.adequate, found.verdict
    assert found.ar1["sigma0_V"] == pytest.approx(0.02, rel=0.1)
    assert found.ar1["sigma1_V"] == pytest.approx(0.005, rel=0.2)
    posterior = sample_posterior(problem, fit, sampler="independence", seed=1)
    assert posterior.converged and posterior.warnings == ()
    low, high = posterior.quantiles("sigma1_V", [0.005, 0.995])
    assert low < 0.005 < high and high < 0.007


def test_the_law_that_would_do_is_named_and_where_none_does_levels_come_nearest():
    rising = scaled_noise(lambda x, slope: 0.005 + 0.02 * x, 0.5)
    assert "rises with gas by more" in judged(rising, "constant")[2].verdict
    assert "The law 'concentration' describes them" in judged(rising, "constant")[2].verdict
    steep = scaled_noise(lambda x, slope: 0.02 * (1.45 - 1.4 * np.sqrt(np.clip(x, 0, 1))), 0.5)
    verdict = judged(steep)[2].verdict
    assert "falls with gas" in verdict and "can be fitted, if not exactly" in verdict
    assert '"levels"' in verdict and '"levels"' not in judged(steep, "levels")[2].recommendation


@pytest.mark.parametrize(("steps", "adequate"), [(0.0, True), (0.5, True), (5.0, False)])
def test_rounding_that_exceeds_the_noise_is_said_to_fail_every_method(steps, adequate):
    sigma = 0.01
    campaign = scaled_noise(lambda x, slope: np.full(len(x), sigma), 0.0)
    if steps:
        step = steps * sigma
        campaign = campaign.with_data({e.name: step * np.rint(e.values / step) for e in campaign})
    _, _, found = judged(campaign)
    assert found.checks["rounding"]["adequate"] == adequate
    if steps:
        assert found.checks["rounding"]["step_V"] == pytest.approx(steps * sigma)
    if not adequate:
        assert not found.adequate and "rounding errors more than noise" in found.verdict
        assert found.recommendation == f"{TAKE_AS_THEY_ARE} {TOO_COARSE}"
    else:
        assert found.adequate, found.verdict


def test_variance_bins_rise_from_pure_carrier_gas() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    bins = diagnose_residuals(problem, Known(theta)).to_json()["variance_vs_concentration"]
    low, high = np.array(bins["concentration_low"]), np.array(bins["concentration_high"])
    reference = problem.campaign.reference_concentration
    np.testing.assert_allclose(low[:3], [0.0, 0.02 * reference, 0.1 * reference])
    assert (high > low).all() and (low[1:] == high[:-1]).all() and low[0] == 0.0
    assert bins["count"][0] > 0  # the baseline


@pytest.mark.parametrize(("n", "farthest"), [(40_000, 2000), (5000, 501)])
def test_residuals_that_stay_correlated_are_thinned_beyond_the_farthest_lag(
    n: int, farthest: int
) -> None:
    # half a wave over the record: the correlation at a twentieth or tenth of it is still high
    z = np.cos(np.pi * np.arange(n) / n)
    series = SimpleNamespace(z=z, r=0.01 * z, x=np.linspace(0.0, 1.0, n), concentration=0.2)
    found = breusch_pagan([series])
    assert found["every"] == farthest + 1
    assert found["n"] == len(range(0, n, farthest + 1))


def test_a_lattice_needs_levels_that_differ_by_more_than_rounding() -> None:
    assert lattice_step(np.repeat([0.0, 0.25, 0.5, 1.0], 5)) == pytest.approx(0.25)
    assert lattice_step(np.repeat([0.0, 1.0], 5)) == 0.0  # any two levels lie on a lattice
    assert lattice_step(np.repeat([0.0, 0.3, 1.0, 1.45], 5)) == 0.0
    assert lattice_step(np.repeat([0.0, 1e-12, 1.0, 2.0], 5)) == pytest.approx(1.0)
