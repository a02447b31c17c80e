"""What changed code had got past the tests, second draw of mutants (study_mutants.py)."""

from dataclasses import replace
from itertools import pairwise
from math import floor, sqrt
from types import SimpleNamespace

import numpy as np
import pytest
from campaigns import PUBLISHED, small_problem
from posterior_calibration import _said

from bayes_sensor.bounds.gaussian_intervals import least_tau
from bayes_sensor.bounds.likelihood_surface import _roomy
from bayes_sensor.bounds.profile import Point, _next
from bayes_sensor.campaign import CampaignError, Experiment
from bayes_sensor.checks import coverage
from bayes_sensor.checks.delays import regress_line
from bayes_sensor.checks.predictive import _Statistics
from bayes_sensor.coating import Coating, assemble, march, modal
from bayes_sensor.coating.readout import Ring
from bayes_sensor.design import choose_experiments
from bayes_sensor.design.choose_experiments import _candidates
from bayes_sensor.design.extra_knowledge import _as_pulse
from bayes_sensor.design.planned_experiments import settings_of, truth_of
from bayes_sensor.fit.block_averages import averages
from bayes_sensor.fit.first_estimates import first_look
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.mesh import compress, default_region
from bayes_sensor.likelihood.mesh.blocks import _blocks_of_run
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.posterior.laplace import _expand, _information, draw_root
from bayes_sensor.posterior.r_hat import pareto_k
from bayes_sensor.posterior.widen_mesh import covered
from bayes_sensor.residuals import _breusch_pagan
from bayes_sensor.rig.cascade import time_constants


def published_shape(excess: np.ndarray) -> float:
    """Shape of the generalised Pareto law by Zhang and Stephens (2009), step by step."""
    x = np.sort(excess)
    n = len(x)
    m = 30 + floor(sqrt(n))
    quartile = x[floor(n / 4 + 0.5) - 1]
    thetas, logs = [], []
    for j in range(1, m + 1):
        theta = 1.0 / x[-1] + (1.0 - sqrt(m / (j - 0.5))) / (3.0 * quartile)
        k = -np.mean(np.log(1.0 - theta * x))
        thetas.append(theta)
        logs.append(n * (np.log(theta / k) + k - 1.0))
    weights = [1.0 / sum(np.exp(other - own) for other in logs) for own in logs]
    best = sum(w * theta for w, theta in zip(weights, thetas))
    return float(np.mean(np.log(1.0 - best * x)))


@pytest.mark.parametrize("power", [0.2, 0.5, 0.9])
def test_the_tail_of_weights_has_the_shape_of_the_published_estimate(power: float) -> None:
    log_weights = power * np.random.default_rng(3).exponential(size=1000)
    weights = np.sort(np.exp(log_weights - log_weights.max()))
    n = 95  # ceil(3 sqrt(1000)) of the largest
    expected = published_shape(weights[-n:] - weights[-n - 1])
    # drawn to one half with the weight of ten observations
    assert pareto_k(log_weights) == pytest.approx((n * expected + 5.0) / (n + 10.0), rel=1e-9)
    assert pareto_k(log_weights) == pytest.approx(power, abs=0.3)


def test_before_a_switch_a_record_is_averaged_in_eight_equal_stretches() -> None:
    problem, _ = small_problem(n=1, interval=0.01)
    e = problem.campaign.experiments[0]
    look = first_look(e)
    points = averages(problem.campaign, [look], per_rise=12, most=60)
    before = points.t < look.on - e.interval
    assert before.sum() == 8
    np.testing.assert_allclose(points.weight[before], look.on / e.interval / 8, atol=1.0)


def test_candidates_answer_as_late_as_the_present_experiments() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    early = [replace(e, commanded_on=0.5) for e in problem.campaign.experiments]
    problem = replace(problem, campaign=replace(problem.campaign, experiments=tuple(early)))
    present, truth = settings_of(problem, theta), truth_of(problem, theta)
    found = _candidates(
        problem, theta, present, truth, (60.0, 120.0), (0.1, 0.3), (20.0, 60.0), (2, 2, 2)
    )
    delay = np.mean([s.t0 for s in present]) - 0.5  # of two, the median is the mean
    assert delay == pytest.approx(1.5137)
    for s in found:
        assert s.experiment.commanded_on is not None and s.experiment.commanded_off is not None
        assert s.t0 - s.experiment.commanded_on == pytest.approx(delay)
        assert s.tf is not None and s.tf - s.experiment.commanded_off == pytest.approx(delay)


def test_a_pulse_lasts_six_slowest_time_constants_or_is_not_proposed() -> None:
    problem, theta = small_problem(n=1, interval=0.01, duration=120.0)
    setting, truth = settings_of(problem, theta)[0], truth_of(problem, theta)
    slowest = max(truth.tau, truth.tau_v, truth.V / setting.experiment.total_flow)
    most = int(0.4 * 120.0 / (6.0 * slowest))  # up at 20 %, down at 60 %
    assert most > 10
    pulse = _as_pulse(setting, most, truth)
    assert pulse is not None and pulse.tf is not None and pulse.tf - pulse.t0 >= 6.0 * slowest
    assert _as_pulse(setting, most + 1, truth) is None


def test_the_design_of_the_coverage_study_holds_published_experiments() -> None:
    assert coverage.RUNS == tuple(PUBLISHED[name][:4] for name in "167")


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


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_time_constant_is_positive_and_finite(place: int, value: float) -> None:
    values = [0.05, 0.8, 60.0]
    values[place] = value
    with pytest.raises(CampaignError, match="time constants must be positive"):
        time_constants(*values, total_flow=100.0)


def test_the_statistics_of_residuals_are_those_of_the_textbook() -> None:
    # one experiment, two stretches missing; what stands there is of no account
    problem, theta = small_problem(n=1, interval=0.02, masked=[(1.0, 1.5), (4.0, 4.1)])
    statistics = _Statistics(problem, theta)
    (e,) = problem.campaign.experiments
    rng = np.random.default_rng(5)
    z, s = rng.standard_normal(len(e.t)), 0.01 + 0.02 * rng.random(len(e.t))
    z[~e.used] = 1e3
    autocorrelation, variance, spectrum = statistics([z], [s])

    u = e.used
    expected = []
    for lag in statistics.lags:
        pairs = [z[i] * z[i + lag] for i in range(len(z) - lag) if u[i] and u[i + lag]]
        expected.append(np.mean(pairs) / np.mean(z[u] ** 2))
    np.testing.assert_allclose(autocorrelation, expected, rtol=1e-10)

    counts = statistics.bin_counts
    assert counts.sum() <= u.sum()
    (where,) = statistics.bins
    squares = [np.mean((s * z)[u & (where == b)] ** 2) for b in range(len(counts))]
    np.testing.assert_allclose(variance, squares, rtol=1e-12)

    n, zero = len(z), np.where(u, z, 0.0)
    k = np.arange(n // 2 + 1)
    wave = np.exp(-2j * np.pi * np.outer(k, np.arange(n)) / n)
    density = np.abs(wave @ zero) ** 2 / u.sum()  # 1 for white noise
    f = k / (n * e.interval)
    edges = np.geomspace(0.999 * f[1], 1.001 * 0.5 / e.interval, 13)
    bands = [density[(f >= a) & (f < b)] for a, b in pairwise(edges)]
    np.testing.assert_allclose(spectrum, [b.mean() for b in bands if len(b)], rtol=1e-8)


def test_a_wider_region_is_wider_in_both_slow_constants() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    usual, wide = default_region(problem, theta), _roomy(problem, theta, room=1.5)
    for i in (1, 2):  # tau_v, V
        assert wide.high[i] - theta[i] == pytest.approx(1.5 * (usual.high[i] - theta[i]))
        low = theta[i] - 1.5 * (theta[i] - usual.low[i])
        assert wide.low[i] == pytest.approx(max(low, 0.1 * theta[i]))


def test_a_point_off_an_exact_line_stands_out_without_limit() -> None:
    x = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    y = 0.25 + 0.125 * x
    y[2] += 0.5
    line = regress_line(list("abcde"), x, y)
    found = line.studentised
    assert found["c"] is not None and found["c"] > 1e6
    assert all(abs(found[name]) < 10.0 for name in "abde")


def test_curvatures_are_taken_where_tau_squared_is_positive() -> None:
    problem, theta = small_problem(n=2, interval=0.05, tau=0.01)
    mesh, coordinates = compress(problem, theta), Coordinates(problem)
    psi = coordinates.psi(theta)
    info = _information(mesh, coordinates, psi)
    assert psi[0] < 0.3 / np.sqrt(info[0, 0])  # a usual step would reach below zero
    asked = []

    def gradient(at: np.ndarray) -> np.ndarray:
        asked.append(at.copy())
        return -info @ (at - psi)

    mean, cov = _expand(mesh, coordinates, psi, gradient)
    assert (np.array(asked)[:, coordinates.squared] > 0.0).all()
    # a Gaussian is its own expansion
    np.testing.assert_allclose(mean, psi, rtol=1e-12)
    scale = np.sqrt(np.diag(info))
    np.testing.assert_allclose(
        cov * np.outer(scale, scale), np.linalg.inv(info / np.outer(scale, scale)), rtol=1e-5
    )


@pytest.mark.parametrize("outer_radius", [Coating().outer_radius, np.inf])
@pytest.mark.parametrize("geometry", ["axisymmetric", "planar"])
def test_the_mesh_fills_the_coating_from_its_axis(outer_radius: float, geometry: str) -> None:
    coating = Coating(outer_radius=outer_radius, geometry=geometry)
    system = assemble(coating, level=0)
    assert (np.diff(system.r) > 0).all() and (np.diff(system.z) > 0).all()
    assert (system.r[0], system.z[0]) == (0.0, 0.0)
    assert system.z[-1] == pytest.approx(coating.thickness)
    if np.isfinite(outer_radius):
        assert system.r[-1] == pytest.approx(outer_radius)
    # the capacity is positive, as a quadratic form
    assert np.linalg.eigvalsh(system.mass.toarray()).min() > 0


def test_roots_are_drawn_to_beyond_eight_standard_deviations() -> None:
    mean, sd = np.array([-1.0, 0.0, 3.0, 40.0]), np.array([1.0, 0.5, 2.0, 4.0])

    def drawn_at(u: float) -> np.ndarray:
        drawn, log_q = draw_root(mean, sd, SimpleNamespace(random=lambda n: np.full(n, u)))
        assert np.isfinite(log_q).all()
        return drawn**2

    # where the density has sunk to its floor, so that weights stay bounded there
    assert (drawn_at(1.0 - 1e-15) > np.maximum(mean, 0.0) + 8.0 * sd).all()
    assert (drawn_at(0.0) <= np.maximum(mean - 8.0 * sd, 0.0)).all()


def test_a_step_that_is_cut_follows_the_third_order_of_its_error() -> None:
    system = assemble(Coating(), level=0)
    usual = 1e-6 * system.tau_moment()
    first = []
    for tolerance in (1e-9, 3e-12, 1e-12):
        times = march(system, tolerance=tolerance, until=3.0 * usual).times
        first.append(times[1] - times[0])
    assert first[0] == pytest.approx(usual, rel=1e-9)  # fits as it is
    assert first[1] < usual
    assert first[1] / first[2] == pytest.approx(3.0 ** (1 / 3), rel=1e-2)


def test_a_profile_is_followed_outwards_in_proportion() -> None:
    def at(value: float, drop: float) -> Point:
        return Point(value, drop, np.zeros(1))

    for centre, sign in ((2.0, 1.0), (2.0, -1.0), (-0.5, 1.0)):
        near = at(centre + sign * 0.25, 1.0)
        # a Gaussian profile: the drop is proportional to the distance; 2 % beyond the target
        assert _next(centre, near, None, 9.0, 1.96) == pytest.approx(
            centre + sign * 0.25 * 1.02 * 1.96
        )
        assert _next(centre, at(centre, 0.0), None, 9.0, 1.96) == 9.0
        # at most three times as far
        assert _next(centre, near, None, 9.0, 100.0) == pytest.approx(centre + sign * 0.75)


@pytest.mark.parametrize(("lags", "settled"), [(1.0, False), (2.0, False), (6.0, True)])
def test_a_step_of_few_lags_does_not_reach_its_plateau(lags: float, settled: bool) -> None:
    t = np.arange(0.0, 3.0 + lags, 0.01)
    y = np.where(t < 2.0, 0.0, 1.0 - np.exp(-(t - 2.0)))
    y += 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    e = Experiment("a", t, y, 60.0, 10.0, 0.01, 2.0, 2.0 + lags)
    assert first_look(e).settled == settled


def test_where_the_mesh_grows_at_all_it_holds_a_uniform_prior_of_a_switch_time() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    name = "t0_s[a]"
    i = problem.layout.index(name)
    low, high = theta[i] - 1.5, theta[i] + 2.5
    problem = replace(problem, given_priors={name: Prior("uniform", low, high)})
    thetas = np.stack([theta, theta])
    thetas[0, i], thetas[1, i] = theta[i] - 0.3, theta[i] + 0.3
    wider = covered(compress(problem, theta), thetas)
    for end in (low, high):
        at = theta.copy()
        at[i] = end
        assert wider.covers(at)
    assert wider.region.low[i] == pytest.approx(low) and wider.region.high[i] == pytest.approx(high)


def test_a_response_below_zero_counts_as_pure_carrier_gas(monkeypatch) -> None:
    problem, theta = small_problem(n=1, interval=0.02)
    plain = _Statistics(problem, theta)
    (e,) = problem.campaign.experiments
    response = problem.model.response

    def undershooting(t: np.ndarray, *rest: object) -> np.ndarray:
        x = response(t, *rest)
        return np.where(x < 1e-3, -0.01, x)

    monkeypatch.setattr(type(problem.model), "response", lambda self, *a: undershooting(*a))
    found = _Statistics(problem, theta)
    np.testing.assert_array_equal(found.bin_counts, plain.bin_counts)
    assert (found.concentration >= 0.0).all()
    assert found.concentration[-1] == pytest.approx(e.concentration, rel=0.1)


def test_blocks_reach_into_no_stretch_that_is_wanted_sample_by_sample() -> None:
    h, kinks = 0.01, np.array([[3.0, 3.2], [6.0, 6.005]])
    none = np.empty((0, 2))
    blocks = _blocks_of_run(0, 1000, 0.0, h, none, 0.1, np.ones((3, 2)), 1.0, kinks, 1.0)
    starts, sizes, kinds = np.array(blocks).T
    assert starts[0] == 0 and (starts[1:] == (starts + sizes)[:-1]).all() and sizes.sum() == 1000
    within = np.zeros(len(starts), dtype=bool)
    for low, high in kinks:
        within |= (starts * h < high) & ((starts + sizes) * h > low)
    assert within.sum() > 3 and (kinds[within] == 0).all() and (sizes[within] <= 8).all()
    assert kinds[~within].max() > 2


def test_derivatives_by_tau_squared_reach_down_to_a_thousandth_of_the_fastest_lag() -> None:
    problem, theta = small_problem(n=1, interval=1e-3, duration=10.0)
    (e,) = problem.campaign.experiments
    mesh = compress(problem, theta)
    fastest = min(theta[1], theta[2] / e.total_flow)
    assert mesh.arrays.setting[0, 4] < 0.5e-3 * fastest  # the mesh itself resolves less
    assert least_tau(mesh) == pytest.approx(1e-3 * fastest)


def test_a_free_spectral_range_is_one_more_wavelength_around_the_ring() -> None:
    ring = Ring()
    turns = ring.group_index * 2.0 * np.pi * ring.radius / ring.resonance
    # of n wavelengths to n + 1; the group index is the slope of the optical path by 1 / wavelength
    away = ring.resonance * turns / (turns + 1.0)
    assert ring.free_spectral_range == pytest.approx(ring.resonance - away, rel=2.0 / turns)
    assert ring.free_spectral_range == pytest.approx(9.17e-9, rel=1e-3)


@pytest.mark.parametrize(("n", "farthest"), [(40_000, 2000), (5000, 501)])
def test_residuals_that_stay_correlated_are_thinned_beyond_the_farthest_lag(
    n: int, farthest: int
) -> None:
    # half a wave over the record: the correlation at a twentieth or tenth of it is still high
    z = np.cos(np.pi * np.arange(n) / n)
    series = SimpleNamespace(z=z, r=0.01 * z, x=np.linspace(0.0, 1.0, n), concentration=0.2)
    found = _breusch_pagan([series])
    assert found["every"] == farthest + 1
    assert found["n"] == len(range(0, n, farthest + 1))


@pytest.mark.parametrize("k_hat", [None, 0.31])
def test_a_study_notes_the_tail_of_weights_where_there_are_weights(k_hat: float | None) -> None:
    posterior = SimpleNamespace(
        sampler="hmc", k_hat=k_hat, mesh_error=1e-5, converged=True,
        r_hat=np.array([1.0, np.nan, 1.02]), ess_bulk=np.array([900.0, 400.0, np.nan]),
    )  # fmt: skip
    said = _said(posterior)
    assert np.isnan(said["k_hat"]) if k_hat is None else said["k_hat"] == k_hat
    assert (said["r_hat"], said["ess"], said["converged"]) == (1.02, 400.0, 1.0)


def test_the_modal_response_is_its_own_measure() -> None:
    assert modal(Coating()).max_error == 0.0


@pytest.mark.parametrize(("tau", "target", "rounds"), [(0.01, 4e-3, 2), (0.1, 10.0, 1)])
def test_a_design_is_made_again_where_better_experiments_tell_tau_better(
    monkeypatch, tau: float, target: float, rounds: int
) -> None:
    problem, theta = small_problem(n=2, interval=0.05, tau=tau)
    choose, made = choose_experiments._choose, []

    def counted(*args: object) -> list[int]:
        made.append(choose(*args))
        return made[-1]

    monkeypatch.setattr(choose_experiments, "_choose", counted)
    found = choose_experiments.design_experiments(
        problem, theta, target, (60.0, 200.0), (0.2, 0.4), (20.0, 40.0), n_grid=(2, 2, 1)
    )
    better = found.after.high68 < 0.9 * found.before.high68
    assert better == (rounds == 2) and len(made) == rounds
