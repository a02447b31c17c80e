"""Three samplers against each other and against quadrature; resuming, records, honesty."""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import bayes_sensor.posterior.sample as sampling
import bayes_sensor.posterior.samplers.emcee_ensembles as emcee_ensembles
import bayes_sensor.posterior.samplers.independence as independence
from bayes_sensor.bounds import compare_bounds
from bayes_sensor.campaign import CampaignError, SideInformation
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.density import log_likelihood, simulate
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Posterior, Settings, load_chains, sample_posterior
from bayes_sensor.posterior.checkpoints import Checkpoint
from bayes_sensor.posterior.convergence import ESS_LIMIT, out_of_reach
from bayes_sensor.posterior.laplace import approximate, log_posteriors
from bayes_sensor.posterior.quantiles import reaches_end
from bayes_sensor.posterior.r_hat import diagnostics
from bayes_sensor.posterior.sample import start_vector
from bayes_sensor.posterior.samplers.emcee_ensembles import MOST_POINTS, in_bounded_time
from bayes_sensor.posterior.samplers.hmc import Whitened
from bayes_sensor.posterior.widen_mesh import covered
from bayes_sensor.rig.cascade import (
    Cascade,
    cascade_response,
    exchanged,
    local_parameters,
    time_constants,
)
from tests.support.campaigns import small_design, small_problem, small_theta

SAMPLERS = ("emcee", "independence", "hmc")
QUICK = Settings(max_steps=2000, target_ess=500.0, n_draws=600)


@cache
def drawn(sampler: str, phi: float) -> Posterior:
    """One run on the same small campaign, shared by the tests below."""
    problem, theta = small_problem(phi, sigma=0.01, n=2, interval=1e-3, fall=[True, False])
    return sample_posterior(problem, theta, seed=3, sampler=sampler, settings=QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("phi", [0.0, 0.9])
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_every_sampler_converges_and_says_how(sampler: str, phi: float) -> None:
    posterior = drawn(sampler, phi)
    assert posterior.converged and posterior.sampler == sampler
    assert posterior.status.startswith("converged") and not posterior.warnings
    assert posterior.mesh_error < 1e-3
    assert len(posterior.reasons) == 1 and posterior.reasons[0].lower()[:5] in (
        "emcee", "indep", "hamil"
    )  # fmt: skip
    # the truth lies where it should: 13 parameters, none beyond 4.5 sd
    theta = posterior.layout.flat(small_theta(posterior.problem.campaign, phi, 0.01, 0.01))
    z = (posterior.draws.mean(axis=0) - theta) / posterior.draws.std(axis=0)
    assert np.abs(z).max() < 4.5 and np.abs(z).max() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("phi", [0.0, 0.9])
@pytest.mark.parametrize(
    "pair", [("emcee", "hmc"), ("independence", "hmc"), ("emcee", "independence")]
)
def test_the_samplers_agree_on_every_marginal(pair: tuple[str, str], phi: float) -> None:
    a, b = (drawn(sampler, phi) for sampler in pair)
    ess = [np.minimum(p.ess_bulk, p.ess_tail) for p in (a, b)]
    sds = [p.draws.std(axis=0) for p in (a, b)]
    error = np.hypot(sds[0] / np.sqrt(ess[0]), sds[1] / np.sqrt(ess[1]))
    z = (a.draws.mean(axis=0) - b.draws.mean(axis=0)) / error
    assert np.abs(z).max() < 4.5
    # the spread: relative error of a standard deviation is about sqrt(.5/ESS) for near-Gaussian
    # laws, and up to twice that for tau's
    spread = np.log(sds[0] / sds[1]) / (2 * np.hypot(np.sqrt(0.5 / ess[0]), np.sqrt(0.5 / ess[1])))
    assert np.abs(spread).max() < 4.5
    # each tail holds its share of the other's draws: binomial with the effective sizes
    for level in (0.025, 0.16, 0.84, 0.975):
        share = (a.draws < np.quantile(b.draws, level, axis=0)).mean(axis=0)
        sd = np.sqrt(level * (1 - level) * (1 / ess[0] + 1 / ess[1]))
        assert (np.abs(share - level) / sd).max() < 4.5
    # negative control: another campaign's posterior does not agree
    other = drawn(pair[0], 0.9 - phi)
    assert np.abs((a.draws.mean(axis=0) - other.draws.mean(axis=0)) / error).max() > 4.5


@cache
def two_parameters() -> tuple[Problem, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A problem with tau and t0 alone left free, and their posterior on a grid.

    y0 and beta integrate out in closed form under white noise; priors hold everything else.
    """
    base, theta = small_problem(
        n=1, interval=0.02, fall=False, noise=Noise("constant", "white"), tau=0.06
    )
    names = base.layout.names
    held = {
        name: Prior("normal", theta[names.index(name)], 1e-5 * theta[names.index(name)])
        for name in ("tau_v_s", "V_mL", "sigma0_V")
    }
    problem = replace(base, given_priors={**held, "tau_s": Prior("half_normal", 0.1)})
    e = problem.campaign.experiments[0]
    assert e.total_flow == pytest.approx(14.0 / 0.2)
    tau, t0 = np.linspace(1e-4, 0.2, 101), np.linspace(1.9, 2.12, 121)
    log_p = np.empty((len(tau), len(t0)))
    for i, a in enumerate(tau):
        for j, b in enumerate(t0):
            basis = np.stack([np.ones(len(e.t)), cascade_response(e.t, [0.3, 0.2, a], b)])
            gram, right = basis @ basis.T, basis @ e.values
            explained = right @ np.linalg.solve(gram, right)
            log_p[i, j] = 0.5 * explained / 0.02**2 - 0.5 * np.linalg.slogdet(gram)[1]
            log_p[i, j] -= 0.5 * (a / 0.1) ** 2
    p = np.exp(log_p - log_p.max())
    assert p[:, 0].max() < 1e-6 and p[:, -1].max() < 1e-6 and p[-1].max() < 1e-6
    return problem, theta, tau, t0, p


@pytest.mark.slow
@pytest.mark.parametrize("sampler", SAMPLERS)
def test_two_parameters_against_quadrature(sampler: str) -> None:
    problem, theta, tau, t0, p = two_parameters()
    posterior = sample_posterior(problem, theta, seed=1, sampler=sampler, settings=QUICK)
    assert posterior.sampler == sampler
    for name, grid, weight in (("tau_s", tau, p.sum(axis=1)), ("t0_s[a]", t0, p.sum(axis=0))):
        cdf = np.concatenate([[0], np.cumsum(0.5 * (weight[1:] + weight[:-1]))])
        cdf /= cdf[-1]
        ess = posterior.ess_bulk[problem.layout.index(name)]
        for level in (0.025, 0.16, 0.5, 0.84, 0.975):
            share = (posterior.of(name) < np.interp(level, cdf, grid)).mean()
            assert share == pytest.approx(level, abs=4.5 * np.sqrt(level * (1 - level) / ess))


# --- resuming and repeating


SHORT = Settings(
    n_chains=2, n_walkers=32, chunk=20, burn_in=20, max_steps=120, thin=2, target_ess=1e9
)


class Interruption(Exception):
    """Stands for the user's Ctrl-C."""


@pytest.mark.parametrize("after", [1, 3, 5])
def test_a_resumed_run_is_the_uninterrupted_one(tmp_path, after: int) -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    whole = sample_posterior(problem, theta, seed=5, settings=SHORT)
    calls = []

    def stop(fraction: float, text: str) -> None:
        calls.append(text)
        if len(calls) > after:
            raise Interruption

    with pytest.raises(Interruption):
        sample_posterior(problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path, progress=stop)
    saved = sorted(path.name for path in tmp_path.glob("ensemble-*.npz"))
    assert saved and not list(tmp_path.glob(".*"))
    resumed = sample_posterior(
        problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path, resume=True
    )
    np.testing.assert_array_equal(resumed.chains, whole.chains)
    np.testing.assert_array_equal(resumed.log_likelihood, whole.log_likelihood)


def test_a_half_written_chunk_of_one_ensemble_is_made_up_for(tmp_path) -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    whole = sample_posterior(problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path)
    # as if killed between the two ensembles of the last chunk
    sorted(tmp_path.glob("ensemble-1-*.npz"))[-1].unlink()
    resumed = sample_posterior(
        problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path, resume=True
    )
    np.testing.assert_array_equal(resumed.chains, whole.chains)


def test_a_run_stopped_after_its_last_step_takes_no_further_one(tmp_path) -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    whole = sample_posterior(problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path)
    saved = sorted(path.name for path in tmp_path.glob("ensemble-*.npz"))
    resumed = sample_posterior(
        problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path, resume=True
    )
    np.testing.assert_array_equal(resumed.chains, whole.chains)
    assert sorted(path.name for path in tmp_path.glob("ensemble-*.npz")) == saved


@pytest.mark.parametrize("steps", [80, 160])
def test_a_run_that_was_too_short_goes_on_and_one_too_long_is_cut(tmp_path, steps: int) -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    other = replace(SHORT, max_steps=steps)
    whole = sample_posterior(problem, theta, seed=5, settings=other)
    sample_posterior(problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path)
    first = tmp_path / "ensemble-0-00000.npz"
    made = first.stat().st_mtime_ns
    resumed = sample_posterior(
        problem, theta, seed=5, settings=other, checkpoint=tmp_path, resume=True
    )
    np.testing.assert_array_equal(resumed.chains, whole.chains)
    assert first.stat().st_mtime_ns == made


def test_what_belongs_to_another_run_is_not_continued(tmp_path) -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    sample_posterior(problem, theta, seed=5, settings=SHORT, checkpoint=tmp_path)
    other = sample_posterior(
        problem, theta, seed=6, settings=SHORT, checkpoint=tmp_path, resume=True
    )
    alone = sample_posterior(problem, theta, seed=6, settings=SHORT)
    np.testing.assert_array_equal(other.chains, alone.chains)


@pytest.mark.slow
def test_the_numbers_do_not_depend_on_jobs() -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    short = replace(SHORT, max_steps=60)
    one, two = (
        sample_posterior(problem, theta, seed=5, settings=short, jobs=jobs) for jobs in (1, 2)
    )
    np.testing.assert_array_equal(one.chains, two.chains)


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["independence", "hmc"])
def test_seeds_decide(sampler: str) -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    few = Settings(n_draws=400, max_draws=4000, target_ess=50.0)
    runs = [
        sample_posterior(problem, theta, seed=s, sampler=sampler, settings=few) for s in (1, 1, 2)
    ]
    np.testing.assert_array_equal(runs[0].chains, runs[1].chains)
    assert (
        runs[0].chains.shape != runs[2].chains.shape
        or (runs[0].chains[0, 0] != runs[2].chains[0, 0]).any()
    )


# --- gates and honesty


def test_a_run_that_is_too_short_says_so() -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    posterior = sample_posterior(problem, theta, settings=replace(SHORT, max_steps=60))
    assert not posterior.converged
    assert posterior.status.startswith("NOT converged") and posterior.status in posterior.warnings
    record = posterior.to_json()
    assert record["converged"] is False and "NOT converged" in record["status"]


def test_the_k_hat_gate_hands_over_to_hmc(monkeypatch) -> None:
    monkeypatch.setattr(independence, "K_HAT_LIMIT", -np.inf)
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    posterior = sample_posterior(problem, theta, sampler="independence", settings=QUICK)
    assert posterior.sampler == "hmc" and posterior.converged
    assert "given up, refitted 5 times to its draws: Pareto k-hat" in posterior.reasons[0]
    assert posterior.reasons[1].startswith("Hamiltonian")


def test_a_sampler_ends_early_where_its_target_is_out_of_reach() -> None:
    few, many = np.array([100.0, 600.0]), np.array([600.0, 600.0])
    r_hat = np.ones(2)
    assert out_of_reach((r_hat, few, many), 0.25, 1000.0)  # 400 of 1000 at its end
    assert out_of_reach((r_hat, many, few / 4.0), 0.25, 1000.0)  # 100 of 400 in the tails
    assert not out_of_reach((r_hat, few, many), 0.1, 1000.0)


def test_hmc_that_falls_short_hands_over_to_emcee() -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    few = replace(SHORT, n_draws=40, max_draws=80)
    posterior = sample_posterior(problem, theta, sampler="hmc", settings=few)
    assert posterior.sampler == "emcee" and "was given up" in posterior.reasons[0]


def test_the_whitened_density_and_gradient_are_those_of_psi() -> None:
    problem, theta = small_problem(0.5, n=2, interval=0.02, fall=[True, False])
    laplace, mesh = approximate(problem, theta)
    target = Whitened(laplace, mesh)
    rng = np.random.default_rng(1)
    thetas, _ = laplace.draw(5, rng)
    q = target.q(thetas)
    np.testing.assert_allclose(target.theta(q), thetas, rtol=1e-9)
    expected = log_posteriors(mesh, laplace.coordinates, thetas, roots=True)
    values = np.array([target.value_and_gradient(row)[0] for row in q])
    np.testing.assert_allclose(values, expected, rtol=1e-10)
    for row in q:
        _, gradient = target.value_and_gradient(row)
        for i in range(len(row)):
            step = np.zeros(len(row))
            step[i] = 1e-4
            difference = (
                target.value_and_gradient(row + step)[0] - target.value_and_gradient(row - step)[0]
            ) / 2e-4
            assert gradient[i] == pytest.approx(difference, abs=2e-3)
    # a root's sign does not matter to the density: tau = |root|
    mirrored = target.centre + q[0] @ target.factor.T
    mirrored[laplace.coordinates.squared] *= -1
    back = np.linalg.solve(target.factor, mirrored - target.centre)
    assert target.value_and_gradient(back)[0] == pytest.approx(values[0], rel=1e-12)
    # nor does the order of the lags: switch times stay where they are, t0 + tau moves
    exchanged = thetas[0].copy()
    exchanged[:2] = thetas[0, [1, 0]]
    back = target.q(exchanged[None])[0]
    np.testing.assert_allclose(target.theta(back), thetas[0], rtol=1e-9)
    value, gradient = target.value_and_gradient(back)
    assert value == pytest.approx(values[0], rel=1e-10)
    for i in range(len(back)):
        step = np.zeros(len(back))
        step[i] = 1e-4
        difference = (
            target.value_and_gradient(back + step)[0] - target.value_and_gradient(back - step)[0]
        ) / 2e-4
        assert gradient[i] == pytest.approx(difference, rel=1e-5, abs=2e-3)


def test_side_information_is_respected() -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    campaign = replace(problem.campaign, side_information={"V_mL": SideInformation(14.2, 0.01)})
    posterior = sample_posterior(campaign, theta, sampler="independence", settings=QUICK)
    assert posterior.mean("V_mL") == pytest.approx(14.2, abs=0.02)
    assert posterior.sd("V_mL") == pytest.approx(0.01, rel=0.15)
    assert posterior.to_json()["priors"]["V_mL"] == "normal(14.2, 0.01)"
    plain = sample_posterior(problem, theta, sampler="independence", settings=QUICK)
    assert plain.sd("V_mL") > 5 * posterior.sd("V_mL")


def test_equal_flows_are_warned_of() -> None:
    design = small_design(n=2, interval=0.02)
    same = [replace(e, carrier_flow=60.0, test_gas_flow=10.0) for e in design]
    design = replace(design, experiments=tuple(same))
    theta = small_theta(design)
    posterior = sample_posterior(
        simulate(design, theta), theta, sampler="hmc", settings=replace(SHORT, max_draws=400)
    )
    assert any("cannot tell tau_v from V/Q" in text for text in posterior.warnings)
    problem, theta = small_problem(n=2, interval=0.02)
    assert not problem.campaign.same_flow


def one_flow(side: dict[str, SideInformation]) -> tuple[Problem, np.ndarray, float]:
    """A campaign at one flow with tau_v 0.5 s and V/Q 0.83 s, and the flow in mL/s."""
    design = small_design(n=2, interval=0.02)
    same = [replace(e, carrier_flow=60.0, test_gas_flow=10.0) for e in design]
    design = replace(design, experiments=tuple(same), side_information=side)
    theta = small_theta(design, sigma0=0.004, sigma1=0.004)
    layout = Problem(design).layout
    theta = layout.flat(theta)
    theta[1], theta[2] = 0.5, 58.0
    return Problem(simulate(design, theta, seed=4)), theta, 70.0


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["emcee", "independence"])
def test_at_one_flow_the_priors_choose_the_order_of_valve_and_manifold(sampler: str) -> None:
    problem, _, flow = one_flow({"V_mL": SideInformation(58.0, 2.0)})
    fit = fit_least_squares(problem, seed=1, swarms=1, euler=False)
    # the fit keeps lags by size; the volume tells which of them is V/Q
    assert fit.lags == pytest.approx([0.1, 0.5, 58.0 / flow], rel=0.1)
    assert fit.parameters["V_mL"] == pytest.approx(58.0, rel=0.05)
    assert fit.parameters["tau_v_s"] == pytest.approx(0.5, rel=0.1)
    posterior = sample_posterior(problem, fit, seed=1, sampler=sampler, settings=QUICK)
    assert posterior.converged and posterior.naming.place("manifold") == 2
    low, high = posterior.quantiles("V_mL", [0.005, 0.995])
    assert low < 58.0 < high < 63.0
    low, high = posterior.quantiles("tau_v_s", [0.005, 0.995])
    assert 0.45 < low < 0.5 < high < 0.55


@pytest.mark.slow
def test_at_one_flow_both_orders_have_their_share_without_other_knowledge() -> None:
    problem, _, flow = one_flow({})
    fit = fit_least_squares(problem, seed=1, swarms=1, euler=False)
    posterior = sample_posterior(problem, fit, seed=1, settings=replace(QUICK, max_steps=3000))
    assert posterior.converged
    tau_v, lag = posterior.of("tau_v_s"), posterior.of("V_mL") / flow
    # names are drawn for every draw: a half to within 4.5 binomial standard deviations
    assert np.mean(tau_v > lag) == pytest.approx(0.5, abs=2.25 / np.sqrt(len(tau_v)))
    low, high = posterior.quantiles("V_mL", [0.025, 0.975])
    assert low < 0.5 * flow * 1.05 and high > 57.0
    # that the sensor is the shortest of the three is said in the campaign
    assert posterior.naming.order == "given" and len(posterior.assignments) == 1
    bounds = compare_bounds(problem, fit, posterior, methods=["crlb_ar1", "posterior"])
    record = bounds["crlb_ar1"].to_json()["parameters"]
    assert record["V_mL"] is None and record["tau_v_s"] is None
    for name, true in (("tau_s", 0.1), ("lag_between_s", 0.5), ("lag_slow_s", 58.0 / flow)):
        for bound in bounds.methods.values():
            low, high = bound.interval(name, "997")
            assert low < true < high, (name, bound.method)


def test_bounds_refuse_what_is_of_other_data_and_tell_what_has_not_converged() -> None:
    problem, theta = small_problem(n=2, interval=0.02)
    other = replace(problem, campaign=simulate(problem, theta, seed=9))
    fit, strange = (fit_least_squares(p, seed=1, swarms=1, euler=False) for p in (problem, other))
    few = Settings(n_chains=2, chunk=10, burn_in=5, max_steps=30)
    posterior, foreign = (
        sample_posterior(p, f, seed=1, settings=few) for p, f in ((problem, fit), (other, strange))
    )
    with pytest.raises(CampaignError, match="it is of other data; fit this campaign first"):
        compare_bounds(problem, strange, methods=["crlb_ar1"])
    with pytest.raises(CampaignError, match="the posterior is of other data"):
        compare_bounds(problem, fit, foreign, methods=["posterior"])
    assert not posterior.converged
    found = compare_bounds(problem, fit, posterior, methods=["posterior"])["posterior"]
    assert "NOT converged" in found.status


def test_exchanging_twice_changes_nothing_and_keeps_volumes() -> None:
    problem, theta, flow = one_flow({})
    assert exchanged(exchanged(theta, flow), flow) == pytest.approx(theta)
    assert log_likelihood(problem, exchanged(theta, flow)) == pytest.approx(
        log_likelihood(problem, theta), rel=1e-10
    )
    step = 1e-6
    jacobian = np.array([
        (exchanged(theta + step * unit, flow) - exchanged(theta - step * unit, flow)) / (2 * step)
        for unit in np.eye(len(theta))
    ])  # fmt: skip
    assert abs(np.linalg.det(jacobian)) == pytest.approx(1.0, rel=1e-6)


def test_switch_times_stay_behind_their_commands() -> None:
    # commanded 2 ms before the truth: the prior cuts the posterior there
    problem, theta = small_problem(0.9, n=1, interval=0.02, fall=False)
    e = replace(problem.campaign.experiments[0], commanded_on=2.0)
    posterior = sample_posterior(
        replace(problem.campaign, experiments=(e,)), theta, sampler="emcee", settings=QUICK
    )
    assert posterior.of("t0_s[a]").min() >= 2.0
    assert posterior.of("t0_s[a]").min() < 2.003


def test_a_design_an_unknown_sampler_and_small_settings_are_refused() -> None:
    problem, theta = small_problem(n=1)
    with pytest.raises(CampaignError, match="sampler must be one of emcee, independence, hmc"):
        sample_posterior(problem, theta, sampler="nuts")
    with pytest.raises(CampaignError, match="a design has no data"):
        sample_posterior(small_design(n=1), theta)
    with pytest.raises(CampaignError, match="sampler setting n_chains is too small: 1"):
        Settings(n_chains=1)


# --- the record


def test_the_record_has_the_contracts_keys() -> None:
    posterior = drawn("independence", 0.9)
    record = json.loads(json.dumps(posterior.to_json(), allow_nan=False))
    assert set(record["parameters"]) == {
        "tau_s", "tau_v_s", "V_mL", "phi", "sigma0_V", "sigma1_V",
        "y0_V[a]", "beta_V[a]", "t0_s[a]", "tf_s[a]", "y0_V[b]", "beta_V[b]", "t0_s[b]",
    }  # fmt: skip
    row = record["parameters"]["tau_s"]
    levels = ["q0.5", "q2.5", "q16", "q50", "q84", "q97.5", "q99.5"]
    assert set(row) == {"mean", "sd", *levels, "ess_bulk", "ess_tail", "r_hat"}
    assert [row[q] for q in levels] == sorted(row[q] for q in levels)
    assert row["q50"] == pytest.approx(np.median(posterior.of("tau_s")))
    assert record["n_draws"] == len(posterior.draws) and record["converged"] is True
    assert record["phi_interval_s"] == 0.001 and record["signal_unit"] == "V"
    assert list(posterior.summary().index) == posterior.names


def test_pinned_parameters_are_null() -> None:
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02, noise=Noise("constant", "white"))
    posterior = sample_posterior(problem, theta, sampler="independence", settings=QUICK)
    assert posterior.converged
    record = posterior.to_json()
    assert record["parameters"]["phi"] is None and record["parameters"]["sigma1_V"] is None
    assert (posterior.of("phi") == 0).all()
    json.dumps(record, allow_nan=False)


def test_log_likelihood_per_experiment_is_kept() -> None:
    posterior = drawn("hmc", 0.9)
    row = posterior.draws[7]
    assert posterior.log_likelihood.reshape(-1, 2)[7].sum() == pytest.approx(
        log_likelihood(posterior.problem, row), abs=1e-3
    )


def test_tau_under_other_priors() -> None:
    posterior = drawn("independence", 0.9)
    table = posterior.tau_under_priors().set_index("prior")
    own = table.loc["half_normal"]
    # the prior in use: no reweighting
    assert own["n_effective"] == pytest.approx(len(posterior.draws))
    np.testing.assert_allclose(
        [own["lo95_s"], own["hi95_s"], own["upper99_s"]],
        posterior.quantiles("tau_s", [0.025, 0.975, 0.99]),
        rtol=0.01,
    )
    # a half-normal law pulls tau down against a flat one
    assert table.loc["flat", "upper95_s"] > own["upper95_s"]
    # the log-uniform law: the same draws weighted by hand
    tau = posterior.of("tau_s")
    scale = posterior.problem.priors["tau_s"].a
    weight = np.exp(0.5 * (tau / scale) ** 2) / np.maximum(tau, scale / 100)
    order = np.argsort(tau)
    cdf = np.cumsum(weight[order]) / weight.sum()
    upper = tau[order][np.searchsorted(cdf, 0.95)]
    assert table.loc["log_uniform_floored", "upper95_s"] == pytest.approx(upper, rel=0.01)
    width = table["hi95_s"] - table["lo95_s"]
    assert (table["hdi_hi95_s"] - table["hdi_lo95_s"] <= width + 1e-12).all()
    # with another law in use the half-normal one is the default, which follows the rig
    flat = replace(posterior.problem, given_priors={"tau_s": Prior("flat")})
    law = replace(posterior, problem=flat).tau_under_priors().set_index("prior")["law"]
    assert scale < 0.2 and law["half_normal"] == f"half-normal({scale:g})"


def test_only_a_mean_linear_in_y0_and_beta_is_marginalised() -> None:
    class Saturating(Cascade):
        def mean(self, t, theta, layout, experiment):
            return np.tanh(super().mean(t, theta, layout, experiment))

    problem, theta = small_problem(n=1, interval=0.05, fall=False)
    problem = Problem(problem.campaign, model=Saturating())
    campaign = simulate(problem, theta)
    posterior = sample_posterior(
        replace(problem, campaign=campaign), theta, settings=replace(SHORT, max_steps=40)
    )
    assert "all parameters" in posterior.reasons[-1]


# --- a model with parameters of its own


@dataclass(frozen=True)
class Closing(Cascade):
    """A valve that shuts with tau_v (1 + closing_ratio), as an effect would bring it."""

    extra: tuple[str, ...] = ("closing_ratio",)

    def response(self, t, theta, layout, experiment):
        _, _, t0, tf = local_parameters(theta, layout, experiment.name)
        taus = time_constants(theta[0], theta[1], theta[2], experiment.total_flow)
        x = cascade_response(t, taus, t0)
        if tf is not None:
            taus[0] *= 1.0 + theta[layout.index("closing_ratio")]
            x = x - cascade_response(t, taus, tf)
        return x


@dataclass(frozen=True)
class Drifting(Cascade):
    """A baseline with its own slope in every experiment; the mean is still linear in y0, beta."""

    extra: tuple[str, ...] = ("drift_V_per_s[a]", "drift_V_per_s[b]")
    affine: bool = True

    def mean_and_response(self, t, theta, layout, experiment):
        slope = theta[layout.index(f"drift_V_per_s[{experiment.name}]")]
        x = self.response(t, theta, layout, experiment)
        y0, beta, _, _ = local_parameters(theta, layout, experiment.name)
        return y0 + beta * x + slope * (t - 6.0), x


EFFECTS = {
    "closing": (Closing(), {"closing_ratio": Prior("normal", 0.0, 0.3)}, {"closing_ratio": 0.2}),
    "drifting": (
        Drifting(),
        {f"drift_V_per_s[{e}]": Prior("normal", 0.0, 0.01) for e in "ab"},
        {"drift_V_per_s[a]": 0.004, "drift_V_per_s[b]": -0.002},
    ),
}


@cache
def with_effect(name: str, sampler: str) -> tuple[Posterior, np.ndarray]:
    model, priors, truth = EFFECTS[name]
    plan = small_design(n=2, interval=5e-3)
    bare = small_theta(plan, 0.5, 0.01, 0.01)
    theta = {**bare, **truth}
    problem = Problem(plan, model=model, given_priors=priors)
    campaign = simulate(problem, theta, seed=4)
    # from the cascade's parameters: those of the effect are fitted
    start = Problem(campaign).layout.flat(bare)
    posterior = sample_posterior(
        replace(problem, campaign=campaign), start, seed=2, sampler=sampler, settings=QUICK
    )
    return posterior, problem.layout.flat(theta)


@pytest.mark.parametrize("name", EFFECTS)
def test_a_models_own_parameters_are_sampled(name: str) -> None:
    posterior, truth = with_effect(name, "independence")
    assert posterior.sampler == "independence" and posterior.converged
    assert posterior.mesh_error < 1e-3
    z = (posterior.draws.mean(axis=0) - truth) / posterior.draws.std(axis=0)
    assert np.abs(z).max() < 4.5
    for own in EFFECTS[name][2]:
        # negative control: the effect is really there, and the data hold it
        assert abs(posterior.mean(own)) > 4.5 * posterior.sd(own)
    record = json.loads(json.dumps(posterior.to_json(), allow_nan=False))
    assert set(EFFECTS[name][2]) < set(record["parameters"])
    assert record["priors"].keys() > EFFECTS[name][2].keys()


@pytest.mark.slow
def test_emcee_integrates_y0_and_beta_out_of_an_affine_mean_too() -> None:
    a, _ = with_effect("drifting", "independence")
    few = Settings(n_chains=2, n_walkers=26, chunk=40, burn_in=40, max_steps=160, thin=2)
    start = a.draws.mean(axis=0)
    b = sample_posterior(a.problem, start, seed=2, sampler="emcee", settings=few)
    assert b.sampler == "emcee" and "integrated out exactly" in b.reasons[0]
    # too short to converge; its effective sample size says how far to trust it
    ess = [np.minimum(p.ess_bulk, p.ess_tail) for p in (a, b)]
    assert ess[1].min() > 40
    error = np.hypot(a.draws.std(axis=0) / np.sqrt(ess[0]), b.draws.std(axis=0) / np.sqrt(ess[1]))
    assert np.abs((a.draws.mean(axis=0) - b.draws.mean(axis=0)) / error).max() < 4.5
    spread = np.log(a.draws.std(axis=0) / b.draws.std(axis=0))
    assert np.abs(spread / np.sqrt(0.5 / ess[0] + 0.5 / ess[1])).max() < 4.5


def test_own_parameters_are_saved_and_read_back(tmp_path) -> None:
    posterior, _ = with_effect("drifting", "independence")
    group = posterior.inference_data["posterior"]
    assert group["drift_V_per_s"].dims == ("chain", "draw", "experiment")
    assert group["drift_V_per_s"].attrs["units"] == "V/s"
    posterior.save(tmp_path / "posterior.nc")
    names, chains = load_chains(tmp_path / "posterior.nc")
    np.testing.assert_array_equal(
        chains[:, :, names.index("drift_V_per_s[b]")].ravel(), posterior.of("drift_V_per_s[b]")
    )


def closing(ratio: float, prior: Prior) -> Posterior:
    plan = small_design(n=2, interval=5e-3)
    problem = Problem(plan, model=Closing(), given_priors={"closing_ratio": prior})
    theta = {**small_theta(plan, 0.5, 0.01, 0.01), "closing_ratio": ratio}
    problem = replace(problem, campaign=simulate(problem, theta, seed=1))
    start = problem.layout.flat(theta)
    posterior = sample_posterior(problem, start, seed=1, sampler="independence", settings=QUICK)
    assert posterior.sampler == "independence" and posterior.converged
    return posterior


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "prior"),
    [
        # truth and maximum sit at the prior's end, where draws are cut
        (0.0, Prior("half_normal", 0.3)),
        (0.0, Prior("uniform", 0.0, 0.5)),
        (0.3, Prior("log_normal", 0.3, 0.05)),
        (0.3, Prior("log_uniform", 0.305, 2.0)),
    ],
    ids=str,
)
def test_bounded_priors_against_reweighted_draws_of_an_unbounded_one(
    ratio: float, prior: Prior
) -> None:
    bounded, free = closing(ratio, prior), closing(ratio, Prior("normal", 0.0, 0.3))
    x = free.of("closing_ratio")
    log_w = prior.log_density(x) - free.problem.priors["closing_ratio"].log_density(x)
    w = np.exp(log_w - log_w.max())
    # negative control: the prior matters
    assert w.min() < 0.9
    i = bounded.problem.layout.index("closing_ratio")
    n_free = min(free.ess_bulk[i], w.sum() ** 2 / (w**2).sum())
    for name in ("closing_ratio", "tau_v_s"):
        z = free.of(name)
        mean = (w * z).sum() / w.sum()
        sd = np.sqrt((w * (z - mean) ** 2).sum() / w.sum())
        error = sd * np.sqrt(1 / n_free + 1 / bounded.ess_bulk[i])
        assert bounded.mean(name) == pytest.approx(mean, abs=4.5 * error)
        assert bounded.sd(name) == pytest.approx(sd, rel=4.5 * error / sd)
    low, high = prior.support
    assert low <= bounded.of("closing_ratio").min() and bounded.of("closing_ratio").max() <= high


def test_a_parameter_without_a_prior_is_named() -> None:
    problem, theta = small_problem(n=1)
    problem = replace(problem, model=Closing())
    with pytest.raises(CampaignError, match="'closing_ratio' has no prior"):
        sample_posterior(problem, np.append(theta, 0.1), sampler="independence")


@pytest.mark.slow
def test_no_reweighting_beyond_the_support_of_what_was_sampled() -> None:
    problem, theta = small_problem(n=2, interval=0.02, tau=0.1)
    numbers = ["lo95_s", "hi95_s", "hdi_lo95_s", "hdi_hi95_s", "upper95_s", "upper99_s"]

    def under(prior: Prior, sampler: str = "independence") -> Posterior:
        bounded = replace(problem, given_priors={"tau_s": prior})
        few = replace(QUICK, max_steps=300, target_ess=100.0)  # whose numbers are not compared
        settings = few if sampler == "emcee" else replace(QUICK, target_ess=4000.0)
        return sample_posterior(bounded, theta, sampler=sampler, settings=settings)

    for prior in (Prior("uniform", 0.0, 0.08), Prior("uniform", 0.1, 0.6)):
        posterior = under(prior, "emcee")
        table = posterior.tau_under_priors()
        assert table[numbers].isna().all(axis=None) and (table["n_effective"] == 0).all()
        assert table["status"].str.startswith(f"the draws were made under {prior} and reach").all()
        record = json.loads(json.dumps(posterior.to_json(), allow_nan=False))
        assert record["tau_under_priors"] == []
        left_out = record["tau_under_priors_left_out"]
        assert [row["prior"] for row in left_out] == list(table["prior"])
        assert "never drawn; sample under that law" in left_out[0]["status"]
    # a bound that the draws do not reach hides nothing
    wide = under(Prior("uniform", 0.0, 0.6))
    table = wide.tau_under_priors().set_index("prior")
    assert (table["status"] == "ok").all() and np.isfinite(table[numbers]).all(axis=None)
    free = under(Prior("flat")).tau_under_priors().set_index("prior")
    at = "flat", "upper95_s"
    assert table.loc[at] == pytest.approx(free.loc[at], rel=0.05)
    assert wide.to_json()["tau_under_priors_left_out"] == []
    assert len(wide.to_json()["tau_under_priors"]) == 3


def test_draws_that_would_go_on_beyond_an_end() -> None:
    x, w = np.linspace(0.2, 1.0, 4000), np.full(4000, 1 / 4000)
    assert not reaches_end(x, w, 0.0, np.inf) and not reaches_end(x, w, 0.0, 1.2)
    assert reaches_end(x, w, 0.0, 1.0) and reaches_end(x, w, 0.2, np.inf)
    thin = np.exp(-0.5 * ((x - 0.6) / 0.08) ** 2)
    assert not reaches_end(x, thin / thin.sum(), 0.2, 1.0)


def test_a_start_may_hold_some_of_a_models_own_parameters() -> None:
    problem, theta = small_problem(n=2, interval=0.02)
    own = replace(Closing(), extra=("closing_ratio", "idle"))
    priors = {name: Prior("normal", 0.0, 0.3) for name in own.extra}
    extended = replace(problem, model=own, given_priors=priors)
    given = {**problem.layout.nested(theta), "closing_ratio": 0.1}
    np.testing.assert_array_equal(start_vector(extended, given), start_vector(extended, theta))


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


@dataclass(frozen=True)
class Known:
    """A fit that ended at the truth."""

    theta_hat: np.ndarray


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


def test_ensembles_that_stay_apart_are_out_of_reach() -> None:
    good = np.random.default_rng(3).standard_normal((4, 500, 2))
    stuck = good + 5.0 * np.arange(4)[:, None, None]
    assert out_of_reach(diagnostics(stuck), 0.25, ESS_LIMIT)
    assert not out_of_reach(diagnostics(good), 0.25, ESS_LIMIT)


def test_what_a_killed_run_left_half_written_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".ensemble-0-00000.npz.tmp").write_bytes(b"half")
    Checkpoint(tmp_path, "digest", resume=True)
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.json"]


@pytest.mark.parametrize(
    ("n_points", "walkers", "steps"),
    [
        (6000, 64, 3000),  # the published size
        (MOST_POINTS // (4 * 64 * 1000), 64, 1000),
        (MOST_POINTS // (4 * 32 * 300), 32, 300),  # what a judgement of convergence needs
        (MOST_POINTS, 14, 300),  # and the fewest walkers of six coordinates
    ],
)
def test_a_run_ends_in_bounded_time_on_records_of_any_size(
    n_points: int, walkers: int, steps: int
) -> None:
    settings = Settings(max_steps=3000, burn_in=100, chunk=100)
    bounded = in_bounded_time(settings, 6, n_points)
    assert bounded == replace(settings, n_walkers=walkers, max_steps=steps)
    asked = Settings(max_steps=4000)
    assert in_bounded_time(asked, 6, MOST_POINTS) == asked
    assert in_bounded_time(asked, 40, 100).n_walkers == 82


def test_a_run_that_is_cut_short_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(emcee_ensembles, "MOST_POINTS", 1)
    problem, theta = small_problem(n=1, interval=0.05)
    settings = Settings(n_chains=2, burn_in=10, chunk=10, max_steps=400)
    found = sample_posterior(problem, theta, sampler="emcee", settings=settings)
    assert found.chains.shape[1] * settings.thin == 18 * 20  # the fewest of eight coordinates
    assert not found.converged and "more steps would take too long" in found.reasons[-1]
