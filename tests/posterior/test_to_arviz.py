"""A posterior for ArviZ: blocks sum to the likelihood, and ArviZ's functions take all groups."""

import warnings
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy import stats

import bayes_sensor as bs
from bayes_sensor.posterior import inference_data as idata
from bayes_sensor.posterior.to_arviz import Blocks, to_arviz
from tests.support.campaigns import dense_covariance, small_problem

pytestmark = pytest.mark.arviz

GROUPS = {
    "posterior", "sample_stats", "log_likelihood", "posterior_predictive", "observed_data", "prior",
}  # fmt: skip


@pytest.fixture(scope="module")
def posterior() -> bs.Posterior:
    """Of two records, one masked in part, one without a step down."""
    problem, theta = small_problem(
        n=2, interval=0.02, fall=[True, False], masked=[(4.0, 4.3)], phi=0.7
    )
    return bs.sample_posterior(problem, theta, seed=1, sampler="independence")


@pytest.fixture(scope="module")
def data(posterior: bs.Posterior) -> Any:
    return to_arviz(posterior, most_draws=400)


def groups_of(data: Any) -> set[str]:
    names = data.children if idata.has_data_tree() else data.groups()
    return {str(name).strip("/") for name in names}


def test_groups_dimensions_and_units(posterior: bs.Posterior, data: Any) -> None:
    assert groups_of(data) == GROUPS
    group = data["posterior"]
    for name in ("tau", "tau_v", "V", "phi", "sigma0", "sigma1"):
        assert group[name].dims == ("chain", "draw")
    for name in ("y0", "beta", "t0"):
        assert group[name].dims == ("chain", "draw", "experiment")
    # only the first record has a step down: nothing is invented, and nothing is nan
    assert group["tf"].dims == ("chain", "draw", "tf_of")
    assert list(group["tf_of"].values) == ["a"]
    assert all(np.isfinite(group[name].values).all() for name in group.data_vars)
    assert (group["tau"].attrs["units"], group["beta"].attrs["units"]) == ("s", "V")
    shape = group["tau"].shape
    assert shape[0] * shape[1] <= 400
    step = data.attrs["thinned_by"]
    whole = posterior.of("tau_s").reshape(posterior.chains.shape[:2])
    np.testing.assert_array_equal(group["tau"].values, whole[:, ::step])
    for name in ("log_likelihood", "posterior_predictive"):
        assert data[name]["y"].dims == ("chain", "draw", "block")
        assert data[name]["y"].shape[:2] == shape
    assert data["observed_data"]["y"].dims == ("block",)
    assert "the correlation of each block's first samples" in data.attrs["left_out"]
    assert "y0_V, whose laws are flat" in data.attrs["left_out"]


def test_blocks_sum_to_the_exact_likelihood(posterior: bs.Posterior, data: Any) -> None:
    step = data.attrs["thinned_by"]
    thetas = posterior.chains[:, ::step]
    total = data["log_likelihood"]["y"].values.sum(axis=-1)
    prior = data["sample_stats"]["lp"].values
    for i, j in ((0, 0), (1, 7), (3, 20)):
        theta = thetas[i, j]
        exact = bs.log_likelihood(posterior.problem, theta)
        assert total[i, j] == pytest.approx(exact, abs=1e-7)
        # lp has the likelihood of the mesh, which is exact to 1e-3
        whole = exact + bs.log_prior(posterior.problem, theta)
        assert prior[i, j] == pytest.approx(whole, abs=2e-3)


def test_a_block_is_the_dense_conditional_density(posterior: bs.Posterior, data: Any) -> None:
    problem, theta = posterior.problem, posterior.chains[0, 0]
    e = problem.campaign.experiments[0]
    kept = posterior.chains[:, :: data.attrs["thinned_by"], problem.layout.index("phi")]
    blocks = Blocks.of(e, float(np.median(kept)))
    assert blocks.duration > 5 * blocks.memory
    a, b = blocks.starts[3], blocks.starts[4]
    mean = problem.model.mean(e.t[e.used], theta, problem.layout, e)
    cov = dense_covariance(problem, theta, 0)
    r = e.values[e.used] - mean

    def log_density(n: int) -> float:
        return float(stats.multivariate_normal(cov=cov[:n, :n]).logpdf(r[:n]))

    found = float(data["log_likelihood"]["y"].values[0, 0, 3])
    assert found == pytest.approx(log_density(b) - log_density(a), abs=1e-6)


def test_replicates_look_like_the_data(posterior: bs.Posterior, data: Any) -> None:
    seen = data["observed_data"]["y"].values
    made = data["posterior_predictive"]["y"].values.reshape(-1, len(seen))
    z = (seen - made.mean(axis=0)) / made.std(axis=0)
    # the data were drawn from the model: of 2 n_blocks numbers |z| < 5, mean square near 1
    assert np.abs(z).max() < 5.0 and 0.5 < np.mean(z**2) < 1.7
    labels = data["observed_data"]["experiment"].values
    assert set(labels) == {"a", "b"}
    times = data["observed_data"]["t"].values[labels == "a"]
    assert (np.diff(times) > 0).all()


def test_prior_draws_follow_the_priors(posterior: bs.Posterior, data: Any) -> None:
    prior = data["prior"]
    assert "y0" not in prior and "beta" not in prior
    law = posterior.problem.priors["phi"].law
    assert stats.kstest(prior["phi"].values.ravel(), law.cdf).pvalue > 1e-3
    tau, tau_v = prior["tau"].values, prior["tau_v"].values
    assert (tau <= tau_v).all()  # the sensor is said to be the faster lag
    # half-normal and log-normal, given their order: against draws by rejection
    rng = np.random.default_rng(0)
    pair = [
        posterior.problem.priors[n].law.rvs(20000, random_state=rng) for n in ("tau_s", "tau_v_s")
    ]
    kept = pair[0] <= pair[1]
    assert stats.ks_2samp(tau.ravel(), pair[0][kept]).pvalue > 1e-3
    assert stats.ks_2samp(tau_v.ravel(), pair[1][kept]).pvalue > 1e-3


@pytest.mark.slow
def test_functions_of_arviz(data: Any) -> None:
    az = idata.import_quietly("arviz")
    with warnings.catch_warnings():
        # ArviZ's own words on its future, on matplotlib's, and on influential blocks
        for text in (".*alias_mapping.*", "Estimated shape parameter.*", ".*refactor.*"):
            warnings.filterwarnings("ignore", message=text)
        table = az.summary(data)
        assert any(str(name).startswith("tf") for name in table.index)
        assert np.isfinite(np.asarray(table["mean"], dtype=float)).all()
        found = az.loo(data, pointwise=True)
        elpd = found.elpd if hasattr(found, "elpd") else found.elpd_loo
        assert np.isfinite(float(elpd))
        az.plot_trace(data, var_names=["tau", "tf"])
        az.plot_pair(data, var_names=["tau", "tau_v"])
        if idata.has_data_tree():
            az.plot_ppc_dist(data)
        else:
            az.plot_ppc(data, num_pp_samples=20)
    plt.close("all")


def test_loo_finds_the_better_noise_law(posterior: bs.Posterior) -> None:
    # blocks know the correlation inside them: white noise must lose by much
    az = idata.import_quietly("arviz")
    problem = bs.make_problem(posterior.problem.campaign, noise={"autocorrelation": "white"})
    other = bs.sample_posterior(problem, posterior.draws[0], seed=1, sampler="independence")
    found = []
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Estimated shape parameter.*")
        for each in (posterior, other):
            loo = az.loo(to_arviz(each, most_draws=400))
            found.append(float(loo.elpd if hasattr(loo, "elpd") else loo.elpd_loo))
    white = to_arviz(other, most_draws=40)
    assert found[0] > found[1] + 100.0
    assert (
        "phi" not in white["posterior"]
        and "posterior: phi, which are held" in white.attrs["left_out"]
    )


def test_too_few_draws_are_refused(posterior: bs.Posterior) -> None:
    with pytest.raises(bs.CampaignError, match="most_draws of at least 4, but got 1"):
        to_arviz(posterior, most_draws=1)
