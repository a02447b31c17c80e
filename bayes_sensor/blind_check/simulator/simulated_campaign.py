"""Campaigns recorded on the simulated rig, and where in them its causes act."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bayes_sensor.blind_check.simulator.case import Case, Step, Switch
from bayes_sensor.blind_check.simulator.causes import CAUSES, converter_step, tail_mixture
from bayes_sensor.blind_check.simulator.noise_laws import draw_noise
from bayes_sensor.blind_check.simulator.simulated_rig import Rig
from bayes_sensor.campaign import Campaign, CampaignError, Commands, Experiment, FloatArray

PHASES = ("baseline", "onset", "rise", "plateau", "fall", "tail")


def prepared_rigs(case: Case) -> list[Rig]:
    """The rig of every experiment, as the case's causes have changed it.

    Raises
    ------
    CampaignError
        If a cause is not known.
    """
    for name in case.strengths:
        if name not in CAUSES:
            raise CampaignError(f"case: no cause '{name}'; there are {', '.join(CAUSES)}")
    rigs = [Rig(case, step, number) for number, step in enumerate(case.steps)]
    for name, cause in CAUSES.items():
        for rig in rigs:
            cause.apply(rig, case.strengths.get(name, 0.0))
    return rigs


def sample_times(step: Step) -> FloatArray:
    """(n_t,) s, as the recorder calls them."""
    return np.arange(step.n_samples, dtype=float) * step.interval


def clean_signals(
    case: Case, times: Mapping[str, FloatArray] | None = None
) -> dict[str, FloatArray]:
    """Voltage without noise (n_t,) of every experiment, at its samples or at given times."""
    found = {}
    for rig in prepared_rigs(case):
        name = rig.step.name
        found[name], _ = rig.voltage(sample_times(rig.step) if times is None else times[name])
    return found


def noise_scale(case: Case, step: Step, x: FloatArray) -> FloatArray:
    """(n_t,) V, standard deviation of the noise where the response is ``x`` (n_t,)."""
    grown = case.noise.sigma1**2 * case.relative_concentration(step) * np.maximum(x, 0.0)
    return np.sqrt(case.noise.sigma0**2 + grown)


def make_campaign(case: Case) -> Campaign:
    """The campaign that the recorder of this rig would have saved; the same case, the same bits."""
    lsb = converter_step(case)
    experiments = []
    for rig in prepared_rigs(case):
        step = rig.step
        y, x = rig.voltage(sample_times(step))
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
                carrier_flow=step.carrier_flow if case.flows_told else None,
                test_gas_flow=step.test_gas_flow if case.flows_told else None,
                interval=step.interval,
                commanded_on=rig.recorded_time(step.commanded_on),
                commanded_off=None if step.programme else rig.recorded_time(step.commanded_off),
                commands=_commands(rig) if step.programme else None,
            )
        )
    # on the published rig the sensor was drawn faster, or next to nothing slower
    is_faster = case.is_published or case.tau < case.tau_v
    order = ("faster" if is_faster else "slower") if case.has_valve else "unknown"
    return Campaign(case.title, tuple(experiments), sensor_is=order, stages=case.stages)


def _commands(rig: Rig) -> Commands:
    """The programme of a record, by the recorder's clock."""
    switches = rig.step.programme
    return Commands(
        times=np.array([rig.recorded_time(switch.commanded) for switch in switches]),
        levels=np.array([switch.level for switch in switches]),
        delays="shared" if rig.step.shared_delays else "free",
    )


def without_causes(case: Case) -> Case:
    """The same rig with nothing wrong."""
    return replace(case, strengths={})


def as_recorded(case: Case) -> Case:
    """The same rig with nothing wrong and its switches at the times that the recorder gave them."""
    steps = []
    for rig in prepared_rigs(case):
        step = rig.step
        t0, tf, on, off = (
            rig.recorded_time(true)
            for true in (step.t0, step.tf, step.commanded_on, step.commanded_off)
        )
        programme = tuple(
            Switch(rig.recorded_time(each.commanded), rig.recorded_time(each.at), each.level)
            for each in step.programme
        )
        steps.append(
            replace(step, t0=t0, tf=tf, commanded_on=on, commanded_off=off, programme=programme)
        )
    return replace(case, strengths={}, steps=tuple(steps))


def phase_spans(case: Case, step: Step) -> list[tuple[str, float, float]]:
    """(phase, start, end) s of every phase of an experiment, in order.

    A rise lasts from when the gas really begins to switch on until the undisturbed response is
    within 1 % of the step's end, a fall likewise; onset is what passes between the command and the
    rise.  What follows a rise is a plateau, what follows a fall a tail.
    """
    t = np.linspace(0.0, step.duration, 20001)
    _, x = Rig(case, step).voltage(t)
    switches = step.switches
    found = [("baseline", 0.0, min(switches[0].commanded, switches[0].at))]
    level = 0.0
    for i, switch in enumerate(switches):
        end = switches[i + 1].at if i + 1 < len(switches) else step.duration
        up = switch.level > level
        if up:  # begins with the command, which ends what was before
            phase, start, _ = found[-1]
            begin = min(switch.commanded, switch.at)
            found[-1] = phase, start, begin
            found.append(("onset", begin, switch.at))
        left = (switch.level - x) / (switch.level - level)
        arrived = t[(t >= switch.at) & (t < end) & (left <= 0.01)]
        settled = float(arrived[0]) if len(arrived) else end
        found.append(("rise" if up else "fall", switch.at, settled))
        found.append(("plateau" if up else "tail", settled, end))
        level = switch.level
    return found


def acting_places(case: Case) -> dict[tuple[str, str], float]:
    """Where the causes act: share of the squared noise-free difference by (experiment, phase)."""
    ideal_case = as_recorded(case)
    with_causes, ideal = clean_signals(case), clean_signals(ideal_case)
    energy: dict[tuple[str, str], float] = {}
    for step in ideal_case.steps:
        t = sample_times(step)
        difference = (with_causes[step.name] - ideal[step.name]) ** 2
        for phase, low, high in phase_spans(ideal_case, step):
            part = float(difference[(t >= low) & (t < high)].sum()) * step.interval
            energy[step.name, phase] = energy.get((step.name, phase), 0.0) + part
    total = sum(energy.values())
    return {place: value / total if total > 0 else 0.0 for place, value in energy.items()}
