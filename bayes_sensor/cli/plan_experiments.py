"""The next experiments: proposed, predicted, and checked by simulation."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.analysis.overrides import make_problem, read_overrides
from bayes_sensor.analysis.read_input import read_input
from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.cli.options import given
from bayes_sensor.cli.read_parameters import read_option, read_truth
from bayes_sensor.cli.terminal import Progress, lined_up, progress_bar, say
from bayes_sensor.design import Design, check_design, design_experiments
from bayes_sensor.design.choose_experiments import refuse_unplannable
from bayes_sensor.fit.side_information import named_parameters
from bayes_sensor.io.json_files import sha256
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.readers.quantities import FLOW, TIME, Kind
from bayes_sensor.io.results import Results
from bayes_sensor.io.writers import campaign_text
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.lags import Naming

if TYPE_CHECKING:
    from bayes_sensor.cli.command_options import Planning

SHORTEST = 0.25
"""share of the shortest existing record: the shortest proposal without --duration"""
KINDS = {"flow": FLOW, "duration": Kind(TIME.name, TIME.unit, "60 s")}


def plan_experiments(asked: Planning) -> int:
    """Write design.json and the input files for ``simulate``; return the exit code.

    ``design.toml`` goes with ``truth.json``, ``next.toml`` with ``next_truth.json``: sigma1 and phi
    refer to a campaign's own highest concentration and sampling interval.
    """
    clock = CommandClock()
    path, quiet, k = asked.campaign, asked.quiet, asked.experiments
    goal = _positive(asked.target_tau, "--target-tau")
    known = None if asked.trigger is None else _positive(asked.trigger, "--trigger", zero=True)
    assumed = None if asked.tau is None else _positive(asked.tau, "--tau", zero=True)
    overrides = read_overrides(asked.config)
    campaign, _, _ = read_input(path)
    refuse_unplannable(campaign)
    ranges = _ranges(
        campaign,
        given(flow=asked.flow, concentration=asked.concentration, duration=asked.duration),
    )
    problem = make_problem(campaign, overrides, asked.config.name if asked.config else "--config")
    vector = None
    if asked.truth is not None:
        vector = problem.layout.flat(read_truth(asked.truth, campaign))
    elif campaign.is_design:
        raise CampaignError(
            f"{path.name}: this is a design without data; expected --truth THETA.json "
            "with the parameters to plan for: give one, or plan from measured experiments"
        )
    elif not len(problem.name_factors[1]):  # nothing that the data may decide
        _check_order(problem.naming(), path)
    results = Results(asked.out)
    with results.locked(steps=["design"]):
        with progress_bar("design", quiet) as tell:
            if vector is None:
                vector = _estimated(problem, asked.seed, tell, path)
            if assumed is not None:
                vector = vector.copy()
                vector[problem.layout.tau] = assumed
            tell(0.5, "choosing experiments")
            found = design_experiments(
                problem, problem.layout.nested(vector), goal, ranges["flow"],
                ranges["concentration"], ranges["duration"], k=k, k_max=asked.most, trigger=known,
            )  # fmt: skip
        record = found.to_json()
        record["assumed"] = {
            name: float(value)
            for name, value in zip(problem.layout.shared_names, vector, strict=False)
        } | {name: float(vector[problem.layout.index(name)]) for name in problem.layout.noise_names}
        record["limits"] = {
            "total_flow_mL_s": ranges["flow"], "concentration": ranges["concentration"],
            "duration_s": ranges["duration"], "experiments": k if k is not None else asked.most,
            "trigger_s": known,
        }  # fmt: skip
        record["check"] = None
        if asked.check:
            with progress_bar("check", quiet) as tell:
                record["check"] = check_design(
                    found, asked.check, asked.seed, known,
                    lambda done: tell(done, "simulated campaigns"),
                )  # fmt: skip
        code = 0 if found.reached or k is not None else 3
        with results.writing() as stage:
            stage.json("design.json", record)
            stage.text("design.toml", campaign_text(_from_zero(found.campaign), {}))
            if found.new is not None:
                stage.text("next.toml", campaign_text(_from_zero(found.new), {}))
                stage.json("next_truth.json", found.truth)
            else:
                stage.drop += ["next.toml", "next_truth.json"]
            stage.json("truth.json", found.truth_for(found.campaign))
            put_run(
                stage, "design", clock, seed=asked.seed,
                settings={
                    "target_tau": asked.target_tau, "limits": record["limits"],
                    "check": asked.check,
                    **overrides.record(),
                },
                campaign=str(path), files={path.name: sha256(path)},
                exit_code=code, warnings=[] if code == 0 else [found.status],
            )  # fmt: skip
    _tell(found, record, results, quiet)
    if code == 3:
        print(
            f"not converged: {found.status}; allow more experiments (--most), wider limits, or a "
            "trigger; the results are marked",
            file=sys.stderr,
        )
    return code


def _positive(text: str, option: str, zero: bool = False) -> float:
    value = read_option(text, Kind(TIME.name, TIME.unit, "5 ms"), option)
    if value < 0 or (value == 0 and not zero):
        raise CampaignError(f"{option}: expected a positive time, but got '{text}'; write \"5 ms\"")
    return value


def _fraction(text: str, option: str) -> float:
    number, percent, _ = text.partition("%")
    try:
        value = float(number) * (0.01 if percent else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1.0:
        raise CampaignError(
            f"{option}: expected concentrations between 0 and 100 %, but got '{text}'; "
            'write "10 %" or 0.1'
        )
    return value


def _ranges(
    campaign: Campaign, limits: Mapping[str, tuple[str, str]]
) -> dict[str, tuple[float, float]]:
    """Low and high of flow, concentration and duration: as given, else as in the campaign."""
    own = {
        "flow": [e.total_flow for e in campaign],
        "concentration": [e.concentration for e in campaign],
        "duration": [len(e.t) * e.interval for e in campaign],
    }
    found = {name: (min(values), max(values)) for name, values in own.items()}
    # a response that settles needs no longer record
    found["duration"] = (SHORTEST * found["duration"][0], found["duration"][1])
    for name, (low, high) in limits.items():
        option = f"--{name}"
        if name == "concentration":
            ends = _fraction(low, option), _fraction(high, option)
        else:
            ends = read_option(low, KINDS[name], option), read_option(high, KINDS[name], option)
        if not 0.0 < ends[0] <= ends[1]:
            raise CampaignError(
                f"{option}: expected two positive values, the lower one first, but got '{low}' and "
                f"'{high}'; swap or correct them"
            )
        found[name] = ends
    return found


def _check_order(naming: Naming, path: Path) -> None:
    """Raise CampaignError if it is not known which lag is the sensor's."""
    if naming.order == "undecided":
        raise CampaignError(
            f"{path.name}: expected to be told which lag is the sensor's, since it is its interval "
            "that is planned for, but [rig] sensor_is is unknown; write [rig] and sensor_is = "
            '"faster" or "slower", or give --truth THETA.json'
        )


def _estimated(problem: Problem, seed: int, tell: Progress, path: Path) -> FloatArray:
    """The posterior's medians, by name: least squares may have tau at its bound."""
    from bayes_sensor.fit import fit_least_squares
    from bayes_sensor.posterior import FASTEST, sample_posterior

    fit = fit_least_squares(
        problem, seed=seed, euler=False, progress=lambda share, _: tell(0.3 * share, "fit")
    )
    tell(0.3, "posterior")
    posterior = sample_posterior(problem, fit, seed=seed, sampler=FASTEST)
    _check_order(posterior.naming, path)
    median: FloatArray = np.median(posterior.draws, axis=0)
    median[: problem.layout.n_shared] = list(named_parameters(posterior.naming, median).values())
    return median


def _from_zero(design: Campaign) -> Campaign:
    """The design with every record starting at zero, as a design file has it."""
    moved = []
    for e in design:
        first = float(e.t[0])
        on = None if e.commanded_on is None else e.commanded_on - first
        off = None if e.commanded_off is None else e.commanded_off - first
        done = e.commands
        if done is not None:
            done = replace(done, times=done.times - first)
        moved.append(replace(e, t=e.t - first, commanded_on=on, commanded_off=off, commands=done))
    return replace(design, experiments=tuple(moved))


def _tell(found: Design, record: Mapping[str, Any], results: Results, quiet: bool) -> None:
    """A table of the proposal and its expected result."""
    header = ("times", "Q (L/min)", "test gas (%)", "duration (s)", "on (s)", "off (s)")
    kinds = Counter(
        (
            f"{0.06 * row['total_flow_mL_s']:.3g}", f"{100 * row['concentration']:.3g}",
            f"{row['duration_s']:.4g}", f"{row['on_s']:.4g}", f"{row['off_s']:.4g}",
        )
        for row in found.experiments.to_dict("records")
    )  # fmt: skip
    if not kinds:
        say("the experiments there are suffice", quiet)
    rows: list[tuple[str, ...]] = [header, *((str(times), *kind) for kind, times in kinds.items())]
    for line in lined_up(rows) if kinds else ():
        say(line, quiet)
    for words, prediction in (("now", found.before), ("with these", found.after)):
        say(
            f"{words}: tau between {1e3 * prediction.low95:.3g} and {1e3 * prediction.high95:.3g} "
            f"ms (95 %), half width {1e3 * prediction.half_width95:.3g} ms",
            quiet,
        )
    if record["check"]:
        seen = record["check"]
        say(
            f"{seen['n']} simulated campaigns: half width {1e3 * seen['mean_half_width95_s']:.3g} "
            f"ms on average, {seen['ratio']:.2f} of the prediction",
            quiet,
        )
    say(f"design: {results.path('design.toml')}", quiet)
