"""Compiled code against the same code run by Python: numbers, and no write past an array's end.

Compiled code reads and writes past the end of an array without a word, and no tracer sees into
it.  Here everything that is compiled runs on very small data, once compiled and once with
``NUMBA_DISABLE_JIT=1``, where leaving an array is an error.
"""

import contextlib
import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

SMALL = """
import numpy as np
from dataclasses import replace
from types import SimpleNamespace
from tests.support.campaigns import small_problem
from bayes_sensor.likelihood.noise import Noise
np.set_printoptions(threshold=10**6, precision=17, linewidth=10**6)
def say(*values):
    for value in values:
        print(*np.ravel(value))
"""

PARTS = {
    "model": """
from bayes_sensor.rig.cascade import cascade_response, cascade_sensitivities, euler_response
from bayes_sensor.rig.chain import impulse_response, step_response
t = np.concatenate([np.linspace(0.0, 3.0, 40), [60.0]])
for taus in ([0.8, 0.4, 0.05], [0.5, 0.5, 0.5], [0.5, 0.45, 0.4], [0.3, 0.3 + 1e-9, 0.02]):
    say(cascade_response(t, taus, 0.3, 1.1), cascade_sensitivities(t, taus, 0.3, 1.1))
    say(euler_response(t, 0.01, taus, 0.3, 1.1))
    rates = np.sort(1.0 / np.array(taus))
    say([(step_response(s, rates), impulse_response(s, rates)) for s in (-1.0, 0.0, 0.2)])
from bayes_sensor.rig.chain import chain_response, lag_sensitivities, switch_sensitivities
from bayes_sensor.rig.programme import Programme, RecordedInput
grid = 0.1 * np.arange(30.0)
switches = Programme.pulses([0.3, 1.32], [1.1, 2.0])
recorded = RecordedInput(grid, np.sin(grid))
for taus in ([0.8], [0.5, 0.5], [0.3, 0.3 + 1e-9, 0.02, 2.0]):
    for interval in (None, 0.1):
        say(chain_response(grid, taus, switches.drive, interval))
        say(lag_sensitivities(grid, taus, switches.derivative, interval))
        say(switch_sensitivities(grid, taus, switches.times, switches.heights, interval))
        for delay in (-0.5, 0.03, 1.0, 9.0):
            later = recorded.later(delay)
            say(chain_response(grid, taus, later.drive, interval))
            say(lag_sensitivities(grid, taus, later.derivative, interval))
""",
    "likelihood": """
from bayes_sensor.likelihood.density import log_likelihood
from bayes_sensor.likelihood.prior_density import log_prior, log_prior_derivatives
from bayes_sensor.likelihood.priors import Prior
problem, theta = small_problem(n=2, interval=0.05, masked=[(3.0, 3.5)])
say(log_likelihood(problem, theta), log_prior(problem, theta))
laws = [Prior("normal", 0.3, 0.2), Prior("half_normal", 0.3, 0.0), Prior("log_normal", 0.3, 0.5),
        Prior("uniform", 0.1, 0.9), Prior("log_uniform", 0.1, 0.9)]
for law in laws:
    other = replace(problem, given_priors={"tau_v_s": law})
    say(log_prior(other, theta), *log_prior_derivatives(other, theta))
    for tau_v in (-0.1, 0.05, 2.0):
        moved = theta.copy()
        moved[1] = tau_v
        say(log_prior(other, moved))
""",
    "compression": """
from bayes_sensor.likelihood.mesh import compress
designs = [dict(phi=0.5, masked=[(3.0, 3.5), (6.0, 6.1)]), dict(phi=-0.4, masked=[(3.0, 3.5)]),
           dict(phi=0.5, fall=[True, False], interval=[0.05, 0.1]), dict(phi=0.5, tau=0.2999999)]
for design in designs:
    problem, theta = small_problem(n=2, **{"interval": 0.05, **design})
    mesh = compress(problem, theta)
    say(mesh.log_likelihood(theta), mesh.gradient(theta), mesh.information(theta))
    say(*mesh.marginals(theta[None]))
    gone = theta.copy()
    gone[0] = -1.0
    say(mesh.log_likelihoods(np.stack([theta, gone])))
problem, theta = small_problem(n=2, interval=0.05, noise=Noise(variance="constant"))
say(compress(problem, theta).gradient(theta))
quick = theta.copy()
quick[0] = 1e-4
say(compress(problem, quick).gradient(quick))
from bayes_sensor.diagnosis.effects.effect_model import with_effects
other = with_effects(small_problem(n=1, interval=0.05)[0], ["optical_nonlinearity"])
theta = np.concatenate([small_problem(n=1, interval=0.05)[1], [0.05] * len(other.layout.extra)])
say(compress(other, theta).log_likelihood(theta))
""",
    "bounds": """
from bayes_sensor.bounds.methods.block_bootstrap import resample_and_refit
from bayes_sensor.bounds.cramer_rao import cramer_rao
from bayes_sensor.bounds.context import Evidence
problem, theta = small_problem(n=2, interval=0.05, masked=[(3.0, 3.5)], fall=[True, False])
fit = SimpleNamespace(names=problem.layout.names, theta_hat=theta, rms=0.03)
from bayes_sensor.bounds.gaussian_intervals import switch_quantiles
from bayes_sensor.likelihood.mesh import mean_derivatives
say(cramer_rao(problem, theta).cov)
say(*(mean_derivatives(problem, theta, k, e.t[::20])[3] for k, e in enumerate(problem.campaign)))
close = theta.copy()
close[0] = close[1] - 1e-9
say(mean_derivatives(problem, close, 0, problem.campaign.experiments[0].t[::20], 1.0)[3])
say(*switch_quantiles(2.0, 0.01, 0.02, 1e-4, 5e-5, np.array([1.0, 2.0])))
for whitened in (True, False):
    bounded, free, details = resample_and_refit(Evidence(problem, fit), 3, whitened)
    say(bounded, free)
""",
    "simulator": """
from bayes_sensor.blind_check.simulator.causes import CAUSES
from bayes_sensor.blind_check.simulator.draw import draw_case
from bayes_sensor.blind_check.simulator.simulated_campaign import clean_signals
for seed, (name, cause) in enumerate(sorted(CAUSES.items())):
    case = draw_case(seed, {name: cause.highest}, size="small")
    case = replace(case, steps=case.steps[:1])
    clean = clean_signals(case, {s.name: np.linspace(0.0, s.duration, 25) for s in case.steps})
    say(*clean.values())
""",
    "squares": """
from bayes_sensor.diagnosis.evidence.block_least_squares import (
    broyden_update, normal_equations, whiten,
)
rng = np.random.RandomState(2)
ends, places = np.array([0, 3, 5]), np.array([[0, 1, 2], [0, 3, -1]])
factors, values = rng.normal(size=13), rng.normal(size=(5, 3))
say(whiten(factors, ends, values), whiten(factors, ends, values[:, 0].copy()))
values[3:, 2] = 0.0
say(*normal_equations(values, rng.normal(size=5), ends, places, 4))
broyden_update(values, rng.normal(size=5), rng.normal(size=4), np.ones(4), ends, places)
say(values)
""",
    "rig": """
from bayes_sensor.diagnosis import CATALOGUE
from bayes_sensor.diagnosis.effects.effect_model import with_effects
from bayes_sensor.diagnosis.effects.rig_view import coating_modes
from bayes_sensor.rig.imperfections import FIRST, INDEX, settings_vector
from bayes_sensor.rig.perturbed import rig_means
times = np.sort(np.random.default_rng(1).uniform(0.0, 20.0, 24))
first = [0.05, 0.8, 0.6, 0.1, 1.5, 2.0, 9.0, 0.3, 0.0, 10.0]
neutral = np.concatenate([first, settings_vector({})])
rigs = [neutral, *(neutral.copy() for _ in range(4))]
for rig, (name, value) in zip(rigs[1:], [("late_share", 0.2), ("release_ratio", 1.5)]):
    rig[FIRST + INDEX[name]] = value
rigs[3][6] = 1e30
rigs[4][5] = 30.0
bins = times[::3] - 0.01, times[2::3] + 0.01
weights, starts = np.full(24, 1.0 / 3.0), np.arange(0, 24, 3)
twice = np.concatenate([times, times]), np.concatenate([weights, weights]), np.tile(starts, 2)
ends = np.array([0, 24, 48]), np.array([0, 8, 16])
twice = (*twice, *(np.tile(b, 2) for b in bins))
say(rig_means(*twice, *ends, np.stack(rigs[:2]), np.arange(3), *coating_modes()))
moved = np.stack([neutral, *rigs, *rigs[:3]]), np.array([0, 6, 9])
say(rig_means(*twice, *ends, *moved, *coating_modes()))
for name, effect in CATALOGUE.items():
    for form in effect.forms:
        text = f"{name}:{form.name}" if form.name else name
        problem, theta = small_problem(n=1, interval=0.5)
        other = with_effects(problem, [text])
        strengths = [effect.plausible.get(key.split("[")[0], 0.2) for key in other.layout.extra]
        experiment = other.campaign.experiments[0]
        full = np.concatenate([theta, strengths])
        say(*other.model.mean_and_response(experiment.t, full, other.layout, experiment))
""",
    "restoration": """
from bayes_sensor.restoration.state_space import Model, make_samples
rng = np.random.default_rng(1)
for t in (np.arange(40.0), np.cumsum(rng.choice([0.1, 1.0, 30.0], 40))):
    y = np.cumsum(rng.standard_normal(40))
    y[[5, 6, 20]] = np.nan
    samples = make_samples(t, y, 4.0)[0]
    held = samples.with_input(np.array([0, 20, 39]), np.array([0.1, 0.2, -0.3]), np.full(3, 0.4))
    for order, lags in ((1, (2.0,)), (2, (2.0, 2.0, 0.01))):
        model = Model(order, 1.0, 5.0, lags, 0.1, 0.5, 1.0)
        say(samples.log_likelihood(model), *samples.smooth(model), *held.smooth(model))
""",
    "mixing": """
from bayes_sensor.posterior.r_hat import diagnostics
say(*diagnostics(np.random.default_rng(1).standard_normal((2, 40, 9))))
""",
}


END = "END OF A PART"


def in_python() -> dict[str, str]:
    """What every part prints where nothing is compiled; one process for all."""
    environment = {
        **os.environ, "NUMBA_DISABLE_JIT": "1", "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), *sys.path]),
    }  # fmt: skip
    script = "\n".join(f"exec({SMALL + part!r}, {{}})\nprint({END!r})" for part in PARTS.values())
    command = [sys.executable, "-W", "ignore::RuntimeWarning", "-c", script]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return dict(zip(PARTS, done.stdout.split(END)))


def compiled(part: str) -> str:
    """What a part prints here."""
    with contextlib.redirect_stdout(io.StringIO()) as said, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # as there: infinities are compared too
        exec(SMALL + PARTS[part], {})
    return said.getvalue()


def differ(part: str, said: str, by_python: str) -> str:
    """How the numbers of a part differ; empty if they do not."""
    python, numba = (np.array(text.split(), dtype=float) for text in (by_python, said))
    if not len(python) == len(numba) > 20:
        return f"{len(numba)} numbers, {len(python)} by Python"
    finite = np.isfinite(python)
    if finite.mean() <= 0.5 or (finite != np.isfinite(numba)).any():
        return f"{np.mean(~finite):.0%} of the numbers are not finite"
    # sums in another order; what is refitted or inverted carries it on
    scale = np.maximum(np.abs(python[finite]), 1e-6)
    most = float((np.abs(numba[finite] - python[finite]) / scale).max())
    return "" if most < (1e-5 if part == "bounds" else 1e-7) else f"by {most:.2g} of their size"


# One test for all parts: the process without compilation is then started once, by one worker.
@pytest.mark.slow
def test_compiled_code_gives_the_numbers_of_the_same_code_in_python() -> None:
    by_python = in_python()
    found = {part: differ(part, compiled(part), by_python[part]) for part in PARTS}
    assert {part: words for part, words in found.items() if words} == {}
    assert differ("rig", "1 " * 30, "1 " * 29 + "1.001") and differ("rig", "1", "1")
