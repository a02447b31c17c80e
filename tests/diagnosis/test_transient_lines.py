"""Lines that pass or that records have each for itself; gusts and what all have are none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import bayes_sensor.diagnosis.signals.transient_lines as passing_lines
from bayes_sensor.diagnosis.signals.lines import LINES
from bayes_sensor.diagnosis.signals.periodograms import find_line, pieces_of_records
from bayes_sensor.diagnosis.signals.transient_lines import look_for_transient_lines
from tests.support.planted_effects import design


def passing(rng, add, n=6, size=1.0, gusts=0.0):
    """AR(1) noise of .01 V in records of 60 s, plus what ``add(k, t)`` V says of record k."""
    campaign = design(n, interval=0.002)
    found = []
    for k, e in enumerate(campaign):
        phi = np.exp(-e.interval / 0.005)
        y = 0.01 * lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], rng.standard_normal(len(e.t)))
        gust = (e.t > 20.0 + 3.0 * k) & (e.t < 25.0 + 3.0 * k)
        found.append(y * np.where(gust, 1.0 + gusts, 1.0) + size * add(k, e.t))
    return campaign, found, [np.full(len(y), 0.01) for y in found]


def call(k, t):
    """A line that two of the records have for six seconds."""
    return 0.004 * np.sin(2.0 * np.pi * 83.3 * t) * ((t > 31.0) & (t < 37.0) & (k in (1, 4)))


def flutter(k, t):
    """A line at a frequency of its own in every record, whose phase wanders."""
    phase = np.cumsum(0.7 * np.sqrt(t[1] - t[0]) * np.random.default_rng(k).standard_normal(len(t)))
    return 0.0018 * np.sin(2.0 * np.pi * (9.0 + 2.3 * k) * t + phase)


@pytest.mark.parametrize(("add", "hertz"), [(call, [83.3]), (flutter, 9.0 + 2.3 * np.arange(6))])
def test_a_line_that_passes_or_differs_from_record_to_record_is_found(add, hertz):
    rng = np.random.default_rng(11)
    found = look_for_transient_lines(*passing(rng, add))[0]
    assert found.name == "passing" and found.log_bayes_factor > 6.0
    assert np.min(np.abs(found.strength["passing_Hz"] - np.asarray(hertz))) < 0.2
    assert found.strength["passing_V"] == pytest.approx(0.004 if add is call else 0.0018, rel=0.3)
    if add is call:
        assert found.strength["passing_experiment"] in (1.0, 4.0)
    # over all stretches it adds up to nothing
    spread = pieces_of_records(*passing(rng, add))
    assert find_line(spread, LINES)[0].log_bayes_factor < found.log_bayes_factor - 5.0


@pytest.mark.parametrize("hertz", [1.3, 3.0])
def test_slow_bursts_that_raise_the_noise_floor_are_found(hertz):
    # four seconds of a slow oscillation in every record, ten times the noise of its own band
    def burst(k, t):
        phase = 2.0 * np.pi * hertz * t + k
        return 0.02 * np.sin(phase) * ((t > 20.0) & (t < 24.0))

    found = look_for_transient_lines(*passing(np.random.default_rng(13), burst))[0]
    assert found.log_bayes_factor > 50.0
    assert found.strength["passing_Hz"] == pytest.approx(hertz, abs=0.4)


def test_noise_that_rises_slowly_towards_low_frequencies_is_no_passing_line():
    rng = np.random.default_rng(14)

    def slow(k, t):
        steps = rng.standard_normal(len(t))
        times = np.exp(rng.uniform(np.log(0.1), np.log(3.0)))
        phi = np.exp(-(t[1] - t[0]) / times)
        return 0.004 * lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], steps)

    values = [look_for_transient_lines(*passing(rng, slow))[0].log_bayes_factor for _ in range(8)]
    assert max(values) < 0.0, values


def test_what_all_records_have_and_gusts_are_no_passing_line():
    rng = np.random.default_rng(12)

    def resonance(k, t):  # of the noise, a few tenths of a hertz wide
        angle, radius = 2.0 * np.pi * 23.0 * (t[1] - t[0]), 1.0 - 1.0 * (t[1] - t[0])
        return lfilter([3e-4], [1.0, -2.0 * radius * np.cos(angle), radius**2],
                       rng.standard_normal(len(t)))  # fmt: skip

    quiet = [
        look_for_transient_lines(*passing(rng, lambda k, t: 0.0 * t, gusts=gusts))[0]
        for gusts in (0.0, 0.0, 0.0, 1.5, 4.0)
    ]
    everywhere = look_for_transient_lines(*passing(rng, resonance))[0]
    mains = look_for_transient_lines(
        *passing(rng, lambda k, t: 0.01 * np.sin(2.0 * np.pi * 50.1 * t) * (t > 10.0 * k))
    )[0]
    assert max(f.log_bayes_factor for f in (*quiet, everywhere, mains)) < 1.0


def test_a_share_of_many_windows_tells_what_is_usual(monkeypatch):
    campaign, found, deviations = passing(np.random.default_rng(13), call)
    whole = look_for_transient_lines(campaign, found, deviations)[0]
    monkeypatch.setattr(
        "bayes_sensor.diagnosis.signals.transient_lines.MOST", 60
    )  # every third window tells
    some = look_for_transient_lines(campaign, found, deviations)[0]
    assert some.log_bayes_factor == pytest.approx(whole.log_bayes_factor, rel=0.2)
    assert some.strength["passing_Hz"] == whole.strength["passing_Hz"]


def test_records_too_short_for_a_window_tell_of_no_passing_line():
    campaign, found, deviations = passing(np.random.default_rng(14), call)
    for seconds, told in ((2.0, 0), (8.0, 1)):
        n = round(seconds / 0.002)
        short = replace(
            campaign,
            experiments=tuple(replace(e, t=e.t[:n], mask=None) for e in campaign.experiments),
        )
        parts = look_for_transient_lines(short, [y[:n] for y in found], [d[:n] for d in deviations])
        assert len(parts) == told


def remembering(rng, memories, size=1.0):
    """Noise of .01 V in records of 60 s, each with a memory (s) of its own."""
    campaign = design(len(memories), interval=0.002)
    found = []
    for e, memory in zip(campaign, memories, strict=True):
        phi = np.exp(-e.interval / memory)
        drawn = rng.standard_normal(len(e.t))
        found.append(0.01 * lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], drawn))
    return campaign, found, [np.full(len(y), 0.01) for y in found]


MEMORIES = (0.02, 0.1, 0.004, 0.3, 0.01, 0.05)


def test_records_of_other_memories_have_no_passing_line(monkeypatch):
    rng = np.random.default_rng(19)
    drawn = [remembering(rng, MEMORIES) for _ in range(4)]
    values = [look_for_transient_lines(*some)[0].log_bayes_factor for some in drawn]
    assert max(values) < 2.0
    # taken for alike, the louder ones would have a line where they are
    monkeypatch.setattr(
        passing_lines, "own_shapes", lambda ratios, *rest: [np.ones(r.shape[1]) for r in ratios]
    )
    assert min(look_for_transient_lines(*some)[0].log_bayes_factor for some in drawn) > 5.0


def test_a_passing_line_is_found_among_records_of_other_memories():
    campaign, noise, deviations = remembering(np.random.default_rng(23), MEMORIES)
    # between a half and twice the noise that a window has around it
    for hertz, volts in ((3.1, 0.02), (83.3, 0.004)):
        called = [
            y + volts * np.sin(2.0 * np.pi * hertz * e.t) * ((e.t > 31.0) & (e.t < 37.0)) * (k == 3)
            for k, (e, y) in enumerate(zip(campaign, noise, strict=True))
        ]
        found = look_for_transient_lines(campaign, called, deviations)[0]
        assert found.log_bayes_factor > 6.0, hertz
        assert found.strength["passing_Hz"] == pytest.approx(hertz, abs=0.3)
        assert found.strength["passing_experiment"] == 3.0
