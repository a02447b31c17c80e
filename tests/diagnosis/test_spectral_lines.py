"""Lines in the spectrum: slow swings, the mains and how far they are closed; echoes are none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter, windows

import bayes_sensor.diagnosis.signals.periodograms as lines
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.diagnosis.effects.mains_pickup import mains_closure
from bayes_sensor.diagnosis.signals.bursts import find_bursts, look_for_bursts
from bayes_sensor.diagnosis.signals.lines import LINES
from bayes_sensor.diagnosis.signals.mains import SEARCH, look_for_mains
from bayes_sensor.diagnosis.signals.periodograms import Piece, find_line, own_shapes
from bayes_sensor.diagnosis.signals.signal import Finding
from bayes_sensor.diagnosis.signals.swing import look_for_slow_lines
from tests.support.planted_effects import SIGNALS, design, measured


def residuals(rng, period=None, size=0.0, memory=0.0, n=4):
    """White noise and, if asked for, slow noise and a swing in records of 60 s."""
    campaign = design(n)
    found = []
    for e in campaign:
        y = 0.012 * rng.standard_normal(len(e.t))
        if memory:
            phi = np.exp(-e.interval / memory)
            y += 0.004 * lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], rng.standard_normal(len(y)))
        if period:
            y += size * np.sin(2.0 * np.pi * (e.t / period + rng.random()))
        found.append(y)
    return campaign, found, [np.full(len(y), 0.012) for y in found]


def test_a_slow_swing_is_found_with_its_period_and_size():
    found = look_for_slow_lines(*residuals(np.random.default_rng(1), period=7.0, size=0.0012))[0]
    assert found.log_bayes_factor > 5.0
    assert 1.0 / found.strength["swing_Hz"] == pytest.approx(7.0, rel=0.04)
    assert found.strength["swing_V"] == pytest.approx(0.0012, rel=0.25)


@pytest.mark.parametrize("memory", [0.0, 0.5, 3.0])
def test_slow_noise_is_no_swing(memory):
    rng = np.random.default_rng(2)
    values = [look_for_slow_lines(*residuals(rng, memory=memory))[0].log_bayes_factor
              for _ in range(15)]  # fmt: skip
    assert max(values) < 3.0 and np.median(values) < 0.0


def test_ripples_that_an_echo_makes_in_the_spectrum_are_no_lines():
    rng = np.random.default_rng(3)
    pieces = []
    for _ in range(8):
        e = rng.standard_normal(20_000)
        e[25:] += 0.7 * e[:-25]  # a copy 25 ms later: ripples 40 Hz apart
        pieces.append(Piece(e, np.ones(len(e)), 1e-3, 0))
    assert find_line(pieces, LINES)[0].log_bayes_factor < 0.0
    t = np.arange(20_000) * 1e-3
    humming = [
        replace(p, samples=p.samples + 0.06 * np.sin(2.0 * np.pi * 431.0 * t)) for p in pieces
    ]
    found = find_line(humming, LINES)[0]
    assert found.log_bayes_factor > 5.0
    assert found.strength["line_Hz"] == pytest.approx(431.0, abs=0.1)


def test_what_strong_mains_leak_to_their_sides_is_no_line():
    rng = np.random.default_rng(5)
    t = np.arange(6000) * 2e-3

    def pieces(size: float) -> list[Piece]:
        return [
            Piece(
                rng.standard_normal(len(t))
                + 2.0 * np.sin(2.0 * np.pi * (60.0 * t + rng.random()))
                + size * np.sin(2.0 * np.pi * (63.0 * t + rng.random())),
                windows.tukey(len(t), 0.2), 2e-3, 0,
            )
            for _ in range(8)
        ]  # fmt: skip

    assert find_line(pieces(0.0), LINES)[0].log_bayes_factor < 0.0
    found = find_line(pieces(0.15), LINES)[0]
    assert found.log_bayes_factor > 5.0
    assert found.strength["line_Hz"] == pytest.approx(63.0, abs=0.1)


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_the_edge_of_a_filter_is_no_line(share):
    # part of the noise has passed a steep filter before a recorder that is faster
    rng = np.random.default_rng(6)
    n = 20_000
    f = np.fft.rfftfreq(n, 1e-3)
    pieces = []
    for _ in range(14):
        kept = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) * (f < 80.0), n)
        y = np.sqrt(share / 0.16) * kept + np.sqrt(1.0 - share) * rng.standard_normal(n)
        pieces.append(Piece(y, windows.tukey(n, 0.2), 1e-3, 0))
    assert find_line(pieces, LINES)[0].log_bayes_factor < 1.0
    t = np.arange(n) * 1e-3
    for hertz in (71.3, 88.7):  # a line on either side of the edge is still found
        humming = [
            replace(p, samples=p.samples + 0.1 * np.sin(2.0 * np.pi * hertz * t)) for p in pieces
        ]
        found = find_line(humming, LINES)[0]
        assert found.log_bayes_factor > 5.0
        assert found.strength["line_Hz"] == pytest.approx(hertz, abs=0.1)


def test_a_line_between_two_ordinates_keeps_its_amplitude():
    # ordinates of 20 000 samples lie .05 Hz apart: the worst place is half-way
    t = np.arange(20_000) * 1e-3
    rng = np.random.default_rng(4)
    pieces = [
        Piece(0.05 * rng.standard_normal(len(t)) + 0.01 * np.sin(2.0 * np.pi * 77.025 * t + k),
              np.ones(len(t)), 1e-3, 0)
        for k in range(4)
    ]  # fmt: skip
    found = find_line(pieces, LINES)[0]
    assert found.strength["line_V"] == pytest.approx(0.01, rel=0.15)


def every_other(rng, size, phi=0.0, n=6):
    """AR(1) noise of standard deviation .01 V in which every other sample is ``size`` V higher."""
    turns = size * (0.5 - np.arange(15_000) % 2)
    scale = 0.01 * np.sqrt(1.0 - phi**2)
    return [
        Piece(turns + lfilter([scale], [1.0, -phi], rng.standard_normal(len(turns))),
              np.ones(len(turns)), 1e-3, k % 2)
        for k in range(n)
    ]  # fmt: skip


def test_two_converters_that_take_turns_are_a_line_at_half_the_rate():
    # the ordinate there is real: a difference of 2 A is seen with n A^2 / sigma^2
    found = find_line(every_other(np.random.default_rng(8), 6e-4), LINES)[0]
    assert found.strength["line_Hz"] == 500.0 and found.log_bayes_factor > 4.0
    assert found.strength["line_V"] == pytest.approx(3e-4, rel=0.2)
    assert found.d == pytest.approx(np.sqrt(6 * 15_000) * 3e-4 / 0.01, rel=0.2)


def test_at_half_a_rate_that_is_near_the_mains_a_line_is_the_mains():
    slow = [replace(p, interval=0.01) for p in every_other(np.random.default_rng(8), 2e-3)]
    found = find_line(slow, LINES)[0]
    assert found.strength["line_Hz"] < 49.8 and found.log_bayes_factor < 0.0
    found = find_line(slow, SEARCH)[0]
    assert found.strength["mains_Hz"] == 50.0 and found.log_bayes_factor > 4.0


def folded(rng, frequency, size, n=6):
    """Records of 48 s at 100 Hz: 50 Hz folds onto half that rate, where the samples hardly see
    one of a sine's two phases."""
    t = np.arange(4800) * 0.01
    return [
        Piece(size * np.sin(2.0 * np.pi * frequency * t + rng.uniform(0.0, 2.0 * np.pi))
              + 0.05 * rng.standard_normal(len(t)), np.ones(len(t)), 0.01, 0)
        for _ in range(n)
    ]  # fmt: skip


@pytest.mark.parametrize("frequency", [49.97, 50.0, 50.01, 50.05])
def test_the_mains_are_found_and_closed_where_they_fold_onto_half_the_rate(frequency):
    for seed in range(4):
        pieces = folded(np.random.default_rng(seed), frequency, 0.02)
        found = find_line(pieces, SEARCH)[0]
        assert found.strength["mains_Hz"] == 50.0 and found.log_bayes_factor > 20.0
        closed, out = mains_closure(pieces, found)
        # a sine fitted as if its phases were orthogonal would be taken off twice
        assert closed.fraction == pytest.approx(1.0, abs=0.08)
        assert closed.low < 1.01 and closed.high > 0.99
        # on half the rate itself a sine's other phase is unknown, and so is its other half
        assert out is None if frequency == 50.0 else out == pytest.approx(1.0, abs=0.1)


def of_mains(rng, size, share=1.0, every=67, seconds=0.0):
    """Records of 60 s with mains, ``share`` of every so many of whose periods there are.

    Or, with ``seconds``, whose size and phase wander in that time.
    """
    campaign, found, deviations = residuals(rng)
    for e, y in zip(campaign, found, strict=True):
        periods = 50.02 * e.t + every * rng.random()
        there = np.mod(np.floor(periods), every) < share * every
        phase = 0.0
        if seconds:
            phi = np.exp(-e.interval / seconds)
            slow = lfilter([np.sqrt(1 - phi**2)], [1.0, -phi], rng.standard_normal((2, len(y))))
            there, phase = 1.0 + 0.2 * slow[0], 0.2 * slow[1]
        hum = np.sin(2.0 * np.pi * periods + phase) + 0.3 * np.sin(6.0 * np.pi * periods)
        y += size * there * hum
    return campaign, found, deviations


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_mains_that_come_and_go_are_told_from_steady_ones(share):
    for seed in range(4):
        records = of_mains(np.random.default_rng(seed), 0.004, share)
        mains = look_for_mains(*records)[0]
        assert mains.probability > 0.99
        found = look_for_bursts(*records, mains)[0]
        assert found.log_odds > 2.2 and found.beside_the_mean
        assert found.strength["bursts_Hz"] == pytest.approx(50.02 / 67, abs=0.05)


@pytest.mark.parametrize("size", [0.0006, 0.002, 0.02, 0.2])
@pytest.mark.parametrize("seconds", [0.0, 60.0])
def test_steady_mains_are_no_bursts(size, seconds):
    # however loud; nor those whose size and phase wander over a minute
    factors = []
    for seed in range(12):
        records = of_mains(np.random.default_rng(100 + seed), size, seconds=seconds)
        found = look_for_bursts(*records, look_for_mains(*records)[0])
        factors += [f.log_bayes_factor for f in found]
    assert max(factors, default=-1.0) < (2.0 if seconds == 0.0 else 4.0)
    assert len(factors) == 12 or size == 0.0006


def test_harmonics_that_fold_beside_the_mains_are_no_bursts():
    # at 200 samples a second the third of 50.07 Hz folds to 49.79 Hz, and the fifth to 50.35 Hz
    rng = np.random.default_rng(5)
    t = np.arange(12_000) * 0.005
    found = []
    for _ in range(4):
        whole = 2.0 * np.pi * (50.07 * t + rng.random())
        hum = sum(np.sin(h * whole) for h in (1, 3, 5, 7, 9))
        found.append(Piece(0.004 * hum + 0.012 * rng.standard_normal(len(t)), np.ones(len(t)),
                           0.005, 0))  # fmt: skip
    mains = find_line(found, SEARCH)[0]
    assert mains.log_bayes_factor > 20.0
    assert find_bursts(found)[0].log_bayes_factor < 1.0


def test_bursts_are_looked_for_where_mains_are():
    records = residuals(np.random.default_rng(3))
    assert look_for_bursts(*records, look_for_mains(*records)[0]) == []


def test_noise_at_half_the_rate_is_not_the_mains():
    rng = np.random.default_rng(12)
    factors = [find_line(folded(rng, 50.0, 0.0), SEARCH)[0].log_bayes_factor
               for _ in range(60)]  # fmt: skip
    assert max(factors) < 3.0 and np.mean(np.exp(factors)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("phi", [0.0, 0.95, -0.95])
def test_noise_alone_is_no_line_at_half_the_rate(phi):
    rng = np.random.default_rng(9)
    factors = [find_line(every_other(rng, 0.0, phi), LINES)[0].log_bayes_factor
               for _ in range(40)]  # fmt: skip
    assert max(factors) < 3.0
    # a Bayes factor is on average 1 where there is nothing (Good, J. R. Stat. Soc. B 12, 1950)
    assert np.mean(np.exp(factors)) < 1.5


def humming(rng, fundamental, third=0.0, steady=True, n=6):
    """Records of 30 s at 1 kHz with the mains at 49.98 Hz."""
    t = np.arange(30_000) * 1e-3
    found = []
    for k in range(n):
        angle = 2.0 * np.pi * 49.98 * t
        y = fundamental * np.sin(angle + k) + third * np.sin(3.0 * angle + 0.3 * k)
        y = y if steady else y * (t < 15.0)  # or it stops half-way
        found.append(Piece(y + 0.05 * rng.standard_normal(len(t)), np.ones(len(t)), 1e-3, 0))
    return found


def test_the_mains_closed_fraction_is_the_share_that_one_sine_explains():
    rng = np.random.default_rng(5)
    mains = Finding(SIGNALS["mains_pickup"], 50.0, {"mains_V": 0.01, "mains_Hz": 50.0}, 60.0)
    pure, out = mains_closure(humming(rng, 0.01), mains)
    assert pure.fraction == pytest.approx(1.0, abs=0.03) and pure.low < 1.0 < pure.high
    assert pure.before_V == pytest.approx(0.01 / np.sqrt(2.0), rel=0.03)
    assert out == pytest.approx(1.0, abs=0.05)
    # of 1 + .8^2 the fundamental is 1 / 1.64
    mixed, out = mains_closure(humming(rng, 0.01, third=0.008), mains)
    assert mixed.fraction == pytest.approx(1.0 / 1.64, abs=0.05)
    assert mixed.low < 1.0 / 1.64 < mixed.high
    # each half predicts the other as wrongly as it can
    _, out = mains_closure(humming(rng, 0.01, steady=False), mains)
    assert out == pytest.approx(-1.0, abs=0.3)


def test_too_little_of_the_mains_has_no_closed_fraction():
    faint = Finding(SIGNALS["mains_pickup"], 0.0, {"mains_V": 1e-4, "mains_Hz": 150.0}, 1.0)
    closed, out = mains_closure(humming(np.random.default_rng(6), 0.0), faint)
    assert closed.withheld and out is None


@pytest.mark.slow
def test_a_diagnosis_that_names_the_mains_says_how_far_they_are_closed():
    campaign = measured({"mains_pickup": 0.006}, seed=10, interval=0.004)
    gap = diagnose_gap(campaign, bootstrap=0, hidden=False, separate=False)
    assert gap.verdict.kind == "effect" and gap.verdict.effects == ("mains_pickup",)
    shrink = gap.to_json()["shrink"]
    assert shrink["explanation"] == "mains_pickup" and not shrink["withheld"]
    assert shrink["fraction_closed"] == pytest.approx(1.0, abs=0.1)
    assert shrink["held_out_fraction_closed"] == pytest.approx(1.0, abs=0.15)
    assert shrink["before_excess_rms_V"] == pytest.approx(0.006 / np.sqrt(2.0), rel=0.15)
    assert "closes" in gap.verdict.sentence


@pytest.mark.slow
def test_a_diagnosis_names_the_mains_where_they_fold_onto_half_the_rate():
    campaign = measured({"mains_pickup": 0.006}, seed=10, interval=0.01)
    gap = diagnose_gap(campaign, bootstrap=0, hidden=False, separate=False)
    assert gap.verdict.kind == "effect" and gap.verdict.effects == ("mains_pickup",)
    shrink = gap.to_json()["shrink"]
    assert shrink["fraction_closed"] == pytest.approx(1.0, abs=0.1)
    assert shrink["held_out_fraction_closed"] is None


def other_memories(rng, mains=0.0):
    """Noise whose memory differs from record to record, and the mains."""
    campaign = design(6, interval=0.002)
    found = []
    for e, memory in zip(campaign, (0.02, 0.1, 0.004, 0.3, 0.01, 0.05), strict=True):
        phi = np.exp(-e.interval / memory)
        drawn = rng.standard_normal(len(e.t))
        y = 0.012 * lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], drawn)
        found.append(y + mains * np.sin(2.0 * np.pi * (50.0 * e.t + rng.random())))
    return campaign, found, [np.full(len(y), 0.012) for y in found]


def test_the_mains_are_not_named_where_some_records_are_louder_at_their_frequency(monkeypatch):
    rng = np.random.default_rng(31)
    drawn = [other_memories(rng) for _ in range(8)]
    values = [look_for_mains(*some)[0].log_bayes_factor for some in drawn]
    assert max(values) < 2.0
    monkeypatch.setattr(
        lines, "own_shapes", lambda ratios, *rest: [np.ones(r.shape[1]) for r in ratios]
    )
    taken_for_alike = [look_for_mains(*some)[0].log_bayes_factor for some in drawn]
    assert max(taken_for_alike) > 5.0 and np.median(taken_for_alike) > 3.0


def test_the_mains_are_found_where_memories_differ():
    found = look_for_mains(*other_memories(np.random.default_rng(32), mains=0.0006))[0]
    assert found.log_bayes_factor > 6.0
    assert found.strength["mains_Hz"] == 50.0
    assert found.strength["mains_V"] == pytest.approx(0.0006, rel=0.2)


def test_spectra_that_are_alike_are_taken_for_alike():
    rng = np.random.default_rng(33)
    changed = 0
    for _ in range(100):
        ratios = [rng.exponential(size=(3, 4000)) for _ in range(6)]
        changed += any(
            np.any(shape != 1.0) for shape in own_shapes(ratios, [1.0] * len(ratios), 40.0)
        )
    assert changed <= 5


def test_what_is_smooth_in_a_spectrum_is_its_own_and_what_is_narrow_is_not():
    rng = np.random.default_rng(34)
    f = np.arange(20000)
    true = [1.0 / (1.0 + (f / corner) ** 2) + 0.01 for corner in (300.0, 900.0, 3000.0)]
    usual = np.mean(true, axis=0)
    ratios = [own / usual * rng.exponential(size=(4, len(f))) for own in true]
    ratios[1][:, 2000:2006] *= 50.0
    for shape, own in zip(own_shapes(ratios, [1.0] * len(ratios), 40.0), true, strict=True):
        assert np.max(np.abs(np.log(shape / (own / usual)))[50:]) < 0.35
        assert np.std(np.log(shape / (own / usual))[50:]) < 0.15


def test_one_spectrum_or_one_too_short_has_no_shape_of_its_own():
    rng = np.random.default_rng(35)
    for ratios in ([rng.exponential(size=(3, 900))], [rng.exponential(size=(3, 15))] * 2):
        assert all(np.all(shape == 1.0) for shape in own_shapes(ratios, [1.0] * len(ratios), 40.0))
    silent = [np.zeros((1, 900)), rng.exponential(size=(1, 900))]
    assert all(np.all(shape > 0.0) for shape in own_shapes(silent, [1.0, 1.0], 40.0))


@pytest.mark.parametrize("look", [look_for_mains, look_for_slow_lines])
def test_a_record_without_noise_among_others_breaks_nothing(look):
    campaign, noise, deviations = other_memories(np.random.default_rng(36))
    noise[2] = np.zeros(len(noise[2]))
    assert np.isfinite(look(campaign, noise, deviations)[0].log_bayes_factor)
