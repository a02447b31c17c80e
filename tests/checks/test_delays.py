"""Delay regressions against the published lines, statsmodels and cases without an answer."""

import json
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import statsmodels.api as sm
from scipy import stats
from statsmodels.stats.outliers_influence import OLSInfluence

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.checks.delays import regress_delays, regress_line
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.posterior import sample_posterior
from bayes_sensor.rig.layout import Layout
from tests.support.other_rigs import CASES

FLOWS = np.array([4.5, 3.5, 3.0, 9.0, 7.0, 6.0, 9.0])  # L/min
INVERSE = 60.0 / FLOWS  # s/L
NAMES = [str(k + 1) for k in range(7)]


@dataclass(frozen=True)
class Known:
    theta_hat: np.ndarray


def case(noise=0.0, outlier=0.0, seed=1, fall=True, commanded=True, flows=FLOWS, n=7):
    """A campaign and a fit whose delays follow the published regressions."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(1200)
    experiments, delays = [], []
    for k in range(n):
        start = 0.1340 + 0.1125 * 60.0 / flows[k] + noise * rng.standard_normal()
        end = 0.0161 + 0.0745 * 60.0 / flows[k] + noise * rng.standard_normal()
        delays.append((start + (outlier if k == 3 else 0.0), end))
        experiments.append(
            Experiment(
                NAMES[k], t, None, 0.8 * flows[k] / 0.06, 0.2 * flows[k] / 0.06, 0.1,
                commanded_on=20.0 if commanded else None,
                commanded_off=80.0 if fall else None,
            )
        )  # fmt: skip
    campaign = Campaign("delays", tuple(experiments), sensor_is="faster")
    layout = Layout.of(campaign)
    theta = np.ones(len(layout))
    for k, (start, end) in enumerate(delays):
        theta[layout.local[k, 2]] = 20.0 + start
        if fall:
            theta[layout.local[k, 3]] = 80.0 + end
    return campaign, Known(theta)


def test_published_lines_come_back_exactly():
    delays = regress_delays(*case())
    assert delays.end is not None
    for line, intercept, slope in (
        (delays.start, 0.1340, 0.1125),
        (delays.end, 0.0161, 0.0745),
    ):
        assert line.intercept == pytest.approx(intercept, abs=1e-10)
        assert line.slope == pytest.approx(slope, abs=1e-11)
        assert line.r2 == pytest.approx(1.0) and line.outliers == [] and line.n == 7


def test_experiment_4_is_found_and_left_out():
    delays = regress_delays(*case(noise=0.02, outlier=0.5))
    start = delays.start
    assert start.outliers == ["4"] and start.n == 6 and "4" in start.status
    assert start.bonferroni_p["4"] < 0.01
    # two-sided 99.9 % of the estimates' own errors, 4 degrees of freedom
    reach = stats.t.ppf(0.9995, 4)
    assert abs(start.intercept - 0.1340) < reach * start.se["intercept_s"]
    assert abs(start.slope - 0.1125) < reach * start.se["slope_L"]
    assert start.with_outliers is not None and start.with_outliers["n"] == 7
    assert start.with_outliers["r2"] < start.r2
    assert delays.end is not None and delays.end.outliers == []


def test_one_outlier_on_an_exact_line_is_found():
    # its own residual apart, nothing scatters
    assert regress_delays(*case(outlier=0.3)).start.outliers == ["4"]


def test_numbers_are_those_of_statsmodels():
    campaign, fit = case(noise=0.03, seed=5)
    line = regress_delays(campaign, fit).start
    result = sm.OLS(line.delay, sm.add_constant(INVERSE)).fit()
    influence = OLSInfluence(result)
    studentised = [line.studentised[name] for name in NAMES]
    assert studentised == pytest.approx(influence.resid_studentized_external, rel=1e-9)
    bonferroni = [line.bonferroni_p[name] for name in NAMES]
    assert bonferroni == pytest.approx(result.outlier_test()[:, 2], rel=1e-8)
    assert line.outliers == []
    assert line.p_value == pytest.approx(result.pvalues[1])
    assert line.ci95["slope_L"] == pytest.approx(result.conf_int()[1])
    # closed forms
    r = line.delay - line.intercept - line.slope * INVERSE
    s = np.sqrt(r @ r / 5)
    assert line.residual_sd == pytest.approx(s)
    assert line.se["slope_L"] == pytest.approx(s / np.sqrt(np.sum((INVERSE - INVERSE.mean()) ** 2)))
    assert line.r2 == pytest.approx(1 - r @ r / np.sum((line.delay - line.delay.mean()) ** 2))


def test_prediction_band_is_the_textbook_one():
    line = regress_delays(*case(noise=0.03, seed=5)).start
    x = np.array(line.band["inverse_flow_s_per_L"])
    leverage = 1 / 7 + (x - INVERSE.mean()) ** 2 / np.sum((INVERSE - INVERSE.mean()) ** 2)
    reach = stats.t.ppf(0.975, 5) * line.residual_sd * np.sqrt(1 + leverage)
    assert np.array(line.band["hi95_s"]) - line.band["fit_s"] == pytest.approx(reach)
    assert line.band["fit_s"] - np.array(line.band["lo95_s"]) == pytest.approx(reach)


def test_false_outliers_are_as_rare_as_said():
    rng = np.random.default_rng(9)
    found = sum(
        bool(regress_line(NAMES, INVERSE, 0.1 * rng.standard_normal(7)).outliers)
        for _ in range(300)
    )
    # level 0.05: 15 expected, sd 3.8; none at all would be suspicious too
    assert 3 <= found <= 28


def test_intervals_cover():
    rng = np.random.default_rng(10)
    inside = 0
    for _ in range(300):
        y = 0.1340 + 0.1125 * INVERSE + 0.02 * rng.standard_normal(7)
        low, high = regress_line(NAMES, INVERSE, y).ci95["slope_L"]
        inside += low <= 0.1125 <= high
    # 0.95, less a little for points left out by mistake; sd 0.0126
    assert 0.88 < inside / 300 < 0.985


def test_weights_follow_the_posterior():
    campaign, fit = case(noise=0.03, seed=5)
    spread = dict(zip(NAMES, [0.01, 0.02, 0.03, 0.01, 0.05, 0.02, 0.04]))

    class Posterior:
        def sd(self, name):
            kind, _, rest = name.partition("[")
            assert kind in ("t0_s", "tf_s")
            return spread[rest[:-1]]

    line = regress_delays(campaign, fit, Posterior()).start
    w = np.array([1 / spread[name] ** 2 for name in NAMES])
    X = np.column_stack([np.ones(7), INVERSE])
    expected = np.linalg.solve(X.T @ (X * w[:, None]), X.T @ (w * line.delay))
    assert line.weighted["intercept_s"] == pytest.approx(expected[0])
    assert line.weighted["slope_L"] == pytest.approx(expected[1])
    assert line.weighted["slope_L"] != pytest.approx(line.slope, rel=1e-6)


def test_sensors_of_one_record_share_its_switches():
    campaign, fit = case(noise=0.03, seed=5)
    alone = regress_delays(campaign, fit).start
    pairs = [
        replace(e, name=f"{e.name},{sensor}", record=e.name, sensor=sensor)
        for e in campaign
        for sensor in "AB"
    ]
    both = replace(campaign, experiments=tuple(pairs))
    layout, own = Layout.of(both), Layout.of(campaign).nested(fit.theta_hat)["experiments"]
    theta = np.ones(len(layout))
    for k, e in enumerate(both):
        theta[layout.switches(k)] = own[e.record]["t0_s"], own[e.record]["tf_s"]

    class Posterior:
        def sd(self, name):
            assert name in layout.names
            return 0.01

    line = regress_delays(both, Known(theta), Posterior()).start
    assert line.n == 7 and line.slope == pytest.approx(alone.slope, rel=1e-9)


@pytest.mark.arviz
def test_weights_from_inference_data():
    import xarray as xr

    campaign, fit = case(noise=0.03, seed=5)
    spread = np.array([0.01, 0.02, 0.03, 0.01, 0.05, 0.02, 0.04])
    draws = np.random.default_rng(1).standard_normal((2, 4000, 7)) * spread
    data = xr.Dataset(
        {
            name: (("chain", "draw", "experiment"), draws + offset)
            for name, offset in (("t0", 20.0), ("tf", 80.0))
        },
        coords={"experiment": NAMES},
    )
    posterior = SimpleNamespace(inference_data=SimpleNamespace(posterior=data))
    known = SimpleNamespace(sd=lambda name: spread[int(name[-2]) - 1])
    from_draws = regress_delays(campaign, fit, posterior).start.weighted
    from_sd = regress_delays(campaign, fit, known).start.weighted
    # sds from 8000 draws are good to 1 %
    assert from_draws["slope_L"] == pytest.approx(from_sd["slope_L"], rel=0.01)


def test_intervals_hold_what_all_switch_times_share():
    # an error of tau moves all of them: no scatter about the line tells of it
    rng = np.random.default_rng(3)
    shared = 0.03**2 * np.outer(INVERSE / INVERSE.mean() + 2.0, INVERSE / INVERSE.mean() + 2.0) / 9
    covariance = shared + 0.004**2 * np.eye(7)
    held = {"told": [], "ordinary": []}
    for _ in range(400):
        y = 0.134 + 0.1125 * INVERSE
        y = y + rng.multivariate_normal(np.zeros(7), covariance) + 0.006 * rng.standard_normal(7)
        line = regress_line(NAMES, INVERSE, y, covariance)
        if line.outliers:
            continue
        for kind, found in (("told", line.ci95), ("ordinary", line.ordinary["ci95"])):
            low, high = found["intercept_s"]
            held[kind].append(low <= 0.134 <= high)
    assert 0.92 < np.mean(held["told"]) < 0.98
    assert np.mean(held["ordinary"]) < 0.7


def test_errors_of_a_fit_are_those_of_its_information():
    campaign, truth = case(noise=0.01)
    layout = Layout.of(campaign)
    theta = truth.theta_hat.copy()
    for name, value in (("tau_s", 0.3), ("tau_v_s", 1.0), ("V_mL", 60.0), ("phi", 0.3),
                        ("sigma0_V", 0.01), ("sigma1_V", 0.01)):  # fmt: skip
        theta[layout.index(name)] = value
    measured = simulate(campaign, theta, seed=2)
    fit = fit_least_squares(measured, seed=1, swarms=1, euler=False)
    line = regress_delays(measured, fit).start
    draws = sample_posterior(measured, fit, sampler="independence", seed=1)
    sampled = regress_delays(measured, fit, draws).start
    assert line.se["intercept_s"] > 1.2 * line.ordinary["se"]["intercept_s"]
    assert line.se["intercept_s"] == pytest.approx(sampled.se["intercept_s"], rel=0.15)
    assert sampled.weighted["reduced_chi2"] > 0.0 and line.weighted is None
    assert line.slope == pytest.approx(np.polyfit(INVERSE, line.delay, 1)[0])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"n": 2}, "at least 3"),
        ({"commanded": False}, "no commanded time"),
        ({"flows": np.full(7, 5.0)}, "all flows are equal"),
    ],
)
def test_without_an_answer_the_record_says_why(change, reason):
    line = regress_delays(*case(**change)).start
    assert line.slope is None and line.intercept is None and line.ci95 is None
    assert reason in line.status
    json.dumps(line.to_json(), allow_nan=False)


def test_no_step_down_is_no_end_delay():
    delays = regress_delays(*case(fall=False))
    assert delays.end is None and delays.to_json()["end"] is None


def test_some_commanded_times_are_enough():
    campaign, fit = case(noise=0.01)
    first = replace(campaign.experiments[0], commanded_on=None)
    campaign = replace(campaign, experiments=(first, *campaign.experiments[1:]))
    line = regress_delays(campaign, fit).start
    assert line.names == NAMES[1:] and line.n == 6


def test_two_flows_only_is_no_crash():
    # the lone experiment at its flow decides the line there: no studentised residual
    campaign, fit = case(noise=0.01, flows=np.array([4.5, 9, 9, 9, 9, 9, 9.0]))
    line = regress_delays(campaign, fit).start
    assert line.studentised["1"] is None and line.slope is not None
    json.dumps(line.to_json(), allow_nan=False)


def test_three_delays_are_a_line_whose_intervals_have_one_degree_of_freedom():
    campaign, fit = case(noise=0.01, n=3)
    line = regress_delays(campaign, fit).start
    slope, intercept = np.polyfit(line.inverse_flow, line.delay, 1)
    assert (line.slope, line.intercept) == pytest.approx((slope, intercept))
    left = line.delay - intercept - slope * line.inverse_flow
    se = np.sqrt(left @ left / ((line.inverse_flow - line.inverse_flow.mean()) ** 2).sum())
    half = 12.7062 * se  # Student's t of one degree of freedom, tabulated
    assert line.ci95["slope_L"] == pytest.approx([slope - half, slope + half], rel=1e-5)
    assert line.n == 3 and line.outliers == [] and set(line.studentised.values()) == {None}
    json.dumps(line.to_json(), allow_nan=False)


def test_four_points_with_an_outlier_keep_all():
    y = np.array([0.5, 0.6001, 0.7, 5.0])
    line = regress_line(list("abcd"), np.array([1.0, 2.0, 3.0, 4.0]), y)
    assert line.n == 4 and line.outliers == [] and "too few would be left" in line.status


def test_json_follows_the_contract():
    result = json.loads(json.dumps(regress_delays(*case(0.02, 0.5)).to_json(), allow_nan=False))
    for side in ("start", "end"):
        assert {"intercept_s", "slope_L", "r2", "p_value", "ci95", "outliers", "n"} <= set(
            result[side]
        )
        low, high = result[side]["ci95"]["slope_L"]
        assert low < result[side]["slope_L"] < high
    assert result["start"]["outliers"] == ["4"]


def test_a_point_that_decides_its_line_hides_no_other() -> None:
    # the first flow stands alone; the points after it still have their studentised residuals
    x = np.array([1.0, 2.0, 2.0, 2.0, 2.0])
    y = np.array([0.3, 0.51, 0.48, 0.5, 0.52])
    line = regress_line(list("abcde"), x, y)
    assert line.studentised["a"] is None
    assert all(line.studentised[name] is not None for name in "bcde")


def test_the_interval_of_the_intercept_is_its_own() -> None:
    x, y = np.array([1.0, 2.0, 3.0, 5.0]), np.array([0.5, 0.63, 0.69, 0.92])
    line = regress_line(list("abcd"), x, y)
    expected = sm.OLS(y, sm.add_constant(x)).fit().conf_int()
    assert line.ci95["intercept_s"] == pytest.approx(expected[0])
    assert line.ci95["slope_L"] == pytest.approx(expected[1])


def test_a_point_off_an_exact_line_stands_out_without_limit() -> None:
    x = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    y = 0.25 + 0.125 * x
    y[2] += 0.5
    line = regress_line(list("abcde"), x, y)
    found = line.studentised
    assert found["c"] is not None and found["c"] > 1e6
    assert all(abs(found[name]) < 10.0 for name in "abde")


@pytest.mark.parametrize("rig", ["staircase", "pulse train", "recorded input"])
def test_programmes_have_no_delays_of_pulses(rig):
    case = CASES[rig]()
    found = regress_delays(case.design, Known(case.theta))
    assert found.start.status == "No regression: it is of single pulses, and there is none."
    assert found.end is None
