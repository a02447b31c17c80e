"""Speed of likelihood and posterior, side by side in one run: ``make bench``.

Everything at the paper's size (the bundled campaign: 7 experiments, 840 000 samples, 34
parameters) on one core.  The methods take turns within every round, so that a slow spell of the
machine hits all of them; ratios are formed within rounds.  Times are CPU times, which are wall
times on a core of one's own; where a goal is about waiting, the wall time stands beside it.
Medians with the smallest and largest round.  Writes paper/tables/benchmark.csv.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numba import njit

from bayes_sensor.campaign import Campaign
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.density import experiment_log_likelihood, grid_response, simulate
from bayes_sensor.likelihood.density import log_likelihood as full_log_likelihood
from bayes_sensor.likelihood.mesh import Compressed, compress
from bayes_sensor.likelihood.prior_density import log_priors
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Posterior, Settings, sample_posterior
from bayes_sensor.posterior.laplace import approximate
from bayes_sensor.rig.cascade import time_constants

ROOT = Path(__file__).resolve().parent.parent.parent
CAMPAIGN = ROOT / "data" / "reference" / "campaign.toml"
TABLE = ROOT / "paper" / "tables" / "benchmark.csv"


@dataclass(frozen=True)
class Row:
    """One measured quantity beside its goal."""

    what: str
    unit: str
    values: tuple[float, ...]
    most: float | None = None
    """goal: at most this"""
    least: float | None = None
    """goal: at least this"""
    note: str = ""

    @property
    def median(self) -> float:
        """Middle of the rounds."""
        return float(np.median(self.values))

    @property
    def goal(self) -> str:
        """The goal as text."""
        if self.most is not None:
            return f"<= {self.most:g}"
        return f">= {self.least:g}" if self.least is not None else ""

    @property
    def verdict(self) -> str:
        """met, or missed and by what factor."""
        if self.most is not None:
            factor = self.median / self.most
        elif self.least is not None:
            factor = self.least / self.median
        else:
            return ""
        return "met" if factor <= 1.0 else f"missed by {factor:.2f}x"


# --------------------------------------------------------------------------- rivals


def numpy_log_likelihood(problem: Problem, theta: np.ndarray) -> float:
    """The likelihood as one writes it in numpy: partial fractions, arrays, no loops."""
    layout, total = problem.layout, 0.0
    for k, e in enumerate(problem.campaign):
        y0, beta, t0, tf = theta[layout.local[k]]
        phi, sigma0, sigma1 = theta[layout.noise[k]]
        taus = time_constants(theta[0], theta[1], theta[2], e.total_flow)
        x = np.zeros(len(e.t))
        for edge, sign in ((t0, 1.0), (tf, -1.0)):
            s = np.maximum(e.t - edge, 0.0)
            rest = np.zeros(len(s))
            for j in range(3):
                others = [taus[j] - taus[m] for m in range(3) if m != j]
                rest += taus[j] ** 2 / (others[0] * others[1]) * np.exp(-s / taus[j])
            x += sign * (1.0 - rest)
        s2 = sigma0**2 + sigma1**2 * problem.noise.weight(problem.campaign, e) * np.maximum(x, 0.0)
        z = (e.values - y0 - beta * x) / np.sqrt(s2)
        innovation = z[1:] - phi * z[:-1]
        total -= 0.5 * (
            np.log(s2).sum()
            + z[0] ** 2
            + innovation @ innovation / (1 - phi**2)
            + (len(z) - 1) * np.log(1 - phi**2)
            + len(z) * np.log(2 * np.pi)
        )
    return float(total)


@njit(cache=True)
def euler_model(t, h, y0, beta, t0, tf, a_v, a_m, a_s, out):  # pragma: no cover - compiled
    """Forward Euler of the three lags, as a user would compile it."""
    x1 = x2 = x3 = 0.0
    for i in range(len(t)):
        out[i] = y0 + beta * x3
        u = 1.0 if t0 <= t[i] < tf else 0.0
        d1, d2, d3 = a_v * (u - x1), a_m * (x1 - x2), a_s * (x2 - x3)
        x1 += h * d1
        x2 += h * d2
        x3 += h * d3


def pints_log_likelihoods(problem: Problem) -> dict[str, Callable[[np.ndarray], float]] | None:
    """PINTS AR1LogLikelihood on the pooled series, with two numba models; None without PINTS.

    PINTS knows one AR(1) law for the whole series and no growing variance: it does less.
    """
    try:
        import pints
    except ImportError:
        print("PINTS is not installed: its rows are skipped; for them run "
              "pip install 'bayes-sensor[bench]'", file=sys.stderr)  # fmt: skip
        return None
    campaign, layout = problem.campaign, problem.layout
    n_mean = layout.n_mean

    class Model(pints.ForwardModel):
        """All experiments end to end."""

        def __init__(self, closed: bool) -> None:
            super().__init__()
            self.closed = closed

        def n_parameters(self) -> int:
            return n_mean

        def simulate(self, parameters: Any, times: Any) -> np.ndarray:
            theta = np.asarray(parameters)
            means = np.empty(len(times))
            i = 0
            for k, e in enumerate(campaign):
                y0, beta, t0, tf = theta[layout.local[k]]
                n = len(e.t)
                if self.closed:
                    taus = time_constants(theta[0], theta[1], theta[2], e.total_flow)
                    means[i : i + n] = y0 + beta * grid_response(e, taus, t0, tf)
                else:
                    euler_model(
                        e.t, e.interval, y0, beta, t0, tf, 1.0 / theta[1],
                        e.total_flow / theta[2], 1.0 / theta[0], means[i : i + n],
                    )  # fmt: skip
                i += n
            return means

    values = np.concatenate([e.values for e in campaign])
    times = np.arange(len(values)) * campaign.reference_interval
    found = {}
    for name, closed in (("Euler", False), ("closed form", True)):
        likelihood = pints.AR1LogLikelihood(pints.SingleOutputProblem(Model(closed), times, values))

        def call(theta: np.ndarray, likelihood: Any = likelihood) -> float:
            phi, sigma0, sigma1 = theta[layout.noise[0]]
            total = float(np.hypot(sigma0, sigma1))
            return float(likelihood(np.concatenate([theta[:n_mean], [phi, total]])))

        found[name] = call
    return found


# --------------------------------------------------------------------------- measuring


def rounds(
    calls: dict[str, tuple[Callable[[np.ndarray], Any], int]], thetas: np.ndarray, n: int
) -> dict[str, np.ndarray]:
    """CPU seconds a call (n,) of every method, all in every round; each warmed up once."""
    for call, _ in calls.values():
        call(thetas[0])
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(n):
        for name, (call, repeats) in calls.items():
            begin = time.process_time()
            for i in range(repeats):
                call(thetas[i % len(thetas)])
            times[name].append((time.process_time() - begin) / repeats)
    return {name: np.array(values) for name, values in times.items()}


def seconds(call: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds that a call takes, and what it returns."""
    begin = time.process_time()
    result = call()
    return time.process_time() - begin, result


# --------------------------------------------------------------------------- the parts


def evaluations(
    problem: Problem, posterior: Posterior, compressed: Compressed, n: int
) -> list[Row]:
    """One evaluation by every method."""
    thetas = posterior.draws[:: len(posterior.draws) // 400][:400].copy()
    free = compressed.problem
    by_name = cycle([problem.layout.nested(theta) for theta in thetas])
    calls: dict[str, tuple[Callable[[np.ndarray], Any], int]] = {
        "full pass, numba": (lambda th: full_log_likelihood(free, th), 10),
        "numpy closed form": (lambda th: numpy_log_likelihood(free, th), 1),
        "compressed value": (compressed.log_likelihood, 400),
        "compressed value and gradient": (compressed.value_and_gradient, 400),
        "compressed marginal (y0, beta integrated out)": (compressed.marginal, 400),
        "compressed value, parameters by name": (
            lambda _: compressed.log_likelihood(next(by_name)), 100
        ),
    }  # fmt: skip
    rivals = pints_log_likelihoods(problem)
    for name, call in (rivals or {}).items():
        calls[f"PINTS AR1LogLikelihood, numba {name}"] = (call, 4)
    agree = abs(numpy_log_likelihood(problem, thetas[0]) - full_log_likelihood(problem, thetas[0]))
    assert agree < 1e-5, f"the numpy rival disagrees by {agree}"
    times = rounds(calls, thetas, n)
    value = times["compressed value"]
    rows = []
    goals = {"compressed value": 50.0, "compressed value and gradient": 70.0}
    for name, spent in times.items():
        rows.append(Row(name, "us", tuple(1e6 * spent), most=goals.get(name)))
    batch = np.ascontiguousarray(thetas)
    spent = [seconds(lambda: compressed.log_likelihoods(batch))[0] / len(batch) for _ in range(n)]
    rows.append(Row("compressed values, 400 at once", "us", tuple(1e6 * np.array(spent))))
    gradient = times["compressed value and gradient"]
    rows.append(Row("gradient over value", "ratio", tuple(gradient / value), most=1.5))
    full = times["full pass, numba"]
    rows.append(Row("own full pass over value", "ratio", tuple(full / value), least=30.0))
    for name in times:
        if name.startswith("PINTS"):
            note = "does less: one AR(1) law, constant variance"
            goal = 80.0 if "Euler" in name else None
            rows.append(Row(f"{name} over value", "ratio", tuple(times[name] / value),
                            least=goal, note=note))  # fmt: skip
            rows.append(Row(f"{name} over own full pass", "ratio", tuple(times[name] / full),
                            note="like for like: both visit every sample"))  # fmt: skip
            rows.append(Row(f"{name} over value, parameters by name", "ratio",
                            tuple(times[name] / times["compressed value, parameters by name"]),
                            note="through the public interface, names looked up"))  # fmt: skip
    rows.append(
        Row("numpy closed form over value", "ratio", tuple(times["numpy closed form"] / value))
    )
    built = [seconds(lambda: approximate(problem, thetas[0]))[0] for _ in range(5)]
    rows.append(Row("set-up of the compressed form", "s", tuple(built),
                    note="once a campaign: Laplace approximation and mesh"))  # fmt: skip
    error = compressed.error(thetas[:50])
    rows.append(Row("largest error in log L, 50 draws", "1", (error,), most=1e-3))
    return rows


def raw_to_posterior(campaign: Campaign, names: dict[str, int]) -> list[Row]:
    """Arrays in memory to a converged posterior, by every sampler."""

    def fresh() -> Problem:
        # nothing that an earlier run has cached travels along
        arrays = tuple(replace(e, y=e.values.copy()) for e in campaign)
        return Problem(replace(campaign, experiments=arrays))

    goals = {"independence": 0.5, "emcee": 10.0}
    rows = []
    settings = Settings(target_ess=1000.0)
    for sampler, n in names.items():
        quick, whole, wall, fits, ess, r_hat, used = [], [], [], [], [], [], set()
        for i in range(n):

            def run(i: int = i, sampler: str = sampler) -> tuple[float, Posterior]:
                problem = fresh()
                spent, fit = seconds(lambda: fit_least_squares(problem, swarms=1, euler=False))
                return spent, sample_posterior(problem, fit, i, sampler, settings)

            begin = time.perf_counter()
            total, (fitting, posterior) = seconds(run)
            wall.append(time.perf_counter() - begin)
            whole.append(total)
            quick.append(total - fitting)
            fits.append(fitting)
            ess.append(float(np.nanmin(posterior.ess_bulk)))
            r_hat.append(float(np.nanmax(posterior.r_hat)))
            used.add(posterior.sampler)
        note = f"used {', '.join(sorted(used))}; smallest bulk ESS {min(ess):.0f}, "
        note += f"largest R-hat {max(r_hat):.4f}"
        goal = goals.get(sampler)
        rows.append(Row(f"arrays and a fit to posterior, {sampler}", "s", tuple(quick), most=goal,
                        note=note))  # fmt: skip
        rows.append(Row(f"arrays to posterior with one-swarm fit, {sampler}", "s", tuple(whole),
                        most=goal, note=f"of which the fit {np.median(fits):.2f} s"))  # fmt: skip
        rows.append(Row(f"arrays to posterior with one-swarm fit, {sampler}, wall", "s",
                        tuple(wall), most=goal))  # fmt: skip
    return rows


def by_hand(
    problem: Problem,
    posterior: Posterior,
    compressed: Compressed,
    steps: int,
    pints_us: float | None,
) -> list[Row]:
    """emcee as a user would write it: all 34 parameters, stretch move, full pass.

    Seconds a step are measured; how many steps ESS 1000 takes follows from the autocorrelation
    time of the same ensemble run on the compressed likelihood, started in the posterior (so no
    burn-in is charged).
    """
    import emcee

    free = Coordinates(problem).free
    n_walkers = 2 * len(free) + 4
    start = posterior.draws[:: len(posterior.draws) // n_walkers][:n_walkers][:, free]
    base = posterior.draws[0].copy()

    def vector(point: np.ndarray) -> np.ndarray:
        theta = base.copy()
        theta[free] = point
        return theta

    def slow(point: np.ndarray) -> float:
        theta = vector(point)
        prior = log_priors(problem, theta)[0]
        if not np.isfinite(prior):
            return -np.inf
        each = range(len(problem.campaign))
        return float(prior + sum(experiment_log_likelihood(problem, theta, k) for k in each))

    def fast(points: np.ndarray) -> np.ndarray:
        thetas = np.tile(base, (len(points), 1))
        thetas[:, free] = points
        values = log_priors(problem, thetas)
        good = np.isfinite(values)
        if good.any():
            values[good] += compressed.log_likelihoods(thetas[good]).sum(axis=1)
        return values

    np.random.seed(1)  # noqa: NPY002 - emcee takes its first state from the global generator
    sampler = emcee.EnsembleSampler(n_walkers, len(free), slow)
    state = sampler.run_mcmc(start, 1)
    spent = []
    for _ in range(5):
        each, state = seconds(partial(sampler.run_mcmc, state, 2))
        spent.append(0.5 * each)
    step = np.array(spent)
    chain = emcee.EnsembleSampler(n_walkers, len(free), fast, vectorize=True)
    chain.run_mcmc(start, steps)
    tau = emcee.autocorr.integrated_time(chain.get_chain(discard=steps // 10), tol=0, quiet=True)
    worst = float(np.nanmax(tau))
    need = 1000.0 * worst / n_walkers
    note = (
        f"extrapolated: autocorrelation time {worst:.0f} steps of {n_walkers} walkers "
        f"(measured over {steps}), {need:.0f} steps without burn-in, "
        f"against {50 * worst:.0f} that emcee's own rule of 50 autocorrelation times asks for"
    )
    rows = [
        Row("emcee by hand, 34-d, full pass: one step", "s", tuple(step)),
        Row("emcee by hand to ESS 1000", "s", tuple(step * need), note=note),
    ]
    if pints_us is not None:
        hours = pints_us * 1e-6 * n_walkers * need
        rows.append(Row("the same with PINTS AR1LogLikelihood, numba Euler", "s", (hours,),
                        note="extrapolated from one evaluation"))  # fmt: skip
    return rows


def scaling(problem: Problem, truth: np.ndarray, posterior: Posterior, n: int) -> list[Row]:
    """Ten times the sampling rate, and fifty experiments."""
    design = problem.campaign
    finer = tuple(
        replace(e, t=e.t[0] + 0.1 * e.interval * np.arange(10 * len(e.t)), y=None, drive=None,
                mask=None, interval=0.1 * e.interval)
        for e in design
    )  # fmt: skip
    theta = truth.copy()
    # the same noise seen ten times as often: phi per sample is its tenth root
    theta[problem.layout.noise[0, 0]] **= 0.1
    fine = simulate(replace(design, experiments=finer), theta, seed=2)
    fine_problem = Problem(fine, given_priors=dict(problem.priors))
    spent_fine, fine_mesh = seconds(lambda: approximate(fine_problem, theta)[1])
    n_many = 50
    many_experiments, local = [], {}
    for i in range(n_many):
        e = design.experiments[i % len(design)]
        many_experiments.append(replace(e, name=str(i + 1)))
        values = dict(zip(("y0_V", "beta_V", "t0_s", "tf_s"),
                          truth[problem.layout.local[i % len(design)]]))  # fmt: skip
        local[str(i + 1)] = {name: float(v) for name, v in values.items()}
    nested = problem.layout.nested(truth)
    nested["experiments"] = local
    many = Problem(replace(design, experiments=tuple(many_experiments)))
    many_theta = many.layout.flat(nested)
    many = Problem(simulate(many, many_theta, seed=3))
    spent_many, many_mesh = seconds(lambda: approximate(many, many_theta)[1])
    base_problem = Problem(simulate(problem, truth, seed=2))
    base_spent, mesh = seconds(lambda: approximate(base_problem, truth)[1])
    times = rounds(
        {
            "base": (lambda _: mesh.log_likelihood(truth), 400),
            "fine": (lambda _: fine_mesh.log_likelihood(theta), 400),
            "many": (lambda _: many_mesh.log_likelihood(many_theta), 100),
        },
        posterior.draws[:1],
        n,
    )
    base = times["base"]
    assert fine_mesh.n_full_passes + many_mesh.n_full_passes + mesh.n_full_passes < 100
    return [
        Row("value at 10 times the sampling rate, over 1 kHz", "ratio",
            tuple(times["fine"] / base), most=1.3,
            note=f"{fine_mesh.n_nodes} nodes against {mesh.n_nodes}; Laplace and mesh "
            f"{spent_fine:.2f} s against {base_spent:.2f} s"),
        Row("value of 50 experiments, over 7", "ratio", tuple(times["many"] / base),
            most=round(n_many / len(design), 2),
            note=f"{many_mesh.n_nodes} nodes; Laplace and mesh {spent_many:.2f} s"),
    ]  # fmt: skip


# --------------------------------------------------------------------------- output


def table(rows: list[Row]) -> pd.DataFrame:
    """The rows as they are written."""
    return pd.DataFrame(
        [
            {
                "what": r.what, "unit": r.unit, "median": r.median, "min": min(r.values),
                "max": max(r.values), "n": len(r.values), "goal": r.goal, "verdict": r.verdict,
                "note": r.note,
            }
            for r in rows
        ]
    )  # fmt: skip


def show(rows: list[Row], title: str = "at the paper's size, CPU time on one core") -> None:
    """Print the table."""
    from rich.console import Console
    from rich.table import Table

    printed = Table(title=f"bayes_sensor {title}")
    for column in ("", "median", "min .. max", "unit", "goal", "verdict"):
        printed.add_column(column, justify="left" if column in ("", "verdict") else "right")
    for r in rows:
        printed.add_row(
            r.what, f"{r.median:.4g}", f"{min(r.values):.4g} .. {max(r.values):.4g}", r.unit,
            r.goal, r.verdict,
        )  # fmt: skip
    console = Console(width=None if sys.stdout.isatty() else 150)
    console.print(printed)
    for r in rows:
        if r.note:
            console.print(f"{r.what}: {r.note}")


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few rounds, nothing written")
    quick = parser.parse_args().quick
    load = [os.getloadavg()[0]]
    campaign = read_campaign(CAMPAIGN)
    problem = Problem(campaign)
    fit = fit_least_squares(problem)
    posterior = sample_posterior(problem, fit, sampler="independence")
    _, compressed = approximate(problem, fit.theta_hat)
    compress(problem, fit.theta_hat)
    print("one evaluation ..", file=sys.stderr, flush=True)
    rows = evaluations(problem, posterior, compressed, 3 if quick else 15)
    pints = [r.median for r in rows if r.what == "PINTS AR1LogLikelihood, numba Euler"]
    print("posteriors ..", file=sys.stderr, flush=True)
    rows += raw_to_posterior(
        campaign, {"independence": 1} if quick else {"independence": 7, "hmc": 3, "emcee": 3}
    )
    print("scaling ..", file=sys.stderr, flush=True)
    rows += scaling(problem, posterior.draws.mean(axis=0), posterior, 3 if quick else 15)
    print("emcee by hand ..", file=sys.stderr, flush=True)
    rows += by_hand(
        problem, posterior, compressed, 300 if quick else 6000, pints[0] if pints else None
    )
    load.append(os.getloadavg()[0])
    note = f"{os.cpu_count()} cores; before and after: wall times want less than one a core"
    rows.append(Row("load average of the machine", "1", tuple(load), note=note))
    show(rows)
    if not quick:
        TABLE.parent.mkdir(parents=True, exist_ok=True)
        table(rows).to_csv(TABLE, index=False, float_format="%.4g")
        print(f"written: {TABLE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
