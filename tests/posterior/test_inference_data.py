"""InferenceData under ArviZ 0.23 and the DataTree of ArviZ 1.x: same groups, same names."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.posterior import Posterior, load_chains
from bayes_sensor.posterior import inference_data as idata
from bayes_sensor.posterior.r_hat import diagnostics, pareto_k
from tests.support.campaigns import small_problem

pytestmark = pytest.mark.arviz

GROUPS = ("posterior", "log_likelihood", "posterior_predictive", "observed_data")


@pytest.fixture
def posterior() -> Posterior:
    """A record with made-up draws: what is tested is how it is kept."""
    problem, theta = small_problem(n=2, interval=0.02, fall=[True, False])
    rng = np.random.default_rng(1)
    chains = theta * (1 + 0.01 * rng.standard_normal((2, 150, len(theta))))
    r_hat, bulk, tail = diagnostics(chains)
    each = rng.standard_normal((2, 150, 2))
    return Posterior(
        problem=problem, chains=chains, log_likelihood=each, sampler="emcee", reasons=("made up",),
        mesh_error=1e-5, r_hat=r_hat, ess_bulk=bulk, ess_tail=tail,
    )  # fmt: skip


def check(data, posterior: Posterior) -> None:
    group = data["posterior"]
    assert set(group.data_vars) == {
        "tau", "tau_v", "V", "phi", "sigma0", "sigma1", "y0", "beta", "t0", "tf"
    }  # fmt: skip
    for name in ("tau", "tau_v", "V", "phi", "sigma0", "sigma1"):
        assert group[name].dims == ("chain", "draw")
    for name in ("y0", "beta", "t0", "tf"):
        assert group[name].dims == ("chain", "draw", "experiment")
    assert list(group["experiment"].values) == ["a", "b"]
    np.testing.assert_array_equal(group["tau"].values, posterior.chains[:, :, 0])
    assert group["tau"].attrs["units"] == "s" and group["beta"].attrs["units"] == "V"
    # no step down in b: tf is absent there, not invented
    assert np.isnan(group["tf"].sel(experiment="b").values).all()
    assert np.isfinite(group["tf"].sel(experiment="a").values).all()
    likelihood = data["log_likelihood"]["log_likelihood"]
    assert likelihood.dims == ("chain", "draw", "experiment")
    np.testing.assert_array_equal(likelihood.values, posterior.log_likelihood)
    assert data["posterior_predictive"]["mean_q50"].dims == ("experiment", "bin")
    predicted = data["posterior_predictive"]["mean_q50"].values
    assert np.abs(predicted - data["observed_data"]["y"].values).max() < 0.3
    assert data.attrs["sampler"] == "emcee" and data.attrs["phi_interval_s"] == 0.02
    assert json.loads(data.attrs["priors"])["phi"] == "uniform(-1, 1)"
    assert "made up" in data.attrs["reasons"]


def test_groups_variables_and_dimensions(posterior: Posterior) -> None:
    data = posterior.inference_data
    names = {
        str(name).strip("/") for name in (data.children if idata.has_data_tree() else data.groups())
    }
    assert names == set(GROUPS)
    check(data, posterior)


def test_saving_and_loading(posterior: Posterior, tmp_path) -> None:
    path = tmp_path / "posterior.nc"
    path.write_text("an older file")
    posterior.save(path)
    assert [file.name for file in tmp_path.iterdir()] == ["posterior.nc"]
    check(idata.load(path), posterior)
    path.unlink()  # loading leaves no handle behind that would hold it


def test_chains_are_read_back(posterior: Posterior, tmp_path) -> None:
    posterior.save(tmp_path / "posterior.nc")
    names, chains = load_chains(tmp_path / "posterior.nc")
    assert set(names) == set(posterior.names)
    order = [names.index(name) for name in posterior.names]
    np.testing.assert_array_equal(chains[:, :, order], posterior.chains)


def test_a_campaign_without_any_step_down_has_no_tf(posterior: Posterior) -> None:
    problem, theta = small_problem(n=1, interval=0.02, fall=False)
    chains = theta * (1 + 0.01 * np.random.default_rng(1).standard_normal((2, 100, len(theta))))
    one = np.ones(len(theta))
    bare = Posterior(problem, chains, np.zeros((2, 100, 1)), "hmc", (), 0.0, one, one, one)
    assert "tf" not in bare.inference_data["posterior"].data_vars


# --- R-hat, effective sample size and k-hat against ArviZ's own


def made_up(kind: str) -> np.ndarray:
    """(n_chain, n_draw, n_parameters) draws of several characters."""
    rng = np.random.default_rng(7)
    draws = rng.standard_normal((4, 401, 3))
    if kind in ("slow", "repeated"):
        for i in range(1, draws.shape[1]):
            draws[:, i] = 0.8 * draws[:, i - 1] + 0.6 * draws[:, i]
    if kind == "repeated":  # as a chain that rejects: equal draws share their rank
        return np.repeat(draws[:, ::3], 3, axis=1)[:, :400]
    if kind == "alternating":
        for i in range(1, draws.shape[1]):
            draws[:, i] = -0.6 * draws[:, i - 1] + 0.8 * draws[:, i]
    if kind == "apart":
        draws += 0.3 * np.arange(4)[:, None, None]
    return draws**2 if kind == "skewed" else draws


@pytest.mark.parametrize(
    "kind", ["independent", "slow", "repeated", "alternating", "apart", "skewed"]
)
def test_the_diagnostics_are_those_of_arviz(kind: str) -> None:
    import arviz
    import xarray

    chains = made_up(kind)
    data = xarray.Dataset({"x": (("chain", "draw", "parameter"), chains)})
    expected = [
        arviz.rhat(data)["x"].values,
        arviz.ess(data, method="bulk")["x"].values,
        arviz.ess(data, method="tail", prob=(0.05, 0.95))["x"].values,
    ]
    for own, theirs in zip(diagnostics(chains), expected, strict=True):
        np.testing.assert_allclose(own, theirs, rtol=1e-10)


@pytest.mark.parametrize("k", [0.2, 0.5, 0.8])
def test_pareto_k_is_that_of_arviz(k: float) -> None:
    rng = np.random.default_rng(6)
    log_weights = np.log((rng.random(4000) ** -k - 1) / k + 1)
    if idata.has_data_tree():
        from arviz_stats.base import array_stats

        weights = np.exp(log_weights - log_weights.max())
        theirs = array_stats.pareto_khat(weights[None], r_eff=1.0, tail="right")
    else:
        import arviz

        theirs = arviz.psislw(log_weights)[1]
    # ArviZ 1.x cuts the tail half a draw elsewhere
    tolerance = 0.01 if idata.has_data_tree() else 1e-9
    assert pareto_k(log_weights) == pytest.approx(float(theirs), abs=tolerance)


LIMITED = """
import resource, sys
from pathlib import Path
import numpy, xarray
from bayes_sensor.posterior.inference_data import save
draws = xarray.Dataset({"tau": (("chain", "draw"), numpy.ones((4, 20000)))})
save({"posterior": draws}, {}, Path(sys.argv[1]) / "fits.nc")
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
try:
    save({"posterior": draws}, {}, Path(sys.argv[1]) / "large.nc")
except OSError:
    print("told")
"""


def test_a_file_that_cannot_be_written_ends_no_process(tmp_path: Path) -> None:
    """HDF5 itself does, where it meets a full disk: by a signal, while it clears away."""
    pytest.importorskip("resource", reason="files are limited as on Unix")
    command = [sys.executable, "-c", LIMITED, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (0, "told\n"), done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["fits.nc"]


def _saved_size(path: str) -> int:
    import xarray

    idata.save({"posterior": xarray.Dataset({"tau": (("draw",), np.ones(9))})}, {}, Path(path))
    return Path(path).stat().st_size


@pytest.mark.filterwarnings("ignore")  # distributed warns about ports and its own shutdown
def test_a_dask_worker_writes_it_too(tmp_path: Path) -> None:
    """There xarray looks for locks at the scheduler, by the file's name."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert client.submit(_saved_size, str(tmp_path / "a.nc")).result(60) > 500
