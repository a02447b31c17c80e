"""Settings a user may override: the TOML file of ``--config``, checked key by key.

::

    [noise]
    variance = "concentration"         # or "signal", "constant", "levels" (may fall with gas)
    autocorrelation = "ar1"            # or "white"
    per_experiment = false

    [priors]                           # tau, tau_v, V, phi, sigma0, sigma1, y0, beta, t0, tf
    tau = "half-normal(200 ms)"        # log-normal(median, sd of the logarithm), normal(mean, sd),
    V = "normal(60 mL, 2 mL)"          # uniform(low, high), log-uniform(low, high), flat
    "t0[4]" = "uniform(28 s, 33 s)"    # one experiment; without [..] all of them

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
    step_study = true
    explain = true                     # what makes tau hard, and what would help
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from math import isfinite, nan
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    create_model,
)
from pydantic_core import PydanticCustomError

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.io.readers.quantities import TIME, VOLUME, Kind, read_quantity
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Settings
from bayes_sensor.posterior.samplers import DEFAULT, SAMPLERS
from bayes_sensor.rig.layout import Layout

LARGEST = 1 << 20


class Part(BaseModel):
    """A table of the file: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class NoisePart(Part):
    """The noise law."""

    variance: Literal["concentration", "signal", "constant", "levels"] = "concentration"
    autocorrelation: Literal["ar1", "white"] = "ar1"
    per_experiment: bool = False


class FitPart(Part):
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


PosteriorPart: type[Part] = create_model("PosteriorPart", __base__=Part, **_sampler_keys())


class BoundsPart(Part):
    """The comparison of bounds."""

    methods: list[str] | None = None
    resamples: int = Field(default=400, ge=20, le=100_000)
    step_study: bool = True
    explain: bool = True


class Overrides(Part):
    """All settings."""

    noise: NoisePart = Field(default_factory=NoisePart)
    priors: dict[str, str] = Field(default_factory=dict)
    fit: FitPart = Field(default_factory=FitPart)
    posterior: PosteriorPart = Field(default_factory=PosteriorPart)  # type: ignore[valid-type]
    bounds: BoundsPart = Field(default_factory=BoundsPart)

    def record(self) -> dict[str, Any]:
        """Everything as plain values, for run.json."""
        return self.model_dump()

    def sampler_settings(self) -> Settings:
        """The record that the samplers take."""
        values = self.posterior.model_dump()  # type: ignore[attr-defined]
        values.pop("sampler")
        return Settings(**values)


def read_overrides(path: Path | None, posterior: Mapping[str, Any] | None = None) -> Overrides:
    """The settings of a file (None: the defaults) with the sampler's options put in.

    Raises
    ------
    CampaignError
        If the file cannot be read, or a key or a value in it is not known.
    """
    tables: dict[str, Any] = {}
    label = "--config"
    if path is not None:
        label = path.name or str(path)
        tables = _read(path, label)
    given = dict(posterior or {})
    if given:
        table = tables.get("posterior", {})
        if isinstance(table, dict):
            tables = {**tables, "posterior": {**table, **given}}
    try:
        return Overrides.model_validate(tables)
    except ValidationError as error:
        raise CampaignError(_first_problem(error, label, given)) from None


def _read(path: Path, label: str) -> dict[str, Any]:
    try:
        if not path.is_file():
            what = "it is a folder" if path.is_dir() else "there is no such file"
            raise CampaignError(
                f"{label}: expected a file with settings, but {what}; check --config"
            )
        if path.stat().st_size > LARGEST:
            raise CampaignError(f"{label}: expected at most 1 MB of settings; check --config")
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError:
        raise CampaignError(f"{label}: expected UTF-8 text in TOML; save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        text = " ".join(str(error).split())
        raise CampaignError(
            f"{label}: expected TOML, but {text[:1].lower() + text[1:]}; correct that line"
        ) from None
    except (OSError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "nested too deeply"
        raise CampaignError(f"{label}: the file cannot be read ({reason}); check it") from None


def _first_problem(error: ValidationError, label: str, given: Mapping[str, Any]) -> str:
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
    if table == "posterior" and key in given:
        option = {"n_walkers": "walkers", "max_steps": "steps", "n_chains": "chains"}
        where, key = "", f"--{option.get(key, key)}"
    value = f"'{first['input']}'" if isinstance(first["input"], str) else str(first["input"])
    message = first["msg"].removeprefix("Input ").replace("should be", "expected")
    return f"{where}{key}: {message}, but got {value[:80]}; correct it"


# --------------------------------------------------------------------------- priors and bounds

_KINDS = ("half-normal", "log-normal", "normal", "uniform", "log-uniform", "flat")
_CALL = re.compile(r"\s*([a-z-]+)\s*(?:\(([^()]*)\))?\s*")


def _kind_of(name: str, unit: str) -> Kind | None:
    """The kind of a parameter; None for phi, which has no unit."""
    kind = name.split("[")[0]
    if kind == "phi":
        return None
    if kind == "V_mL":
        return VOLUME
    if kind.endswith("_s"):
        return Kind(TIME.name, TIME.unit, "48 ms")
    return Kind("a signal", unit, f"0.05 {unit}")


def flat_names(key: str, layout: Layout, where: str) -> list[str]:
    """The flat names that a key stands for: ``tau``, ``t0`` (all experiments) or ``t0[4]``.

    Raises CampaignError, with the nearest known key, if there are none.
    """
    short: dict[str, list[str]] = {}
    for name in layout.names:
        kind, bracket, rest = name.partition("[")
        plain = re.sub(r"_(s|mL|V)$", "", kind)
        for alias in {plain, kind}:
            short.setdefault(alias, []).append(name)
            if bracket:
                short.setdefault(f"{alias}[{rest}", []).append(name)
    if key in short:
        return short[key]
    known = sorted({re.sub(r"_(s|mL|V)$", "", n.split("[")[0]) for n in layout.names})
    close = difflib.get_close_matches(key, [k for k in short if "_" not in k[-3:]], n=1, cutoff=0.5)
    hint = f'write "{close[0]}"' if close else f"known are {', '.join(known)}"
    raise CampaignError(
        f"{where}: unknown parameter '{key[:80]}'; expected one to be known: {hint}"
    )


def _value(text: str, kind: Kind | None, where: str) -> float:
    if kind is not None:
        return read_quantity(text, kind, where)
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not isfinite(value):
        raise CampaignError(f"{where}: expected a number, but got '{text}'; write 0.5")
    return value


def read_prior(text: str, name: str, unit: str, where: str) -> Prior:
    """The prior that a text such as ``half-normal(200 ms)`` stands for.

    >>> read_prior("log-normal(850 ms, 1.5)", "tau_v_s", "V", "tau_v")
    Prior(kind='log_normal', a=0.85, b=1.5)
    """
    match = _CALL.fullmatch(text)
    example = 'half-normal(200 ms)"' if name.endswith("_s") else 'uniform(low, high)"'
    if match is None or match[1] not in _KINDS:
        raise CampaignError(
            f"{where}: expected a prior such as \"{example}, but got '{text[:80]}'; "
            f"known are {', '.join(_KINDS)}"
        )
    law = match[1]
    parts = [part.strip() for part in (match[2] or "").split(",") if part.strip()]
    wanted = {"flat": 0, "half-normal": 1}.get(law, 2)
    if len(parts) != wanted:
        raise CampaignError(
            f"{where}: {law} takes {wanted} numbers, but got {len(parts)} in '{text[:80]}'; "
            "correct it"
        )
    kind = _kind_of(name, unit)
    second = None if law == "log-normal" else kind
    values = [_value(p, k, where) for p, k in zip(parts, (kind, second), strict=False)]
    if law in ("uniform", "log-uniform") and not values[0] < values[1]:
        raise CampaignError(f"{where}: expected low < high, but got '{text[:80]}'; swap them")
    must_be_positive = {"half-normal": 0, "log-normal": 0, "log-uniform": 0, "normal": 1}
    if law in must_be_positive and not min(values[must_be_positive[law] :]) > 0:
        raise CampaignError(
            f"{where}: expected positive numbers, but got '{text[:80]}'; correct it"
        )
    return Prior(law.replace("-", "_"), *values)


def make_problem(campaign: Campaign, overrides: Overrides, label: str) -> Problem:
    """The campaign with the noise law and the priors that were asked for."""
    noise = Noise(**overrides.noise.model_dump())
    layout = Layout.of(campaign, noise.per_experiment)
    priors: dict[str, Prior] = {}
    # a key for one experiment wins over one for all, whatever their order
    for key in sorted(overrides.priors, key=lambda k: "[" in k):
        where = f"{label}: [priors] {key}"
        for name in flat_names(key, layout, where):
            priors[name] = read_prior(overrides.priors[key], name, campaign.signal_unit, where)
    return Problem(campaign, noise=noise, given_priors=priors)


def fit_bounds(
    problem: Problem, overrides: Overrides, label: str
) -> dict[str, tuple[float, float]] | None:
    """Search bounds that were asked for, by flat name."""
    found: dict[str, tuple[float, float]] = {}
    unit = problem.campaign.signal_unit
    for key, pair in overrides.fit.bounds.items():
        where = f"{label}: [fit] bounds {key}"
        if len(pair) != 2:
            raise CampaignError(
                f"{where}: expected low and high, but got {len(pair)} values; "
                'write for example ["1 ms", "1 s"]'
            )
        for name in flat_names(key, problem.layout, where):
            low, high = (_value(v, _kind_of(name, unit), where) for v in pair)
            if not low < high:
                raise CampaignError(f"{where}: expected low < high, but got {pair}; swap them")
            found[name] = (low, high)
    return found or None
