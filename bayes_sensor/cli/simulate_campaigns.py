"""Campaigns with known truth, written like recorded ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, counted
from bayes_sensor.cli.read_parameters import read_option, read_truth
from bayes_sensor.cli.terminal import progress_bar, say
from bayes_sensor.io.json_files import read_json, sha256
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.io.readers.quantities import TIME, VOLUME, Kind
from bayes_sensor.io.results import Results
from bayes_sensor.io.writers import FORMATS, write_campaign
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import Layout

if TYPE_CHECKING:
    from bayes_sensor.cli.command_options import Simulation

START_DELAY, END_DELAY = (0.1340, 0.1125e3), (0.0161, 0.0745e3)
"""s and mL: the published delay lines, for a design without switch times of its own"""
DEFAULTS = {
    "tau_s": 0.0481, "tau_v_s": 0.8577, "V_mL": 58.23, "phi": 0.8, "sigma0_V": 0.045,
    "sigma1_V": 0.0724,
}  # fmt: skip
"""the published rig"""


def published_design() -> tuple[Campaign, dict[str, Any]]:
    """The paper's seven experiments as a design, and their published parameters."""
    templates = resources.files("bayes_sensor") / "templates"
    with resources.as_file(templates / "seven_experiments.toml") as path:
        design = replace(read_campaign(path), source="")
    with resources.as_file(templates / "seven_experiments.json") as path:
        return design, read_json(path)


def default_truth(design: Campaign) -> dict[str, Any]:
    """Parameters for a design that comes with none: the published rig's, delays on its lines.

    On another rig the sensor's lag is a fiftieth of the shortest record, or of twice the shortest
    stretch between two switches, and every other lag a third of that.
    """
    layout = Layout.of(design)
    if not layout.is_published:
        return _other_truth(design, layout)
    experiments = {}
    for e in design:
        on = e.commanded_on if e.commanded_on is not None else float(e.t[0] + 0.2 * np.ptp(e.t))
        own = {
            "y0_V": 0.2,
            "beta_V": 2.0,
            "t0_s": on + START_DELAY[0] + START_DELAY[1] / e.total_flow,
        }
        if e.commanded_off is not None:
            own["tf_s"] = e.commanded_off + END_DELAY[0] + END_DELAY[1] / e.total_flow
        experiments[e.name] = own
    theta = {**DEFAULTS, "experiments": experiments}
    if design.sensor_is == "slower":
        theta["tau_s"], theta["tau_v_s"] = theta["tau_v_s"], theta["tau_s"]
    return theta


def _other_truth(design: Campaign, layout: Layout) -> dict[str, Any]:
    """Parameters for a design of another rig or programme."""
    lengths = [len(e.t) * e.interval for e in design]
    programmes = [e.commands.times for e in design if e.commands and not e.commands.recorded]
    lengths += [2.0 * float(np.diff(times).min()) for times in programmes if len(times) > 1]
    shortest = min(lengths)
    flow = float(np.median([e.total_flow for e in design]))
    theta: dict[str, Any] = {}
    for i, name in enumerate(layout.shared_names):
        lag = shortest / 50.0 * (i + 1 if "[" in name else 1.0)
        if not name.startswith("tau_s"):
            lag /= 3.0
        theta[name] = lag * flow if name.startswith("V_") else lag
    for name in layout.noise_names:
        theta[name] = DEFAULTS[name.partition("[")[0]]
    experiments: dict[str, dict[str, float]] = {}
    for e, switching, record in zip(design, layout.switching, layout.records, strict=True):
        experiments.setdefault(e.name, {}).update(y0_V=0.2, beta_V=2.0)
        begin = e.commanded_on if e.commanded_on is not None else float(e.t[0])
        commanded = [begin, e.commanded_off]
        if e.commands is not None and not e.commands.recorded and not any(switching.offsets):
            commanded = e.commands.times.tolist()
        if any(switching.offsets) or switching.recorded is not None:
            commanded = [0.0] * len(switching.names)
        late = 10.0 * e.interval
        experiments.setdefault(record, {}).update(
            {kind: at + late for kind, at in zip(switching.names, commanded) if at is not None}
        )
    return {**theta, "experiments": experiments}


def resized(
    campaign: Campaign, truth: dict[str, Any], duration: float | None, interval: float | None
) -> tuple[Campaign, dict[str, Any]]:
    """The design on another grid; commanded times keep their relative place in the record, delays
    are unchanged."""
    if duration is None and interval is None:
        return campaign, truth
    if not Layout.of(campaign).is_published:
        raise CampaignError(
            "--duration and --interval are for the published rig and one pulse a record; expected "
            "the lengths of another design in its file: write interval and duration there"
        )
    experiments, own = [], {}
    for e in campaign:
        h = interval or e.interval
        old = len(e.t) * e.interval
        length = duration or old
        n = round(length / h)
        commanded: dict[str, float | None] = {}
        if not 2 <= n <= 50_000_000:
            few = ("least 2", "longer --duration or a shorter --interval")
            many = ("most 50 million", "shorter --duration or a longer --interval")
            wanted, advice = few if n < 2 else many
            raise CampaignError(
                f"experiment '{e.name}': {length:g} s at {h:g} s are {n} samples; expected at "
                f"{wanted}: give a {advice}"
            )
        start = float(e.t[0])
        scale = length / old
        values = dict(truth["experiments"][e.name])
        for name, key in (("commanded_on", "t0_s"), ("commanded_off", "tf_s")):
            given = getattr(e, name)
            commanded[name] = None if given is None else start + (given - start) * scale
            if values.get(key) is not None:
                origin = given if given is not None else values[key]
                moved = start + (origin - start) * scale
                values[key] = moved + (values[key] - origin)
        grid = start + h * np.arange(n, dtype=float)
        experiments.append(
            Experiment(
                e.name, grid, None, e.carrier_flow, e.test_gas_flow, h,
                commanded["commanded_on"], commanded["commanded_off"],
            )
        )  # fmt: skip
        own[e.name] = values
    return replace(campaign, experiments=tuple(experiments)), {**truth, "experiments": own}


def _chosen(campaign: Campaign, only: str | None) -> Campaign:
    if only is None:
        return campaign
    names = [name.strip() for name in only.split(",") if name.strip()]
    for name in names:
        if name not in campaign.names_of_experiments:
            raise CampaignError(
                f"--experiments: no experiment '{name}'; expected some of "
                f"{', '.join(campaign.names_of_experiments)}: correct the list"
            )
    if not names:
        raise CampaignError('--experiments: expected names such as "1,4,7", but got none')
    return replace(campaign, experiments=tuple(e for e in campaign if e.name in names))


def _empty(campaign: Campaign) -> Campaign:
    """The design of a campaign: the same without data."""
    experiments = tuple(
        replace(e, y=None, mask=None, drive=None, source="", sha256="") for e in campaign
    )
    return replace(campaign, experiments=experiments, warnings=())


def _recorded(
    plan: Problem, theta: dict[str, Any], wanted: Mapping[str, float | None], seed: int
) -> tuple[Campaign, dict[str, Any]]:
    """The simulated campaign, and the truth with the effects that act."""
    if not wanted:
        return simulate(plan, theta, seed=seed), theta
    from bayes_sensor.diagnosis.effects.simulate_effects import simulate_with_effects

    recorded, strengths = simulate_with_effects(plan, theta, wanted, seed=seed)
    return recorded, {**theta, "effects": strengths}


def simulate_campaign(asked: Simulation) -> None:
    """Write data files, campaign.toml and truth.json.

    Of the settings only the noise law is used; parameters that it fixes are fixed in the truth.
    """
    from bayes_sensor.analysis.overrides import make_problem, read_overrides

    overrides = read_overrides(asked.config)
    clock = CommandClock()
    if asked.file_format not in FORMATS:
        raise CampaignError(
            f"--format: expected one of {', '.join(FORMATS)}, but got '{asked.file_format}'; "
            "choose one"
        )
    if asked.campaign is not None and asked.design is not None:
        raise CampaignError("both CAMPAIGN.toml and --design are given; expected one: drop one")
    phi = asked.phi
    if phi is not None and not -1.0 < phi < 1.0:
        raise CampaignError(f"--phi: expected a number between -1 and 1, but got {phi}; try 0.8")
    wanted: dict[str, float | None] = {}
    if asked.effect:
        from bayes_sensor.diagnosis.effects.simulate_effects import read_strength

        for which, strength in map(read_strength, asked.effect):
            if which in wanted:
                raise CampaignError(f"--effect {which}: it is given twice; leave one out")
            wanted[which] = strength
    source = asked.campaign or asked.design
    given: dict[str, Any] | None = None
    if source is None:
        plan, given = published_design()
    else:
        plan = read_campaign(source)
    plan = _chosen(plan, asked.experiments)
    unit = plan.signal_unit
    kinds = {
        "tau": Kind("a time", "s", "20 ms"), "tau_v": Kind("a time", "s", "850 ms"), "V": VOLUME,
        "sigma0": Kind("a signal", unit, f"0.045 {unit}"),
        "sigma1": Kind("a signal", unit, f"0.07 {unit}"),
        "duration": Kind(TIME.name, "s", "60 s"), "interval": Kind(TIME.name, "s", "1 ms"),
    }  # fmt: skip
    quantities = asked.quantities
    values = {k: read_option(text, kinds[k], f"--{k}") for k, text in quantities.items()}
    for name, value in values.items():
        if value < 0 or (value == 0 and not name.startswith("sigma")):
            raise CampaignError(
                f"--{name}: expected a positive value, but got '{quantities[name]}'; write for "
                f'example "{kinds[name].example}"'
            )
    if asked.truth is not None:
        given = read_truth(asked.truth, plan)
    elif given is None and not plan.is_design:
        from bayes_sensor.fit import fit_least_squares

        with progress_bar("fit", asked.quiet) as tell:
            fit = fit_least_squares(plan, seed=asked.seed, euler=False, progress=tell)
            given = fit.parameters
    plan = _empty(plan)
    theta = given or default_truth(plan)
    kept = {*plan.names_of_experiments, *(e.record_name for e in plan)}
    theta["experiments"] = {n: own for n, own in theta["experiments"].items() if n in kept}
    plan, theta = resized(plan, theta, values.get("duration"), values.get("interval"))
    flat = {"tau": "tau_s", "tau_v": "tau_v_s", "V": "V_mL", "sigma0": "sigma0_V",
            "sigma1": "sigma1_V"}  # fmt: skip
    set_to = {flat[k]: v for k, v in values.items() if k in flat}
    known = Layout.of(plan)
    for name in set_to:
        if name not in (*known.shared_names, *known.noise_names):
            raise CampaignError(
                f"--{name.rsplit('_', 1)[0]}: this rig has no such parameter; it has "
                f"{', '.join(known.shared_names)}: give others by --truth"
            )
    theta.update(set_to)
    if phi is not None:
        theta["phi"] = phi
    for name in known.noise_names:
        kind = name.partition("[")[0]
        theta.setdefault(name, DEFAULTS[kind] if kind == "sigma0_V" else 0.0)
    if plan.sensor_is != "unknown" and known.is_published:  # the truth says it as well
        order = "faster" if theta["tau_s"] <= theta["tau_v_s"] else "slower"
        plan = replace(plan, sensor_is=order)
    label = asked.config.name if asked.config is not None else "--config"
    problem = make_problem(plan, overrides, label)
    theta = problem.layout.nested({**theta, **problem.noise.fixed})
    results = Results(asked.out)
    with results.locked(), progress_bar("simulate", asked.quiet) as tell:
        tell(0.2, "noise")
        recorded, theta = _recorded(problem, theta, wanted, asked.seed)
        recorded = replace(recorded, title=f"simulated: {plan.title}" if source else plan.title)
        with results.writing() as stage:
            tell(0.4, "writing")
            write_campaign(recorded, stage.inside, formats=asked.file_format)
            stage.json("truth.json", {**theta, "signal_unit": unit})
            put_run(
                stage, "simulate", clock, seed=asked.seed,
                settings={
                    **quantities, "phi": theta.get("phi"), "noise": overrides.noise.model_dump(),
                    "format": asked.file_format, "effects": list(asked.effect or ()),
                },
                campaign="" if source is None else str(source),
                files={} if source is None else {source.name: sha256(source)},
            )  # fmt: skip
    lags = [
        f"{name.replace('_s', '', 1)} = {1e3 * theta[name]:g} ms"
        for name in known.shared_names
        if name.startswith("tau_s")
    ]
    what = f"{counted(len(recorded), 'experiment')} with {', '.join(lags)}, seed {asked.seed}"
    say(what, asked.quiet)
    say(f"campaign: {results.path('campaign.toml')}", asked.quiet)
