"""Draws of the lags that lie between the input and the record, from where they were measured."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.quantities import Kind, read_quantity, read_spread
from bayes_sensor.io.result_schema import read_result
from bayes_sensor.io.untrusted import refused
from bayes_sensor.posterior.save_draws import load_chains

LAG = Kind("a lag", "s", "40 min")
N_STATED = 4096
"""draws of lags that are stated as mean and standard deviation"""
SAME_FLOW = 0.01
"""share by which flows may differ and be the same"""
PLACES = ("rig", "sensor")
"""what can be restored: what entered the rig, or what reached the sensor"""


@dataclass(frozen=True, eq=False)
class LagDraws:
    """Draws of the lags of a chain; their order does not matter, as lags commute."""

    draws: FloatArray
    """(n, n_lags) s"""
    source: str
    """where they come from, in words"""
    remarks: tuple[str, ...] = ()
    """what is to be known of them, in sentences"""
    doubts: tuple[str, ...] = ()
    """why the band may not hold the input"""

    def __post_init__(self) -> None:
        good = self.draws.ndim == 2 and self.draws.size and np.isfinite(self.draws).all()
        if not good or (self.draws < 0).any():
            raise CampaignError(
                f"{self.source}: expected draws of lags (n, n_lags), finite and not negative, but "
                f"got an array of shape {self.draws.shape}; give lags in seconds"
            )
        slowest = self.draws.max(axis=1)
        mean, sd = float(slowest.mean()), float(slowest.std())
        if mean - 2.0 * sd <= 0.0:
            raise CampaignError(
                f"{self.source}: the longest lag is {mean:.4g} +- {sd:.2g} s and may be zero: an "
                "upper limit restores nothing; measure the lag with steps that it can be seen in"
            )

    def spread_out(self, n: int) -> FloatArray:
        """(n, n_lags) s, draws at evenly spaced probabilities of the longest lag."""
        order = np.argsort(self.draws.max(axis=1), kind="stable")
        places = ((np.arange(n) + 0.5) / n * len(order)).astype(int)
        found = self.draws[order[places]]
        # no lag of exactly zero: it has no state
        least = 1e-6 * float(np.median(self.draws.max(axis=1)))
        return np.asarray(np.maximum(found, least))


def stated_lags(texts: str | Sequence[str], seed: int = 1, label: str = "lags") -> LagDraws:
    """Draws of lags such as ``"40 +- 2 min"``; without ``+-`` a lag is taken as known.

    A lag is positive: the draws are log-normal of that mean and standard deviation.  ``label``:
    what messages call them.

    >>> stated_lags("40 +- 2 min").draws.mean().round(-1)
    np.float64(2400.0)
    """
    texts = [texts] if isinstance(texts, str) else list(texts)
    if not texts:
        raise CampaignError(f'{label}: expected at least one lag; give {label} "40 +- 2 min"')
    rng = np.random.default_rng(seed)
    columns = []
    for text in texts:
        mean, sd = _spread(text, label)
        if sd == 0.0:
            columns.append(np.full(N_STATED, mean))
            continue
        if mean - 2.0 * sd <= 0.0:
            raise CampaignError(
                f"{label}: '{text}' may be zero: an upper limit restores nothing; give a lag that "
                "was measured to better than half of its size"
            )
        width = np.sqrt(np.log1p((sd / mean) ** 2))
        columns.append(mean * np.exp(width * rng.standard_normal(N_STATED) - 0.5 * width**2))
    return LagDraws(np.stack(columns, axis=1), f"stated lags ({', '.join(texts)})")


def _spread(text: Any, label: str) -> tuple[float, float]:
    if isinstance(text, str) and text.strip().startswith("<"):
        raise CampaignError(
            f"{label}: '{text[:60]}' is an upper limit, which restores nothing; expected a "
            'measured lag such as "40 +- 2 min"'
        )
    if isinstance(text, str) and not any(mark in text for mark in ("+-", "+/-", "±")):
        mean = read_quantity(text, LAG, label)
        if mean <= 0.0:
            raise CampaignError(
                f"{label}: expected a positive lag, but got '{text}'; give one such as "
                f'"{LAG.example}"'
            )
        return mean, 0.0
    return read_spread(text, LAG, label)


def posterior_lags(
    posterior: Any, at: str = "rig", flow: float | None = None, sensor: str | None = None
) -> LagDraws:
    """Draws of the lags of a posterior's rig.

    Parameters
    ----------
    posterior
        as from ``sample_posterior``, or anything that has one as ``.posterior``.
    at
        ``"rig"``: what entered the rig is restored, through all lags that do not depend on flow.
        ``"sensor"``: what reached the sensor, through the sensor's own lag.
    flow
        mL/s, total flow of the record; then the volume's lag V/flow counts as well.
    sensor
        whose record it is, where the posterior has several.
    """
    posterior = getattr(posterior, "posterior", posterior)
    _check_place(at)
    problem, layout = posterior.problem, posterior.problem.layout
    names = layout.sensor_names if layout.sensors_are_named else ()
    own = layout.value_names[0]
    told = _doubts(getattr(posterior, "caveats", ()))
    if names or sensor is not None:
        own = layout.value_names[names.index(_sensor(names, sensor, "the posterior"))]
    if at == "sensor":
        source, factor = layout.sources[own]
        undecided = source == "tau_s" and posterior.naming.order == "undecided"
        remark = "which lag is the sensor's is undecided: the band holds all of them"
        lag = factor * np.asarray(posterior.of(source))[:, None]
        return LagDraws(lag, _of_sensor(sensor), (remark,) if undecided else (), told)
    common = problem.flow
    if flow is not None and common is not None and abs(flow / common - 1.0) > SAME_FLOW:
        raise CampaignError(
            f"flow: all experiments had a total flow of {common:.4g} mL/s, but the record has "
            f"{flow:.4g} mL/s; which lag changes with the flow is not known: add experiments at "
            "another flow"
        )
    lags = [*np.asarray(posterior.lags).T]
    for stage in layout.rig.stages:
        source, factor = layout.sources[own if stage.name == "sensor" else stage.parameter]
        if source in problem.commuting.names or (stage.kind.depends_on_flow and flow is None):
            continue
        value = factor * np.asarray(posterior.of(source))
        lags += stage.kind.passage(value, np.nan if flow is None else flow).lags
    return LagDraws(np.column_stack(lags), "the posterior of the rig's lags", (NO_ORDER,), told)


def _sensor(names: Sequence[str], sensor: str | None, where: str) -> str:
    """The sensor whose record it is; CampaignError where that is not said, or is none of them."""
    if sensor is None and len(names) == 1:
        return names[0]
    if sensor is None:
        raise CampaignError(
            f"{where} has {len(names)} sensors ({', '.join(names)}), and a record is that of one; "
            f"expected to be told which: give --sensor {names[0]}"
        )
    if sensor not in names:
        known = f"those are {', '.join(names)}" if names else "it has one sensor, without a name"
        raise CampaignError(
            f"sensor: expected a sensor of {where}, but got '{sensor[:40]}'; {known}: correct it "
            "or leave it out"
        )
    return sensor


def _of_sensor(sensor: str | None) -> str:
    return "the sensor's lag" if sensor is None else f"the lag of sensor {sensor}"


NO_ORDER = "lags commute: which of them is the sensor's makes no difference to what is restored"


def saved_lags(
    folder: Path, at: str = "rig", flow: float | None = None, sensor: str | None = None
) -> LagDraws:
    """Draws of the lags from ``posterior.nc`` of a results folder; as :func:`posterior_lags`."""
    _check_place(at)
    path = folder / "posterior.nc"
    if not os.path.lexists(path):
        raise CampaignError(
            f"{folder}: expected a results folder with posterior.nc, but there is none; run "
            "bayes-sensor posterior with --out there first"
        )
    if read_result(folder / "campaign.json").get("ties"):
        raise CampaignError(
            f"{folder}: parameters are tied, so that one lag stands for several; expected the "
            "campaign's TOML file instead: give that, or the analysis in Python"
        )
    record = read_result(folder / "posterior.json")
    told = _doubts(record.get("caveats") or [])
    names, chains = load_chains(path)
    columns = dict(zip(names, chains.reshape(-1, chains.shape[-1]).T, strict=True))
    sensors = [name[len("tau_s[") : -1] for name in columns if name.startswith("tau_s[")]
    own = "tau_s"
    if sensors or sensor is not None:
        own = f"tau_s[{_sensor(sensors, sensor, str(path))}]"
    if at == "sensor":
        if own not in columns:
            raise CampaignError(
                f"{path}: which lag is the sensor's is undecided; say sensor_is in the campaign, "
                "or restore what entered the rig with --at rig"
            )
        return LagDraws(columns[own][:, None], f"{_of_sensor(sensor)} in {path}", (), told)
    kept = [
        name
        for name in columns
        if name.startswith(("tau", "lag_")) and (name == own or not name.startswith("tau_s["))
    ]
    lags = np.stack([columns[name] for name in kept], axis=1)
    n_lags = len(record["lags_s"]) + bool(sensors)
    if not kept:
        raise refused(path, "draws of lags", "there are none")
    if len(kept) < n_lags:
        raise CampaignError(
            f"{path}: all experiments had one total flow, so that the volume's lag is one of "
            f"{n_lags}; give the campaign's TOML file instead, which says that flow"
        )
    if flow is not None:
        volumes = [values / flow for name, values in columns.items() if name.startswith("V_")]
        lags = np.column_stack([lags, *volumes])
    return LagDraws(lags, f"the lags in {path}", (NO_ORDER,), told)


def _doubts(caveats: Sequence[str]) -> tuple[str, ...]:
    """What the step experiments say against the lags that they gave."""
    return tuple(f"the band rests on the lags of the step experiments. {text}" for text in caveats)


def _check_place(at: str) -> None:
    if at not in PLACES:
        raise CampaignError(f"at: expected 'rig' or 'sensor', but got '{at}'; write one of them")
