"""Calibration: ranks, bands, coverage, and long runs that resume."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from posterior_calibration import (
    LEVELS,
    TAU_CLAIMS,
    TAU_PRIORS,
    CoverageStudy,
    Ranks,
    RankStudy,
    coverage_table,
    draw_prior,
    ranks_of,
    tau_table,
)
from scipy import stats

import bayes_sensor.checks.study_chunks as study_chunks
from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.checks.counted_coverage import binomial_interval
from bayes_sensor.checks.study_chunks import code_digest, run_chunks
from bayes_sensor.likelihood.prior_density import log_priors
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Settings

TABLES = Path(__file__).resolve().parents[2] / "paper" / "tables"


class Conjugate:
    """A normal mean with a normal prior, whose posterior is known; ``widen`` makes it wrong."""

    def __init__(self, widen: float = 1.0, shift: float = 0.0) -> None:
        self.widen, self.shift = widen, shift

    def __call__(self, i: int) -> dict[str, Any]:
        rng = np.random.default_rng([7, i])
        theta = rng.normal(0.0, 2.0, size=2)
        y = theta + rng.normal(0.0, 1.0, size=2)
        mean, sd = 0.8 * y, np.sqrt(0.8)
        draws = mean + self.shift * sd + self.widen * sd * rng.standard_normal((127, 2))
        return {"theta": theta, "ranks": ranks_of(theta, draws, 127)}


def ranks(task: Conjugate, n: int = 400) -> Ranks:
    return Ranks(("a", "b"), np.stack([task(i)["ranks"] for i in range(n)]), 127)


def test_ranks_of_a_known_posterior_are_uniform() -> None:
    found = ranks(Conjugate())
    assert (found.chi_squared()[1] > 0.01).all()
    assert (found.ecdf_p_values() > 0.01).all()
    low, high = found.ecdf_band(0.99)
    assert ((found.ecdf_difference >= low) & (found.ecdf_difference <= high)).all()


@pytest.mark.parametrize(("widen", "shift"), [(0.7, 0.0), (1.5, 0.0), (1.0, 0.4)])
def test_a_wrong_sampler_is_seen(widen: float, shift: float) -> None:
    found = ranks(Conjugate(widen, shift))
    assert (found.chi_squared()[1] < 1e-3).all()
    assert (found.ecdf_p_values() < 2e-3).all()
    low, high = found.ecdf_band()
    outside = (found.ecdf_difference < low) | (found.ecdf_difference > high)
    assert outside.any(axis=1).all()


def test_ecdf_p_values_and_band_have_their_level() -> None:
    # 300 uniform rank samples: 5 % outside a 95 % band, binomial 3 sd = 3.8 %
    rng = np.random.default_rng(5)
    names = tuple(str(i) for i in range(300))
    found = Ranks(names, rng.integers(0, 64, size=(100, 300)), 63)
    low, high = found.ecdf_band(0.95)
    outside = ((found.ecdf_difference < low) | (found.ecdf_difference > high)).any(axis=1).mean()
    assert abs(outside - 0.05) < 0.038
    p = found.ecdf_p_values()
    assert abs((p < 0.05).mean() - 0.05) < 0.038
    assert abs((p < 0.5).mean() - 0.5) < 0.09


def test_histogram_and_table() -> None:
    found = ranks(Conjugate(), 64)
    assert found.histogram(16).sum(axis=1).tolist() == [64, 64]
    assert list(found.table()["parameter"]) == ["a", "b"]
    with pytest.raises(CampaignError, match="do not divide"):
        found.histogram(10)
    with pytest.raises(CampaignError, match="ranks"):
        Ranks(("a",), np.array([[200]]), 127)
    with pytest.raises(CampaignError, match="as many draws"):
        ranks_of(np.zeros(1), np.zeros((3, 1)), 4)


def test_binomial_interval_covers() -> None:
    n, p = 50, 0.9
    k = np.arange(n + 1)
    inside = [low <= p <= high for low, high in (binomial_interval(int(v), n) for v in k)]
    assert stats.binom.pmf(k, n, p)[inside].sum() >= 0.95
    assert binomial_interval(50, 50)[1] == 1.0


# --- long runs


class Counted:
    """A task that leaves a mark for each call, and may stop half way."""

    def __init__(self, folder: Path, stop: int = 10**9) -> None:
        self.folder, self.stop = folder, stop

    def __call__(self, i: int) -> dict[str, Any]:
        if i == self.stop:
            raise KeyboardInterrupt
        (self.folder / f"call-{i}").touch()
        return {"x": np.random.default_rng([1, i]).normal(size=2), "i": float(i)}


def test_an_interrupted_run_goes_on(tmp_path: Path) -> None:
    chunks, calls = tmp_path / "chunks", tmp_path / "calls"
    calls.mkdir()
    with pytest.raises(KeyboardInterrupt):
        run_chunks(Counted(calls, stop=7), 12, chunks, "key", chunk=3)
    assert len(list(chunks.glob("chunk-*.npz"))) == 2
    for mark in calls.iterdir():
        mark.unlink()
    told: list[tuple[int, int]] = []
    found = run_chunks(
        Counted(calls), 12, chunks, "key", chunk=3, progress=lambda a, b: told.append((a, b))
    )
    assert sorted(int(p.name[5:]) for p in calls.iterdir()) == list(range(6, 12))
    assert told[0] == (6, 12) and told[-1] == (12, 12)
    whole = run_chunks(Counted(calls), 12, tmp_path / "other", "key", chunk=5)
    np.testing.assert_array_equal(found["x"], whole["x"])
    np.testing.assert_array_equal(found["i"], np.arange(12.0))


@pytest.mark.parametrize("change", ["renamed", "reshaped", "replaced"])
def test_a_part_that_was_changed_is_computed_anew(tmp_path: Path, change: str) -> None:
    chunks, calls = tmp_path / "chunks", tmp_path / "calls"
    calls.mkdir()
    whole = run_chunks(Counted(calls), 2, chunks, "key", chunk=2)
    (part,) = chunks.glob("chunk-*.npz")
    with np.load(part) as saved:
        arrays = dict(saved)
    x = arrays.pop("x")
    new = {"renamed": {"y": x}, "reshaped": {"x": x[:, None]}, "replaced": {"x": x + 1.0}}
    np.savez_compressed(part, **{**arrays, **new[change]})
    again = run_chunks(Counted(calls), 2, chunks, "key", chunk=2)
    assert set(again) == set(whole) == {"x", "i"}
    np.testing.assert_array_equal(again["x"], whole["x"])


def test_another_key_starts_again(tmp_path: Path) -> None:
    run_chunks(Counted(tmp_path), 4, tmp_path / "c", "one", chunk=2)
    for mark in tmp_path.glob("call-*"):
        mark.unlink()
    run_chunks(Counted(tmp_path), 4, tmp_path / "c", "two", chunk=2)
    assert len(list(tmp_path.glob("call-*"))) == 4


@pytest.mark.slow
def test_numbers_do_not_depend_on_jobs(tmp_path: Path) -> None:
    one = run_chunks(Conjugate(), 8, tmp_path / "one", "key", jobs=1, chunk=2)
    two = run_chunks(Conjugate(), 8, tmp_path / "two", "key", jobs=2, chunk=2)
    np.testing.assert_array_equal(one["ranks"], two["ranks"])


@pytest.mark.filterwarnings("ignore")  # distributed warns about ports and its own shutdown
def test_numbers_do_not_depend_on_a_dask_scheduler(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        far = run_chunks(
            Conjugate(), 6, tmp_path / "far", "key", chunk=2, scheduler=cluster.scheduler_address
        )
    near = run_chunks(Conjugate(), 6, tmp_path / "near", "key", chunk=2)
    np.testing.assert_array_equal(far["ranks"], near["ranks"])


# --- campaigns


def small(**changes: Prior) -> Problem:
    t = np.arange(3000) * 0.01
    experiments = tuple(
        Experiment(str(k), t, None, flow, flow / 8, 0.01, 4.0, 17.0)
        for k, flow in ((1, 60.0), (2, 120.0))
    )
    priors = {
        "tau_s": Prior("half_normal", 0.2),
        "tau_v_s": Prior("log_normal", 0.86, 0.2),
        "V_mL": Prior("log_normal", 58.0, 0.2),
        "phi": Prior("uniform", -0.3, 0.8),
        "sigma0_V": Prior("half_normal", 0.01),
        "sigma1_V": Prior("half_normal", 0.01),
    }
    for e in experiments:
        priors[f"y0_V[{e.name}]"] = Prior("normal", 0.25, 0.05)
        priors[f"beta_V[{e.name}]"] = Prior("normal", 1.9, 0.2)
        priors[f"t0_s[{e.name}]"] = Prior("uniform", 4.0, 5.0)
        priors[f"tf_s[{e.name}]"] = Prior("uniform", 17.0, 18.0)
    return Problem(
        Campaign("small", experiments, sensor_is="faster"), given_priors={**priors, **changes}
    )


def test_prior_draws_are_inside_the_prior() -> None:
    problem = small(tau_s=Prior("half_normal", 2.0))
    rng = np.random.default_rng(1)
    drawn = np.array([draw_prior(problem, rng) for _ in range(60)])
    assert np.isfinite(log_priors(problem, drawn)).all()
    assert (drawn[:, 0] <= drawn[:, 1]).all()
    with pytest.raises(CampaignError, match="flat"):
        draw_prior(small(phi=Prior("flat")), rng)


def test_rank_study_is_repeatable_and_says_which_sampler() -> None:
    settings = Settings(n_chains=2, n_draws=300, target_ess=50, max_draws=900, max_steps=300)
    study = RankStudy(small(), settings=settings, n_ranks=31, seed=3)
    first, again = study(0), study(0)
    np.testing.assert_array_equal(first["ranks"], again["ranks"])
    assert first["ranks"].shape == (len(study.problem.layout),)
    assert first["sampler"] in (0.0, 1.0, 2.0)
    assert study.key != RankStudy(small(), settings=settings, n_ranks=31, seed=4).key


def test_coverage_study_rows() -> None:
    problem = small()
    theta = draw_prior(problem, np.random.default_rng(2))
    settings = Settings(n_chains=2, n_draws=300, target_ess=50, max_draws=900, max_steps=300)
    study = CoverageStudy(problem, theta, settings=settings, seed=3)
    results = {k: np.stack([np.asarray(v)] * 2) for k, v in study(0).items()}
    table = coverage_table(problem.layout.names, theta, results)
    assert len(table) == len(problem.layout) * len(LEVELS)
    assert (np.diff(results["high"][0] - results["low"][0], axis=0) > 0).all()
    rows = tau_table(float(theta[0]), results)
    assert len(rows) == len(TAU_PRIORS) * len(TAU_CLAIMS)
    assert (rows["covered"] + rows["missed_below"] + rows["missed_above"] == rows["n"]).all()


# --- the committed tables


def committed(name: str) -> pd.DataFrame:
    if not (TABLES / name).exists():
        pytest.skip(f"{name} is not in this checkout")
    return pd.read_csv(TABLES / name)


@pytest.mark.tables
@pytest.mark.parametrize("name", ["sbc", "sbc_short"])
def test_committed_ranks_give_the_committed_table(name: str) -> None:
    raw, table = committed(f"{name}_ranks.csv"), committed(f"{name}.csv")
    found = Ranks(tuple(raw.columns), raw.to_numpy(), int(table["n_ranks"].iloc[0])).table()
    assert len(raw) >= 500 and (table["n"] == len(raw)).all()
    assert list(found["parameter"]) == list(table["parameter"])
    for column in ("mean_rank", "chi2", "p_chi2", "largest_ecdf_difference", "p_ecdf"):
        # four digits are written
        np.testing.assert_allclose(found[column], table[column], rtol=1e-3)
    samplers = committed(f"{name}_samplers.csv")
    assert samplers.loc[samplers["sampler"] != "failed", "n"].sum() == len(raw)


@pytest.mark.tables
def test_committed_tau_table_holds_together() -> None:
    table = committed("coverage_tau.csv")
    assert len(table) == 3 * len(TAU_PRIORS) * len(TAU_CLAIMS)
    assert (table["n"] >= 100).all()
    assert (table["covered"] + table["missed_below"] + table["missed_above"] == table["n"]).all()
    check_binomial(table)
    default = table[table["prior"] == "half_normal"].set_index(["claim", "tau_ms"])["coverage"]
    # the promise of the default prior near tau's boundary: at least 93 %
    assert (default["interval 95 %"].loc[[20.0, 48.1]] >= 0.93).all()
    assert (default["highest density 95 %"] >= 0.93).all()
    # missed at 5 ms by the equal-tailed interval, whose lower end lies above the truth too often
    assert default["interval 95 %", 5.0] >= 0.90
    assert (default["upper limit 95 %"] >= 0.95).all()


def check_binomial(table: pd.DataFrame) -> None:
    np.testing.assert_allclose(table["coverage"], table["covered"] / table["n"], rtol=1e-4)
    for _, row in table.iloc[::7].iterrows():
        low, high = binomial_interval(int(row["covered"]), int(row["n"]))
        assert (row["coverage_lo95"], row["coverage_hi95"]) == pytest.approx(
            (low, high), rel=1e-4, abs=1e-9
        )
        assert row["agrees"] == int(low <= row["nominal"] <= high)


# --------------------------------------------------------------------------- parts of other code


class Squares:
    """A task that counts its calls."""

    calls = 0

    def __call__(self, i: int) -> dict[str, Any]:
        Squares.calls += 1
        return {"x": i * i}


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of two sources that stands for this one, in a process that has run nothing."""
    folder = tmp_path / "package"
    for room in ("gap", "figures"):
        (folder / room).mkdir(parents=True)
        (folder / room / "one.py").write_text("A = 1\n")
    monkeypatch.setattr(study_chunks, "PACKAGE", folder)
    monkeypatch.setattr(study_chunks, "CODE_AT_START", {})
    monkeypatch.setattr(Squares, "calls", 0)
    return folder


def test_parts_of_other_code_are_not_used(
    tmp_path: Path, package: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    def run() -> int:
        """How many results were computed."""
        monkeypatch.setattr(study_chunks, "CODE_AT_START", {})  # as a new process would begin
        before = Squares.calls
        found = run_chunks(Squares(), 4, tmp_path / "parts", "key", chunk=2)
        np.testing.assert_array_equal(found["x"], np.arange(4) ** 2)
        return Squares.calls - before

    assert (run(), run()) == (4, 0) and not caplog.records
    digest = code_digest(Squares())
    (package / "figures" / "one.py").write_text("A = 2\n")  # no number depends on it
    (package / "gap" / ".#one.py").symlink_to("nobody@nowhere")  # an editor's lock
    assert code_digest(Squares()) == digest and run() == 0
    (package / "gap" / "one.py").write_text("A = 2\n")
    assert code_digest(Squares()) != digest and run() == 4
    (said,) = (record.getMessage() for record in caplog.records)
    assert "2 finished parts are of other code and are not used" in said
    (package / "gap" / "one.py").rename(package / "gap" / "two.py")
    assert run() == 4


def test_a_digest_has_the_source_of_the_task_as_well(
    package: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = code_digest(Squares())
    monkeypatch.setattr(Squares, "__module__", "bayes_sensor.checks.study_chunks")
    assert code_digest(Squares()) != digest


def test_code_changed_while_it_ran_is_told_and_its_parts_are_not_used(
    tmp_path: Path, package: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    def change(done: int, n: int) -> None:
        if done == n:
            (package / "gap" / "one.py").write_text("A = 3\n")

    run_chunks(Squares(), 2, tmp_path / "a", "key", progress=change)
    (said,) = (record.getMessage() for record in caplog.records)
    assert "the code was changed while this ran" in said
    run_chunks(Squares(), 2, tmp_path / "b", "key")  # by what this process has loaded before
    monkeypatch.setattr(study_chunks, "CODE_AT_START", {})
    for folder in "ab":
        run_chunks(Squares(), 2, tmp_path / folder, "key")
    assert Squares.calls == 8
