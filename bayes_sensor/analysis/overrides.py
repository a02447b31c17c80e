"""Settings a user may override: the TOML file of ``--config``, checked key by key.

::

    [noise]
    variance = "concentration"         # or "signal", "constant", "levels" (may fall with gas)
    autocorrelation = "ar1"            # or "white"
    per_experiment = false

    [priors]                           # tau, tau_v, V, phi, sigma0, sigma1, y0, beta, t0, tf
    tau = "half-normal(200 ms)"        # log-normal(median, sd of the logarithm), normal(mean, sd),
    V = "normal(60, 2) mL"             # uniform(low, high), log-uniform(low, high), flat
    "t0[4]" = "uniform(28 s, 33 s)"    # one experiment; without [..] all of them

    [fix]                              # held at a value, not fitted: the same names
    tau_v = "0.86 s"

    [fit]
    swarms = 3
    particles = 40
    euler = true                       # repeat with forward Euler
    differential_evolution = false     # cross-check of the swarm
    bounds = { tau = ["1 ms", "1 s"] }

    [posterior]
    sampler = "emcee"                  # or "independence", "hmc"
    n_chains = 4
    n_walkers = 64
    max_steps = 4000

    [bounds]
    methods = ["crlb_iid", "profile", "posterior"]
    resamples = 400
    step_study = true                  # where the sensor is the published one
    explain = true                     # what makes tau hard, and what would help
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
)
from pydantic_core import PydanticCustomError

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.io.toml_text import LARGEST, read_toml
from bayes_sensor.likelihood import problem_settings
from bayes_sensor.likelihood.prior_text import prior_of_law, read_bounds
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Settings
from bayes_sensor.posterior.samplers import DEFAULT, SAMPLERS

_EXAMPLES = {
    "noise": '{"variance": "constant"}',
    "priors": '{"V": "normal(60, 2) mL"}',
    "fix": '{"tau_v": "0.86 s"}',
}


class OverrideTable(BaseModel):
    """A table of the file: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class NoisePart(OverrideTable):
    """The noise law."""

    variance: Literal["concentration", "signal", "constant", "levels"] = "concentration"
    autocorrelation: Literal["ar1", "white"] = "ar1"
    per_experiment: bool = False


class FitPart(OverrideTable):
    """The least-squares fit."""

    swarms: int = Field(default=3, ge=1, le=100)
    particles: int = Field(default=40, ge=4, le=10_000)
    euler: bool = True
    differential_evolution: bool = False
    bounds: dict[str, list[str]] = Field(default_factory=dict)


def _known_sampler(name: str) -> str:
    if name not in SAMPLERS:
        *others, last = (f"'{known}'" for known in SAMPLERS)
        raise PydanticCustomError(
            "unknown_sampler",
            "Input should be {names}",
            {"names": f"{', '.join(others)} or {last}"},
        )
    return name


def _sampler_keys() -> dict[str, Any]:
    """The sampler's name and its own settings, as keys with their types and defaults."""
    keys: dict[str, Any] = {"sampler": (Annotated[str, AfterValidator(_known_sampler)], DEFAULT)}
    for f in fields(Settings):
        least = {"burn_in": 0, "n_chains": 2}.get(f.name, 1)
        keys[f.name] = (type(f.default), Field(default=f.default, ge=least))
    return keys


PosteriorPart: type[OverrideTable] = create_model(
    "PosteriorPart", __base__=OverrideTable, **_sampler_keys()
)


class BoundsPart(OverrideTable):
    """The comparison of bounds."""

    methods: list[str] | None = None
    resamples: int = Field(default=400, ge=20, le=100_000)
    step_study: bool = True
    explain: bool = True


def _prior_text(value: object) -> str | Prior:
    if isinstance(value, str | Prior):
        return value
    made = prior_of_law(value)
    if made is None:
        raise PydanticCustomError("prior", "Input should be a prior such as 'normal(60, 2) mL'")
    return made


def _fixed_text(value: object) -> str | float:
    if isinstance(value, str) or (isinstance(value, float | int) and not isinstance(value, bool)):
        return value
    raise PydanticCustomError("fixed", "Input should be a value such as '0.86 s'")


PriorText = Annotated[Any, BeforeValidator(_prior_text)]
FixedText = Annotated[Any, BeforeValidator(_fixed_text)]


class Overrides(OverrideTable):
    """All settings."""

    noise: NoisePart = Field(default_factory=NoisePart)
    priors: dict[str, PriorText] = Field(default_factory=dict)
    fix: dict[str, FixedText] = Field(default_factory=dict)
    tie: dict[str, str] = Field(default_factory=dict)
    fit: FitPart = Field(default_factory=FitPart)
    posterior: PosteriorPart = Field(default_factory=PosteriorPart)  # type: ignore[valid-type]
    bounds: BoundsPart = Field(default_factory=BoundsPart)

    def record(self) -> dict[str, Any]:
        """Everything as plain values, for run.json."""
        found = self.model_dump()
        found["priors"] = {name: _plain(law) for name, law in self.priors.items()}
        return {key: table for key, table in found.items() if table or key not in ("fix", "tie")}

    def basis(self) -> dict[str, Any]:
        """Settings that say what is computed, for the digest of what a result rests on."""
        record = self.record()
        return {key: record[key] for key in ("noise", "priors", "fix", "tie") if key in record}

    def sampler_settings(self) -> Settings:
        """The record that the samplers take."""
        values = self.posterior.model_dump()  # type: ignore[attr-defined]
        values.pop("sampler")
        return Settings(**values)


def _plain(law: str | Prior) -> str:
    return law if isinstance(law, str) else repr(law)


def read_overrides(
    path: Path | None,
    posterior: Mapping[str, Any] | None = None,
    more: Mapping[str, Any] | None = None,
    label: str = "--config",
) -> Overrides:
    """The settings of a file (None: the defaults) with the sampler's options put in.

    ``more``: tables by name whose keys win over the file's; ``label``: what messages call them.

    Raises
    ------
    CampaignError
        If the file cannot be read, or a key or a value in it is not known.
    """
    tables: dict[str, Any] = {}
    called = label
    if path is not None:
        label = path.name or str(path)
        tables = _read(path, label)
    for name, table in (more or {}).items():
        if not isinstance(table, Mapping):
            raise CampaignError(
                f"{label}: {name}: expected a mapping of settings, but got a "
                f"{type(table).__name__}; write for example {_EXAMPLES.get(name, '{..}')}"
            )
        before = tables.get(name, {})
        tables[name] = {**(before if isinstance(before, dict) else {}), **table}
    given = dict(posterior or {})
    if given:
        table = tables.get("posterior", {})
        if isinstance(table, dict):
            tables = {**tables, "posterior": {**table, **given}}
    try:
        return Overrides.model_validate(tables)
    except ValidationError as error:
        raise CampaignError(_first_problem(error, label, given, called)) from None


def _read(path: Path, label: str) -> dict[str, Any]:
    try:
        if not path.is_file():
            what = "it is a folder" if path.is_dir() else "there is no such file"
            raise CampaignError(
                f"{label}: expected a file with settings, but {what}; check --config"
            )
        with path.open("rb") as stream:
            content = stream.read(LARGEST + 1)
    except OSError as error:
        raise CampaignError(
            f"{label}: the file cannot be read ({error.strerror or error}); check it"
        ) from None
    return read_toml(content, label, "settings")


def _first_problem(
    error: ValidationError, label: str, given: Mapping[str, Any], called: str
) -> str:
    problems = error.errors(include_url=False)
    first = min(problems, key=lambda p: p["type"] != "extra_forbidden")
    place = [str(part) for part in first["loc"]]
    key = place[-1]
    table = place[0] if len(place) > 1 else ""
    where = f"{label}: [{table}] " if table else f"{label}: "
    if first["type"] == "extra_forbidden":
        model = Overrides.model_fields[table].default_factory if table else Overrides
        known = list(model.model_fields)  # type: ignore[union-attr]
        if not table and key in ("title", "experiment", "side_information"):
            return (
                f"{label}: this is a campaign file; expected settings, with tables such as "
                "[noise], [priors], [fit]: give the campaign as the argument, settings as --config"
            )
        close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
        hint = f'write "{close[0]}"' if close else f"known are {', '.join(known)}"
        return f"{where}unknown key '{key[:80]}'; expected one that is known: {hint}"
    if table == "posterior" and key in given and called.startswith("--"):
        option = {"n_walkers": "walkers", "max_steps": "steps", "n_chains": "chains"}
        where, key = "", f"--{option.get(key, key)}"
    elif table == "posterior" and key in given:
        where = f"{called}: " if key == "sampler" else f"{called}: settings: "
    value = f"'{first['input']}'" if isinstance(first["input"], str) else str(first["input"])
    message = first["msg"].removeprefix("Input ").replace("should be", "expected")
    return f"{where}{key}: {message}, but got {value[:80]}; correct it"


def make_problem(campaign: Campaign, overrides: Overrides, label: str) -> Problem:
    """The campaign with the noise law, the priors and the held and tied values that were asked
    for."""
    noise = overrides.noise.model_dump()
    return problem_settings.make_problem(
        campaign, overrides.priors, overrides.fix, noise, label, overrides.tie
    )


def fit_bounds(
    problem: Problem, overrides: Overrides, label: str
) -> dict[str, tuple[float, float]] | None:
    """Search bounds that were asked for, by flat name."""
    unit = problem.campaign.signal_unit
    given = overrides.fit.bounds
    return read_bounds(given, problem.layout, unit, f"{label}: [fit] bounds") or None
