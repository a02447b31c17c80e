"""First estimates from the records without a model: levels, times and search bounds."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np

from bayes_sensor.campaign import CampaignError, Experiment, FloatArray
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.likelihood.rise_time import DRIFT, UNSETTLED, moves_on
from bayes_sensor.likelihood.switch_ranges import after_step, step_begin, step_end, switch_ranges

LEAST_TAU = 0.1
"""lower bound of tau in sampling intervals, far below what samples can resolve"""
LEAST_SHARE = 1e-6
"""lower bound of a model's own parameter, of its prior's median, where the prior begins at zero"""
FARTHER = 10.0
"""times as far a lag is looked for that has ended at its bound"""


@dataclass(frozen=True)
class Look:
    """Levels and times read off one record, without a model."""

    on: float  # earliest start, s
    off: float  # earliest end, s, or the end of the record
    start_by: float  # the response is rising by then, s
    end_by: float  # .. and falling by then
    rise: float | None  # 10 to 90 %, s; None where no step is visible
    before: float
    step: float
    settled: bool = True  # False where the signal still moves when the step ends
    ranges: tuple[tuple[float, float], ...] = ()  # s, of what moves the switches, where not a pulse
    switches: tuple[tuple[float, float], ...] = ()  # s, each command and the time by which it shows
    has_fall: bool = True
    late: bool = False  # True where the signal moves on after the step's end

    @property
    def stretches(self) -> tuple[tuple[float, float], ...]:
        """Stretches (s) in which the signal may set off."""
        if self.switches:
            return self.switches
        return ((self.on, self.start_by), (self.off, self.end_by))[: 1 + self.has_fall]


def typical_rise(looks: Sequence[Look], otherwise: float) -> float:
    """s, the median rise of records whose step is visible; ``otherwise`` where none is."""
    rises = [look.rise for look in looks if look.rise is not None]
    return float(np.median(rises)) if rises else otherwise


def blocks(e: Experiment, start: float, end: float, n: int) -> tuple[FloatArray, FloatArray]:
    """Times and means of up to ``n`` stretches of used samples in [start, end)."""
    a = int(np.searchsorted(e.t, start - 1e-9 * e.interval))
    b = int(np.searchsorted(e.t, end - 1e-9 * e.interval))
    used = e.used[a:b]
    t, y = e.t[a:b][used], e.values[a:b][used]
    size = max(1, len(t) // n)
    m = len(t) // size * size
    return t[:m].reshape(-1, size).mean(axis=1), y[:m].reshape(-1, size).mean(axis=1)


def split(y: FloatArray) -> int:
    """Index at which a series is best divided into two constant parts: the first of the second."""
    n = len(y)
    centred = y - y.mean()
    left = np.cumsum(centred)[:-1]
    i = np.arange(1, n)
    return int(np.argmax(left**2 / i + left**2 / (n - i))) + 1


def first_look(e: Experiment) -> Look:
    """Of a programme of more than one pulse, the first step is looked at."""
    first, last = float(e.t[0]), float(e.t[-1]) + e.interval
    on = min(max(step_begin(e), first), last)
    off = last if e.commanded_off is None else min(max(e.commanded_off, on), last)
    done = e.commands
    if done is not None:
        if not done.recorded and len(done.times) > 1:
            off = min(max(step_end(e), on), last)
        look = replace(_first_step(e, on, off, first, last), ranges=tuple(switch_ranges(e)))
        if done.recorded:
            return replace(look, rise=None, switches=((first, last),))
        later = max(look.start_by - on, 2.0 * e.interval)
        return replace(look, switches=tuple((at, at + later) for at in done.times.tolist()))
    return replace(_first_step(e, on, off, first, last), has_fall=e.has_fall)


def _first_step(e: Experiment, on: float, off: float, first: float, last: float) -> Look:
    t, y = blocks(e, on, off, 1000)
    _, quiet = blocks(e, first, on, 200)
    if len(y) < 8:
        level = float(e.values[e.used].mean())
        return Look(on, off, off, last, None, level, 0.0)
    cut = split(y)
    before = float(np.median(quiet)) if len(quiet) >= 5 else float(y[:cut].mean())
    after = y[cut:]
    top = float(np.median(after[-max(1, len(after) // 4) :]))
    step = top - before
    noise = float(np.median(np.abs(np.diff(y)))) / 0.954  # of a block; robust against the rise
    if len(quiet) >= 5:
        noise = max(noise, float(np.std(quiet)))
    end_by = last
    if off < last:
        t_fall, y_fall = blocks(e, off, last, 1000)
        if len(y_fall) >= 8:
            end_by = float(t_fall[split(y_fall)])
    begin, end = after_step(e)
    _, later = blocks(e, begin, end, max(1, int((end - begin) / (t[1] - t[0]))))
    late = moves_on(after - before, later - before, noise) is not None
    if abs(step) < 4.0 * noise:
        middles = 0.5 * (on + off), 0.5 * (off + last)
        return Look(on, off, *middles, None, before, step, late=late)
    half = len(after) // 2
    drift = float(np.median(after[-half:]) - np.median(after[:half])) if half >= 4 else 0.0
    settled = abs(drift) < max(DRIFT * abs(step), 6.0 * noise * sqrt(2.0 / max(half, 1)))
    x = (y - before) / step
    low = np.flatnonzero(x[:cut] < 0.1)
    high = np.flatnonzero(x[max(cut - 1, 0) :] >= 0.9)
    begin = t[low[-1]] if len(low) else t[0]
    finish = t[max(cut - 1, 0) + high[0]] if len(high) else t[-1]
    width = t[1] - t[0]
    rise = max(float(finish - begin), width)
    return Look(on, off, float(t[cut]), end_by, rise, before, step, settled, late=late)


def initial_bounds(
    problem: Problem, looks: list[Look], given: Mapping[str, tuple[float, float]] | None
) -> dict[str, tuple[float, float]]:
    """Search bounds by flat name, from the records and their commanded times alone."""
    campaign, layout = problem.campaign, problem.layout
    rises = [look.rise for look in looks if look.rise is not None]
    slowest = max(rises) if rises else max(0.25 * (look.off - look.on) for look in looks)
    flow = max(e.total_flow for e in campaign)
    least = LEAST_TAU * min(e.interval for e in campaign)
    slowest = max(slowest, 100.0 * least)
    unsettled = [look.off - look.on for look in looks if not look.settled]
    most = 3.0 * slowest if not unsettled else UNSETTLED * max(3.0 * slowest, *unsettled)
    bounds: dict[str, tuple[float, float]] = {}
    for i, name in enumerate(layout.shared_names):
        # the first of several lags is the shortest
        longest = slowest if i == 0 and layout.one_sensor and layout.rig.n_lags > 1 else most
        factor = flow if name.startswith("V_") else 1.0
        bounds[name] = (least * factor, longest * factor)
    for k, (e, look) in enumerate(zip(campaign, looks)):
        y = e.values[e.used]
        low, high = float(y.min()), float(y.max())
        spread = max(high - low, 1e-12 * max(abs(high), abs(low)), 1e-300)
        bounds[f"y0_V[{e.name}]"] = (low - spread, high + spread)
        # where no plateau is reached, the step may be as much higher as the lag is longer
        reach = 3.0 * spread if look.settled else 10.0 * UNSETTLED * spread
        if e.commands is not None:  # beta is of an input of 1
            reach /= float(np.ptp(np.append(e.commands.levels, e.commands.rest)))
        bounds[f"beta_V[{e.name}]"] = (-reach, reach)
        kinds, record = layout.switching[k].names, layout.records[k]
        ranges = look.ranges
        if not ranges:
            soon = 2.0 * e.interval
            ranges = (
                (look.on, max(look.start_by, look.on + soon)),
                (look.off, max(look.end_by, look.off + soon)),
            )
        for kind, (low, high) in zip(kinds, ranges, strict=False):
            name = f"{kind}[{record}]"
            known = bounds.get(name, (low, high))  # of another sensor
            bounds[name] = (min(low, known[0]), max(high, known[1]))
    for name in layout.extra:
        law = problem.priors[name].law if name in problem.priors else None
        bounds[name] = (-inf, inf)
        if law is not None:  # all that the prior allows, but for a zero that models divide by
            low, high = law.support()
            bounds[name] = (low or LEAST_SHARE * law.median(), high)
    bounds = {name: (float(low), float(high)) for name, (low, high) in bounds.items()}
    for name, pair in (given or {}).items():
        if name not in bounds:
            raise CampaignError(
                f"bounds: no parameter '{name}' in the search; there are {', '.join(bounds)}"
            )
        bounds[name] = pair
    for name, value in problem.held.items():
        bounds[name] = (value, value)
    # lags stand in their places by size
    lags = [layout.shared_names[i] for i in problem.commuting.without_volumes.places]
    for i, name in enumerate(lags):
        if name in problem.held:
            for shorter in lags[:i]:
                low, high = bounds[shorter]
                bounds[shorter] = (min(low, problem.held[name]), min(high, problem.held[name]))
            for longer in lags[i + 1 :]:
                low, high = bounds[longer]
                bounds[longer] = (max(low, problem.held[name]), max(high, problem.held[name]))
    return bounds


def farther_bounds(
    problem: Problem,
    theta: FloatArray,
    bounds: Mapping[str, tuple[float, float]],
    given: Container[str],
    late: bool = False,
) -> dict[str, tuple[float, float]] | None:
    """Search bounds ten times as far for lags and steps, and as far as commands allow for switch
    times, where a lag of ``theta`` (n_mean, ..) ends at the upper end of its own, or a signal is
    ``late``; else None.  What is ``given`` stays as it is.

    A record whose step is too short or too noisy for its lag to be read off is not known as such.
    """
    layout = problem.layout
    free = [name for name in layout.shared_names if name not in given and name not in problem.held]
    if not late and all(theta[layout.index(name)] <= 0.99 * bounds[name][1] for name in free):
        return None
    steps = [name for name in bounds if name.startswith("beta_V") and name not in given]
    farther = {name: (bounds[name][0], FARTHER * bounds[name][1]) for name in free}
    farther |= {name: (FARTHER * bounds[name][0], FARTHER * bounds[name][1]) for name in steps}
    for k, e in enumerate(problem.campaign):
        kinds, record = layout.switching[k].names, layout.records[k]
        for kind, (_, end) in zip(kinds, switch_ranges(e), strict=False):
            if (name := f"{kind}[{record}]") not in given and name not in problem.held:
                low, high = farther.get(name, bounds[name])
                farther[name] = (low, max(high, end))
    return {**bounds, **farther}
