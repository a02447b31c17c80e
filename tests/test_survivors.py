"""What changed code had got past the tests: found by mutants that survived (study_mutants.py)."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import statsmodels.api as sm
from campaigns import small_design, small_problem, small_theta
from posterior_calibration import Ranks
from scipy.stats import kstest

import bayes_sensor.posterior.sample as sampling
from bayes_sensor.blind_check import oracle
from bayes_sensor.bounds.bootstrap import _series
from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks import coverage
from bayes_sensor.checks.counted_coverage import coverage_row
from bayes_sensor.checks.delays import regress_line
from bayes_sensor.checks.predictive import PredictiveCheck, _compare, _pit
from bayes_sensor.coating import find_outer_radius
from bayes_sensor.coating.readout import Cladding, Ring
from bayes_sensor.design.choose_experiments import _candidates
from bayes_sensor.design.planned_experiments import settings_of, truth_of
from bayes_sensor.design.record_information import record_information
from bayes_sensor.fit.block_averages import sorted_apart
from bayes_sensor.fit.first_estimates import first_look
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.mesh import compress, expected_information
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.laplace import Laplace, approximate, covering_region, draw_root
from bayes_sensor.posterior.r_hat import diagnostics, pareto_k
from bayes_sensor.posterior.widen_mesh import covered
from bayes_sensor.reality import draw
from bayes_sensor.reality.simulator import prepared_rig, sample_times
from bayes_sensor.residuals import diagnose_residuals
from bayes_sensor.rig.cascade import cascade_response


@dataclass(frozen=True)
class Known:
    """A fit that ended at the truth."""

    theta_hat: np.ndarray


def test_the_gradient_across_gaps_under_alternating_noise() -> None:
    problem, theta = small_problem(
        -0.4, n=2, interval=0.02, masked=[(3.0, 3.04), (4.0, 4.06), (5.5, 5.52)]
    )
    mesh = compress(problem, theta)
    i = problem.layout.index("phi")
    h = 1e-5
    up, down = theta.copy(), theta.copy()
    up[i] += h
    down[i] -= h
    expected = (mesh.log_likelihood(up) - mesh.log_likelihood(down)) / (2 * h)
    assert mesh.gradient(theta)[i] == pytest.approx(expected, rel=1e-6)


def test_the_density_of_drawn_roots_is_the_one_they_are_drawn_from() -> None:
    mean, sd = np.full(20_000, 0.3), np.full(20_000, 0.5)
    x, log_q = draw_root(mean, sd, np.random.default_rng(4), n_grid=32)
    order = np.argsort(x)
    q = np.exp(log_q[order])
    # the density of the draws made, summed over the stretch they cover
    assert np.trapezoid(q, x[order]) == pytest.approx(1.0, abs=2e-3)
    # piecewise linear: the distribution function at the draws is uniform, sd of its mean 0.002
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (q[1:] + q[:-1]) * np.diff(x[order]))])
    assert np.abs(cdf - np.arange(len(x)) / len(x)).max() < 0.014  # Kolmogorov: 1.95 / sqrt(n)


def test_every_parameter_with_limits_is_drawn_within_them() -> None:
    # two of them, correlated, each cut on one side at half a standard deviation
    cov = np.array([[1.0, 0.2, 0.1, 0.0], [0.2, 1.0, 0.6, 0.3], [0.1, 0.6, 1.0, 0.4],
                    [0.0, 0.3, 0.4, 1.0]])  # fmt: skip
    limits = (np.array([-9.0, -0.5, -9.0, -9.0]), np.array([9.0, 9.0, 0.5, 9.0]))
    coordinates = SimpleNamespace(
        squared=np.array([0]), limited=np.array([1, 2]), limits=limits, theta=lambda psi: psi,
        signs=lambda theta: np.ones(4),
    )  # fmt: skip
    laplace = Laplace(coordinates, np.zeros(4), cov, np.zeros(4), 0.0, True)
    drawn, log_q = laplace.draw(4000, np.random.default_rng(7))
    assert (drawn[:, 1] >= -0.5).all() and (drawn[:, 2] <= 0.5).all()
    assert drawn[:, 1].max() > 2.0 and drawn[:, 2].min() < -2.0 and np.isfinite(log_q).all()


def test_chains_that_differ_in_spread_alone_are_seen() -> None:
    draws = np.random.default_rng(2).standard_normal((4, 1000, 1)) + 7.0
    draws[2:] = 7.0 + 3.0 * (draws[2:] - 7.0)
    r_hat, _, _ = diagnostics(draws)
    assert r_hat[0] > 1.1


def test_a_mesh_grows_to_the_draws_also_where_a_switch_time_has_another_prior() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    name = "t0_s[a]"
    i = problem.layout.index(name)
    # 0.2 s wide around 2 s: two numbers that are no limits
    problem = replace(problem, given_priors={name: Prior("normal", theta[i], 0.2)})
    mesh = compress(problem, theta)
    thetas = np.stack([theta, theta])
    thetas[0, i] -= 1.0
    thetas[1, i] += 1.0
    wider = covered(mesh, thetas)
    assert wider.region.low[i] <= theta[i] - 1.0 and wider.region.high[i] >= theta[i] + 1.0
    assert wider.covers(thetas[0]) and wider.covers(thetas[1])


def test_without_a_fit_the_sampler_makes_one_and_with_one_it_does_not(monkeypatch) -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    seeds = []

    def fit(problem: Problem, seed: int) -> Known:
        seeds.append(seed)
        return Known(theta)

    def stop(*_: object) -> None:
        raise CampaignError("far enough")

    monkeypatch.setattr(sampling, "fit_least_squares", fit)
    monkeypatch.setattr(sampling, "approximate", stop)
    for given, expected in ((None, [5]), (Known(theta), [5])):
        with pytest.raises(CampaignError, match="far enough"):
            sampling.sample_posterior(problem, given, seed=5)
        assert seeds == expected


def test_holm_stops_at_the_first_check_that_passes() -> None:
    # the third would fail by its own: .003 * 3 < .01, but the second passes: .0026 * 4 > .01
    p = (0.5, 0.003, 0.0026, 0.001, 0.4)
    comparisons = [SimpleNamespace(p_value=value) for value in p[:3]]
    pit = SimpleNamespace(p_uniform=p[3], p_independent=p[4])
    check = PredictiveCheck(*comparisons, pit=pit, n_draws=1, seed=1)
    assert check.failed == ["pit_uniform"]


def test_the_distance_from_uniform_is_drawn_over_the_whole_range() -> None:
    problem, _ = small_problem(n=1, interval=0.05)
    n = int(problem.campaign.experiments[0].used.sum())
    u = np.random.default_rng(1).random(n)
    found = _pit([u], problem)
    np.testing.assert_allclose(found.grid, np.arange(1, 100) / 100)
    expected = [(u <= g).mean() - g for g in found.grid]
    np.testing.assert_allclose(found.ecdf_difference, expected)
    assert np.abs(found.ecdf_difference).max() <= found.ks


def test_variance_bins_rise_from_pure_carrier_gas() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    bins = diagnose_residuals(problem, Known(theta)).to_json()["variance_vs_concentration"]
    low, high = np.array(bins["concentration_low"]), np.array(bins["concentration_high"])
    reference = problem.campaign.reference_concentration
    np.testing.assert_allclose(low[:3], [0.0, 0.02 * reference, 0.1 * reference])
    assert (high > low).all() and (low[1:] == high[:-1]).all() and low[0] == 0.0
    assert bins["count"][0] > 0  # the baseline


def test_whitening_across_a_gap_leaves_white_noise() -> None:
    # phi .95 and two samples missing in every twenty: a wrong neighbour across the gap shows
    masked = [(0.2 * k, 0.2 * k + 0.0199) for k in range(1, 600)]
    campaign = small_design(n=1, interval=0.01, duration=120.0, masked=masked)
    problem = Problem(campaign)
    theta = small_theta(campaign, phi=0.95)
    problem = replace(problem, campaign=simulate(problem, theta, seed=3))
    e = problem.campaign.experiments[0]
    series = _series(problem, problem.layout.flat(theta), 0, whitened=True)
    starts = np.cumsum([0, *(b - a for a, b in e.runs[:-1])])[1:]
    assert len(starts) > 500
    # variance 1 within and across, sd of the mean square across sqrt(2/n)
    assert np.mean(series.e[starts] ** 2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / len(starts)))
    z = (e.values - e.values.mean())[e.used]
    assert z.std() > 0  # the raw series is not what is resampled
    np.testing.assert_allclose(
        series.across[1:], 0.95 ** (e.runs[1:, 0] - e.runs[:-1, 1] + 1), rtol=1e-12
    )


def test_candidates_fill_the_grid_that_was_asked_for() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    present, truth = settings_of(problem, theta), truth_of(problem, theta)
    found = _candidates(
        problem, theta, present, truth, (60.0, 120.0), (0.1, 0.3), (20.0, 60.0), (2, 3, 4)
    )
    assert len(found) == 2 * 3 * 4
    concentrations = {round(s.experiment.concentration, 9) for s in found}
    assert concentrations == {0.1, 0.2, 0.3}


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


def test_a_mesh_reaches_a_fifth_of_both_slow_constants_at_least() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    mesh = compress(problem, theta)
    laplace = SimpleNamespace(coordinates=SimpleNamespace(problem=problem), theta=theta)
    thetas = np.stack([theta, theta])
    thetas[0, 1:3] *= 0.5
    thetas[1, 1:3] *= 1.5
    region = covering_region(mesh, laplace, thetas, 0.4)
    np.testing.assert_allclose(region.low[1:3], 0.2 * theta[1:3])
    np.testing.assert_allclose(region.high[1:3], 1.9 * theta[1:3])


def test_the_tail_of_nearly_equal_weights_is_judged_like_any_other() -> None:
    # excesses of an exponential law have k = 0 in any unit; sd of the estimate about 0.07
    x = np.random.default_rng(8).exponential(size=20_000)
    assert pareto_k(np.log1p(1e-4 * x)) == pytest.approx(pareto_k(np.log1p(1e4 * x)), abs=1e-3)
    assert pareto_k(np.log1p(1e-4 * x)) == pytest.approx(0.0, abs=0.2)


def test_where_a_perfect_reader_looks_sums_to_one(monkeypatch) -> None:
    monkeypatch.setattr(oracle, "phase_edges", lambda case, step: {"rise": (1.0, 2.0),
                                                                   "tail": (2.0, 4.0)})  # fmt: skip
    step = SimpleNamespace(name="1", interval=0.1)
    seen = SimpleNamespace(steps=[step], spans=lambda: [slice(0, 4)], edges=[np.arange(5) * 10])
    fit = SimpleNamespace(residual=np.array([9.0, 1.0, 1.0, 1.0]))
    shares = oracle.places_after_refit(SimpleNamespace(), fit, seen)
    assert shares == {("1", "rise"): pytest.approx(1 / 3), ("1", "tail"): pytest.approx(2 / 3)}
    fit.residual[:] = 0.0
    assert set(oracle.places_after_refit(SimpleNamespace(), fit, seen).values()) == {0.0}


def test_a_rise_ends_where_nine_tenths_are_first_reached() -> None:
    problem, theta = small_problem(n=1, interval=0.01, sigma=0.002)
    e = problem.campaign.experiments[0]
    t = np.arange(0.0, 5.0, 1e-3)
    taus = [theta[0], theta[1], theta[2] / e.total_flow]
    x = cascade_response(t, taus, 0.0)
    expected = t[x >= 0.9][0] - t[x >= 0.1][0]
    assert first_look(e).rise == pytest.approx(expected, abs=0.03)


def test_equal_time_constants_are_set_apart_by_a_thousandth() -> None:
    taus = np.array([0.4, 0.5, 0.5])
    sorted_apart(taus)
    np.testing.assert_allclose(taus, [0.4, 0.5, 0.5005])


def test_a_coverage_is_a_share() -> None:
    row = coverage_row(np.arange(50) < 47, 0.95)
    assert (row["n"], row["covered"], row["coverage"], row["agrees"]) == (50, 47, 0.94, 1)
    assert row["coverage_lo95"] < 0.94 < row["coverage_hi95"]


def test_delays_of_the_design_of_the_coverage_study_are_the_published_lines() -> None:
    design, theta = coverage.small_design()
    layout = Problem(design).layout
    for e, (_, _, on, off) in zip(design, layout.local):
        inverse = 1000.0 / e.total_flow  # s/L
        assert theta[on] - e.commanded_on == pytest.approx(0.1340 + 0.1125 * inverse)
        assert theta[off] - e.commanded_off == pytest.approx(0.0161 + 0.0745 * inverse)


@pytest.mark.parametrize("tau63", [1e-6, 1.0])
def test_a_response_time_that_no_radius_gives_is_refused_in_words(tau63: float) -> None:
    with pytest.raises(ValueError, match="no radius gives .* ms; this coating reaches 63.2 %"):
        find_outer_radius(tau63)


def test_a_histogram_of_ranks_has_sixteen_bins_unless_told_otherwise() -> None:
    ranks = Ranks(("tau",), np.arange(64)[:, None], 63)
    assert ranks.histogram().tolist() == [[4] * 16]
    assert ranks.chi_squared()[0].tolist() == [0.0]
    assert ranks.histogram(8).tolist() == [[8] * 8]


@pytest.mark.parametrize(("size", "least"), [("small", 0.96), ("paper", 1.6)])
def test_drawn_valves_are_slower_than_drawn_sensors(monkeypatch, size: str, least: float) -> None:
    # a slow sensor with a quick valve, as one draw in ten thousand has them
    medians = {0.048: 0.25, 0.75: 0.3}
    monkeypatch.setattr(
        draw, "_log_normal", lambda rng, median, spread: medians.get(median, median)
    )
    case = draw.draw_case(1, size=size)
    assert case.tau == 0.25 and case.tau_v / case.tau == pytest.approx(least)


def test_samples_are_lost_after_the_switches_only() -> None:
    lost = 0
    for seed in range(30):
        case = draw.draw_case(seed, {"lost_samples": 0.5}, size="small")
        rig = prepared_rig(case)
        for step in case.steps:
            t = sample_times(step)
            true = rig[step.name].clock(t)
            jumps = np.flatnonzero(np.diff(true - t) > 0.01)
            lost += len(jumps)
            reach = 1.5 * (case.tau_v + case.V / np.mean([p.total_flow for p in case.steps]))
            for at in true[jumps] + step.interval:
                since = [at - switch for switch in (step.t0, step.tf) if at >= switch]
                assert since, f"seed {seed}, experiment {step.name}: lost before any switch"
                # seen at the first sample that follows
                assert 0.1 * reach <= min(since) <= reach + 2 * step.interval
    assert lost > 50  # 0.6 of the 180 switches


def test_a_pressure_spike_and_its_reversal_have_one_shape() -> None:
    case = replace(draw.draw_case(3, size="small"), strengths={"pressure_spike": 0.5})
    for step in case.steps:
        (course,) = prepared_rig(case)[step.name].offset
        # the other switch is too far away to show
        d = np.linspace(-1.5, 0.2, 300)
        opening, closing = course(step.t0 + d), course(step.tf + d)
        np.testing.assert_allclose(closing, -0.7 * opening, atol=1e-9 * np.abs(opening).max())
        peak = d[np.argmax(np.abs(opening))]
        assert -0.5 - 0.01 <= peak <= -0.1 + 0.01  # before the gas
        assert np.abs(opening).max() == pytest.approx(0.5 * abs(step.beta), rel=1e-2)


def test_the_ring_is_like_the_published_ones() -> None:
    ring, cladding = Ring(), Cladding()
    assert (ring.resonance, ring.q, ring.extinction) == (1574.4e-9, 20_000, 15)
    assert (ring.radius, ring.group_index) == (10e-6, 4.3)
    # De Vos et al. 2007: 70 nm/RIU; Kong et al. 2021: 7.4 pm/% at 188 nm/RIU
    assert cladding.redshift_per_percent == pytest.approx(7.4e-12 * 70 / 188)


def test_p_values_of_few_replicates_are_uniform_where_nothing_is_wrong() -> None:
    # one data set and three replicates of the same law, twenty thousand times over
    rng = np.random.default_rng(6)
    observed = np.broadcast_to(rng.standard_normal(20_000), (3, 20_000))
    replicated = rng.standard_normal((3, 20_000))
    found = _compare("mean", "x", "s", np.arange(20_000.0), observed, replicated)
    assert kstest(found.p_values, "uniform").pvalue > 0.01
    assert np.mean(found.p_values < 0.05) == pytest.approx(0.05, abs=4 * 0.0015)


@pytest.mark.parametrize("noise", [Noise("constant"), Noise("concentration")], ids=str)
def test_without_growing_noise_a_record_tells_the_same_under_either_law(noise: Noise) -> None:
    problem, theta = small_problem(0.4, n=2, interval=0.05, noise=noise)
    theta[problem.layout.noise[0][2]] = 0.0
    truth = truth_of(problem, theta)
    found = record_information(settings_of(problem, theta)[0], truth, truth.tau)
    assert np.isfinite(found).all()
    alone = replace(problem, campaign=small_design(n=1, interval=0.05))
    direct = expected_information(alone, np.array([*theta[:7], *theta[problem.layout.noise[0]]]))
    # of tau_v, V, y0, beta, t0, tf and, through d(tau^2) = 2 tau d(tau) at t0 + tau, of tau
    np.testing.assert_allclose(found[2:8, 2:8], direct[1:7, 1:7], rtol=1e-9)
    slope = np.zeros(len(found))
    slope[[0, 6, 7]] = 2.0 * truth.tau, 1.0, 1.0
    assert slope @ found @ slope == pytest.approx(direct[0, 0], rel=1e-9)


def test_a_mesh_that_was_widened_once_is_wide_enough() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    first = compress(problem, theta)
    narrow = replace(
        first.region, low=theta - 0.5 * (theta - first.region.low),
        high=theta + 0.05 * (first.region.high - theta),
    )  # fmt: skip
    _, wide = approximate(problem, theta, compress(problem, theta, narrow))
    assert (wide.region.high > narrow.high).any()
    _, again = approximate(problem, theta, wide)
    assert again is wide
