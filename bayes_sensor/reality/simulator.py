"""Campaigns recorded on the simulated rig."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.reality.causes import CAUSES, Rig, converter_step, tail_mixture
from bayes_sensor.reality.knobs import Knobs
from bayes_sensor.reality.noise import draw_noise
from bayes_sensor.reality.records import Case, Step
from bayes_sensor.reality.rig import on_the_clock, voltage

PHASES = ("baseline", "onset", "rise", "plateau", "fall", "tail")


def prepared_rig(case: Case) -> Rig:
    """The knobs of every experiment, by name, as the case's causes turn them.

    Raises
    ------
    CampaignError
        If a cause is not known.
    """
    rig = {step.name: Knobs() for step in case.steps}
    for name, strength in case.strengths.items():
        if name not in CAUSES:
            raise CampaignError(f"case: no cause '{name}'; there are {', '.join(CAUSES)}")
        CAUSES[name].apply(rig, strength, case)
    return rig


def sample_times(step: Step) -> FloatArray:
    """(n_t,) s, as the recorder calls them."""
    return np.arange(step.n_samples, dtype=float) * step.interval


def clean_signals(
    case: Case, times: Mapping[str, FloatArray] | None = None
) -> dict[str, FloatArray]:
    """Voltage without noise (n_t,) of every experiment, at its samples or at given times."""
    return {name: y for name, (y, _) in _clean(case, times).items()}


def _clean(
    case: Case, times: Mapping[str, FloatArray] | None = None
) -> dict[str, tuple[FloatArray, FloatArray]]:
    rig = prepared_rig(case)
    found = {}
    for step in case.steps:
        t = sample_times(step) if times is None else times[step.name]
        y, x = voltage(case, step, rig[step.name], t)
        found[step.name] = (y, x)
    return found


def noise_scale(case: Case, step: Step, x: FloatArray) -> FloatArray:
    """(n_t,) V, standard deviation of the noise where the response is ``x`` (n_t,)."""
    grown = case.noise.sigma1**2 * case.relative_concentration(step) * np.maximum(x, 0.0)
    return np.sqrt(case.noise.sigma0**2 + grown)


def make_campaign(case: Case) -> Campaign:
    """The campaign that the recorder of this rig would have saved; the same case, the same bits."""
    lsb = converter_step(case)
    rig = prepared_rig(case)
    experiments = []
    for step, (y, x) in zip(case.steps, _clean(case).values(), strict=True):
        knobs = rig[step.name]
        rng = np.random.default_rng(
            [case.seed, zlib.crc32(b"noise"), zlib.crc32(step.name.encode())]
        )
        z = draw_noise(case.noise, len(y), step.interval, rng, tail_mixture(case))
        recorded = y + noise_scale(case, step, x) * z
        if lsb > 0:
            recorded = np.rint(recorded / lsb) * lsb
        experiments.append(
            Experiment(
                name=step.name,
                t=sample_times(step),
                y=recorded,
                carrier_flow=step.carrier_flow,
                test_gas_flow=step.test_gas_flow,
                interval=step.interval,
                commanded_on=on_the_clock(knobs, step.commanded_on, step),
                commanded_off=on_the_clock(knobs, step.commanded_off, step),
            )
        )
    return Campaign(case.title, tuple(experiments), sensor_is="faster")


def without_causes(case: Case) -> Case:
    """The same rig with nothing wrong."""
    return replace(case, strengths={})


def phase_edges(case: Case, step: Step) -> dict[str, tuple[float, float]]:
    """(start, end) s of every phase of an experiment.

    The rise lasts from t0 until the undisturbed response is within 1 % of its plateau, the fall
    likewise from tf; onset is what passes between the command and t0.
    """
    t = np.linspace(0.0, step.duration, 20001)
    _, x = voltage(without_causes(case), step, Knobs(), t)
    up = t[(t >= step.t0) & (t < step.tf) & (x >= 0.99)]
    down = t[(t >= step.tf) & (x <= 0.01)]
    settled = float(up[0]) if len(up) else step.tf
    emptied = float(down[0]) if len(down) else step.duration
    on = min(step.commanded_on, step.t0)
    return {
        "baseline": (0.0, on),
        "onset": (on, step.t0),
        "rise": (step.t0, settled),
        "plateau": (settled, step.tf),
        "fall": (step.tf, emptied),
        "tail": (emptied, step.duration),
    }


def as_recorded(case: Case) -> Case:
    """The same rig with nothing wrong and its switches at the times that the recorder gave them."""
    rig = prepared_rig(case)
    steps = []
    for step in case.steps:
        t0, tf, on, off = (
            on_the_clock(rig[step.name], true, step)
            for true in (step.t0, step.tf, step.commanded_on, step.commanded_off)
        )
        steps.append(replace(step, t0=t0, tf=tf, commanded_on=on, commanded_off=off))
    return replace(case, strengths={}, steps=tuple(steps))


def acting_places(case: Case) -> dict[tuple[str, str], float]:
    """Where the causes act: share of the squared noise-free difference by (experiment, phase)."""
    ideal_case = as_recorded(case)
    with_causes, ideal = clean_signals(case), clean_signals(ideal_case)
    energy = {}
    for step in ideal_case.steps:
        t = sample_times(step)
        difference = (with_causes[step.name] - ideal[step.name]) ** 2
        for phase, (low, high) in phase_edges(ideal_case, step).items():
            part = difference[(t >= low) & (t < high)]
            energy[step.name, phase] = float(part.sum()) * step.interval
    total = sum(energy.values())
    return {place: value / total if total > 0 else 0.0 for place, value in energy.items()}
