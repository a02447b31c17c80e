"""Predictions: closed forms, the bound they rest on, and posteriors of simulated campaigns."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_sensor.bounds import cramer_rao
from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.design import choose_experiments, design_experiments, what_if
from bayes_sensor.design.choose_experiments import candidate_settings
from bayes_sensor.design.extra_knowledge import as_pulse
from bayes_sensor.design.planned_experiments import settings_of, truth_of
from bayes_sensor.design.record_information import record_information, sum_information
from bayes_sensor.design.tau_interval import predict, predict_tau
from bayes_sensor.likelihood.density import mean_and_variance, simulate
from bayes_sensor.likelihood.mesh import expected_information
from bayes_sensor.likelihood.noise import Noise, lag_coefficient
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import sample_posterior
from bayes_sensor.rig.layout import Layout
from tests.support.campaigns import small_design, small_problem


def design_of(n: int = 3, interval: float = 0.01, fall: bool = True) -> Campaign:
    t = interval * np.arange(int(22.0 / interval))
    experiments = [
        Experiment(
            f"e{i}",
            t,
            None,
            (0.9 - 0.05 * i) * flow,
            (0.1 + 0.05 * i) * flow,
            interval,
            1.6,
            12.0 if fall else None,
        )
        for i, flow in enumerate((50.0, 90.0, 140.0)[:n])
    ]
    return Campaign("planned", tuple(experiments), sensor_is="faster")


def theta_of(
    campaign: Campaign, tau: float = 0.25, phi: float = 0.5, sigma: float = 0.03
) -> np.ndarray:
    theta = [tau, 0.6, 40.0]
    for i, e in enumerate(campaign):
        theta += [0.1, 1.5 + 0.5 * i, 2.0 + 0.03 * i, *([12.4] if e.has_fall else [])]
    return np.array([*theta, phi, sigma, 0.8 * sigma])


def settings_and_truth(campaign: Campaign, theta: np.ndarray):
    problem = Problem(campaign)
    return settings_of(problem, theta), truth_of(problem, theta)


@pytest.mark.parametrize("fall", [True, False])
def test_prediction_rests_on_the_coloured_bound(fall):
    design = design_of(fall=fall)
    theta = theta_of(design)
    settings, truth = settings_and_truth(design, theta)
    common = sum_information(settings, truth, truth.tau)
    prediction = predict_tau(common, truth.tau)
    bound = cramer_rao(design, theta, noise="ar1")
    # the parts are put together by another route (per experiment, in tau^2) from the same mesh
    assert prediction.sd == pytest.approx(bound["tau_s"], rel=1e-4)
    inverse = np.linalg.inv(common[np.ix_([0, 2, 3], [0, 2, 3])])
    assert np.sqrt(inverse[2, 2]) == pytest.approx(bound["V_mL"], rel=0.01)


def test_unequal_intervals_and_concentrations_are_put_on_one_footing():
    design = design_of()
    other = design.experiments[2]
    other = replace(other, t=other.t[::2], interval=2 * other.interval, mask=None)
    mixed = replace(design, experiments=(*design.experiments[:2], other))
    theta = theta_of(mixed)
    settings, truth = settings_and_truth(mixed, theta)
    prediction = predict_tau(sum_information(settings, truth, truth.tau), truth.tau)
    assert prediction.sd == pytest.approx(cramer_rao(mixed, theta, noise="ar1")["tau_s"], rel=1e-4)


def test_exactly_known_switch_times_give_the_bound_without_them():
    design = design_of()
    theta = theta_of(design)
    settings, truth = settings_and_truth(design, theta)
    known = predict_tau(sum_information(settings, truth, truth.tau, trigger=0.0), truth.tau)
    bound = cramer_rao(design, theta, noise="ar1", fixed=("t0_s", "tf_s"))
    assert known.sd == pytest.approx(bound["tau_s"], rel=1e-3)
    useless = predict_tau(sum_information(settings, truth, truth.tau, trigger=1e3), truth.tau)
    free = predict_tau(sum_information(settings, truth, truth.tau), truth.tau)
    assert useless.sd == pytest.approx(free.sd, rel=1e-4)


def test_interval_of_a_square_matches_its_distribution():
    common = np.zeros((7, 7))
    sd_square, tau = 0.002, 0.05
    common[0, 0] = 1.0 / sd_square**2
    found = predict_tau(common, tau, Prior("half_normal", 0.2))
    # tau's density: the Gaussian in tau^2 times the prior, by brute force
    grid = np.linspace(0, 0.3, 200_001)
    density = stats.norm.pdf(grid**2, tau**2, sd_square) * stats.halfnorm(scale=0.2).pdf(grid)
    mass = np.cumsum(density) / density.sum()
    expected = np.interp([0.16, 0.84, 0.025, 0.975], mass, grid)
    ends = [found.low68, found.high68, found.low95, found.high95]
    np.testing.assert_allclose(ends, expected, atol=2e-5)
    assert found.sd == pytest.approx(sd_square / (2 * tau))


def test_far_from_zero_the_interval_is_the_usual_one():
    common = np.zeros((7, 7))
    common[0, 0] = 1.0 / 0.01**2
    found = predict_tau(common, 1.0)
    assert found.half_width95 == pytest.approx(1.959964 * 0.005, rel=1e-3)


def test_a_vanishing_tau_is_predicted_as_an_upper_limit():
    design = design_of()
    theta = theta_of(design, tau=0.0)
    settings, truth = settings_and_truth(design, theta)
    found = predict(settings, truth, Prior("half_normal", 0.2))
    assert found.low95 < 0.2 * found.high95
    assert 0.0 < found.high68 < found.high95 < 1.0


def test_what_if_tells_what_helps():
    design = design_of()
    table = what_if(design, theta_of(design)).set_index("change")
    assert (table["half_width95_s"] > 0).all() and np.isfinite(table["gain"]).all()
    assert table.loc["as it is", "gain"] == 1.0
    trigger = table[table["kind"] == "trigger"].sort_values("value")
    assert (np.diff(trigger["half_width95_s"]) > 0).all()
    assert trigger["gain"].max() > 2.0
    volume = table[table["kind"] == "volume"]
    assert (volume["gain"] > 0.999).all()
    repeats = table[table["kind"] == "repeats"].sort_values("value")
    np.testing.assert_allclose(
        repeats["sd_tau_s"] * np.sqrt(repeats["value"]),
        table.loc["as it is", "sd_tau_s"],
        rtol=0.05,
    )  # sensitivities are taken nearer the true tau when more is known
    # with the noise kept in continuous time, sampling faster tells hardly more
    assert table[table["kind"] == "rate"]["gain"].max() < 1.3
    assert {"valve", "flow", "trigger and volume"} <= set(table["kind"])


def test_white_noise_gains_from_a_higher_rate():
    design = design_of()
    table = what_if(design, theta_of(design, phi=0.0)).set_index("change")
    faster = table.loc["10 times the sampling rate"]
    # phi = 0 stays 0: ten times the samples, ten times the information
    assert table.loc["as it is", "sd_tau_s"] / faster["sd_tau_s"] == pytest.approx(
        10**0.5, rel=0.05
    )


def test_an_estimate_of_phi_below_zero_is_no_obstacle():
    # white noise gives one in every second campaign; at twice the rate phi^(1/2) would not be real
    design = design_of()
    found = what_if(design, theta_of(design, phi=-0.02))["half_width95_s"].to_numpy()
    white = what_if(design, theta_of(design, phi=0.0))["half_width95_s"].to_numpy()
    # a 2 % smaller sum of neighbours' noise
    np.testing.assert_allclose(found, white, rtol=0.05)


LIMITS = {"flows": (60.0, 200.0), "concentrations": (0.1, 0.3), "durations": (12.0, 30.0)}


@pytest.fixture(scope="module")
def proposal():
    design = design_of()
    theta = theta_of(design)
    before = what_if(design, theta)["half_width95_s"].iloc[0]
    return design, theta, design_experiments(design, theta, 0.5 * before, **LIMITS)


def test_proposals_reach_the_target_within_the_limits(proposal):
    design, theta, found = proposal
    assert found.reached and found.after.half_width95 <= found.target
    assert found.before.half_width95 == pytest.approx(2.0 * found.target, rel=1e-6)
    table = found.experiments
    assert 1 <= len(table) <= 40
    for column, key in (
        ("total_flow_mL_s", "flows"),
        ("concentration", "concentrations"),
        ("duration_s", "durations"),
    ):
        low, high = LIMITS[key]
        assert ((table[column] > low * (1 - 1e-9)) & (table[column] < high * (1 + 1e-9))).all()
    assert len(found.campaign) == len(design) + len(table)
    # one fewer would not do
    fewer = design_experiments(design, theta, found.target, k=len(table) - 1, **LIMITS)
    assert not fewer.reached and "not the" in fewer.status
    json.dumps(found.to_json(), allow_nan=False)


def test_more_noise_needs_more_experiments(proposal):
    design, theta, found = proposal
    worse = theta.copy()
    worse[-2:] *= 1.5
    more = design_experiments(design, worse, found.target, **LIMITS)
    assert len(more.experiments) > len(found.experiments)
    triggered = design_experiments(design, worse, found.target, trigger=0.005, **LIMITS)
    assert len(triggered.experiments) < len(more.experiments)


def test_posteriors_of_simulated_proposals_are_as_wide_as_predicted(proposal):
    _, _, found = proposal
    widths = []
    for seed in range(8):
        campaign = simulate(found.campaign, found.theta, seed)
        posterior = sample_posterior(campaign, found.theta, seed=1, sampler="independence")
        tau = posterior.draws[:, list(posterior.names).index("tau_s")]
        low, high = np.quantile(tau, [0.025, 0.975])
        widths.append(0.5 * (high - low))
    assert np.mean(widths) == pytest.approx(found.after.half_width95, rel=0.2)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"target_tau": 0.0}, "target must be a positive time"),
        ({"flows": (3.0, 1.0)}, "flows must be a range"),
        ({"concentrations": (0.1, 1.2)}, "fractions below 1"),
        ({"durations": (0.1, 0.2)}, "lets the response settle"),
    ],
)
def test_design_refuses(changes, match):
    design = design_of()
    options = {"target_tau": 0.01, **LIMITS, **changes}
    with pytest.raises(CampaignError, match=match):
        design_experiments(design, theta_of(design), **options)


def test_a_prediction_needs_noise():
    design = design_of()
    with pytest.raises(CampaignError, match="sigma0_V"):
        what_if(design, theta_of(design)[:-3])


def test_what_is_known_about_the_volume_enters_every_prediction():
    from bayes_sensor.campaign import SideInformation

    design = design_of()
    theta = theta_of(design)
    measured = replace(design, side_information={"V_mL": SideInformation(40.0, 0.02)})
    plain, told = what_if(design, theta), what_if(measured, theta)
    first = told.iloc[0]["half_width95_s"]
    assert first < plain.iloc[0]["half_width95_s"]
    expected = plain[plain["kind"] == "volume"]["half_width95_s"].min()  # +-0.1 mL
    assert first <= expected * (1 + 1e-9)
    # knowing it less well than it is known already changes next to nothing
    coarse = told[(told["kind"] == "volume") & (told["value"] == 2.0)]["half_width95_s"].iloc[0]
    assert coarse == pytest.approx(first, rel=1e-3)


@pytest.mark.parametrize("variance", ["concentration", "signal", "levels"])
def test_the_truth_belongs_to_the_new_campaign(variance: str) -> None:
    # weaker proposals than there were, so that sigma1 refers to another concentration
    design = replace_intervals(design_of(), [0.02, 0.02, 0.01])
    problem = Problem(design, noise=Noise(variance))
    found = design_experiments(
        problem, theta_of(design), 0.02, (50.0, 150.0), (0.05, 0.08), (20.0, 30.0), k=2
    )
    new, whole = found.new, found.campaign
    assert new is not None and new.reference_concentration < 0.9 * whole.reference_concentration
    for e in new:
        alone, together = (
            noise_of(Problem(c, noise=found.noise), t, e.name)
            for c, t in ((new, found.truth), (whole, found.truth_for(whole)))
        )
        np.testing.assert_allclose(alone, together, rtol=1e-9)
    sigma1 = found.theta[Layout.of(whole).index("sigma1_V")]
    # each campaign's own scale
    assert (found.truth["sigma1_V"] < 0.95 * sigma1) == (variance == "concentration")
    assert found.truth_for(whole)["sigma1_V"] == sigma1


def replace_intervals(design: Campaign, intervals: list[float]) -> Campaign:
    return replace(
        design,
        experiments=tuple(
            replace(e, t=h * np.arange(int(22.0 / h)), interval=h, mask=None)
            for e, h in zip(design, intervals, strict=True)
        ),
    )


def noise_of(problem: Problem, truth: dict, name: str) -> list[float]:
    """Plateau noise (V) and phi over one sample of an experiment."""
    k = problem.campaign.names_of_experiments.index(name)
    vector = problem.layout.flat(truth)
    s2 = mean_and_variance(problem, vector, k)[1]
    phi = float(vector[problem.layout.noise[k, 0]])
    return [float(np.sqrt(s2.max())), lag_coefficient(phi, problem.steps(problem.campaign[name]))]


def test_candidates_fill_the_grid_that_was_asked_for() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    present, truth = settings_of(problem, theta), truth_of(problem, theta)
    found = candidate_settings(
        problem, theta, present, truth, (60.0, 120.0), (0.1, 0.3), (20.0, 60.0), (2, 3, 4)
    )
    assert len(found) == 2 * 3 * 4
    concentrations = {round(s.experiment.concentration, 9) for s in found}
    assert concentrations == {0.1, 0.2, 0.3}


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


def test_candidates_answer_as_late_as_the_present_experiments() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    early = [replace(e, commanded_on=0.5) for e in problem.campaign.experiments]
    problem = replace(problem, campaign=replace(problem.campaign, experiments=tuple(early)))
    present, truth = settings_of(problem, theta), truth_of(problem, theta)
    found = candidate_settings(
        problem, theta, present, truth, (60.0, 120.0), (0.1, 0.3), (20.0, 60.0), (2, 2, 2)
    )
    delay = np.mean([s.switches[0] for s in present]) - 0.5  # of two, the median is the mean
    assert delay == pytest.approx(1.5137)
    for s in found:
        assert s.experiment.commanded_on is not None and s.experiment.commanded_off is not None
        assert s.switches[0] - s.experiment.commanded_on == pytest.approx(delay)
        assert s.switches[1] - s.experiment.commanded_off == pytest.approx(delay)


def test_a_pulse_lasts_six_slowest_time_constants_or_is_not_proposed() -> None:
    problem, theta = small_problem(n=1, interval=0.01, duration=120.0)
    setting, truth = settings_of(problem, theta)[0], truth_of(problem, theta)
    _, tau_v, V = truth.shared
    slowest = max(truth.tau, tau_v, V / setting.experiment.total_flow)
    most = int(0.4 * 120.0 / (6.0 * slowest))  # up at 20 %, down at 60 %
    assert most > 10
    pulse = as_pulse(setting, most, truth)
    assert pulse is not None and np.diff(pulse.switches)[0] >= 6.0 * slowest
    assert as_pulse(setting, most + 1, truth) is None


@pytest.mark.parametrize(("tau", "target", "rounds"), [(0.01, 4e-3, 2), (0.1, 10.0, 1)])
def test_a_design_is_made_again_where_better_experiments_tell_tau_better(
    monkeypatch, tau: float, target: float, rounds: int
) -> None:
    problem, theta = small_problem(n=2, interval=0.05, tau=tau)
    choose, made = choose_experiments.choose_greedily, []

    def counted(*args: object) -> list[int]:
        made.append(choose(*args))
        return made[-1]

    monkeypatch.setattr(choose_experiments, "choose_greedily", counted)
    found = choose_experiments.design_experiments(
        problem, theta, target, (60.0, 200.0), (0.2, 0.4), (20.0, 40.0), n_grid=(2, 2, 1)
    )
    better = found.after.high68 < 0.9 * found.before.high68
    assert better == (rounds == 2) and len(made) == rounds
