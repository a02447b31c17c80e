"""Something else, again: what happens once, and what rings after a switch.

The noise floor comes from the quiet stretches, so an event that befalls one of them raises the
floor it is judged by, and bins average what is shorter than they are.  Two tests at full rate ask
for what stationary Gaussian noise of *any* spectrum does not do: to be much larger somewhere than
it usually is at the same time scale, and to oscillate after the switches more than elsewhere.
Both count as unlisted, whatever explains the rest.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import logsumexp
from scipy.stats import norm
from scipy.stats import t as student_t

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.gap.bins import ExperimentBins
from bayes_sensor.gap.floor import DOF, Stretch, detrended
from bayes_sensor.gap.full_rate import FullRate, any_of, struck
from bayes_sensor.gap.refit import Refit

BLOCK = 0.05
"""s, means over which events are looked for"""
WIDTHS = (0.15, 0.25, 0.42, 0.7, 1.15, 1.9, 3.1, 5.0)
"""s, of a bump or of the means on either side of a jump"""
EVENT_RATIOS = (4.0, 16.0, 64.0)
"""an event's plausible variance over the noise's"""
LOCAL = 20
"""blocks over which the local size of the noise is taken"""
STRUCK = 0.3
"""plausible share of stretches with an event, where there are any"""
MEDIAN_EFFICIENCY = 0.37
"""of a spread taken from the median of absolute values (Hampel 1974)"""
TAIL_CAUTION = 1.5
"""standard errors of the tails' length that are given to a Gaussian"""
TAIL_LEVELS = (0.95, 0.99)
TAIL_DOFS = np.array([2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 25.0, 50.0, 100.0])
HEAVY_DOF = 8.0
"""degrees of freedom where single samples are heavy-tailed"""
FOOTPRINT = 5.0
"""widths over which an event is seen"""
SPARE = 0.2
"""share of what lies beyond a quantile that one event may make up"""
_HALF = [0.5 + 0.5 * level for level in TAIL_LEVELS]
_RATIOS = [student_t.ppf(h, TAIL_DOFS) / student_t.ppf(0.75, TAIL_DOFS) for h in _HALF]
_SLOPES = [2.0 * float(norm.pdf(norm.ppf(h)) * norm.ppf(h)) for h in _HALF]

PATCH_SPAN = (-1.2, 8.0)
"""time scales around a switch"""
PATCH_BINS = (1, 2, 3, 4, 6)
"""bins in a run"""

BREAK_LENGTHS = (1, 2, 3, 5, 8, 13, 21)
"""bins that a passing change lasts"""
ABSORBED = 0.1
"""share of a change that a refit must leave of it, for the change to be looked for"""

RINGING_BLOCK = 0.005
"""s"""
DAMPING = (0.15, 0.4, 1.0, 2.0)
"""s, times in which a ringing dies away"""
BEGINS = np.arange(-7, 8) * 0.05
"""s, when it may begin, from the fitted switch"""
RINGING_HZ = (3.5, 60.0)
RINGING_RATIOS = (0.5, 1.0, 2.5, 6.0, 15.0, 40.0)
TILT = 1.0
"""Hz, over which the slope of a spectrum may change from one window to the next"""
IN_PHASE_BLOCK = 0.01
"""s"""
FEWEST_SWITCHES = 6
IN_PHASE_HZ = (0.7, 25.0)
IN_PHASE_DAMPING = (0.4, 1.0, 2.5, 6.0)
"""s, of a ringing that has the same phase after every switch"""
IN_PHASE_BEGINS = (0.0, 0.3, 0.8, 1.5)
"""s after the fitted switch; later ones leave out a misfit of the rise itself"""
IN_PHASE_CYCLES = 1.2
"""within one damping time, below which an oscillation is only a misfit that fades"""
IN_PHASE_RATIOS = (4.0, 16.0, 64.0)
"""a common amplitude's plausible variance over that of its estimate"""
FEWEST_WINDOWS = 10
"""quiet windows below which the usual power at a frequency is not known"""


@dataclass(frozen=True)
class Quiet:
    """Where one record is quiet, and what to scale it by."""

    switches: tuple[float, ...]
    """s"""
    spans: tuple[tuple[float, float], ...]
    """s, from settling to the next switch"""
    deviation: FloatArray
    """(n_t,) V, the noise's standard deviation at every sample"""
    step: float = 1.0
    """V, height of the plateau over the baseline"""


@dataclass(frozen=True)
class Events:
    """What befalls single stretches, and how much the noise alone makes look like it."""

    found: FullRate
    tails: tuple[float, float]
    """degrees of freedom of means over as long a time as is told, at carrier and plateau; inf for
    those of a Gaussian, or where nothing is told"""

    @property
    def lasting(self) -> float:
        """Degrees of freedom where both gases have long tails: then the noise itself has them."""
        return max(self.tails)


def look_for_events(
    campaign: Campaign, stretches: Sequence[Stretch], heavy_tailed: bool = False
) -> Events:
    """Bumps and jumps in single stretches.

    Differences of means (a bump against both its sides, after against before) are taken in units
    of how much samples change from one to the next there, so that gusts of noise are none, and
    scaled by their own median absolute value over all stretches with the same gas, so that the
    noise's spectrum does not matter and an event that is rare in time does not hide itself.
    ``heavy_tailed``: single samples are, and so means over a few of them may be.
    ``ln B`` of a stretch averages, over positions and the amplitude's plausible spread, the ratio
    of t densities; widths and shapes are averaged over for each stretch, or for all together,
    since what strikes again lasts as long again.  ``strength``: the clearest event's experiment
    (counted from 0), time in s and ratio to the usual.
    """
    blocks = [_blocks(campaign, s) for s in stretches]
    use = [(s, *made) for s, made in zip(stretches, blocks, strict=True) if made is not None]
    found: list[dict[Hashable, float]] = [{} for _ in use]
    largest, where, when = 0.0, 0, 0.0
    tails: dict[tuple[str, int], float] = {}
    for width in WIDTHS:
        for shape, middle in ((_bump, 2.5), (_jump, 1.0)):
            sizes = [max(1, round(width / dt)) for _, _, dt in use]
            made = [shape(x, q, m) for (_, (x, q), _), m in zip(use, sizes, strict=True)]
            for level in (0, 1):
                here = [k for k, u in enumerate(use) if u[0].level == level and len(made[k]) > 0]
                if not here:
                    continue
                usual = float(np.median(np.abs(np.concatenate([made[k] for k in here])))) / 0.6745
                if usual <= 0.0:
                    continue
                seconds = sum(len(made[k]) * use[k][2] for k in here)
                sizes_here = np.abs(np.concatenate([made[k] for k in here])) / usual
                measured = _tail_dof(sizes_here, seconds, width)
                # where records are too short to tell, tails are those of the widest that is told
                tail = tails.get((shape.__name__, level), np.inf) if measured is None else measured
                tails[shape.__name__, level] = tail
                dof = min(max(MEDIAN_EFFICIENCY * seconds / width, 3.0), tail)
                dof = min(dof, HEAVY_DOF) if heavy_tailed else dof
                for k in here:
                    square = (made[k] / usual) ** 2
                    found[k][width, shape.__name__] = _surprise(square, dof)
                    at = int(np.argmax(square))
                    # brought to a Gaussian's tails, so that widths compare
                    clear = float(dof * np.log1p(square[at] / dof))
                    if clear > largest:
                        stretch, _, dt = use[k]
                        largest, where = clear, stretch.experiment
                        when = stretch.begin + (at + middle * sizes[k]) * dt
    value = _alone_or_alike(found)
    strength = {"event_experiment": float(where), "event_s": when, "event_ratio": largest**0.5}
    found_event = FullRate("event", value, strength, float(np.sqrt(largest)))
    longest = [min((d for (_, at), d in tails.items() if at == g), default=np.inf) for g in (0, 1)]
    return Events(found_event, (longest[0], longest[1]))


def _blocks(campaign: Campaign, s: Stretch) -> tuple[tuple[FloatArray, FloatArray], float] | None:
    """Detrended means (n,) over BLOCK, mean squared changes (n,) from sample to sample, step (s).

    Both in units of the changes in the whole stretch.
    """
    h = campaign.experiments[s.experiment].interval
    size = max(1, round(BLOCK / h))
    n = len(s.samples) // size
    if n < 40:
        return None
    x = detrended(s.samples[: n * size])
    change = np.diff(x, prepend=x[0]) ** 2
    scale = float(np.sqrt(np.mean(change)))
    if scale <= 0.0:
        return None
    means = x.reshape(n, size).mean(axis=1) / scale
    return (means, change.reshape(n, size).mean(axis=1) / scale**2), size * h


def _bump(x: FloatArray, changes: FloatArray, m: int) -> FloatArray:
    """Means over m blocks minus those of 2 m on both sides; empty where the record is short."""
    if len(x) < 6 * m:
        return np.empty(0)
    c = np.concatenate([[0.0], np.cumsum(x)])
    i = np.arange(len(x) - 5 * m + 1)
    sides = (c[i + 2 * m] - c[i]) + (c[i + 5 * m] - c[i + 3 * m])
    made = (c[i + 3 * m] - c[i + 2 * m]) / m - sides / (4 * m)
    return np.asarray(made / _local(changes, i, 5 * m))


def _jump(x: FloatArray, changes: FloatArray, m: int) -> FloatArray:
    """Means over the m blocks after minus those before."""
    if len(x) < 6 * m:
        return np.empty(0)
    c = np.concatenate([[0.0], np.cumsum(x)])
    j = np.arange(len(x) - 2 * m + 1)
    return np.asarray((c[j + 2 * m] - 2.0 * c[j + m] + c[j]) / m / _local(changes, j, 2 * m))


def _local(changes: FloatArray, begins: NDArray[np.int64], length: int) -> FloatArray:
    """Root mean square of the changes within ``length`` blocks, at least LOCAL of them.

    At least that of the whole stretch, too: where noise moves more slowly for a while its changes
    are small and its means are not.
    """
    total = np.concatenate([[0.0], np.cumsum(changes)])
    wider = max(LOCAL - length, 0) // 2
    low = np.maximum(begins - wider, 0)
    high = np.minimum(begins + length + wider, len(changes))
    local: FloatArray = np.sqrt(np.maximum((total[high] - total[low]) / (high - low), 1.0))
    return local


def _tail_dof(sizes: FloatArray, seconds: float, width: float) -> float | None:
    """Degrees of freedom of the t law that is as long-tailed as ``sizes`` (n,), median .6745.

    Gusts and shots lengthen the tails at every time scale they act on; without that, each of them
    would be an event.  From ratios of quantiles to the median, less what the number of independent
    values leaves open, and none that a single event would move; None where no quantile is left.
    """
    found = []
    for level, ratios, slope in zip(TAIL_LEVELS, _RATIOS, _SLOPES, strict=True):
        if FOOTPRINT * width > SPARE * (1.0 - level) * seconds:
            continue
        ratio = float(np.quantile(sizes, level)) / 0.6745
        error = sqrt(level * (1.0 - level) / max(seconds / width, 1.0)) / slope
        ratio *= 1.0 - TAIL_CAUTION * error
        longer = ratio > ratios[-1]
        found.append(float(np.interp(-ratio, -ratios, TAIL_DOFS)) if longer else np.inf)
    return min(found, default=None)


def _surprise(square: FloatArray, dof: float) -> float:
    """ln of the mean over positions and spreads of the ratio of t densities."""
    return float(logsumexp(_surprises(square, dof)) - np.log(len(square)))


def _surprises(square: FloatArray, dof: float) -> FloatArray:
    """(n,) ln of the mean over spreads of the ratio of t densities, per position."""
    wider = 1.0 + np.array(EVENT_RATIOS)[:, None]
    logs = 0.5 * (dof + 1.0) * (np.log1p(square / dof) - np.log1p(square / dof / wider))
    logs -= 0.5 * np.log(wider)
    return np.asarray(logsumexp(logs, axis=0) - np.log(len(wider)))


def _alone_or_alike(found: Sequence[Mapping[Hashable, float]]) -> float:
    """ln B of places (records, switches), each with ln B per kind of what may strike there.

    What strikes has a kind of its own at every place, or the same at all of them.
    """
    means = [logsumexp(list(logs.values())) - np.log(len(logs)) for logs in found if logs]
    alone = float(struck(np.array(means), STRUCK).sum())
    alike: dict[Hashable, float] = {}
    for logs in found:
        for kind, value in logs.items():
            alike[kind] = alike.get(kind, 0.0) + float(struck(np.array(value), STRUCK))
    together = float(logsumexp(list(alike.values()))) - np.log(len(alike)) if alike else 0.0
    return float(np.logaddexp(alone, together) - np.log(2.0))


def look_for_patches(found: Refit, tail: float = np.inf) -> FullRate:
    """Runs of bins around single switches that lie on one side of a refit.

    What goes wrong at one switch and not, or elsewhere, at the next has no common shape, and a
    process that is free at every switch pays for all of them.  Per switch, ``ln B`` averages over
    runs of bins the ratio of densities of their whitened sum, wider against usual, the usual with
    the floor's degrees of freedom, or with those of the noise's own ``tail``; runs are averaged
    over for each switch, or for all together.
    """
    dof = min(DOF, tail)
    sketch = found.plan.sketch
    largest, where = 0.0, (0.0, 0.0)
    places: list[dict[Hashable, float]] = []
    for k, (rows, b) in enumerate(zip(sketch.rows, sketch.bins, strict=True)):
        z = found.residual[rows]
        for falling in (False, True):
            here = np.flatnonzero(
                (b.falling == falling)
                & (b.since > PATCH_SPAN[0] * sketch.time_scale)
                & (b.since < PATCH_SPAN[1] * sketch.time_scale)
            )
            if len(here) < max(PATCH_BINS):
                continue
            total = np.concatenate([[0.0], np.cumsum(z[here])])
            squares = [(total[m:] - total[:-m]) ** 2 / m for m in PATCH_BINS]
            for square in squares:
                if float(square.max()) > largest:
                    largest = float(square.max())
                    where = (float(k), float(b.since[here[int(np.argmax(square))]]))
            # bins are counted from the switch: the same number is the same time after it
            first = np.arange(len(here)) - int(np.sum(b.since[here] < 0.0))
            places.append({
                (m, int(at)): value
                for m, square in zip(PATCH_BINS, squares, strict=True)
                for at, value in zip(first, _surprises(square, dof), strict=False)
            })  # fmt: skip
    strength = {"patch_experiment": where[0], "patch_s": where[1], "patch_ratio": largest**0.5}
    return FullRate("patch", _alone_or_alike(places), strength, float(np.sqrt(largest)))


def look_for_breaks(found: Refit, tail: float = np.inf) -> FullRate:
    """Changes that begin at any time in single records: passing, until the fall, or to stay.

    What happens once has no common shape either, and on a plateau it looks like a drift.  A score
    test per record: a change of so many volts between two edges of bins, what the refit's own
    coordinates would take up of it left out.  ``ln B`` of a record averages over begins and
    lengths the ratio of t densities, as in :func:`look_for_patches`; they are averaged over for
    each record, or for all together.
    """
    dof = min(DOF, tail)
    sketch, plan = found.plan.sketch, found.plan
    covariance = np.linalg.inv(found.normal)
    largest, where = 0.0, (0.0, 0.0)
    places: list[dict[Hashable, float]] = []
    for k, (rows, b) in enumerate(zip(sketch.rows, sketch.bins, strict=True)):
        shapes, spans = _changes(b.falling)
        templates = sketch.inverse_factors[k] @ shapes
        inside = found.jacobians[k].T @ templates
        columns = plan.columns(k)
        own = covariance[np.ix_(columns, columns)]
        whole = np.sum(templates**2, axis=0)
        left = whole - np.sum(inside * (own @ inside), axis=0)
        use = left > ABSORBED * whole
        if not np.any(use):
            continue
        square = (found.residual[rows] @ templates[:, use]) ** 2 / left[use]
        edges = _edges(b)
        kinds = [(edges[i], edges[j]) for i, j in spans[use].tolist()]
        places.append(dict(zip(kinds, _surprises(square, dof), strict=True)))
        if float(square.max()) > largest:
            largest = float(square.max())
            first = spans[use][int(np.argmax(square)), 0]
            where = (float(k), float(b.experiment.t[b.first[first]]))
    strength = {"break_experiment": where[0], "break_s": where[1], "break_ratio": largest**0.5}
    return FullRate("break", _alone_or_alike(places), strength, float(np.sqrt(largest)))


def _edges(b: ExperimentBins) -> list[tuple[str, int]]:
    """Where each bin begins, counted from the switch before, since records differ in length.

    After the last bin the record's end, ``("end", 0)``.
    """
    rise, fall = int(np.argmax(b.since >= 0.0)), int(np.argmax(b.falling))
    begins = [
        ("fall", i - fall) if down else ("rise", i - rise) for i, down in enumerate(b.falling)
    ]
    return [*begins, ("end", 0)]


def _changes(falling: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.int64]]:
    """(n_bins, m) ones where a change lasts, and (m, 2) the bins it begins with and ends before."""
    n = len(falling)
    fall = int(np.argmax(falling)) if np.any(falling) else n
    spans = {
        (i, j)
        for i in range(1, n)
        for j in (*(i + m for m in BREAK_LENGTHS), fall, n)
        if i < j <= n
    }
    ordered = np.array(sorted(spans), dtype=np.int64)
    at = np.arange(n)[:, None]
    shapes = (at >= ordered[:, 0]) & (at < ordered[:, 1])
    return shapes.astype(float), ordered


def look_for_ringing(
    campaign: Campaign, residuals: Sequence[FloatArray], quiet: Sequence[Quiet]
) -> FullRate:
    """A damped oscillation that follows the switches, with one phase or with any."""
    return any_of([
        _ringing_of_any_phase(campaign, residuals, quiet),
        _ringing_in_phase(campaign, residuals, quiet),
    ])  # fmt: skip


def _ringing(logs: Sequence[float], frequency: float, power: float) -> FullRate:
    """What the ``logs``, each ln B of one kind of window, say together."""
    if not logs:
        return FullRate("ringing", 0.0, {"ringing_Hz": 0.0}, None)
    value = float(logsumexp(logs) - np.log(len(logs)))
    return FullRate("ringing", value, {"ringing_Hz": frequency}, float(np.sqrt(2.0 * power)))


def _frequencies(length: int, dt: float) -> tuple[int, FloatArray]:
    """Length of the transform of a window of ``length`` samples, and its frequencies Hz."""
    n_fft = 1 << int(np.ceil(np.log2(2 * max(length, 2))))
    return n_fft, np.asarray(np.fft.rfftfreq(n_fft, dt))


def _ringing_of_any_phase(
    campaign: Campaign, residuals: Sequence[FloatArray], quiet: Sequence[Quiet]
) -> FullRate:
    """A damped oscillation after the switches, of any phase.

    Exponentially fading windows that begin near the switches, Fourier transformed; their power
    over that of the same windows in the quiet spans is exponential under noise of any spectrum
    and ``1 + c`` times as large on average with a ringing of any phase.
    """
    records = []
    for e, r, q in zip(campaign, residuals, quiet, strict=True):
        size = max(1, round(RINGING_BLOCK / e.interval))
        n = len(r) // size
        y = (r / q.deviation)[: n * size].reshape(n, size).mean(axis=1)
        dt = size * e.interval
        # what is slower than the slowest ringing is the model's misfit
        smooth = gaussian_filter1d(y, 0.28 / RINGING_HZ[0] / dt, mode="nearest")
        records.append((y - smooth, dt, float(e.t[0])))
    steps = {round(dt, 9) for _, dt, _ in records}
    if len(steps) != 1:
        return _ringing([], 0.0, 0.0)
    dt = records[0][1]
    logs: list[float] = []
    best, frequency, power = -np.inf, 0.0, 0.0
    for damping in DAMPING:
        length = round(3.0 * damping / dt)
        n_fft, f = _frequencies(length, dt)
        keep = (f >= RINGING_HZ[0]) & (f <= min(RINGING_HZ[1], 0.45 / dt))
        if int(keep.sum()) < 3:
            continue
        fading = np.exp(-np.arange(length) * dt / damping)
        fading /= np.sqrt(np.sum(fading**2))

        def spectra(
            y: FloatArray,
            at: NDArray[np.int64],
            w: FloatArray = fading,
            n: int = n_fft,
            keep: NDArray[np.bool_] = keep,
        ) -> FloatArray:
            at = at[(at >= 0) & (at + len(w) <= len(y))]
            windows = y[at[:, None] + np.arange(len(w))] * w
            return np.asarray(np.abs(np.fft.rfft(windows, n, axis=1)[:, keep]) ** 2)

        usual = []
        for (y, _, begin), q in zip(records, quiet, strict=True):
            for low, high in q.spans:
                last = (high - begin) / dt - length
                at = np.arange((low - begin) / dt, last, max(1.0, 2.0 * damping / dt))
                usual.append(spectra(y, at.astype(np.int64)))
        n_usual = sum(len(u) for u in usual)
        if n_usual < FEWEST_WINDOWS:
            continue
        # smoothed within the windows' own resolution only: a resonance of the noise stays one
        native = 0.25 / (np.pi * damping) / float(f[1])
        powers = np.concatenate(usual)
        level = np.maximum(gaussian_filter1d(powers.mean(axis=0), native), 1e-300)
        wild = _wildness(_over_its_median(powers / level), TILT / float(f[1]))
        for begins in BEGINS:
            made = [
                spectra(y, np.rint((np.array(q.switches) + begins - t0) / dt).astype(np.int64))
                for (y, _, t0), q in zip(records, quiet, strict=True)
            ]
            ratio = _over_its_median(np.concatenate(made) / level)
            if len(ratio) == 0:
                continue
            # windows whose power varies more than by chance say as much as fewer of them
            total = ratio.sum(axis=0) / wild
            k, rest = len(ratio) / wild, n_usual / wild
            c = np.array(RINGING_RATIOS)[:, None]
            # ratio of F densities: the usual power is a mean over windows, too
            usually = np.log1p(total / rest) - np.log1p(total / rest / (1.0 + c))
            each = logsumexp((k + rest) * usually - k * np.log1p(c), axis=0)
            each = each - np.log(len(RINGING_RATIOS))
            logs.append(float(logsumexp(each) - np.log(len(each))))
            if logs[-1] > best:
                best, peak = logs[-1], int(np.argmax(each))
                frequency = float(f[keep][peak])
                power = max(float(wild[peak] * (total[peak] - k[peak])), 0.0)
    return _ringing(logs, frequency, power)


def _wildness(ratio: FloatArray, smooth: float) -> FloatArray:
    """(n_f,) variance of power ``ratio`` (n, n_f) over that of exponential ordinates, at least one.

    ``smooth``: ordinates over which it is averaged.
    """
    first, second = (gaussian_filter1d(np.mean(ratio**p, axis=0), smooth) for p in (1, 2))
    return np.asarray(np.maximum(second / np.maximum(first, 1e-300) ** 2 - 1.0, 1.0))


def _over_its_median(ratio: FloatArray) -> FloatArray:
    """``ratio`` (n, n_f) of power: what is stronger for a while is so at all frequencies."""
    return np.asarray(
        ratio / np.maximum(np.median(ratio, axis=1, keepdims=True) / np.log(2.0), 0.3)
    )


def _ringing_in_phase(
    campaign: Campaign, residuals: Sequence[FloatArray], quiet: Sequence[Quiet]
) -> FullRate:
    """A damped oscillation with one phase after all switches of all records.

    What swings because the valve has moved (a bench, a bubbler's water, a pressure controller)
    starts anew with every switch.  The Fourier amplitudes ``x_k`` of fading windows are added up
    with weights ``a_k``, the oscillation's size there; the power of the sum over that of the noise
    at frequencies beside is exponential without ringing and ``1 + g`` times as large on average
    with it.  The size is the same in volts or that of the step, with the same sign after opening
    and shutting or the other.  A misfit in phase at all frequencies is the model's own, and is
    divided out.
    """
    records = []
    for e, r, q in zip(campaign, residuals, quiet, strict=True):
        size = max(1, round(IN_PHASE_BLOCK / e.interval))
        n = len(r) // size
        y, deviation = (
            v[: n * size].reshape(n, size).mean(axis=1) for v in (r, np.asarray(q.deviation))
        )
        dt = size * e.interval
        smooth = gaussian_filter1d(y, 0.28 / IN_PHASE_HZ[0] / dt, mode="nearest")
        records.append(((y - smooth) / deviation, deviation, dt, float(e.t[0])))
    steps = {round(dt, 9) for _, _, dt, _ in records}
    if len(steps) != 1:
        return _ringing([], 0.0, 0.0)
    dt = records[0][2]
    logs: list[float] = []
    best, frequency, power = -np.inf, 0.0, 0.0
    for damping in IN_PHASE_DAMPING:
        length = round(2.0 * damping / dt)
        n_fft, f = _frequencies(length, dt)
        lowest = max(IN_PHASE_HZ[0], IN_PHASE_CYCLES / damping)
        keep = (f >= lowest) & (f <= min(IN_PHASE_HZ[1], 0.45 / dt))
        beside = np.rint(np.array([1.0, 4.0]) / (2.0 * damping) / float(f[1])).astype(np.int64)
        if int(keep.sum()) < 8 or 2 * beside[1] + 1 > len(f):
            continue
        weight = keep / np.maximum(f, IN_PHASE_HZ[0])  # even in ln f
        fading = np.exp(-np.arange(length) * dt / damping)
        for begins in IN_PHASE_BEGINS:
            amplitudes, sizes = [], []
            for (y, deviation, _, t0), q in zip(records, quiet, strict=True):
                ends = [*q.switches[1:], np.inf]
                for which, (switch, end) in enumerate(zip(q.switches, ends, strict=True)):
                    at = round((switch + begins - t0) / dt)
                    last = min(at + length, len(y), int(min((end - t0) / dt, 1e9)))
                    if at < 0 or last - at < 0.7 * length:
                        continue
                    spectrum = np.fft.rfft(y[at:last] * fading[: last - at], n_fft)
                    amplitudes.append(spectrum)
                    volts = 1.0 / float(deviation[at])
                    sizes.append((volts, q.step * volts, -1.0 if which else 1.0))
            if len(amplitudes) < FEWEST_SWITCHES:
                continue
            x, (volts_, steps_, signs) = np.array(amplitudes), np.array(sizes).T
            for a in (volts_, steps_, volts_ * signs, steps_ * signs):
                if not a.any():
                    continue
                value, at_f, found = _in_phase(x, a, beside, weight)
                logs.append(value)
                if value > best:
                    best, frequency, power = value, float(f[at_f]), found
    return _ringing(logs, frequency, power)


def _in_phase(
    x: NDArray[np.complex128], a: FloatArray, beside: NDArray[np.int64], weight: FloatArray
) -> tuple[float, int, float]:
    """ln B of one amplitude for all windows, averaged over frequency, where it is largest.

    ``x`` (K, n_f), ``a`` (K,), ``weight`` (n_f,) of the frequencies; ``beside``: how many
    ordinates away the noise is looked at, which is no smaller than what does not add up here.
    """
    k, n_f = x.shape
    kernel = np.zeros(2 * beside[1] + 1)
    kernel[: beside[1] - beside[0] + 1] = kernel[beside[1] + beside[0] :] = 1.0
    usual = np.mean(np.abs(x) ** 2, axis=0)
    level = np.convolve(usual, kernel, "same") / np.convolve(np.ones(n_f), kernel, "same")
    added = np.abs(a @ x) ** 2 / np.sum(a**2)
    level = np.maximum(level, (k * usual - added) / (k - 1))
    where = np.flatnonzero(weight)
    power = added[where] / np.maximum(level[where], 1e-300)
    power /= max(float(np.median(power)) / np.log(2.0), 1.0)
    g = np.array(IN_PHASE_RATIOS)[:, None]
    n = 4.0 * k  # ordinates that the level rests on, as far as they are independent
    usually = np.log1p(power / n) - np.log1p(power / n / (1.0 + g))
    each = logsumexp((1.0 + n) * usually - np.log1p(g), axis=0) - np.log(len(g))
    peak = int(np.argmax(each))
    value = float(logsumexp(each, b=weight[where] / np.sum(weight)))
    return value, int(where[peak]), float(power[peak])
