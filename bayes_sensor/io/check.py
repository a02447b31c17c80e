"""What was understood of a campaign, before anything is fitted: one row per experiment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import (
    STAGES,
    BoolArray,
    Campaign,
    Experiment,
    FloatArray,
    not_a_campaign,
)
from bayes_sensor.io.step_remarks import step_remarks
from bayes_sensor.io.steps import LEAST, find_steps, largest_change

if TYPE_CHECKING:
    import pandas as pd

BLOCKS = 10
"""stretches into which baseline and plateau are cut at most, to tell noise from drift"""
FEWEST = 30
"""samples of such a stretch: a line through fewer takes correlated noise for drift"""
SAME_FLOW = (
    "all experiments have the same total flow, so valve and manifold (tau_v and V) cannot be told "
    "apart"
)
SEEN = 4.0
"""standard errors above which a step counts as seen"""
LARGER = 1.1
"""ratio from which on one flow counts as larger than another"""
QUIET = 0.04
"""share of the step that the noise may have where a rise is timed"""
SLOWER = 0.1
"""share by which a rise at the larger flow must be the longer one to be remarked on: causes other
than a wrong flow, such as a valve that varies, rarely do as much"""


@dataclass(frozen=True)
class Level:
    """A stretch of nearly constant signal; NaN where there are too few samples."""

    median: float
    noise: float
    """robust standard deviation about a straight line per block"""
    error: float
    """standard error of the median, from the scatter between blocks"""


def check_campaign(campaign: Campaign) -> pd.DataFrame:
    """What was understood, as a table with one row per experiment.

    Columns: ``experiment``, ``samples`` (on the grid), ``used``, ``interval_s``, ``duration_s``,
    ``carrier_flow_L_min``, ``test_gas_flow_L_min``, ``total_flow_L_min``,
    ``concentration_percent``, ``commanded_on_s``, ``commanded_off_s``, ``switches`` (of
    the input; 0 where it was recorded), ``baseline_V`` (median before the command, or of the first
    twentieth where no command is known), ``step_V`` (median of the second half of the plateau less
    the baseline), ``noise_V`` (robust standard deviation of the baseline without drift),
    ``plateau_noise_V``, ``source`` and ``warnings``.  Columns in ``_V`` are in the campaign's
    ``signal_unit``; what is unknown is NaN.
    """
    import pandas as pd  # slow to import

    if not isinstance(campaign, Campaign):
        raise not_a_campaign(campaign)
    return pd.DataFrame(campaign_rows(campaign))


def campaign_rows(campaign: Campaign, remarks: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """The rows of :func:`check_campaign`'s table, one mapping per experiment.

    ``remarks``: those of :func:`campaign_remarks`, where they are known.
    """
    remarks = campaign_remarks(campaign) if remarks is None else remarks
    rows = []
    for experiment in campaign:
        baseline, plateau = levels(experiment)
        mine = [text for text in remarks if text.startswith(f"experiment '{experiment.name}'")]
        rows.append(
            {
                "experiment": experiment.name,
                "samples": len(experiment.t),
                "used": experiment.n_samples,
                "interval_s": experiment.interval,
                "duration_s": round(len(experiment.t) * experiment.interval, 9),
                "carrier_flow_L_min": _litres(experiment.carrier_flow),
                "test_gas_flow_L_min": _litres(experiment.test_gas_flow),
                "total_flow_L_min": experiment.total_flow * 0.06,
                "concentration_percent": (
                    100 * experiment.concentration if experiment.flow_known else np.nan
                ),
                "commanded_on_s": _or_nan(experiment.commanded_on),
                "commanded_off_s": _or_nan(experiment.commanded_off),
                "switches": _switches(experiment),
                "baseline_V": baseline.median,
                "step_V": plateau.median - baseline.median,
                "noise_V": baseline.noise,
                "plateau_noise_V": plateau.noise,
                "source": experiment.source,
                "warnings": "; ".join(mine),
            }
        )
    return rows


def _switches(e: Experiment) -> int:
    """How often the input switches; 0 where it was recorded."""
    if e.commands is None:
        return 1 + e.has_fall
    return 0 if e.commands.recorded else len(e.commands.times)


def _litres(flow: float | None) -> float:
    """L/min; nan where it is not known."""
    return np.nan if flow is None else 0.06 * flow


def campaign_remarks(campaign: Campaign) -> tuple[str, ...]:
    """The reader's warnings and what the numbers of the table suggest, in sentences."""
    remarks = list(campaign.warnings)
    for experiment in campaign:
        if experiment.y is None:
            continue
        where = _where(experiment)
        alone = experiment.commands is None and experiment.commanded_off is None
        fallen = alone and falls_back(experiment)
        end = (
            f"{where}: the record ends where it began, as after a fall, but the command of one is "
            "unknown, and the model holds the plateau to the end: give commanded_off or drive, or "
            "crop with keep"
        )
        remarks += step_remarks(experiment, where, falls_back=fallen)
        if experiment.commands is not None:
            continue  # levels and a plateau are those of one pulse
        if experiment.commanded_on is None:
            remarks += [end] * fallen
            remarks.append(
                f"{where}: the commanded time is unknown; delays cannot be computed, give "
                "commanded_on or drive"
            )
            continue
        baseline, plateau = levels(experiment)
        step = plateau.median - baseline.median
        if np.isnan(baseline.median):
            remarks.append(f"{where}: no baseline is recorded before the command")
        elif np.isnan(plateau.median):
            remarks.append(f"{where}: no plateau is recorded after the command")
        elif fallen:
            remarks.append(end)
        elif abs(step) <= SEEN * np.hypot(baseline.error, plateau.error):
            remarks.append(
                f"{where}: no step is seen (it is {step:.3g} {campaign.signal_unit}, with a "
                f"standard error of {np.hypot(baseline.error, plateau.error):.2g})"
            )
        else:
            remarks += _hidden_step(experiment, abs(step), where, campaign.signal_unit)
    remarks += _recorded_twice(campaign)
    remarks += _flows_exchanged(campaign)
    several = len(campaign) > 1 and campaign.flows_known and campaign.same_flow
    if several and campaign.stages == STAGES:
        remarks.append(SAME_FLOW)
    return tuple(remarks)


def _where(experiment: Experiment) -> str:
    file = f" ({experiment.source})" if experiment.source else ""
    return f"experiment '{experiment.name}'{file}"


def _hidden_step(e: Experiment, step: float, where: str, unit: str) -> list[str]:
    """A remark if a record shows no step because something else in it is far larger.

    ``step``: its size between the levels before and late after the command.
    """
    if e.y is None or find_steps(e.t[e.used], e.y[e.used]):
        return []
    change = largest_change(e.t[e.used], e.y[e.used])
    if step >= LEAST * change:
        return []
    return [
        f"{where}: the step ({step:.3g} {unit}) is hidden by a change of {change:.3g} {unit} in "
        "the same record, such as a spike of the valve; leave that out with mask, or leave out the "
        "experiment"
    ]


def _recorded_twice(campaign: Campaign) -> list[str]:
    """Remarks on experiments whose samples another one has, too."""
    seen: dict[bytes, Experiment] = {}
    remarks = []
    for e in campaign:
        if e.y is None:
            continue
        first = seen.setdefault(sha256(e.y.tobytes()).digest(), e)
        if first is not e:
            remarks.append(
                f"{_where(e)}: has the samples of {_where(first)}, which then count twice; correct "
                "its file, or leave one of them out"
            )
    return remarks


def _flows_exchanged(campaign: Campaign) -> list[str]:
    """A remark if records rise more slowly than others though their flow is larger.

    Only where one exchange of two flows would put everything right: a rig whose rises do not follow
    the flow at all has another fault.
    """
    timed = [(e, *rise_time(e)) for e in campaign]
    timed = [(e, rise, error) for e, rise, error in timed if np.isfinite(rise)]
    flow = np.array([e.total_flow for e, _, _ in timed])
    rise = np.array([rise for _, rise, _ in timed])
    error = np.array([error for _, _, error in timed])
    longer = rise[:, None] - rise > SLOWER * rise + SEEN * np.hypot(error[:, None], error)

    def wrong(flow: FloatArray) -> BoolArray:
        return np.asarray(longer & (flow[:, None] > LARGER * flow))

    def exchanged(i: int, j: int) -> FloatArray:
        other = flow.copy()
        other[[i, j]] = flow[[j, i]]
        return other

    pairs = np.argwhere(wrong(flow)).tolist()
    right = [(i, j) for i, j in pairs if not wrong(exchanged(i, j)).any()]
    if not right:
        return []
    i, j = max(right, key=lambda pair: float(flow[pair[0]] / flow[pair[1]]))
    return [
        f"{_where(timed[i][0])}: takes longer from a quarter to three quarters of its step "
        f"({rise[i]:.3g} s) than {_where(timed[j][0])} ({rise[j]:.3g} s), though its total flow is "
        f"larger ({0.06 * flow[i]:.3g} against {0.06 * flow[j]:.3g} L/min); check that their flows "
        "are not exchanged"
    ]


def rise_time(experiment: Experiment) -> tuple[float, float]:
    """Time from a quarter to three quarters of the step after the command (s), standard error.

    The signal is averaged until its noise is small beside the step.  NaN where no command, level
    or step is known, and where the average would be longer than half of the rise.
    """
    nothing = float("nan"), float("nan")
    if experiment.y is None or experiment.commanded_on is None:
        return nothing
    baseline, plateau = levels(experiment)
    step = plateau.median - baseline.median
    if not abs(step) > SEEN * np.hypot(baseline.error, plateau.error):
        return nothing
    t, used = experiment.t, experiment.used
    after = (t >= experiment.commanded_on) & (t < _end(experiment))
    height = (np.interp(t[after], t[used], experiment.y[used]) - baseline.median) / step
    total = np.concatenate([[0.0], np.cumsum(height)])
    found = nothing
    h = 1
    while h <= len(height) // 20:
        smooth = (total[h:] - total[:-h]) / h
        late = smooth[len(smooth) // 2 :: len(smooth) // 40_000 + 1]  # enough for a median
        noise = _spread(late)
        inside = int(((smooth >= 0.25) & (smooth < 0.75)).sum())
        if noise <= QUIET and inside >= 2 * h:
            rise = inside * experiment.interval
            # an error of the height is one of time by the rise's mean slope, at either end
            found = rise, float(np.sqrt(2.0) * 2.0 * noise * rise)
        if noise <= QUIET and inside < 16 * h:  # a longer average would widen the rise itself
            break
        h *= 2
    return found


def falls_back(experiment: Experiment) -> bool:
    """Whether the record's ends are alike and its middle is far from both."""
    if experiment.y is None or experiment.n_samples < BLOCKS * BLOCKS:
        return False
    blocks = np.array_split(experiment.y[experiment.used], 2 * BLOCKS)
    medians = np.array([np.median(block) for block in blocks])
    noise = max(_level(blocks[0]).noise, _level(blocks[-1]).noise)
    step = float(np.abs(medians - medians[0]).max())
    return bool(abs(medians[-1] - medians[0]) < 0.2 * step and step > 2 * SEEN * noise)


def levels(experiment: Experiment) -> tuple[Level, Level]:
    """Baseline and plateau of an experiment."""
    if experiment.y is None:
        return _level(np.empty(0)), _level(np.empty(0))
    before, late = _quiet(experiment)
    return _level(experiment.y[before]), _level(experiment.y[late])


def quiet_spans(experiment: Experiment) -> list[tuple[float, float, float]]:
    """Start, end (s) and median (V) of the stretches that :func:`levels` reads."""
    spans = []
    if experiment.y is not None:
        for where in _quiet(experiment):
            if where.any():
                t = experiment.t[where]
                spans.append((float(t[0]), float(t[-1]), float(np.median(experiment.y[where]))))
    return spans


def _quiet(experiment: Experiment) -> tuple[BoolArray, BoolArray]:
    """(n_t,) True in the baseline, and in the second half of the plateau."""
    t, used = experiment.t, experiment.used
    on = experiment.commanded_on
    if on is None:
        first = np.arange(len(t)) < max(len(t) // 20, 2)
        return used & first, np.zeros(len(t), dtype=bool)
    end = _end(experiment)
    return used & (t < on), used & (t >= (on + end) / 2) & (t < end)


def _end(experiment: Experiment) -> float:
    """When the first plateau ends (s): at the next command, or with the record."""
    if experiment.commands is not None and len(experiment.commands.times) > 1:
        return float(experiment.commands.times[1])
    if experiment.commanded_off is not None:
        return experiment.commanded_off
    return float(experiment.t[-1]) + experiment.interval


def _spread(y: FloatArray) -> float:
    """Standard deviation as the median deviation from the median tells it."""
    return 1.4826 * float(np.median(np.abs(y - np.median(y))))


def _level(y: FloatArray) -> Level:
    """Median, noise and standard error of a stretch."""
    if len(y) < 2:
        return Level(float("nan"), float("nan"), float("nan"))
    blocks = np.array_split(y, max(min(BLOCKS, len(y) // FEWEST), 1))
    if len(blocks) < 2:
        spread = _spread(y)
        return Level(float(np.median(y)), spread, spread / np.sqrt(len(y)))
    residuals = []
    for block in blocks:
        x = np.arange(len(block)) - (len(block) - 1) / 2
        residual = block - block.mean() - x * ((x * block).sum() / (x * x).sum())
        residuals.append(residual * np.sqrt(len(block) / (len(block) - 2)))
    noise = 1.4826 * float(np.median(np.abs(np.concatenate(residuals))))
    means = np.array([block.mean() for block in blocks])
    return Level(float(np.median(y)), noise, float(means.std(ddof=1) / np.sqrt(len(means))))


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value
