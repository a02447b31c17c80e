"""The full pass against dense normals and other libraries; priors; simulated campaigns."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import integrate
from scipy.stats import multivariate_normal

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, SideInformation
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.default_priors import default_priors
from bayes_sensor.likelihood.density import (
    experiment_log_likelihood,
    log_likelihood,
    mean_and_variance,
    over_levels,
    simulate,
)
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.mesh import log_likelihood as compressed_likelihood
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.prior_density import log_prior, log_prior_derivatives, log_priors
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.likelihood.rise_time import fastest_rise, published_rise_time
from bayes_sensor.likelihood.switch_ranges import after_step
from bayes_sensor.rig.cascade import Cascade
from bayes_sensor.rig.layout import Layout
from tests.support.campaigns import dense_covariance, small_design, small_problem, small_theta

GAPS = [(1.3, 1.37), (2.1, 2.13), (2.15, 2.16), (5.0, 5.6)]


def dense(problem: Problem, theta: np.ndarray) -> float:
    total = 0.0
    for k, e in enumerate(problem.campaign):
        mean = problem.model.mean(e.t[e.used], theta, problem.layout, e)
        law = multivariate_normal(mean, dense_covariance(problem, theta, k))
        total += law.logpdf(e.values[e.used])
    return total


@pytest.mark.parametrize("variance", ["concentration", "signal", "constant", "levels"])
@pytest.mark.parametrize("phi", [-0.7, 0.0, 0.3, 0.9, 0.99])
@pytest.mark.parametrize("masked", [[], GAPS], ids=["whole", "gaps"])
def test_the_likelihood_is_a_dense_normal(variance: str, phi: float, masked) -> None:
    problem, theta = small_problem(
        phi, noise=Noise(variance), n=2, interval=0.02, duration=8.0, fall=[True, False],
        masked=masked, sigma1=0.007 if variance == "levels" else None,
    )  # fmt: skip
    # rounding of the dense factorisation at condition numbers up to 4e4
    assert log_likelihood(problem, theta) == pytest.approx(dense(problem, theta), abs=1e-7)


def test_unequal_intervals_share_one_phi() -> None:
    problem, theta = small_problem(0.6, n=3, interval=[0.02, 0.02, 0.05], duration=8.0, masked=GAPS)
    assert log_likelihood(problem, theta) == pytest.approx(dense(problem, theta), abs=1e-8)
    doubled, at = small_problem(-0.6, n=3, interval=[0.02, 0.02, 0.04], duration=8.0, masked=GAPS)
    assert log_likelihood(doubled, at) == pytest.approx(dense(doubled, at), abs=1e-8)
    # a negative phi at the reference has no real counterpart at 2.5 times the interval
    theta[problem.layout.index("phi")] = -0.6
    assert log_likelihood(problem, theta) == -np.inf


def test_another_phi_would_be_noticed() -> None:
    problem, theta = small_problem(0.5, n=1, interval=0.02, duration=8.0)
    wrong = theta.copy()
    wrong[problem.layout.index("phi")] += 1e-4
    assert abs(log_likelihood(problem, wrong) - dense(problem, theta)) > 1e-5
    gaps, theta = small_problem(0.5, n=1, interval=0.02, duration=8.0, masked=GAPS)
    # taking samples across a gap for neighbours is wrong and is seen
    e = gaps.campaign.experiments[0]
    r = (e.values - mean_and_variance(gaps, theta, 0)[0]) / np.sqrt(
        mean_and_variance(gaps, theta, 0)[1]
    )
    r = r[e.used]
    s2 = mean_and_variance(gaps, theta, 0)[1][e.used]
    joined = -0.5 * (
        r[0] ** 2
        + ((r[1:] - 0.5 * r[:-1]) ** 2 / 0.75 + np.log(0.75)).sum()
        + np.log(2 * np.pi * s2).sum()
    )
    assert abs(joined - dense(gaps, theta)) > 1e-2


@pytest.mark.parametrize("phi", [0.0, 0.8])
def test_noise_per_experiment(phi: float) -> None:
    problem, theta = small_problem(
        phi, noise=Noise(per_experiment=True), n=2, interval=0.02, duration=8.0
    )
    theta[problem.layout.index("phi[b]")] = 0.2
    theta[problem.layout.index("sigma0_V[a]")] = 0.03
    assert log_likelihood(problem, theta) == pytest.approx(dense(problem, theta), abs=1e-8)


@pytest.mark.parametrize("phi", [-0.5, 0.3, 0.95])
def test_statsmodels_gives_the_same_exact_ar1(phi: float) -> None:
    from statsmodels.tsa.statespace.sarimax import SARIMAX

    problem, theta = small_problem(phi, noise=Noise("constant"), n=1, interval=0.01)
    e = problem.campaign.experiments[0]
    mean, s2 = mean_and_variance(problem, theta, 0)
    model = SARIMAX(e.values - mean, order=(1, 0, 0))
    expected = model.loglike([phi, s2[0] * (1 - phi**2)])
    assert log_likelihood(problem, theta) == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("phi", [-0.4, 0.5, 0.9])
def test_pints_gives_the_same_conditional_ar1(phi: float) -> None:
    pints = pytest.importorskip("pints")
    problem, theta = small_problem(phi, noise=Noise("constant"), n=1)
    e = problem.campaign.experiments[0]

    class Model(pints.ForwardModel):
        def n_parameters(self) -> int:
            return problem.layout.n_mean

        def simulate(self, parameters, times):
            return Cascade().mean(times, problem.layout.flat(parameters), problem.layout, e)

    likelihood = pints.AR1LogLikelihood(pints.SingleOutputProblem(Model(), e.t, e.values))
    sigma = theta[problem.layout.index("sigma0_V")]
    conditional = likelihood([*theta[: problem.layout.n_mean], phi, sigma])
    mean, _ = mean_and_variance(problem, theta, 0)
    first = -0.5 * ((e.values[0] - mean[0]) / sigma) ** 2 - np.log(sigma * np.sqrt(2 * np.pi))
    assert log_likelihood(problem, theta) == pytest.approx(conditional + first, abs=1e-7)


@pytest.mark.parametrize("variance", ["concentration", "constant"])
@pytest.mark.parametrize("masked", [[], GAPS], ids=["whole", "gaps"])
def test_celerite_gives_the_same_as_an_exponential_kernel(variance: str, masked) -> None:
    celerite2 = pytest.importorskip("celerite2")
    phi = 0.85
    problem, theta = small_problem(phi, noise=Noise(variance), n=2, masked=masked)
    total = 0.0
    for k, e in enumerate(problem.campaign):
        mean, s2 = mean_and_variance(problem, theta, k)
        process = celerite2.GaussianProcess(
            celerite2.terms.RealTerm(a=1.0, c=-np.log(phi) / e.interval), mean=0.0
        )
        process.compute(e.t[e.used], diag=np.zeros(e.n_samples))
        z = (e.values - mean)[e.used] / np.sqrt(s2[e.used])
        total += process.log_likelihood(z) - 0.5 * np.log(s2[e.used]).sum()
    assert log_likelihood(problem, theta) == pytest.approx(total, abs=1e-6)


def test_outside_its_range_the_likelihood_is_minus_infinity() -> None:
    problem, theta = small_problem(n=1)
    for name, value in [
        ("phi", 1.0), ("phi", -1.2), ("sigma0_V", 0.0), ("sigma1_V", -0.1),
        ("tau_s", 0.0), ("V_mL", -1.0),
    ]:  # fmt: skip
        wrong = theta.copy()
        wrong[problem.layout.index(name)] = value
        assert log_likelihood(problem, wrong) == -np.inf, name


def test_a_design_and_missing_noise_are_refused() -> None:
    design = small_design(n=1)
    with pytest.raises(CampaignError, match="design without data"):
        log_likelihood(design, small_theta(design))
    problem, theta = small_problem(n=1)
    with pytest.raises(CampaignError, match="theta lacks sigma0_V"):
        log_likelihood(problem, theta[: problem.layout.n_mean])


def test_the_sum_over_experiments_is_the_whole() -> None:
    problem, theta = small_problem(n=3)
    parts = [experiment_log_likelihood(problem, theta, k) for k in range(3)]
    assert log_likelihood(problem, theta) == pytest.approx(sum(parts), rel=1e-14)


@pytest.mark.parametrize(("phi", "apart"), [(0.0, 0.0), (0.3, 1.0)])
def test_a_record_in_two_pieces_is_the_record(phi: float, apart: float) -> None:
    """Where the noise of one says nothing of the other: white, or a second apart, 100 samples."""
    problem, theta = small_problem(phi, n=1)
    (e,) = problem.campaign
    cut = 0.4 * e.t[-1]
    pieces = (e.t < cut) & e.used, (e.t >= cut + apart) & e.used

    def log_l(used: np.ndarray) -> float:
        part = replace(problem.campaign, experiments=(replace(e, mask=used),))
        return log_likelihood(replace(problem, campaign=part), theta)

    whole = log_l(pieces[0] | pieces[1])
    assert sum(map(log_l, pieces)) == pytest.approx(whole, rel=1e-12)


def test_long_products_of_variances_do_not_leave_the_range_of_doubles() -> None:
    # scaling data, mean and noise by c moves log L by -n log c exactly
    problem, theta = small_problem(n=1)
    before = log_likelihood(problem, theta)
    for c in (1e-12, 1e12):
        campaign = problem.campaign.with_data({"a": problem.campaign["a"].values * c})
        scaled = theta.copy()
        for name in ("y0_V[a]", "beta_V[a]", "sigma0_V", "sigma1_V"):
            scaled[problem.layout.index(name)] *= c
        expected = before - campaign.n_samples * np.log(c)
        assert log_likelihood(campaign, scaled) == pytest.approx(expected, rel=1e-12)


# --- priors


LAWS = [
    Prior("half_normal", 0.2),
    Prior("log_normal", 0.5, 1.5),
    Prior("normal", 60.0, 2.0),
    Prior("uniform", 1.0, 3.0),
    Prior("log_uniform", 0.01, 2.0),
]


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_prior_is_the_law_it_says_it_is(law: Prior) -> None:
    x = np.array([-1.0, 0.0, 1e-3, 0.02, 0.3, 1.0, 1.7, 3.0, 55.0])
    with np.errstate(divide="ignore"):
        expected = law.law.logpdf(x)
    np.testing.assert_allclose(law.log_density(x), expected, rtol=1e-12, atol=1e-12)
    low, high = law.law.ppf([1e-10, 1 - 1e-10])
    mass, _ = integrate.quad(
        lambda u: np.exp(law.log_density(u)), low, high, points=law.law.ppf([0.1, 0.5, 0.9]),
        limit=300,
    )  # fmt: skip
    assert mass == pytest.approx(1.0, abs=1e-6)


def test_flat_has_no_law() -> None:
    assert Prior("flat").law is None and (Prior("flat").log_density(np.ones(3)) == 0).all()


def test_the_log_prior_is_the_sum_over_the_parameters() -> None:
    problem, theta = small_problem(n=2)
    given = {"tau_v_s": Prior("log_uniform", 0.01, 5.0), "V_mL": Prior("normal", 15.0, 1.0)}
    problem = replace(problem, given_priors=given)
    rng = np.random.default_rng(3)
    thetas = theta * (1 + 0.05 * rng.standard_normal((40, len(theta))))
    expected = np.where(thetas[:, 0] > thetas[:, 1], -np.inf, 0.0)
    for i, name in enumerate(problem.layout.names):
        expected = expected + problem.priors[name].log_density(thetas[:, i])
    np.testing.assert_allclose(log_priors(problem, thetas), expected, rtol=1e-12)
    assert 0 < np.isinf(expected).sum() < 40
    assert log_prior(problem, theta) == pytest.approx(log_priors(problem, theta)[0])
    swapped = theta.copy()
    swapped[0] = 1.01 * swapped[1]
    assert log_prior(problem, swapped) == -np.inf


def test_pinned_parameters_have_no_prior() -> None:
    problem, theta = small_problem(noise=Noise("constant", "white"), n=1)
    free, _ = small_problem(n=1)
    # phi uniform on (-1, 1), sigma1 half-normal: what the pinned problem leaves out
    other = replace(free, campaign=problem.campaign)
    left_out = sum(float(other.priors[n].log_density(0.0)) for n in ("phi", "sigma1_V"))
    assert log_prior(other, theta) - log_prior(problem, theta) == pytest.approx(left_out)


def test_prior_derivatives_match_finite_differences() -> None:
    problem, theta = small_problem(n=1)
    problem = replace(
        problem,
        given_priors={"y0_V[a]": Prior("normal", 0.0, 0.3), "V_mL": Prior("log_uniform", 1, 99)},
    )
    first, second = log_prior_derivatives(problem, theta)
    for i in range(len(theta)):
        step = np.zeros(len(theta))
        step[i] = 1e-4 * abs(theta[i])
        up, middle, down = (log_prior(problem, theta + c * step) for c in (1, 0, -1))
        assert first[i] == pytest.approx((up - down) / (2 * step[i]), rel=1e-6, abs=1e-6)
        curvature = max(-(up - 2 * middle + down) / step[i] ** 2, 0.0)
        if problem.layout.names[i] != "V_mL":  # a log-uniform law is convex: nothing to add
            assert second[i] == pytest.approx(curvature, rel=1e-3, abs=1e-3)
    assert second[2] == 0.0


def test_default_priors_follow_the_campaign() -> None:
    problem, _ = small_problem(n=2, fall=[True, False])
    priors = problem.priors
    assert set(priors) >= set(problem.layout.names)
    assert priors["t0_s[a]"].a == 1.8 and priors["tf_s[a]"].a == 6.8
    assert "tf_s[b]" not in priors
    assert priors["phi"] == Prior("uniform", -1.0, 1.0)
    mixed, _ = small_problem(n=3, interval=[0.01, 0.01, 0.025])
    assert mixed.priors["phi"] == Prior("uniform", 0.0, 1.0)


def test_a_step_down_commanded_at_zero_is_one() -> None:
    # a recorder triggered by the fall counts from there
    problem, _ = small_problem(n=1)
    (e,) = problem.campaign
    off = e.commanded_off
    assert off is not None and e.commanded_on is not None
    moved = replace(e, t=e.t - off, commanded_on=e.commanded_on - off, commanded_off=0.0)
    priors = Problem(replace(problem.campaign, experiments=(moved,))).priors
    assert priors["t0_s[a]"] == Prior("uniform", e.commanded_on - off, 0.0)
    assert priors["tf_s[a]"] == Prior("uniform", 0.0, float(moved.t[-1]))


def test_the_scale_of_tau_follows_the_fastest_rise() -> None:
    # the same record played ten times slower has ten times the scale
    fast, _ = small_problem(n=2)
    slowed = []
    for e in fast.campaign:
        flows = e.carrier_flow / 10, e.test_gas_flow / 10
        slowed.append(Experiment(e.name, e.t * 10, e.y, *flows, e.interval * 10, 18.0, 68.0))
    slow = replace(fast.campaign, experiments=tuple(slowed))
    scale = fast.priors["tau_s"].a
    assert Problem(slow).priors["tau_s"].a == pytest.approx(10 * scale)
    assert scale < 0.2 and published_rise_time() == pytest.approx(2.2, abs=0.3)
    # a design has no rise to see: the published scale
    design = small_design()
    assert default_priors(design, Layout.of(design))["tau_s"] == Prior("half_normal", 0.2)


def test_noise_neither_hides_nor_shortens_the_rise() -> None:
    quiet, _ = small_problem(n=1, sigma=0.005)
    seen = fastest_rise(quiet.campaign)
    (e,) = quiet.campaign
    rng = np.random.default_rng(1)

    def with_noise(size: float) -> Campaign:
        y = e.values + size * rng.standard_normal(len(e.t))
        return replace(quiet.campaign, experiments=(replace(e, y=y),))

    step = float(np.ptp(e.values))
    for share in (0.03, 0.1):
        assert fastest_rise(with_noise(share * step)) == pytest.approx(seen, rel=0.5)
    # where no average shows the step, the time in which it was to be seen
    assert e.commanded_off is not None and e.commanded_on is not None
    longest = pytest.approx(e.commanded_off - e.commanded_on)
    assert fastest_rise(with_noise(100.0 * step)) == longest


@pytest.mark.parametrize("lag", [2.0, 5.0, 20.0, 30.0])
def test_a_rise_that_goes_on_when_the_step_ends_is_longer_than_the_step(lag: float) -> None:
    t = 0.02 * np.arange(1000)
    y = -np.expm1(-np.maximum(t - 5.2, 0.0) / lag)
    y = np.where(t < 15.0, y, -np.expm1(-9.8 / lag) * np.exp(-(t - 15.0) / lag))
    y += 0.002 * np.random.default_rng(1).standard_normal(len(t))
    campaign = Campaign.from_frames(
        {"1": (t, y)}, stages=["sensor"], commanded_on="5 s", commanded_off="15 s"
    )
    assert fastest_rise(campaign) == pytest.approx(2.197 * lag, rel=0.35)


@pytest.mark.parametrize("lag", [5.0, 10.0, 20.0])
def test_of_two_lags_longer_than_the_step_the_rise_is_read_off_where_they_go_on(lag: float) -> None:
    t = 0.02 * np.arange(int(6.0 * lag / 0.02))

    def step(at: float) -> np.ndarray:
        x = np.maximum(t - at, 0.0) / lag
        return 1.0 - (1.0 + x) * np.exp(-x)

    pulse = step(5.2) - step(7.2)
    noise = 0.01 * pulse.max() * np.random.default_rng(1).standard_normal(len(t))
    campaign = Campaign.from_frames(
        {"1": (t, pulse + noise)},
        stages=["valve", "sensor"], commanded_on="5 s", commanded_off="7 s",
    )  # fmt: skip
    # 10 to 90 % of two equal lags takes 3.36 of them
    assert 0.5 < fastest_rise(campaign) / (3.36 * lag) < 1.5


@pytest.mark.parametrize(
    ("commands", "back"),
    [
        ('steps = [{at = "5 s", to = 0.5}, {at = "15 s", to = 1.0}]', (15.0, 15.0)),
        ('commanded_on = ["5 s", "20 s"]\ncommanded_off = ["15 s", "30 s"]', (15.0, 20.0)),
        ('commanded_on = "5 s"\ncommanded_off = "15 s"', (15.0, 40.0)),
    ],
)
def test_when_the_input_is_back_after_its_first_step(
    commands: str, back: tuple[float, float], tmp_path: Path
) -> None:
    design = tmp_path / "design.toml"
    design.write_text(
        '[rig]\nstages = ["sensor"]\n[[experiment]]\nname = "1"\n'
        f'{commands}\ninterval = "20 ms"\nduration = "40 s"\n'
    )
    assert after_step(read_campaign(design).experiments[0]) == pytest.approx(back)


def test_side_information_replaces_a_prior() -> None:
    campaign = replace(small_design(), side_information={"V_mL": SideInformation(14.0, 0.5)})
    assert Problem(campaign).priors["V_mL"] == Prior("normal", 14.0, 0.5)
    given = Problem(campaign, given_priors={"V_mL": Prior("uniform", 1, 20)})
    assert given.priors["V_mL"].kind == "uniform"  # what the caller passes wins


# --- simulation


def test_simulation_is_repeatable_and_seeds_differ() -> None:
    design = small_design()
    theta = small_theta(design)
    a, b, c = (simulate(design, theta, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(a["a"].values, b["a"].values)
    assert not np.array_equal(a["a"].values, c["a"].values)
    assert not np.allclose(a["a"].values[:50], a["b"].values[:50])
    noiseless = simulate(design, {k: v for k, v in theta.items() if k[:5] != "sigma"})
    mean, _ = mean_and_variance(Problem(design), Problem(design).layout.flat(theta), 0)
    np.testing.assert_allclose(noiseless["a"].values, mean, atol=1e-12)


def test_simulated_data_have_the_likelihood_they_should() -> None:
    # -2 log L at the truth is chi-squared up to known terms: its mean over campaigns is known
    problem, theta = small_problem(0.8, n=1)
    squares = []
    for seed in range(60):
        drawn = replace(problem, campaign=simulate(problem, theta, seed=seed))
        mean, s2 = mean_and_variance(drawn, theta, 0)
        n = len(mean)
        logs = n * np.log(2 * np.pi) + np.log(s2).sum() + (n - 1) * np.log(1 - 0.64)
        squares.append(-2 * log_likelihood(drawn, theta) - logs)
    # chi-squared with 1200 degrees of freedom: sd 49, mean of 60 good to 6.3
    assert np.mean(squares) == pytest.approx(1200, abs=4 * 6.3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"phi": 1.0}, "phi is 1; expected a value above -1 and below 1"),
        ({"phi": -0.5}, "experiment 'b': phi is -0.5, and its samples are 1.5 reference intervals"),
        ({"sigma1_V": -0.1}, "sigma1_V is -0.1; expected a size of noise, zero or more"),
    ],
)
def test_a_simulation_of_impossible_noise_is_refused(changes, said: str) -> None:
    design = small_design(n=2, interval=[0.02, 0.03])
    with pytest.raises(CampaignError, match=said):
        simulate(design, {**small_theta(design), **changes})


@pytest.mark.parametrize("name", ["y0_V[a]", "t0_s[b]", "phi", "sigma1_V"])
def test_a_simulation_needs_every_number(name: str) -> None:
    design = small_design(n=2, interval=0.02)
    layout = Layout.of(design)
    vector = layout.flat(small_theta(design))
    vector[layout.index(name)] = np.nan
    with pytest.raises(CampaignError, match=f"{re.escape(name)} is nan; a simulation needs"):
        simulate(design, vector)


# --- what a noise law pins, names, and records


PINNING = [Noise(autocorrelation="white"), Noise("constant"), Noise("constant", "white", True)]


@pytest.mark.slow
@pytest.mark.parametrize("noise", PINNING, ids=str)
def test_what_the_noise_law_pins_is_pinned_whatever_theta_says(noise: Noise) -> None:
    design = small_design(n=2, interval=0.02)
    given = small_theta(design, phi=0.7, sigma0=0.03, sigma1=0.05)
    pinned = {**given, **noise.fixed}
    problem = Problem(design, noise=noise)
    campaign = simulate(problem, given, seed=3)
    for e, expected in zip(campaign, simulate(problem, pinned, seed=3), strict=True):
        np.testing.assert_array_equal(e.values, expected.values)
    problem = replace(problem, campaign=campaign)
    at, expected = problem.layout.flat(given), problem.layout.flat(pinned)
    assert not np.array_equal(at, expected)
    np.testing.assert_array_equal(problem.flat(given), expected)
    assert log_likelihood(problem, given) == log_likelihood(problem, at)
    assert log_likelihood(problem, at) == pytest.approx(dense(problem, expected), abs=1e-7)
    assert compressed_likelihood(problem, at, True) == pytest.approx(
        log_likelihood(problem, at), abs=1e-3
    )
    mesh = compress(problem, expected)
    value = mesh.log_likelihood(expected)
    assert mesh.log_likelihood(at) == value
    assert mesh.value_and_gradient(at)[0] == pytest.approx(value)
    assert mesh.log_likelihoods(at[None])[0].sum() == pytest.approx(value)
    assert mesh.marginals(at[None])[0][0] == mesh.marginal(at)[0] == mesh.marginal(expected)[0]
    np.testing.assert_array_equal(mesh.information(at), mesh.information(expected))
    # negative control: under the full law these numbers act
    full = Problem(campaign, noise=Noise(per_experiment=noise.per_experiment))
    assert abs(log_likelihood(full, at) - log_likelihood(full, expected)) > 1.0


def test_a_prior_for_no_parameter_is_refused() -> None:
    design = small_design(n=2, interval=0.02)
    theta = small_theta(design)
    wrong = Problem(design, given_priors={"tau": Prior("uniform", 0.0, 0.001)})
    with pytest.raises(CampaignError, match="given_priors: .* 'tau'; did you mean 'tau_s'"):
        log_prior(wrong, theta)
    # one for an experiment that was left out waits
    part = replace(wrong, campaign=design.without("b"), given_priors={"t0_s[b]": Prior("flat")})
    assert np.isfinite(log_prior(part, theta))


def test_a_prior_on_shared_noise_serves_noise_per_experiment() -> None:
    design = small_design(n=2, interval=0.02)
    own, shared = Prior("uniform", 0.1, 0.2), Prior("uniform", 0.4, 0.6)
    problem = Problem(
        design, noise=Noise(per_experiment=True), given_priors={"phi": shared, "phi[b]": own}
    )
    assert problem.priors["phi[a]"] == shared and problem.priors["phi[b]"] == own


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (("gaussian", 0.1, 0.2), "kind must be one of flat, normal, .* but is 'gaussian'"),
        (("normal", 0.0, -1.0), r"prior normal\(0, -1\): expected a mean and a positive sd"),
        (("half_normal", 0.0), "expected a positive scale"),
        (("log_normal", 0.0, 1.0), "expected a positive median and a positive sd"),
        (("uniform", 2.0, 1.0), "expected low < high"),
        (("uniform", 0.0, np.inf), "all finite"),
        (("log_uniform", 0.0, 1.0), "expected 0 < low < high"),
        (("normal", np.nan, 1.0), "all finite"),
    ],
)
def test_a_prior_that_is_no_law_is_refused(law, said: str) -> None:
    with pytest.raises(CampaignError, match=said):
        Prior(*law)


TIMES = 0.1 * np.arange(50)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"t": np.insert(TIMES[:-1], 20, TIMES[20])},
            r"t\[21\] is 2 s and follows 2 s; expected times that increase strictly",
        ),
        ({"t": TIMES[::-1]}, r"t\[1\] is 4.8 s and follows 4.9 s"),
        ({"t": np.where(TIMES > 4.0, np.nan, TIMES)}, r"t\[41\] is nan; expected a time in s"),
        ({"interval": 0.11}, r"interval is 0.11 s, but the times are 0.1 s apart"),
        ({"interval": np.inf}, "expected a positive sampling interval, got inf s"),
        ({"commanded_on": 4.0}, "commanded_off = 3 s is not after commanded_on = 4 s"),
        ({"commanded_on": 3.0}, "commanded_off = 3 s is not after commanded_on = 3 s"),
        ({"commanded_on": np.nan}, "commanded_on is nan; expected a time in s, or None"),
    ],
)
def test_times_that_are_no_record_are_refused(changes, said: str) -> None:
    fields = {"t": TIMES, "interval": 0.1, "commanded_on": 1.0, "commanded_off": 3.0}
    Experiment("a", y=None, carrier_flow=60.0, test_gas_flow=10.0, **fields)
    with pytest.raises(CampaignError, match=f"experiment 'a': {said}"):
        Experiment("a", y=None, carrier_flow=60.0, test_gas_flow=10.0, **(fields | changes))


def test_times_as_a_clock_gives_them_are_a_grid() -> None:
    # what jitter recordings may have, an epoch in seconds, single precision
    rng = np.random.default_rng(1)
    for t in (TIMES + 0.01 * rng.uniform(-1, 1, 50), 1.7e9 + TIMES, TIMES.astype(np.float32)):
        assert Experiment("a", t, None, 60.0, 10.0, 0.1).n_samples == 50


@pytest.mark.parametrize("beta", [0.6, 0.0])
def test_levels_moved_over_one_response_give_the_same_density(beta: float) -> None:
    problem, theta = small_problem(n=2)
    i_y0, i_beta = problem.layout.local[1, :2]
    theta = theta.copy()
    theta[i_beta] = beta
    at = over_levels(problem, theta, 1, 0.3)
    for u, w in ((0, 0), (1, 0), (0, -1), (2, 0.5)):
        moved = theta.copy()
        moved[i_y0] += 0.3 * u
        moved[i_beta] += 0.3 * w
        whole = experiment_log_likelihood(problem, moved, 1)
        assert at(u, w) == pytest.approx(whole, rel=1e-11)
    theta[problem.layout.noise[1, 0]] = 1.5  # no AR(1)
    assert over_levels(problem, theta, 1, 0.3)(0, 0) == -np.inf
