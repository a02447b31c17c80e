"""emcee that begins from the draws of another sampler: it agrees, or says that it does not."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import bayes_sensor.posterior.samplers.independence as independence
from bayes_sensor.likelihood.mesh import Compressed
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import (
    R_HAT_LIMIT,
    SAMPLERS,
    Posterior,
    Settings,
    Target,
    fast_posterior,
    sample_posterior,
)
from bayes_sensor.posterior.agreement import r_hat_between
from bayes_sensor.posterior.laplace import Laplace, approximate
from bayes_sensor.posterior.samplers.hmc import MOST_OUTSIDE
from tests.support.campaigns import small_problem
from tests.support.other_rigs import CASES

SETTINGS = Settings(n_chains=2)


@cache
def drawn() -> tuple[Problem, np.ndarray, Posterior]:
    problem, theta = small_problem(sigma=0.004, n=3, interval=0.01)
    fast = fast_posterior(problem, theta, seed=5, settings=SETTINGS)
    assert fast is not None and fast.converged and fast.sampler == "independence"
    return problem, theta, fast


def steps(posterior: Posterior) -> tuple[int, int]:
    """All steps and those dropped, as the reason says."""
    words = posterior.reasons[0].split(" walkers, ")[1].split()
    return int(words[0]), int(words[2].strip("("))


@pytest.mark.slow
def test_emcee_from_the_fast_draws_agrees_and_drops_none() -> None:
    problem, theta, fast = drawn()
    slow = sample_posterior(problem, theta, seed=5, settings=SETTINGS, begin=fast)
    assert slow.converged and slow.sampler == "emcee"
    assert slow.agreement is not None and slow.agreement.agrees
    assert not [text for text in slow.warnings if "does not agree" in text]
    # an independent run, which begins from the Laplace approximation
    alone = sample_posterior(problem, theta, seed=6, settings=SETTINGS)
    assert steps(slow)[1] == 0 and steps(slow)[0] < steps(alone)[0]
    assert alone.agreement is None and alone.to_json()["began_from"] is None
    ess = [np.minimum(p.ess_bulk, p.ess_tail) for p in (slow, alone, fast)]
    for other, effective in ((alone, ess[1]), (fast, ess[2])):
        error = slow.draws.std(axis=0) * np.sqrt(1 / ess[0] + 1 / effective)
        # 4.5 sd of the difference of two means, for a dozen parameters
        z = np.abs(slow.draws.mean(axis=0) - other.draws.mean(axis=0)) / error
        assert np.nanmax(z) < 4.5
    told = slow.to_json()["began_from"]
    assert told["agrees"] and told["r_hat"] < R_HAT_LIMIT
    assert told["parameters"]["tau_s"] == pytest.approx(fast.rows["tau_s"])
    assert any("began from draws of independence and agrees" in text for text in slow.reasons)


@pytest.mark.slow
def test_a_wrong_start_is_found_out_and_left_behind() -> None:
    problem, theta, fast = drawn()
    chains = fast.chains.copy()
    tau_v = problem.layout.index("tau_v_s")
    chains[:, :, tau_v] += 2.0 * fast.draws[:, tau_v].std()
    wrong = replace(fast, chains=chains)
    slow = sample_posterior(problem, theta, seed=5, settings=SETTINGS, begin=wrong)
    assert slow.agreement is not None and not slow.agreement.agrees
    assert np.nanargmax(slow.agreement.r_hat) == tau_v
    assert [text for text in slow.warnings if "does not agree with them" in text]
    # what the walkers went through on their way is dropped, and the law is the right one
    n_steps, dropped = steps(slow)
    assert dropped == SETTINGS.burn_in and n_steps >= dropped + 2 * SETTINGS.chunk
    right = r_hat_between(problem, fast.chains, slow.chains)
    assert slow.converged and np.nanmax(right) < R_HAT_LIMIT


def test_r_hat_of_two_sets_is_one_for_equal_laws_and_grows_with_their_distance() -> None:
    problem, _, fast = drawn()
    rng = np.random.default_rng(1)
    first, second = rng.standard_normal((2, 4, 2000, len(problem.layout)))
    same = r_hat_between(problem, first, second[:, :500])
    # 1 + 1 / (2 n) on average for n = 2000 draws; 1.002 is exceeded once in 10000
    assert np.nanmax(same) < 1.002
    apart = r_hat_between(problem, first, second + 0.3)
    assert np.nanmin(apart) > R_HAT_LIMIT
    wider = r_hat_between(problem, first, 1.4 * second)  # the same mean
    assert np.nanmin(wider) > R_HAT_LIMIT
    assert fast.chains.ndim == 3


@pytest.mark.slow
def test_draws_that_have_not_converged_are_no_start() -> None:
    problem, theta, fast = drawn()
    loose = replace(fast, r_hat=np.full_like(fast.r_hat, 1.5))
    few = replace(SETTINGS, max_steps=300)
    begun = sample_posterior(problem, theta, seed=5, settings=few, begin=loose)
    plain = sample_posterior(problem, theta, seed=5, settings=few)
    assert begun.agreement is None
    np.testing.assert_array_equal(begun.chains, plain.chains)


@pytest.mark.slow
def test_a_run_is_repeated_only_where_a_finer_mesh_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    # one record at one flow: data that hold little; its walkers leave the mesh
    problem, theta = small_problem(sigma=0.05, n=1, interval=0.2, fall=False)
    settings = Settings(n_chains=2, n_walkers=32, max_steps=300)
    marginals, evaluated = Compressed.marginals, {True: 0, False: 0}
    for helps in evaluated:

        def counted(self: Compressed, thetas: np.ndarray, helps: bool = helps) -> Any:
            evaluated[helps] += len(thetas)
            return marginals(self, thetas)

        def error(self: Compressed, thetas: np.ndarray, helps: bool = helps) -> float:
            return 0.0 if helps and self.region.fineness > 1.0 else 1.0

        def finer(self: Compressed, thetas: np.ndarray, limit: float) -> Compressed:
            region = replace(self.region, fineness=2.0)
            return Compressed(self.problem, self.reference, region)

        def usual(problem: Problem, start: np.ndarray) -> tuple[Laplace, Compressed]:
            laplace, mesh = approximate(problem, start)
            region = replace(mesh.region, fineness=1.0)
            return laplace, Compressed(problem, mesh.reference, region)

        with monkeypatch.context() as patch:
            patch.setattr(Compressed, "marginals", counted)
            patch.setattr(Compressed, "error", error)
            patch.setattr(Compressed, "accurate", finer)
            patch.setattr("bayes_sensor.posterior.sample.approximate", usual)
            posterior = sample_posterior(problem, theta, seed=1, settings=settings)
        assert posterior.mesh_error == (0.0 if helps else 1.0)
        assert any("the mesh is off" in text for text in posterior.warnings) == (not helps)
    # at most all steps of all walkers, the draws once more for y0 and beta, and the start: eight
    # times as many draws as there are walkers, in up to sixty attempts
    walkers = settings.n_chains * settings.n_walkers
    most = walkers * (settings.max_steps + settings.max_steps // settings.thin + 8 * 60)
    assert 0 < evaluated[False] < most
    assert evaluated[True] > 1.5 * evaluated[False]


def test_hmc_off_the_mesh_ends_after_a_counted_number_of_evaluations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, theta = small_problem(sigma=0.05, n=1, interval=0.2, fall=False)
    laplace, mesh = approximate(problem, theta)
    slow = []
    exact = Compressed.value_and_gradient

    def counted(self: Compressed, vector: np.ndarray) -> Any:
        slow.append(vector)
        return exact(self, vector)

    monkeypatch.setattr(Compressed, "covers", lambda self, vector: False)
    monkeypatch.setattr(Compressed, "value_and_gradient", counted)
    target = Target(
        problem, theta, laplace, mesh, SETTINGS, 1, np.random.SeedSequence(1), lambda *_: None
    )
    run = SAMPLERS["hmc"].run(target)
    assert not run.good and "leave the mesh" in run.reason and len(run.chains) == 0
    assert 0 < len(slow) <= MOST_OUTSIDE


def test_independence_refits_a_proposal_that_misses_and_then_agrees() -> None:
    problem, theta = small_problem(0.5, sigma=0.01, n=2)
    laplace, mesh = approximate(problem, theta)
    moved = replace(laplace, mean=laplace.mean + 0.8 * np.linalg.cholesky(laplace.cov).sum(axis=1))
    runs = {}
    for name, proposal in (("right", laplace), ("moved", moved)):
        target = Target(
            problem, theta, proposal, mesh, SETTINGS, 1, np.random.SeedSequence(1), lambda *_: None
        )
        runs[name] = SAMPLERS["independence"].run(target)
    assert runs["right"].good
    assert runs["moved"].good and "refitted" in runs["moved"].reason
    assert runs["moved"].k_hat is not None and runs["moved"].k_hat < 0.5
    first, second = (r.chains.reshape(-1, len(problem.layout)) for r in runs.values())
    np.testing.assert_allclose(
        (first.mean(axis=0) - second.mean(axis=0)) / first.std(axis=0), 0.0, atol=0.3
    )
    np.testing.assert_allclose(second.std(axis=0) / first.std(axis=0), 1.0, atol=0.25)


@pytest.mark.slow
def test_hmc_takes_over_only_where_its_gradient_is_compiled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(independence, "K_HAT_LIMIT", -np.inf)
    problem, theta = small_problem(sigma=0.01, n=2, interval=0.02)
    found = fast_posterior(problem, theta, settings=SETTINGS)
    assert found is not None and found.sampler == "hmc"
    campaign = CASES["sensor"]().simulated()
    assert fast_posterior(campaign, settings=SETTINGS) is None
    full = sample_posterior(campaign, sampler="independence", settings=SETTINGS)
    assert full.sampler == "emcee" and len(full.reasons) == 2
    asked = sample_posterior(campaign, sampler="hmc", settings=SETTINGS)
    assert asked.sampler == "hmc" and asked.converged
