"""The independent reality's noise against its stated laws."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter, welch
from scipy.special import erf, erfcx, j0, ndtr, spence, stdtr
from scipy.stats import gamma, poisson

from bayes_sensor.reality import (
    HEAVY_TAILED,
    OPEN_LAWS,
    RESERVE_LAWS,
    Component,
    NoiseLaw,
    autocorrelation,
    clean_signals,
    draw_case,
    draw_law,
    make_campaign,
    phase_edges,
    sample_times,
)
from bayes_sensor.reality.noise import draw_noise
from tests.reality_cases import case


@pytest.mark.parametrize("name", [*OPEN_LAWS, *RESERVE_LAWS])
def test_noise_has_the_stated_autocorrelation(name: str) -> None:
    rng = np.random.default_rng(5)
    law = draw_law(name, rng, 0.05)
    assert law.sigma0**2 + law.sigma1**2 == pytest.approx(0.05**2)
    assert sum(part.share for part in law.components) == pytest.approx(1.0)
    n, interval, stretches = 4000, 2e-3, 150
    stated = autocorrelation(law, n, interval)
    z = np.array([draw_noise(law, n, interval, rng) for _ in range(stretches)])
    for lag in (0, 1, 3, 10, 40, 200, 1000):
        each = (z[:, : n - lag] * z[:, lag:]).mean(axis=1)
        error = each.std(ddof=1) / np.sqrt(stretches)
        # five standard errors of the mean over stretches: seven lags a law, none should fail
        assert abs(each.mean() - stated[lag]) < 5.0 * error + 1e-4


def test_shot_noise_leans_to_one_side_and_gusts_come_and_go() -> None:
    rng = np.random.default_rng(8)
    shot = NoiseLaw("shot", 1.0, components=(Component(1.0, 0.01, shape="shot", rate=0.5),))
    z = draw_noise(shot, 400_000, 1e-3, rng)
    # cumulants of pulses h exp(-s/T), heights with <h^k> = k!: rate k!/k, here (k - 1)! / 2
    assert abs(z.mean()) < 0.03
    assert np.mean(z**3) == pytest.approx(2.0 * 0.5**-0.5, rel=0.15)
    assert z.min() > -(0.5**0.5) - 1e-9  # no pulse: the mean is missing, nothing more

    gusty = Component(1.0, 1e-3, shape="gusts", depth=0.8, gust_time=1.0)
    law = NoiseLaw("gusty", 1.0, components=(gusty,))
    z = draw_noise(law, 400_000, 1e-3, rng)
    assert not law.is_ar1 and not shot.is_ar1
    # the variance is 0.2 or 1.8: kurtosis 3 (1 + 0.8^2), and the squares stay correlated
    assert np.mean(z**4) == pytest.approx(3.0 * 1.64, rel=0.1)
    loud = (z**2).reshape(-1, 100).mean(axis=1)  # 0.1 s each
    assert np.mean(loud < 0.6) > 0.3 and np.mean(loud > 1.2) > 0.3


def test_sparks_echoes_and_double_samples_are_what_they_say() -> None:
    rng = np.random.default_rng(9)
    part = Component(1.0, 0.01, 50.0, shape="sparks", rate=2.0)
    sparks = NoiseLaw("sparks", 1.0, components=(part,))
    z = draw_noise(sparks, 400_000, 1e-3, rng)
    # Campbell: fourth cumulant rate/4 <h^4> <cos^4> over (rate/4 <h^2>)^2, <h^k> = k!: 9 / rate
    assert np.mean(z**4) / np.mean(z**2) ** 2 - 3.0 == pytest.approx(4.5, rel=0.25)
    assert abs(np.mean(z**3)) < 0.5  # to both sides

    # an echo undone: z_i - r z_(i - m) + r^2 z_(i - 2 m) .. is the process itself again
    echo = NoiseLaw("echo", 1.0, components=(Component(1.0, 0.02, 50.0, "echo", depth=0.5),))
    z = draw_noise(echo, 200_000, 1e-3, rng)
    undone = lfilter([1.0], np.concatenate([[1.0], np.zeros(19), [0.5]]), z)[1000:]
    after = [float(np.mean(undone[lag:] * undone[:-lag])) / float(undone.var()) for lag in (5, 20)]
    assert after == pytest.approx(np.exp([-0.25, -1.0]), abs=0.04)

    pair = Component(1.0, shape="difference", depth=0.8)
    law = NoiseLaw("double_sampling", 1.0, components=(pair,))
    z = draw_noise(law, 200_000, 1e-3, rng)
    assert np.mean(z[1:] * z[:-1]) == pytest.approx(-0.8 / 1.64, abs=0.02)
    # what is averaged over is nearly gone: (1 - 0.8)^2 / (1 + 0.8^2) of white noise
    assert z.reshape(-1, 500).mean(axis=1).var() * 500 < 0.1
    assert not (sparks.is_ar1 or echo.is_ar1 or law.is_ar1)


def test_turbulence_walks_set_back_and_pulsing_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(10)
    stirred = NoiseLaw("turbulent", 1.0, components=(Component(1.0, 5.0, shape="turbulent"),))
    z = draw_noise(stirred, 400_000, 1e-3, rng)
    # Kolmogorov: squared differences grow as the 2/3 power of the distance
    near, far = (np.mean((z[lag:] - z[:-lag]) ** 2) for lag in (4, 32))
    assert far / near == pytest.approx(8.0 ** (2.0 / 3.0), rel=0.05)

    walk = NoiseLaw("zeroed_walk", 1.0, components=(Component(1.0, 0.5, shape="zeroed"),))
    z = draw_noise(walk, 500_000, 1e-3, rng)
    folded = np.mean(z.reshape(-1, 500) ** 2, axis=0)
    since = np.roll(folded, -int(folded.argmin()))  # variance 2 lag / period since the last zero
    # a thousand walks, whose squares scatter by 4.5 % of the variance
    assert np.abs(since - 2.0 * np.arange(500) / 500.0).max() < 0.35
    assert since[0] < 0.01

    part = Component(1.0, 2e-3, 4.0, shape="pulsing", depth=0.8)
    law = NoiseLaw("pulsing", 1.0, components=(part,))
    z = draw_noise(law, 500_000, 1e-3, rng)
    # (1 + d cos)^k averaged over a turn: k = 2: 1 + d^2/2, k = 4: 1 + 3 d^2 + 3/8 d^4
    kurtosis = 3.0 * (1.0 + 3.0 * 0.64 + 0.375 * 0.64**2) / 1.32**2
    assert np.mean(z**4) == pytest.approx(kurtosis, rel=0.1)
    loud = np.sqrt(np.mean(z.reshape(-1, 250) ** 2, axis=0) * 1.32)  # over one turn
    turn = np.fft.rfft(loud) / 250
    assert 2.0 * abs(turn[1]) == pytest.approx(0.8, rel=0.1) and turn[0].real > 0.9
    assert not (stirred.is_ar1 or walk.is_ar1 or law.is_ar1)


def test_coupled_noise_drawn_lines_and_fringes_are_what_they_say() -> None:
    rng = np.random.default_rng(12)
    # what the capacitor took is the integral of what it left over its time
    corner = 1.0 / (2.0 * np.pi * 0.2)
    coupled = NoiseLaw("ac_coupled", 1.0, components=(Component(1.0, 0.02, corner, "coupled"),))
    z = draw_noise(coupled, 400_000, 1e-3, rng)
    undone = z + np.cumsum(z) * 1e-3 / 0.2
    undone -= undone.mean()
    after = [float(np.mean(undone[lag:] * undone[:-lag])) / float(undone.var()) for lag in (5, 20)]
    assert after == pytest.approx(np.exp([-0.25, -1.0]), abs=0.04)
    # nothing is left of what is slow: white noise of the same density would have 2 * 0.02 s
    assert z.reshape(-1, 10_000).mean(axis=1).var() * 10.0 < 0.1 * 0.04

    lines = NoiseLaw("interpolated", 1.0, components=(Component(1.0, 0.02, shape="interpolated"),))
    z = draw_noise(lines, 400_000, 1e-3, rng)
    bends = np.abs(np.diff(z, 2)) > 1e-9
    assert bends.mean() == pytest.approx(2.0 / 20.0, rel=0.01)  # about a reading only
    folded = np.mean(z.reshape(-1, 20) ** 2, axis=0)  # 3/2 at the readings, half between them
    assert folded.max() == pytest.approx(1.5, rel=0.06)
    assert folded.min() == pytest.approx(0.75, rel=0.06)

    part = Component(1.0, 0.05, shape="fringes", depth=0.5)
    etalon = NoiseLaw("etalon", 1.0, components=(part,))
    z = draw_noise(etalon, 400_000, 1e-3, rng)
    # sum of r^k cos(k phase) lies between -r/(1 + r) and r/(1 - r); its variance is r^2/(1-r^2)/2
    bounds = np.array([-0.5 / 1.5, 0.5 / 0.5]) / np.sqrt(0.5 * 0.25 / 0.75)
    assert [z.min(), z.max()] == pytest.approx(bounds, abs=0.01)
    # lopsided as that sum is when any phase is as likely
    phase = np.linspace(0.0, 2.0 * np.pi, 20_000, endpoint=False)
    sums = np.sum([0.5**k * np.cos(k * phase) for k in range(1, 40)], axis=0)
    assert np.mean(z**3) == pytest.approx(np.mean(sums**3) / sums.std() ** 3, rel=0.1)
    assert not (coupled.is_ar1 or lines.is_ar1 or etalon.is_ar1)


def test_molecules_speckle_and_whistling_are_what_they_say() -> None:
    rng = np.random.default_rng(14)
    part = Component(1.0, 0.05, shape="diffusing")
    molecules = NoiseLaw("molecules", 1.0, components=(part,))
    z = draw_noise(molecules, 400_000, 1e-3, rng)
    assert np.mean(z**4) == pytest.approx(3.0, rel=0.05)  # many of them: Gaussian
    # 1/(1 + lag/T) has no time of its own beyond T: the variance of means over n T falls as
    # 2 [(1 + n) ln(1 + n) - n] / n^2, far more slowly than 2/n
    for n in (4, 40):
        means = z[: 400_000 // (50 * n) * 50 * n].reshape(-1, 50 * n).mean(axis=1)
        expected = 2.0 * ((1.0 + n) * np.log1p(n) - n) / n**2
        error = expected * np.sqrt(2.0 / len(means))
        assert np.mean(means**2) == pytest.approx(expected, abs=5.0 * error)

    speckle = NoiseLaw("speckle", 1.0, components=(Component(1.0, 0.005, shape="speckle"),))
    z = draw_noise(speckle, 600_000, 1e-3, rng)
    # exponentially distributed: never below no light at all, lopsided by 2, kurtosis 9
    assert z.min() >= -1.0 and z.min() == pytest.approx(-1.0, abs=1e-3)
    assert np.mean(z > 2.0) == pytest.approx(np.exp(-3.0), rel=0.06)
    assert np.mean(z**3) == pytest.approx(2.0, rel=0.15)
    assert np.mean(z**4) == pytest.approx(9.0, rel=0.3)

    part = Component(1.0, 0.5, 10.0, shape="whistling", depth=0.5)
    whistling = NoiseLaw("whistling", 1.0, components=(part,))
    z = draw_noise(whistling, 400_000, 1e-3, rng)
    assert np.abs(z).max() <= np.sqrt(2.0)
    assert np.mean(z**4) == pytest.approx(1.5, rel=0.02)  # of a sine
    power = np.abs(np.fft.rfft(z.reshape(-1, 4000), axis=1)).mean(axis=0) ** 2
    frequency = np.fft.rfftfreq(4000, 1e-3)
    inside = power[(frequency > 6.0) & (frequency < 14.0)]
    outside = power[(frequency > 20.0) | (frequency < 1.0)]
    assert inside.min() > 10.0 * outside.max()
    assert inside.max() < 2.0 * inside.min()  # any pitch as likely
    # a tone obeys x_(i+1) = 2 cos(w) x_i - x_(i-1) but for its breaks, two of them a second
    ratio = (z[2:] + z[:-2])[np.abs(z[1:-1]) > 0.3] / z[1:-1][np.abs(z[1:-1]) > 0.3] / 2.0
    pitch = np.arccos(np.clip(ratio, -1.0, 1.0)) / (2.0 * np.pi * 1e-3)
    assert np.mean((pitch > 4.99) & (pitch < 15.01)) > 0.99
    assert not (molecules.is_ar1 or speckle.is_ar1 or whistling.is_ar1)


def test_notched_interleaved_and_charging_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(16)
    h, time_, frequency = 1e-3, 0.1, 12.0
    part = Component(1.0, time_, frequency, "notched")
    notched = NoiseLaw("notched", 1.0, components=(part,))
    z = draw_noise(notched, 1_000_000, h, rng)
    f, power = welch(z, 1.0 / h, nperseg=20_000, detrend=False)
    # nothing at its frequency, half at 1/(2 pi time) to either side, all of it far away
    far = np.median(power[(f > 100.0) & (f < 400.0)])
    assert power[np.abs(f - frequency).argmin()] < 0.01 * far
    for side in (-1.0, 1.0):
        at = frequency + side / (2.0 * np.pi * time_)
        assert np.mean(power[np.abs(f - at) < 0.16]) == pytest.approx(0.5 * far, rel=0.15)
    # variance 1: what is taken away is pi/2 times the notch's full width, of the whole band
    assert 0.5 / h * far == pytest.approx(1.0 + 2.0 * h / time_ / 2.0, rel=0.03)
    # the closed form of the sampled filter: the spectrum is its autocorrelation's transform
    R = autocorrelation(notched, 4000, h)
    grid = np.array([3.0, 8.0, 12.0, 20.0, 100.0])
    k = np.arange(1, 4000)
    density = [R[0] + 2.0 * np.sum(R[1:] * np.cos(2.0 * np.pi * x * h * k)) for x in grid]
    t2 = (np.tan(np.pi * grid * h) ** 2 - np.tan(np.pi * frequency * h) ** 2) ** 2
    # bilinear transform of (s^2 + w^2)/(s^2 + b s + w^2), the textbook notch
    r2 = np.exp(-2.0 * h / time_)
    b = (1.0 - r2) / (1.0 + r2) * (1.0 + np.tan(np.pi * frequency * h) ** 2)
    expected = t2 / (t2 + (b * np.tan(np.pi * grid * h)) ** 2) * 2.0 / (1.0 + r2)
    assert density == pytest.approx(expected, abs=2e-3)
    assert np.mean(z**4) == pytest.approx(3.0, rel=0.03)

    law = NoiseLaw("interleaved", 1.0, components=(Component(1.0, shape="interleaved", depth=0.8),))
    z = draw_noise(law, 200_000, h, rng)
    pair = np.sort([z[::2].var(), z[1::2].var()])
    assert pair == pytest.approx([0.2, 1.8], rel=0.03)
    assert np.mean(z**4) == pytest.approx(3.0 * 1.64, rel=0.05)
    for half in (z[::2], z[1::2]):  # each converter by itself is Gaussian
        assert np.mean(half**4) / half.var() ** 2 == pytest.approx(3.0, rel=0.05)
    firsts = [np.abs(draw_noise(law, 400, h, rng)[::2]).mean() > 0.6 for _ in range(40)]
    assert 8 < sum(firsts) < 32  # either begins

    charging = NoiseLaw("charging", 1.0, components=(Component(1.0, 0.05, shape="charging"),))
    z = draw_noise(charging, 1_000_000, h, rng)
    # exponentially distributed above the level it falls to: standard deviation, lean and tail
    assert z.min() >= -1.0 and z.min() == pytest.approx(-1.0, abs=1e-3)
    assert np.mean(z > 1.0) == pytest.approx(np.exp(-2.0), rel=0.05)
    assert np.mean(z**3) == pytest.approx(2.0, rel=0.1)
    falls = np.diff(z) < 0.0
    # a rise that breaks down within the next interval shows there unless it was so young
    assert falls.mean() == pytest.approx(-np.expm1(-h / 0.05), rel=0.05)
    assert np.allclose(np.diff(z)[~falls & (z[:-1] > -1.0 + h / 0.05)], h / 0.05, atol=1e-9)
    assert not (notched.is_ar1 or law.is_ar1 or charging.is_ar1)


def test_shaped_noise_motes_and_rollers_are_what_they_say() -> None:
    rng = np.random.default_rng(18)
    h = 1e-3
    shaping = NoiseLaw("noise_shaping", 1.0, components=(Component(1.0, shape="shaped"),))
    z = draw_noise(shaping, 400_000, h, rng)
    # what is passed on twice nearly cancels: a sum over any stretch has the variance 4/6 only
    for n in (20, 200):
        sums = z.reshape(-1, n).sum(axis=1)
        assert sums.var() == pytest.approx(4.0 / 6.0, rel=5.0 * np.sqrt(2.0 / len(sums)))
    f, power = welch(z, 1.0 / h, nperseg=400, detrend=False)
    grid = (f > 20.0) & (f < 480.0)
    assert power[grid] == pytest.approx(2.0 * h / 6.0 * (2.0 * np.sin(np.pi * f[grid] * h)) ** 4,
                                        rel=0.25, abs=2e-6)  # fmt: skip
    assert autocorrelation(shaping, 5, h) == pytest.approx([1.0, -4 / 6, 1 / 6, 0.0, 0.0])
    assert len(autocorrelation(shaping, 1, h)) == 1

    part = Component(1.0, 0.1, shape="motes", rate=0.5)
    dusty = NoiseLaw("dusty", 1.0, components=(part,))
    z = draw_noise(dusty, 1_000_000, h, rng)
    # Poisson's numbers with the mean rate times a disc's mean chord over its diameter
    mean = 0.5 * np.pi / 4.0
    count = mean - z * np.sqrt(mean)
    assert np.abs(count - np.rint(count)).max() < 1e-9 and count.min() > -0.5
    for k, share in enumerate(np.exp(-mean) * np.array([1.0, mean, mean**2 / 2.0])):
        assert np.mean(np.rint(count) == k) == pytest.approx(share, abs=0.015)
    assert np.mean(z**3) == pytest.approx(-(mean**-0.5), rel=0.1)
    # so few that they hardly meet: chords longer than u diameters are sqrt(1 - u^2) of all
    alone = NoiseLaw("dusty", 1.0, components=(replace(part, rate=0.02),))
    dark = draw_noise(alone, 4_000_000, h, rng) < 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], dark, [False]]).astype(int)))
    assert len(edges) > 1000
    lasts = (edges[1::2] - edges[::2]) * h / 0.1
    assert np.mean(lasts > 1.01) < 0.03
    for u in (0.3, 0.6, 0.9):
        error = np.sqrt(u**2 * (1.0 - u**2) / len(lasts))
        assert np.mean(lasts > u) == pytest.approx(np.sqrt(1.0 - u**2), abs=5.0 * error + 0.02)
    # two discs a diameter and more apart do not meet
    assert np.all(autocorrelation(dusty, 300, h)[100:] == 0.0)

    part = Component(1.0, 20.0, 5.0, "strokes", depth=0.5)
    rollers = NoiseLaw("roller_pump", 1.0, components=(part,))
    z = draw_noise(rollers, 400_000, h, rng)
    bounds = np.array([-0.5 / 1.5, 0.5 / 0.5]) / np.sqrt(0.5 * 0.25 / 0.75)
    assert [z.min(), z.max()] == pytest.approx(bounds, abs=0.01)
    f, power = welch(z, 1.0 / h, nperseg=20_000, detrend=False)
    lines = [power[np.abs(f - k * 5.0) < 2.0].sum() for k in (1, 2, 3)]
    # a quarter of the power from each harmonic to the next, and nothing between
    assert lines[1] / lines[0] == pytest.approx(0.25, rel=0.05)
    assert lines[2] / lines[1] == pytest.approx(0.25, rel=0.05)
    assert lines[0] * (f[1] - f[0]) == pytest.approx(0.75, rel=0.05)
    assert power[(f > 2.0) & (f < 3.0)].max() < 0.02 * power.max()
    strokes = np.sum((z[1:] > 1.0) & (z[:-1] <= 1.0))
    assert strokes == pytest.approx(5.0 * 400.0, abs=60)  # its phase walks by some turns only
    # how soon lines forget: after a fifth of the time exp(-1/5) and exp(-4/5) of them are left
    R = autocorrelation(rollers, 4001, h)
    first, second = 0.75 * np.exp(-0.2), 0.75 / 4.0 * np.exp(-0.8)
    later = 0.75 / 16.0 * np.exp(-1.8) + 0.75 / 64.0 * np.exp(-3.2)
    assert R[4000] == pytest.approx(first + second + later, abs=1e-3)  # whole turns of all of them
    assert not (shaping.is_ar1 or dusty.is_ar1 or rollers.is_ar1)


def test_bells_bits_and_intermittent_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(20)
    h = 1e-3
    bell = NoiseLaw("beam_crossing", 1.0, components=(Component(1.0, 0.02, shape="bell"),))
    z = draw_noise(bell, 400_000, h, rng)
    # as smooth as can be: mean square slope 2/T^2, and a spectrum that falls as exp(-(pi f T)^2)
    slopes = np.diff(z) / h
    assert np.mean(slopes**2) == pytest.approx(2.0 / 0.02**2, rel=0.03)
    f, power = welch(z, 1.0 / h, nperseg=4000, detrend=False)
    grid = f < 45.0
    expected = 2.0 * np.sqrt(np.pi) * 0.02 * np.exp(-((np.pi * f * 0.02) ** 2))
    assert power[grid][1:] == pytest.approx(expected[grid][1:], rel=0.6)
    assert np.sum(power[grid][1:]) == pytest.approx(np.sum(expected[grid][1:]), rel=0.05)
    assert power[f > 120.0].max() < 1e-5 * power.max()
    # Rice: how often it comes up through zero
    ups = np.sum((z[1:] > 0.0) & (z[:-1] <= 0.0))
    rate = 400.0 * np.sqrt(2.0) / 0.02 / (2.0 * np.pi)
    assert ups == pytest.approx(rate, rel=0.03)
    # of a stretch shorter than its time the variance over many is 1 still
    short = np.array([draw_noise(bell, 5, h, rng)[[0, -1]] for _ in range(4000)])
    assert np.mean(short**2) == pytest.approx(1.0, abs=0.08)
    assert np.mean(short[:, 0] * short[:, 1]) == pytest.approx(np.exp(-0.04), abs=0.08)

    bits = NoiseLaw("one_bit", 1.0, components=(Component(1.0, 5e-3, shape="bits"),))
    z = draw_noise(bits, 400_000, h, rng)
    decay = np.exp(-h / 5e-3)
    steps = (z[1:] - decay * z[:-1]) / np.sqrt(1.0 - decay**2)
    assert np.abs(np.abs(steps) - 1.0).max() < 1e-9  # up or down, never anything else
    assert abs(np.mean(steps)) < 5.0 / np.sqrt(len(steps))
    assert abs(np.mean(steps[1:] * steps[:-1])) < 5.0 / np.sqrt(len(steps))
    # fourth cumulant of a sum of decay^k e_k: -2 (1 - decay^2)^2 / (1 - decay^4)
    excess = -2.0 * (1.0 - decay**2) / (1.0 + decay**2)
    assert np.mean(z**4) - 3.0 == pytest.approx(excess, abs=0.05)
    assert np.abs(z).max() < np.sqrt((1.0 + decay) / (1.0 - decay))

    part = Component(1.0, 2e-3, shape="lognormal", depth=0.5, gust_time=0.1)
    law = NoiseLaw("intermittent", 1.0, components=(part,))
    z = draw_noise(law, 1_000_000, h, rng)
    assert z.var() == pytest.approx(1.0, rel=0.05)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0 * np.exp(4.0 * 0.25), rel=0.15)
    # ln z^2 adds what the Gaussian has by itself to 2 depth times the slow one: far apart only
    # that is correlated, with variance 4 depth^2
    logs = np.log(z**2)
    logs -= logs.mean()
    for lag in (40, 100):
        expected = 4.0 * 0.25 * np.exp(-lag * h / 0.1)
        assert np.mean(logs[lag:] * logs[:-lag]) == pytest.approx(expected, abs=0.06)
    assert not (bell.is_ar1 or bits.is_ar1 or law.is_ar1)


def test_conducted_latched_and_waning_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(22)
    h = 1e-3
    bar = NoiseLaw("conducting", 1.0, components=(Component(1.0, 0.1, shape="conducting"),))
    z = draw_noise(bar, 1_000_000, h, rng)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0, rel=0.05)
    # a bar's impedance 1/(1 + sqrt(i w T)): its real part is the spectrum but for w itself,
    # rough as the root of the lag when near, and 1/sqrt(pi lag) when far
    for lag, expected in ((1, erfcx(0.1)), (100, erfcx(1.0)), (2000, 1.0 / np.sqrt(20.0 * np.pi))):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(expected, abs=0.06)
    f, power = welch(z, 1.0 / h, nperseg=50_000, detrend=False)
    w = 2.0 * np.pi * f[1:] * 0.1
    # transform of erfcx(sqrt(t)): 1/(s + sqrt(s))
    density = 4.0 * 0.1 * np.real(1.0 / (1j * w + np.sqrt(1j * w)))
    for low, high in ((0.1, 0.5), (0.5, 5.0), (5.0, 50.0)):
        band = (f[1:] > low) & (f[1:] < high)
        assert power[1:][band].mean() == pytest.approx(density[band].mean(), rel=0.2)

    latch = NoiseLaw("latching", 1.0, components=(Component(1.0, 0.05, shape="latching"),))
    z = draw_noise(latch, 1_000_000, h, rng)
    assert np.all(np.abs(z) == 1.0) and abs(z.mean()) < 0.05
    # dwells of two exponentials in a row: mean twice, variance twice the square of their time
    edges = np.flatnonzero(np.diff(z) != 0.0)
    dwells = np.diff(edges) * h / 0.05
    assert dwells.mean() == pytest.approx(2.0, rel=0.05)
    assert dwells.std() == pytest.approx(np.sqrt(2.0), rel=0.05)
    for u in (0.5, 2.0, 5.0):
        assert np.mean(dwells > u) == pytest.approx((1.0 + u) * np.exp(-u), abs=0.02)
    # a quarter of a turn later it has forgotten, and then it is rather on the other side
    for lag, expected in ((79, 0.0), (118, np.exp(-0.75 * np.pi) * np.cos(0.75 * np.pi))):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(expected, abs=0.02)

    waning = NoiseLaw("waning", 1.0, components=(Component(1.0, 2e-3, shape="waning", depth=0.9),))
    records = np.array([draw_noise(waning, 20_000, h, rng) for _ in range(40)])
    assert np.mean(records**2) == pytest.approx(1.0, rel=0.02)
    up = np.mean(records[:, 10_000:] ** 2, axis=1) > np.mean(records[:, :10_000] ** 2, axis=1)
    assert 8 < up.sum() < 32  # either way
    course = np.mean(np.where(up[:, None], records, records[:, ::-1]) ** 2, axis=0)
    tenths = course.reshape(10, -1).mean(axis=1)
    assert tenths == pytest.approx(1.0 + 0.9 * (np.arange(10) - 4.5) / 5.0, abs=0.06)
    # Gaussian of a variance between 0.1 and 1.9, any as likely
    assert np.mean(records**4) == pytest.approx(3.0 * (1.0 + 0.81 / 3.0), rel=0.05)
    after = [float(np.mean(records[:, lag:] * records[:, :-lag])) for lag in (1, 4)]
    assert after == pytest.approx(np.exp([-0.5, -2.0]), abs=0.02)
    assert not (bar.is_ar1 or latch.is_ar1 or waning.is_ar1)


def test_rattling_coded_and_two_paced_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(24)
    h = 1e-3
    rattle = NoiseLaw("rattling", 1.0, components=(Component(1.0, 0.1, shape="stops"),))
    z = draw_noise(rattle, 1_000_000, h, rng)
    # anywhere between its stops as likely, and never beyond
    assert np.abs(z).max() <= np.sqrt(3.0) and np.abs(z).max() > 1.73
    shares = np.histogram(z, np.linspace(-np.sqrt(3.0), np.sqrt(3.0), 11))[0] / len(z)
    assert shares == pytest.approx(0.1, abs=0.01)
    # in the middle it walks freely: steps of one variance, pi^2 D = 1/time for a distance of 1
    middle = np.abs(z[:-1]) < 1.0
    steps = np.diff(z)[middle]
    assert steps.var() == pytest.approx(12.0 * 2.0 * h / (np.pi**2 * 0.1), rel=0.02)
    assert np.mean(steps**4) / steps.var() ** 2 == pytest.approx(3.0, rel=0.03)
    R, near = autocorrelation(rattle, 501, h), autocorrelation(rattle, 3, 1e-5)
    assert R[0] == near[0] == pytest.approx(1.0, abs=1e-5)
    # near: half the mean squared step; far: the slowest mode alone
    assert 1.0 - near[2] == pytest.approx(2.0 * 12.0 * 1e-5 / (np.pi**2 * 0.1), rel=0.02)
    assert R[500] / R[400] == pytest.approx(np.exp(-1.0), rel=1e-6)

    bus = NoiseLaw("coded", 1.0, components=(Component(1.0, 0.02, shape="coded"),))
    z = draw_noise(bus, 500_000, h, rng)
    assert np.all(np.abs(z) == 1.0)
    # level for half a bit, or for a whole one where a half is followed by its like
    dwells = np.diff(np.flatnonzero(np.diff(z) != 0.0))
    assert set(dwells.tolist()) <= {9, 10, 11, 19, 20, 21}
    assert np.mean(dwells > 15) == pytest.approx(1.0 / 3.0, abs=0.02)
    # over whole bits nothing is left, wherever they begin but for one half at either end
    assert np.abs(np.cumsum(z)).max() <= 22.0
    # no line: of one half-bit pulse and its opposite, 4 sin^4(x)/(x^2) at x = pi f T/2
    f, power = welch(z, 1.0 / h, nperseg=10_000, detrend=False)
    x = 0.5 * np.pi * f[1:] * 0.02
    density = 2.0 * 0.02 * np.sin(x) ** 4 / x**2
    band = (f[1:] > 5.0) & (f[1:] < 90.0)
    smooth = np.convolve(power[1:][band] - density[band], np.ones(21) / 21.0, "valid")
    assert np.abs(smooth).max() < 0.15 * density.max()
    assert power.max() < 2.0 * density.max()
    firsts = np.array([draw_noise(bus, 3, h, rng)[0] for _ in range(400)])
    assert abs(firsts.mean()) < 0.25

    part = Component(1.0, 0.1, shape="paces", depth=0.1, gust_time=0.5)
    paced = NoiseLaw("two_paced", 1.0, components=(part,))
    z = draw_noise(paced, 1_000_000, h, rng)
    # one Gaussian all the time, of which the steps alone tell how quick it is
    assert np.mean(z**2) == pytest.approx(1.0, rel=0.05)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0, rel=0.1)
    steps = np.diff(z)
    slow, quick = 2.0 * -np.expm1(-h / 0.1), 2.0 * -np.expm1(-h / 0.01)
    assert np.mean(steps**2) == pytest.approx(0.5 * (slow + quick), rel=0.05)
    ratio = 1.0 + ((quick - slow) / (quick + slow)) ** 2
    assert np.mean(steps**4) / np.mean(steps**2) ** 2 == pytest.approx(3.0 * ratio, rel=0.07)
    loud = np.mean(steps[:999_900].reshape(-1, 50) ** 2, axis=1)
    pace = np.where(loud > np.sqrt(slow * quick), 1.0, -1.0)
    # paces are kept: the telegraph's own memory, a tenth of a second and one later
    for lag in (2, 10):
        kept = np.mean(pace[lag:] * pace[:-lag])
        assert kept == pytest.approx(np.exp(-lag * 0.05 / 0.5), abs=0.1)
    # limits: paces that last for ever, and paces that change at once
    lags = np.arange(200) * h
    for gust_time, expected in (
        (1e6, 0.5 * (np.exp(-lags / 0.1) + np.exp(-lags / 0.01))),
        (1e-8, np.exp(-0.5 * lags * (10.0 + 100.0))),
    ):
        law = NoiseLaw("two_paced", 1.0, components=(replace(part, gust_time=gust_time),))
        assert np.abs(autocorrelation(law, 200, h) - expected).max() < 1e-4
    assert not (rattle.is_ar1 or bus.is_ar1 or paced.is_ar1)


def test_decimated_hopping_and_drilling_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(26)
    h = 1e-3
    steep = NoiseLaw("decimated", 1.0, components=(Component(1.0, 0.01, shape="cut_off"),))
    z = draw_noise(steep, 500_000, h, rng)
    assert z.var() == pytest.approx(1.0, rel=0.03)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0, rel=0.05)
    # white up to 50 Hz, nothing beyond
    f, power = welch(z, 1.0 / h, nperseg=5000, detrend=False)
    assert power[(f > 1.0) & (f < 48.0)].mean() == pytest.approx(1.0 / 50.0, rel=0.03)
    for low in (1.0, 16.0, 32.0):
        assert power[(f > low) & (f < low + 15.0)].mean() == pytest.approx(1.0 / 50.0, rel=0.08)
    assert power[f > 52.0].max() < 1e-3 / 50.0
    # a recorder that is slower sees white at 0.01 s, and turns of the other sign between
    slow = np.array([draw_noise(steep, 400, 0.025, rng) for _ in range(100)])
    for lag, expected in ((0, 1.0), (1, np.sin(2.5 * np.pi) / (2.5 * np.pi)), (2, 0.0)):
        own = slow[:, lag:] * slow[:, : 400 - lag]
        assert own.mean() == pytest.approx(expected, abs=0.03)
    short = np.array([draw_noise(steep, 5, h, rng)[[0, -1]] for _ in range(4000)])
    assert np.mean(short**2) == pytest.approx(1.0, abs=0.08)
    assert np.mean(short[:, 0] * short[:, 1]) == pytest.approx(np.sinc(0.4), abs=0.08)

    part = Component(1.0, 0.05, shape="settling", depth=0.7)
    hops = NoiseLaw("mode_hopping", 1.0, components=(part,))
    z = draw_noise(hops, 2_000_000, h, rng)
    edges = np.flatnonzero(np.diff(z) != 0.0)
    assert np.mean(z[edges[1:]] ** 2) == pytest.approx(1.0, rel=0.05)
    assert abs(np.mean(z[edges[1:]] * z[edges[:-1]])) < 0.05  # of levels one after the other
    # the longer it has stayed, the longer it stays
    dwells = np.diff(edges) * h
    for at in (0.02, 0.1, 0.5):
        assert np.mean(dwells > at) == pytest.approx((1.0 + at / 0.05) ** -1.7, abs=0.02)
    assert np.mean(dwells[dwells > 0.1] > 0.2) > 1.4 * np.mean(dwells > 0.1)
    # the first one is no exception: at any instant the wait is the longer one's
    firsts = np.array([draw_noise(hops, 200, h, rng)[[0, 50, 150]] for _ in range(3000)])
    for k, at in ((1, 0.05), (2, 0.15)):
        held = np.mean(firsts[:, 0] == firsts[:, k])
        assert held == pytest.approx((1.0 + at / 0.05) ** -0.7, abs=0.03)

    part = Component(1.0, 2e-3, shape="drilled", rate=0.25, depth=0.8)
    drill = NoiseLaw("drilling", 1.0, components=(part,))
    records = np.array([draw_noise(drill, 20_000, h, rng) for _ in range(40)])
    assert np.mean(records**2) == pytest.approx(1.0, rel=0.03)
    loudness = np.mean(records.reshape(40, 200, 100) ** 2, axis=2)
    loud = loudness > 1.0
    # 0.2 most of the time and 1 + 0.8 * 3 for a quarter of it, at one stretch
    assert np.mean(loud, axis=1) == pytest.approx(np.full(40, 0.25), abs=0.02)
    turns = np.sum(loud != np.roll(loud, 1, axis=1), axis=1)
    assert np.mean(turns == 2) > 0.8
    assert np.median(loudness[loud]) == pytest.approx(3.4, rel=0.1)
    assert np.median(loudness[~loud]) == pytest.approx(0.2, rel=0.1)
    assert np.ptp(np.mean(loud.reshape(40, 4, 50), axis=(0, 2))) < 0.3  # anywhere
    assert not (steep.is_ar1 or hops.is_ar1 or drill.is_ar1)


def test_hunting_chattering_and_replugged_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(28)
    h = 1e-3
    part = Component(1.0, 50.0, 20.0, "hunting", depth=0.2, gust_time=2.0)
    fan = NoiseLaw("hunting_fan", 1.0, components=(part,))
    z = draw_noise(fan, 400_000, h, rng)
    assert np.abs(z).max() == pytest.approx(np.sqrt(2.0), abs=1e-3)  # a tone, all the time as loud
    assert z.var() == pytest.approx(1.0, rel=0.01)
    # how fast its phase turns, by pairs of ups through zero: between 16 and 24 Hz and back in 2 s
    ups = np.flatnonzero((z[1:] > 0.0) & (z[:-1] <= 0.0))
    exact = (ups - z[ups] / (z[ups + 1] - z[ups])) * h
    pitch = np.interp(
        np.arange(1.0, 399.0, 0.05), 0.5 * (exact[1:] + exact[:-1]), 1 / np.diff(exact)
    )
    lines = np.abs(np.fft.rfft(pitch - pitch.mean()))
    f = np.fft.rfftfreq(len(pitch), 0.05)
    assert f[lines.argmax()] == pytest.approx(0.5, abs=0.01)
    assert pitch.mean() == pytest.approx(20.0, abs=0.1)
    assert 2.0 * lines.max() / len(pitch) == pytest.approx(4.0, rel=0.05)
    # half a swing later the turns that it is ahead or behind decide: Bessel's function
    R = autocorrelation(fan, 2001, h)
    assert R[1000] == pytest.approx(np.exp(-0.02) * j0(2.0 * 0.2 * 20.0 * 2.0), abs=1e-9)
    assert R[2000] == pytest.approx(np.exp(-0.04), abs=1e-9)
    for lag in (5, 400, 1000, 2000):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.05)

    relay = NoiseLaw("chattering_relay", 1.0, components=(Component(1.0, 0.1, shape="chattering"),))
    z = draw_noise(relay, 1_000_000, h, rng)
    assert np.all(np.abs(z) == 1.0) and abs(z.mean()) < 0.06
    for lag in (1, 20, 100, 300):
        expected = 2.0 / np.pi * np.arcsin(np.exp(-lag * h / 0.1))
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(expected, abs=0.05)
    # it chatters: most stays are over in a few samples, and a few last for most of the time
    stays = np.diff(np.flatnonzero(np.diff(z) != 0.0)) * h
    assert np.median(stays) < 0.2 * stays.mean()
    assert stays[stays > 0.1].sum() > 0.5 * stays.sum()
    # an excursion's length goes as t^-1/2 while it is short
    ratio = np.mean(stays > 0.008) / np.mean(stays > 0.032)
    assert ratio == pytest.approx(2.0, rel=0.2)

    part = Component(1.0, 2e-3, shape="replugged", depth=0.8)
    fibre = NoiseLaw("replugged_fibre", 1.0, components=(part,))
    records = np.array([draw_noise(fibre, 10_000, h, rng) for _ in range(300)])
    loud = np.mean(records**2, axis=1)
    assert loud.mean() == pytest.approx(1.0, abs=0.1)
    assert 0.15 < loud.min() < 0.3 and 1.65 < loud.max() < 2.1
    quarters = np.histogram(loud, bins=[0.0, 0.6, 1.0, 1.4, 3.0])[0]  # any as likely
    assert np.all(np.abs(quarters - 75) < 35)
    # a Gaussian within each, as loud at its end as at its beginning
    own = records / np.sqrt(loud)[:, None]
    assert np.mean(own**4) == pytest.approx(3.0, rel=0.03)
    halves = np.mean(records[:, :5000] ** 2, axis=1) / np.mean(records[:, 5000:] ** 2, axis=1)
    assert np.abs(np.log(halves)).max() < 0.5
    for lag in (1, 4):
        expected = np.exp(-lag * h / 2e-3)
        assert np.mean(own[:, lag:] * own[:, :-lag]) == pytest.approx(expected, abs=0.02)
    assert not (fan.is_ar1 or relay.is_ar1 or fibre.is_ar1)


def test_beating_held_and_crackling_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(29)
    h = 1e-3
    part = Component(1.0, 200.0, 20.0, "beating", depth=0.05)
    fans = NoiseLaw("two_fans", 1.0, components=(part,))
    z = draw_noise(fans, 400_000, h, rng)
    assert np.abs(z).max() == pytest.approx(2.0, abs=0.01)
    assert z.var() == pytest.approx(1.0, abs=0.02)
    f, power = welch(z, 1.0 / h, nperseg=40_000)
    assert np.sort(f[np.argsort(power)[-2:]]) == pytest.approx([19.0, 21.0], abs=0.03)
    # the hum swells and fades twice a second: a twentieth of a second is a whole turn
    loud = (z**2).reshape(-1, 50).mean(axis=1)
    assert loud.min() < 0.05 and loud.max() > 1.9
    swell = np.abs(np.fft.rfft(loud - loud.mean()))
    assert np.fft.rfftfreq(len(loud), 0.05)[swell.argmax()] == pytest.approx(2.0, abs=0.02)

    meter = NoiseLaw("slow_meter", 1.0, components=(Component(1.0, 0.025, shape="held"),))
    z = draw_noise(meter, 400_000, h, rng)
    changes = np.flatnonzero(np.diff(z) != 0.0)
    assert np.all(np.diff(changes) == 25)
    levels = z[changes]
    assert levels.var() == pytest.approx(1.0, abs=0.05)
    assert np.mean(levels**4) == pytest.approx(3.0, abs=0.3)
    assert abs(np.mean(levels[1:] * levels[:-1])) < 0.04
    firsts = {int(np.flatnonzero(np.diff(draw_noise(meter, 100, h, rng)))[0]) for _ in range(60)}
    assert len(firsts) > 15  # the recorder begins anywhere

    part = Component(1.0, 0.01, shape="trains", rate=0.5, depth=50.0, gust_time=0.05)
    cable = NoiseLaw("crackling_cable", 1.0, components=(part,))
    z = draw_noise(cable, 1_000_000, h, rng)
    # 10 trains a second, 500 pulses, of 5 in the mean at a time; variance 5 and 5 50/12 besides
    mean, alone, together = 5.0, 5.0, 5.0 * 25.0 * 0.01 / 0.06
    assert z.min() == pytest.approx(-mean / np.sqrt(alone + together), abs=1e-3)
    assert abs(z.mean()) < 0.05 and z.var() == pytest.approx(1.0, abs=0.08)
    assert np.mean(z**3) > 0.5  # to one side
    R = autocorrelation(cable, 400, h)
    for lag in (5, 20, 60, 150):
        # the mean course of a train is a lag of 10 ms after one of 50 ms
        train = (0.05 * np.exp(-lag * h / 0.05) - 0.01 * np.exp(-lag * h / 0.01)) / 0.04
        stated = (alone * np.exp(-lag * h / 0.01) + together * train) / (alone + together)
        assert R[lag] == pytest.approx(stated, abs=1e-9)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.06)
    assert not (fans.is_ar1 or meter.is_ar1 or cable.is_ar1)


def test_sparkling_weighed_and_dimmed_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(31)
    h = 1e-3
    part = Component(1.0, shape="sparkling", rate=0.01)
    codes = NoiseLaw("sparkling_codes", 1.0, components=(part,))
    z = draw_noise(codes, 400_000, h, rng)
    assert set(np.round(z, 9).tolist()) == {-10.0, 0.0, 10.0}
    assert np.mean(z != 0.0) == pytest.approx(0.01, rel=0.08)
    assert np.mean(z > 0.0) == pytest.approx(0.005, rel=0.12)
    both = (z[1:] != 0.0) & (z[:-1] != 0.0)
    assert both.mean() == pytest.approx(1e-4, rel=0.7)  # they come alone

    readings = NoiseLaw("weighed_readings", 1.0, components=(Component(1.0, shape="binomial"),))
    z = draw_noise(readings, 400_000, h, rng)
    R = [float(np.mean(z[lag:] * z[: len(z) - lag])) for lag in range(4)]
    assert pytest.approx([1.0, 2.0 / 3.0, 1.0 / 6.0, 0.0], abs=0.02) == R
    assert autocorrelation(readings, 4, h) == pytest.approx([1.0, 2.0 / 3.0, 1.0 / 6.0, 0.0])
    assert autocorrelation(readings, 2, h) == pytest.approx([1.0, 2.0 / 3.0])
    f, power = welch(z, 1.0 / h, nperseg=1000)
    # cos^4 of a quarter turn at the highest frequency: next to nothing is left there
    expected = 8.0 / 3.0 * np.cos(0.5 * np.pi * f / f[-1]) ** 4 / f[-1]
    assert np.abs(power - expected)[1:-1].max() < 0.25 * expected.max()
    assert power[-20:-1].mean() < 1e-3 * power[1:20].mean()

    part = Component(1.0, 0.05, shape="dimmed")
    lamps = NoiseLaw("dimmed_lamps", 1.0, components=(part,))
    z = draw_noise(lamps, 500_000, h, rng)
    assert set(z.tolist()) == {-1.0, 1.0}
    begins = np.flatnonzero((z[1:] > 0.0) & (z[:-1] < 0.0))
    assert np.mean(np.diff(begins) % 50 == 0) > 0.99  # by the clock, but for pulses unseen
    first = int(np.median(begins % 50)) + 1
    lit = (z[first : first + 50 * 9998].reshape(-1, 50) > 0.0).mean(axis=1)
    assert lit.mean() == pytest.approx(0.5, abs=0.02)
    assert lit.var() == pytest.approx(1.0 / 12.0, abs=0.005)  # any length as likely
    assert abs(np.corrcoef(lit[1:], lit[:-1])[0, 1]) < 0.05
    R = autocorrelation(lamps, 200, h)
    assert R[50] == pytest.approx(1.0 / 3.0) and R[150] == pytest.approx(R[50])
    assert R[75] == pytest.approx(-1.0 / 6.0)
    for lag in (5, 25, 40, 60, 75, 100):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.03)
    assert not (codes.is_ar1 or readings.is_ar1 or lamps.is_ar1)


def test_overcorrected_rectified_and_stretched_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(37)
    h = 1e-3
    part = Component(1.0, shape="overcorrected", depth=0.7)
    zero = NoiseLaw("overcorrecting_zero", 1.0, components=(part,))
    z = draw_noise(zero, 400_000, h, rng)
    R = [float(np.mean(z[lag:] * z[: len(z) - lag])) for lag in range(5)]
    assert pytest.approx([1.0, -0.7, 0.49, -0.343, 0.2401], abs=0.02) == R
    assert autocorrelation(zero, 4, h) == pytest.approx([1.0, -0.7, 0.49, -0.343])
    assert autocorrelation(zero, 1, h) == pytest.approx([1.0])
    # with the share taken back given back nothing is left but what is new, from the first sample
    new = z[1:] + 0.7 * z[:-1]
    assert new.std() == pytest.approx(np.sqrt(1.0 - 0.49), rel=0.01)
    assert abs(np.mean(new[1:] * new[:-1])) < 0.01
    first = [draw_noise(zero, 2, h, rng)[0] for _ in range(4000)]
    assert np.std(first) == pytest.approx(1.0, abs=0.05)

    part = Component(1.0, 0.02, shape="rectified")
    pickup = NoiseLaw("rectified_pickup", 1.0, components=(part,))
    z = draw_noise(pickup, 1_000_000, h, rng)
    lowest = -1.0 / np.sqrt(0.5 * np.pi - 1.0)
    assert lowest - 1e-9 <= z.min() < lowest + 0.01
    # a half-normal distribution
    skewness = np.sqrt(2.0) * (4.0 - np.pi) / (np.pi - 2.0) ** 1.5
    assert np.mean(z) == pytest.approx(0.0, abs=0.03)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.05)
    assert np.mean(z**3) == pytest.approx(skewness, abs=0.15)
    assert np.mean(z < lowest * (1.0 - 0.6745 / np.sqrt(2.0 / np.pi))) == pytest.approx(
        0.5, abs=0.02
    )
    R = autocorrelation(pickup, 100, h)
    assert R[0] == pytest.approx(1.0) and (np.diff(R) < 0.0).all()
    for lag in (1, 5, 14, 40):
        r = np.exp(-lag * h / 0.02)
        # of two moduli: polar coordinates of the half plane in which both have one sign, and not
        angle = np.linspace(0.0, 0.5 * np.pi, 20_001)
        mean = sum(
            np.trapezoid(
                np.sin(2.0 * angle) / (1.0 - sign * r * np.sin(2.0 * angle)) ** 2, angle
            ) for sign in (1.0, -1.0)
        ) * (1.0 - r**2) ** 1.5 / np.pi  # fmt: skip
        assert R[lag] == pytest.approx((mean - 2.0 / np.pi) / (1.0 - 2.0 / np.pi), abs=1e-4)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.04)

    part = Component(1.0, 0.02, shape="stretched", depth=0.4)
    insulation = NoiseLaw("glassy_dielectric", 1.0, components=(part,))
    z = draw_noise(insulation, 2_000_000, h, rng)
    R = autocorrelation(insulation, 1001, h)
    assert R[20] == pytest.approx(np.exp(-1.0))
    # ten times as late, 10^0.4 times as much of the logarithm is gone
    assert np.log(R[1000]) / np.log(R[100]) == pytest.approx(10.0**0.4)
    for lag in (1, 5, 20, 100, 400):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.04)
    assert np.mean(z**4) / np.mean(z**2) ** 2 == pytest.approx(3.0, abs=0.15)
    assert not (zero.is_ar1 or pickup.is_ar1 or insulation.is_ar1)


def test_toothed_diffused_and_squared_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(38)
    h = 1e-3
    part = Component(1.0, 0.01, shape="teeth", gust_time=0.12, depth=0.8)
    gear = NoiseLaw("worn_gear", 1.0, components=(part,))
    z = draw_noise(gear, 1_200_000, h, rng)
    levels = z[5::10]  # one of each tooth, wherever the first one begins
    steps = np.flatnonzero(np.abs(np.diff(z)) > 1e-9) + 1
    assert set(np.diff(steps).tolist()) == {10}
    # a tooth turn by turn remembers its own, and nothing of its neighbours
    new = levels[12:] - 0.8 * levels[:-12]
    assert new.std() == pytest.approx(0.6, rel=0.02)
    for apart in (1, 5, 11, 12, 24):
        assert abs(np.mean(new[apart:] * new[:-apart])) < 0.01
    R = autocorrelation(gear, 241, h)
    assert R[[0, 5, 10, 60, 115, 120, 125, 240]] == pytest.approx(
        [1.0, 0.5, 0.0, 0.0, 0.4, 0.8, 0.4, 0.64], abs=1e-9
    )

    part = Component(1.0, shape="diffused", depth=0.2)
    electrode = NoiseLaw("salty_electrode", 1.0, components=(part,))
    z = draw_noise(electrode, 1_000_000, h, rng)
    assert z.std() == pytest.approx(1.0, abs=0.01)
    # summed up it strays as the number of steps to the power 2 H
    for m in (2, 10, 100):
        sums = z[: len(z) // m * m].reshape(-1, m).sum(axis=1)
        assert sums.var() == pytest.approx(m**0.4, rel=0.06)
    frequency, power = welch(z, 1.0 / h, nperseg=8192)
    low = (frequency > 1.0) & (frequency < 50.0)
    slope = np.polyfit(np.log(frequency[low]), np.log(power[low]), 1)[0]
    assert slope == pytest.approx(0.6, abs=0.05)
    # all of what one sample brings is taken back by the others in the end
    R = autocorrelation(electrode, 100_000, h)
    assert R[1] == pytest.approx(2.0**-0.6 - 1.0)
    assert 0.0 < 1.0 + 2.0 * R[1:].sum() < 2e-3 and (R[1:] < 0.0).all()
    assert autocorrelation(electrode, 1, h) == pytest.approx([1.0])

    part = Component(1.0, 0.5, 5.0, shape="squared")
    mirror = NoiseLaw("trembling_mirror", 1.0, components=(part,))
    z = draw_noise(mirror, 2_000_000, h, rng)
    # chi-square of one degree of freedom, downwards
    assert 0.5**0.5 - 1e-4 < z.max() <= 0.5**0.5
    assert np.mean(z) == pytest.approx(0.0, abs=0.03)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.06)
    assert np.mean(z**3) == pytest.approx(-(8.0**0.5), abs=0.5)
    assert np.mean(z > (1.0 - 0.4549) / 2.0**0.5) == pytest.approx(0.5, abs=0.01)
    # half of it at twice the mirror's pitch, half of it slow
    frequency, power = welch(z, 1.0 / h, nperseg=20_000, detrend=False)
    twice, slow = (np.abs(frequency - 10.0) < 5.0), frequency < 5.0
    assert power[twice].sum() == pytest.approx(power[slow].sum(), rel=0.1)
    assert frequency[twice][power[twice].argmax()] == pytest.approx(10.0, abs=0.5)
    assert power[np.abs(frequency - 5.0) < 0.5].max() < 0.1 * power[twice].max()
    assert not (gear.is_ar1 or electrode.is_ar1 or mirror.is_ar1)


def test_flapping_startled_and_bubbling_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(39)
    h = 1e-3
    part = Component(1.0, 0.02, shape="flapping", gust_time=0.05)
    damper = NoiseLaw("flapping_damper", 1.0, components=(part,))
    z = draw_noise(damper, 2_000_000, h, rng)
    # a beta distribution between the levels: variance 1/(2 a + 1), kurtosis 3 (2 a + 1)/(2 a + 3)
    a = 0.5 * 0.02 / 0.05
    x = z / np.sqrt(2.0 * a + 1.0)
    assert np.abs(x).max() <= 1.0 and np.abs(x).max() > 0.999
    assert np.mean(x**2) == pytest.approx(1.0 / (2.0 * a + 1.0), rel=0.02)
    assert np.mean(z**4) == pytest.approx(3.0 * (2.0 * a + 1.0) / (2.0 * a + 3.0), rel=0.03)
    # the lag undone there are both levels, and between them what flaps within a sample
    left = np.exp(-h / 0.02)
    level = (x[1:] - left * x[:-1]) / (1.0 - left)
    at_one = np.abs(np.abs(level) - 1.0) < 1e-6
    assert np.mean(at_one) == pytest.approx(np.exp(-0.5 * h / 0.05), abs=2e-3)
    sign = np.sign(level)
    assert np.mean(sign[50:] * sign[:-50]) == pytest.approx(np.exp(-1.0), abs=0.02)
    R = autocorrelation(damper, 200, h)
    for lag in (1, 10, 40, 150):
        # what passes two lags in a row, by its spectrum
        w = np.linspace(0.0, 4e4, 4_000_001)
        power = 1.0 / ((1.0 + (0.02 * w) ** 2) * (1.0 + (0.05 * w) ** 2))
        assert R[lag] == pytest.approx(
            np.trapezoid(power * np.cos(w * lag * h), w) / np.trapezoid(power, w), abs=1e-4
        )

    part = Component(1.0, shape="startled", depth=0.3)
    receiver = NoiseLaw("startled_receiver", 1.0, components=(part,))
    z = draw_noise(receiver, 4_000_000, h, rng)
    assert z.std() == pytest.approx(1.0, abs=0.01)
    assert np.mean(z**4) == pytest.approx(3.0 * (1.0 - 0.09) / (1.0 - 3.0 * 0.09), rel=0.05)
    # white, and its squares are an autoregression of the first order
    square = z**2 - np.mean(z**2)
    for lag in (1, 2, 3):
        assert abs(np.mean(z[lag:] * z[:-lag])) < 3e-3
        remembered = np.mean(square[lag:] * square[:-lag]) / square.var()
        assert remembered == pytest.approx(0.3**lag, abs=0.02)
    # after a large sample, and not before one of the same size, it is loud
    large = np.flatnonzero(np.abs(z[1:-1]) > 2.5) + 1
    loud = np.mean(z[large + 1] ** 2)
    assert loud == pytest.approx(0.7 + 0.3 * np.mean(z[large] ** 2), rel=0.05)
    assert autocorrelation(receiver, 4, h) == pytest.approx([1.0, 0.0, 0.0, 0.0])

    part = Component(1.0, 0.02, shape="bubbles", rate=0.4)
    nozzle = NoiseLaw("bubbling_nozzle", 1.0, components=(part,))
    z = draw_noise(nozzle, 2_000_000, h, rng)
    assert abs(z.mean()) < 0.01 and z.std() == pytest.approx(1.0, abs=0.02)
    R = autocorrelation(nozzle, 2000, h)
    for lag in (1, 5, 20, 50, 100):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.02)
    # a bubble is a step up; of two stages each, their waits vary by the root of a half
    steps = z[1:] - np.exp(-h / 0.02) * z[:-1]
    come = steps > steps.min() + 0.3
    waits = np.diff(np.flatnonzero(come)) * h
    assert waits.mean() == pytest.approx(0.02 / 0.4, rel=0.03)
    assert waits.std() / waits.mean() == pytest.approx(0.5**0.5, abs=0.02)
    # so that over long times their number strays half as much as were they independent
    many = come[: len(come) // 2000 * 2000].reshape(-1, 2000).sum(axis=1)
    assert many.var() / many.mean() == pytest.approx(0.5, abs=0.1)
    # over as many pulses' worth of area as come in the mean, what is slow tells the same
    variance = 0.4 * (2.0 * 0.4 + 1.0) / (2.0 * (4.0 * 0.4 + 1.0))
    area = 0.02 / np.sqrt(variance)
    assert (R[0] + 2.0 * R[1:].sum()) * h == pytest.approx(0.5 * 20.0 * area**2, rel=0.02)
    assert not (damper.is_ar1 or receiver.is_ar1 or nozzle.is_ar1)


def test_resting_balanced_and_sinking_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(40)
    h = 1e-3
    ball = NoiseLaw("resting_ball", 1.0, components=(Component(1.0, 0.1, shape="resting"),))
    z = draw_noise(ball, 2_000_000, h, rng)
    # exponentially distributed above its stop
    assert -1.0 <= z.min() < -0.999
    assert abs(z.mean()) < 0.04 and z.std() == pytest.approx(1.0, abs=0.04)
    assert np.mean(z > 2.0) == pytest.approx(np.exp(-3.0), rel=0.1)
    # far from the stop it is a walk of even drift: unit height is two, of h/0.1 variance each
    steps = np.diff(z)[z[:-1] > 0.5]
    assert steps.mean() == pytest.approx(-2.0 * h / 0.1, abs=2e-3)
    assert steps.std() == pytest.approx(2.0 * np.sqrt(h / 0.1), rel=0.01)
    R = autocorrelation(ball, 60_000, h)
    for lag in (1, 10, 50, 200, 400):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.04)
    assert R[0] == pytest.approx(1.0) and np.all(np.diff(R) <= 1e-12)
    # its mean over long strays as if there were an independent height every two times
    assert (R[0] / 2.0 + R[1:].sum()) * h == pytest.approx(0.1, rel=1e-3)

    part = Component(1.0, 0.005, shape="balanced", gust_time=1.0)
    balance = NoiseLaw("drifting_balance", 1.0, components=(part,))
    z = draw_noise(balance, 4_000_000, h, rng)
    # a product of two Gaussians: moments 1, 9, and quiet where the balance goes through zero
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.06)
    assert np.mean(z**4) == pytest.approx(9.0, rel=0.2)
    loud = np.sqrt((z**2).reshape(-1, 20).mean(axis=1))
    assert np.mean(loud < 0.3) == pytest.approx(0.26, abs=0.06)
    square = z**2 - 1.0
    # of the squares: (1 + 2 r^2) (1 + 2 q^2) - 1 over 8, with both correlations
    for lag in (1, 3, 10, 300):
        r, q = np.exp(-2.0 * lag * h / 0.005), np.exp(-2.0 * lag * h)
        both = (1.0 + 2.0 * r) * (1.0 + 2.0 * q) - 1.0
        assert np.mean(square[lag:] * square[:-lag]) == pytest.approx(both, rel=0.3, abs=0.15)
        stated = autocorrelation(balance, 301, h)[lag]
        assert stated == pytest.approx(np.sqrt(r * q))
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(stated, abs=0.05)

    meter = NoiseLaw("sinking_crests", 1.0, components=(Component(1.0, 0.05, shape="crests"),))
    z = draw_noise(meter, 2_000_000, h, rng)
    # Gumbel's distribution
    assert abs(z.mean()) < 0.03 and z.std() == pytest.approx(1.0, abs=0.03)
    assert np.mean(z**3) == pytest.approx(1.1395, rel=0.1)
    unit = np.pi / np.sqrt(6.0)
    assert np.mean(z < -np.euler_gamma / unit) == pytest.approx(np.exp(-1.0), abs=0.01)
    # it sinks evenly or leaps
    steps = np.diff(z) * unit
    sinks = np.abs(steps + h / 0.05) < 1e-9
    assert steps.min() > -h / 0.05 - 1e-9 and np.mean(sinks) == pytest.approx(
        np.exp(-h / 0.05), abs=2e-3
    )
    R = autocorrelation(meter, 400, h)
    u = np.linspace(-4.0, 40.0, 20_001)
    for lag in (1, 10, 50, 200):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.03)
        # by the mean of what is left: it was x, and is x - age or a new crest above that
        age = lag * h / 0.05
        density = np.exp(-u - np.exp(-u))
        # above v it is with 1 - exp(-(1 - exp(-age)) exp(-v))
        above = np.linspace(0.0, 30.0, 2001) + u[::20, None] - age
        more = np.trapezoid(-np.expm1(np.expm1(-age) * np.exp(-above)), above, axis=1)
        later = u[::20] - age + more
        mean = np.trapezoid((density * u)[::20] * later, u[::20]) - np.euler_gamma**2
        assert R[lag] == pytest.approx(mean / unit**2, abs=2e-3)
    assert not (ball.is_ar1 or balance.is_ar1 or meter.is_ar1)


def test_medians_phases_and_passing_charges_are_what_they_say() -> None:
    rng = np.random.default_rng(41)
    h = 1e-3
    law = NoiseLaw("median_of_three", 1.0, components=(Component(1.0, shape="median"),))
    z = draw_noise(law, 2_000_000, h, rng)
    unit = np.sqrt(1.0 - np.sqrt(3.0) / np.pi)
    for level in (-1.5, -0.5, 0.3, 1.0):
        below = ndtr(level)
        assert np.mean(z * unit < level) == pytest.approx(3 * below**2 - 2 * below**3, abs=2e-3)
    # how often two in a row are one reading: count the orders of four
    same = [sorted(p[:3])[1] == sorted(p[1:])[1] for p in permutations(range(4))]
    assert np.mean(np.diff(z) == 0.0) == pytest.approx(np.mean(same), abs=2e-3)
    # given the readings that two medians share, both are means of what one or two others do
    x, weight = np.polynomial.hermite_e.hermegauss(120)
    weight /= weight.sum()
    u = np.linspace(-9.0, 9.0, 3001)
    density = np.exp(-0.5 * u**2) / np.sqrt(2.0 * np.pi)
    du = u[1] - u[0]
    alone = np.array([
        (np.clip(c, np.minimum.outer(u[::10], u[::10]), np.maximum.outer(u[::10], u[::10]))
         * np.multiply.outer(density[::10], density[::10])).sum() * (10 * du) ** 2 for c in x
    ])  # fmt: skip
    two_apart = weight @ alone**2 / unit**2
    low, high = np.minimum.outer(u[::5], u[::5]), np.maximum.outer(u[::5], u[::5])
    clipped = low * ndtr(low) + high * ndtr(-high)
    clipped += np.interp(low, u, density) - np.interp(high, u, density)
    one_apart = density[::5] @ clipped**2 @ density[::5] * (5 * du) ** 2 / unit**2
    R = autocorrelation(law, 5, h)
    assert R[1:3] == pytest.approx(np.array([one_apart, two_apart]), abs=3e-4)
    for lag in range(5):
        assert np.mean(z[lag:] * z[: len(z) - lag]) == pytest.approx(R[lag], abs=5e-3)

    law = NoiseLaw("faded_phase", 1.0, components=(Component(1.0, 0.02, shape="phase"),))
    z = draw_noise(law, 2_000_000, h, rng)
    # anything between both ends as likely, and from one end it goes to the other at once
    assert np.abs(z).max() <= np.sqrt(3.0) and np.mean(z**4) == pytest.approx(1.8, abs=0.02)
    assert np.histogram(z, 8, (-np.sqrt(3.0), np.sqrt(3.0)))[0] / len(z) == pytest.approx(
        np.full(8, 0.125), abs=5e-3
    )
    jumps = np.abs(np.diff(z)) > 1.8 * np.sqrt(3.0)
    assert np.mean(jumps) > 0.02 and np.abs(z[:-1][jumps]).min() > 0.7 * np.sqrt(3.0)
    R = autocorrelation(law, 101, h)
    d = np.linspace(-np.pi, np.pi, 200_001)
    for lag in (1, 4, 20, 100):
        # the density of how far two phases of correlated light are apart (Middleton, 1960)
        r = np.exp(-lag * h / 0.02)
        b = r * np.cos(d)
        apart = (1.0 - r**2) / (2.0 * np.pi) / (1.0 - b**2)
        apart *= 1.0 + b * np.arccos(-b) / np.sqrt(1.0 - b**2)
        assert np.trapezoid(apart, d) == pytest.approx(1.0, abs=1e-6)
        # of phases evenly anywhere, of which the second one is beyond an end or not
        turn = np.abs(d)
        product = np.pi**2 / 3.0 - np.pi * turn + 0.5 * turn**2
        mean = np.trapezoid(apart * product, d) / (np.pi**2 / 3.0)
        assert R[lag] == pytest.approx(mean, abs=1e-5)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.02)

    part = Component(1.0, 0.01, shape="passing", rate=0.5)
    law = NoiseLaw("charged_drops", 1.0, components=(part,))
    z = draw_noise(law, 4_000_000, h, rng)
    assert z.std() == pytest.approx(1.0, abs=0.02) and abs(np.mean(z**3)) < 0.2
    # Campbell: 3 rate int u^4 over (rate int u^2)^2
    s = np.linspace(-9.0, 9.0, 20_001)
    pulse = s * np.exp(-0.5 * s**2)
    fourth = 3.0 * np.trapezoid(pulse**4, s) / np.trapezoid(pulse**2, s) ** 2 / 0.5
    assert np.mean(z**4) - 3.0 == pytest.approx(fourth, rel=0.1)
    R = autocorrelation(law, 200, h)
    for lag in (1, 7, 14, 20, 35, 80):
        beside = np.interp(s - lag * h / 0.01, s, pulse, 0.0, 0.0)
        overlap = np.trapezoid(pulse * beside, s) / np.trapezoid(pulse**2, s)
        assert R[lag] == pytest.approx(overlap, abs=1e-5)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.02)
    # it is a slope: of its sum over long only the ends are left, each of rms sqrt(2) times
    assert z.reshape(-1, 4000).mean(axis=1).std() == pytest.approx(2.0 * 0.01 / 4.0, rel=0.08)
    # and it has no pitch: a broad hump about 1/(2 pi time)
    frequency, power = welch(z, 1.0 / h, nperseg=1 << 12)
    most = np.average(frequency, weights=frequency == frequency[np.argmax(power)])
    assert most == pytest.approx(1.0 / (2.0 * np.pi * 0.01), rel=0.15)
    wide = frequency[power > 0.5 * power.max()]
    assert wide[-1] > 2.5 * wide[0]


def test_restarted_slowing_and_referred_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(42)
    h = 1e-3
    law = NoiseLaw("restarted_mean", 1.0, components=(Component(1.0, 0.02, shape="restarted"),))
    z = draw_noise(law, 2_000_000, h, rng)
    q = np.exp(-h / 0.02)
    # of means of k readings the variance is 1/k, and of k^-2 the mean is a dilogarithm
    assert z.std() == pytest.approx(1.0, abs=0.02) and abs(z.mean()) < 0.02
    once, twice = -np.log1p(-q), spence(1.0 - q)
    fourth = 3.0 * twice * q / (1.0 - q) / once**2
    assert np.mean(z**4) == pytest.approx(fourth, rel=0.05)
    R = autocorrelation(law, 200, h)
    x = np.linspace(0.0, q, 400_001)
    for lag in (1, 3, 20, 60, 199):
        left = np.trapezoid(x**lag / (1.0 - x), x) / once
        assert R[lag] == pytest.approx(left, abs=1e-6)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.02)
    # the first sample is as likely to be anywhere in its mean as any other
    first = np.array([draw_noise(law, 2, h, rng) for _ in range(40_000)])
    assert first.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.04)
    assert np.mean(first[:, 0] * first[:, 1]) == pytest.approx(R[1], abs=0.05)

    part = Component(1.0, 1.0, shape="slowing", depth=0.02)
    law = NoiseLaw("slowing_stream", 1.0, components=(part,))
    n, ways = 200_000, set()
    all_ends: dict[bool, list[list[float]]] = {True: [], False: []}
    for _ in range(40):
        z = draw_noise(law, n, h, rng).reshape(10, -1)
        ends = [float(np.mean(p[10:] * p[:-10]) / np.mean(p**2)) for p in (z[0], z[-1])]
        forth = ends[0] > ends[1]
        ways.add(forth)
        all_ends[forth].append([*ends, float(np.mean(z[0] ** 2)), float(np.mean(z[-1] ** 2))])
    assert ways == {False, True}
    # rates of 1 to 50 per s, of which a tenth at either end: 1 + 49/20 and 50 - 49/20
    slow, quick = np.exp(-0.01 * 3.45), np.exp(-0.01 * 47.55)
    assert np.mean(all_ends[True], axis=0)[:2] == pytest.approx([slow, quick], abs=0.03)
    assert np.mean(all_ends[False], axis=0)[:2] == pytest.approx([quick, slow], abs=0.03)
    loud = np.array(all_ends[True] + all_ends[False])[:, 2:].mean(axis=0)
    assert loud == pytest.approx([1.0, 1.0], abs=0.1)  # as loud all along
    R = autocorrelation(law, 400, h)
    rates = np.linspace(1.0, 50.0, 20_001)
    for lag in (0, 1, 10, 100, 399):
        assert R[lag] == pytest.approx(np.trapezoid(np.exp(-rates * lag * h), rates) / 49.0)

    law = NoiseLaw("weak_reference", 1.0, components=(Component(1.0, shape="referred", rate=6.0),))
    z = draw_noise(law, 1_000_000, h, rng)
    unit = np.sqrt(6.0 / 4.0)  # rms of Student's t of six degrees of freedom
    for level in (-3.0, -1.0, 0.2, 1.5, 4.0):
        assert np.mean(z * unit < level) == pytest.approx(stdtr(6.0, level), abs=2e-3)
    assert np.mean(np.abs(z) > 5.0) == pytest.approx(2.0 * stdtr(6.0, -5.0 * unit), rel=0.15)
    assert z.std() == pytest.approx(1.0, abs=0.01) and abs(z[1:] @ z[:-1]) / len(z) < 5e-3
    assert autocorrelation(law, 4, h).tolist() == [1.0, 0.0, 0.0, 0.0]


def test_dry_friction_larger_ones_and_repeated_packets_are_what_they_say() -> None:
    rng = np.random.default_rng(43)
    h = 1e-3
    law = NoiseLaw("dry_slide", 1.0, components=(Component(1.0, 0.05, shape="dry"),))
    z = draw_noise(law, 2_000_000, h, rng)
    # exponential to both sides: of variance 1, its modulus has the mean 1/sqrt(2)
    for level in (0.1, 0.5, 1.0, 2.5):
        beyond = 0.5 * np.exp(-np.sqrt(2.0) * level)
        assert np.mean(z > level) == pytest.approx(beyond, abs=0.012)
        assert np.mean(z < -level) == pytest.approx(beyond, abs=0.012)
    # as strong at any speed: between samples it loses what dry friction takes, 1 in own units
    drift = np.diff(z) / np.sqrt(2.0) / (h / 0.05)
    for low, high in ((0.8, 1.2), (2.0, 3.0)):
        fast = (np.abs(z[:-1]) > low) & (np.abs(z[:-1]) < high)
        assert np.mean(drift[fast] * np.sign(z[:-1][fast])) == pytest.approx(-1.0, abs=0.12)
    R = autocorrelation(law, 400, h)
    x = np.linspace(0.0, 20.0, 2001)
    for lag in (10, 50, 200, 399):
        t = lag * h / 0.05
        # what drifts to rest and is not there yet, from the image of its free spreading
        near, far = (np.exp(-(np.add.outer(x, s * x) ** 2) / (2.0 * t)) for s in (-1.0, 1.0))
        kept = 4.0 * np.exp(-0.5 * t) * np.outer(x * np.exp(-x), x * np.exp(-x)) * (near - far)
        whole = np.trapezoid(np.trapezoid(kept, x), x) / np.sqrt(2.0 * np.pi * t)
        assert R[lag] == pytest.approx(whole, abs=1e-4)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.03)
    # it does not forget its sign before it has come to rest
    first = np.array([draw_noise(law, 2, h, rng) for _ in range(20_000)])
    assert first.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.03)
    same = np.abs(first[:, 0]) > 1.5  # 1.06 in own units, or 7 standard deviations of a step
    assert np.all(np.sign(first[same, 0]) == np.sign(first[same, 1]))

    law = NoiseLaw("larger_of_two", 1.0, components=(Component(1.0, 0.02, shape="larger"),))
    z = draw_noise(law, 2_000_000, h, rng)
    spread, mean = np.sqrt(1.0 - 1.0 / np.pi), 1.0 / np.sqrt(np.pi)
    for level in (-1.0, 0.0, 0.7, 2.0):  # neither is above
        assert np.mean(z * spread + mean < level) == pytest.approx(ndtr(level) ** 2, abs=0.01)
    R = autocorrelation(law, 100, h)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    for lag in (3, 20, 60):
        r = np.exp(-lag * h / 0.02)
        # both pairs by their common part: the mean of the larger of two given that, squared
        one, other = np.meshgrid(np.sqrt(r) * nodes, np.sqrt(r) * nodes)
        rest = np.sqrt(2.0 * (1.0 - r))
        away = (one - other) / rest
        given = one * ndtr(away) + other * ndtr(-away)
        given += rest * np.exp(-0.5 * away**2) / np.sqrt(2.0 * np.pi)
        both = weights @ given**2 @ weights / (2.0 * np.pi)
        assert R[lag] == pytest.approx((both - mean**2) / spread**2, abs=2e-3)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.02)

    part = Component(1.0, shape="repeated", depth=0.6)
    law = NoiseLaw("repeated_packets", 1.0, components=(part,))
    z = draw_noise(law, 500_000, h, rng)
    assert z.std() == pytest.approx(1.0, abs=0.01)
    assert np.mean(z**4) == pytest.approx(3.0, abs=0.1)  # each reading is as ever
    again = np.diff(z) == 0.0
    assert np.mean(again) == pytest.approx(0.6, abs=5e-3)
    assert np.mean(again[1:] & again[:-1]) == pytest.approx(0.36, abs=5e-3)  # whatever was before
    fresh = z[1:][~again]
    assert abs(np.mean(fresh[1:] * fresh[:-1])) < 0.01
    assert autocorrelation(law, 4, h) == pytest.approx([1.0, 0.6, 0.36, 0.216])


def test_clipped_thrice_filtered_and_fitful_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(47)
    h = 1e-3
    level = 0.6
    part = Component(1.0, 0.02, shape="clipped", depth=level)
    law = NoiseLaw("railed_microphone", 1.0, components=(part,))
    z = draw_noise(law, 2_000_000, h, rng)
    x = np.linspace(-8.0, 8.0, 4001)
    density = np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
    cut = np.clip(x, -level, level)
    spread = np.sqrt(np.trapezoid(cut**2 * density, x))
    # at either rail for as long as the free rumble is beyond, between them Gaussian
    assert np.abs(z).max() == pytest.approx(level / spread, rel=1e-5)
    for side in (-1.0, 1.0):
        held = np.mean(side * z > level / spread - 1e-9)
        assert held == pytest.approx(ndtr(-level), abs=0.01)
    for inner in (-0.4, 0.1, 0.5):
        assert np.mean(z * spread < inner) == pytest.approx(ndtr(inner), abs=0.01)
    R = autocorrelation(law, 100, h)
    assert R[0] == pytest.approx(1.0, abs=1e-9)
    for lag in (1, 3, 20, 60):
        r = np.exp(-lag * h / 0.02)
        rest = np.sqrt(1.0 - r * r)
        # the mean of the later one, given the earlier one
        up, down = (level - r * x) / rest, (-level - r * x) / rest
        bell = (np.exp(-0.5 * down**2) - np.exp(-0.5 * up**2)) / np.sqrt(2.0 * np.pi)
        given = level * (ndtr(-up) - ndtr(down)) + r * x * (ndtr(up) - ndtr(down)) + rest * bell
        whole = np.trapezoid(cut * given * density, x) / spread**2
        assert R[lag] == pytest.approx(whole, abs=1e-5)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.02)

    T = 0.02
    law = NoiseLaw("three_stages", 1.0, components=(Component(1.0, T, shape="thrice"),))
    R = autocorrelation(law, 200, h)
    # three lags answer a kick by s^2 exp(-s): how that overlaps with itself
    s = np.arange(0.0, 40.0, 1e-3)
    kick = s**2 * np.exp(-s)
    for lag in (0, 5, 20, 100):
        moved = round(lag * h / T / 1e-3)
        overlap = kick[moved:] @ kick[: len(s) - moved] / (kick @ kick)
        assert R[lag] == pytest.approx(overlap, abs=1e-6)
    z = draw_noise(law, 1_000_000, h, rng)
    assert z.std() == pytest.approx(1.0, abs=0.02) and np.mean(z**4) == pytest.approx(3.0, abs=0.2)
    # twice smooth: the slope's variance is 1/3 and the bend's 1, in units of the time
    assert np.mean(np.diff(z) ** 2) == pytest.approx((h / T) ** 2 / 3.0, rel=0.03)
    assert np.mean(np.diff(z, 2) ** 2) == pytest.approx((h / T) ** 4, rel=0.08)
    # and three stages turned round leave white noise
    back, decay = z, np.exp(-h / T)
    for _ in range(3):
        back = back[1:] - decay * back[:-1]
    near = back - back.mean()
    assert abs(np.mean(near[5:] * near[:-5])) < 0.01 * np.mean(near**2)
    # short records are of the same law
    two = np.array([draw_noise(law, 2, h, rng) for _ in range(20_000)])
    assert two.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.03)
    assert np.mean((two[:, 1] - two[:, 0]) ** 2) == pytest.approx((h / T) ** 2 / 3.0, rel=0.06)

    time, leap = 0.05, 0.2
    part = Component(1.0, time, shape="fitful", gust_time=leap)
    law = NoiseLaw("fitful_bearing", 1.0, components=(part,))
    z = draw_noise(law, 2_000_000, h, rng)
    # as Gaussian as ever at any one time, over many leaps
    assert z.std() == pytest.approx(1.0, abs=0.03) and np.mean(z**4) == pytest.approx(3.0, abs=0.3)
    # between readings it mostly stands: a free move of what a gamma law lets its clock go by
    quantiles = (np.arange(200_000) + 0.5) / 200_000
    own = -np.expm1(-gamma.ppf(quantiles, h / leap, scale=leap) / time)
    for moves in (1e-6, 0.01, 0.3, 1.0):
        within = np.mean(erf(moves / (2.0 * np.sqrt(np.maximum(own, 1e-300)))))
        assert np.mean(np.abs(np.diff(z)) < moves) == pytest.approx(within, abs=2e-3)
    assert np.mean(np.abs(np.diff(z)) < 1e-6) > 0.8
    R = autocorrelation(law, 200, h)
    for lag in (1, 10, 50, 199):
        # what is left after a clock's progress, over all of its law
        clock = gamma.ppf(quantiles, lag * h / leap, scale=leap)
        assert R[lag] == pytest.approx(np.mean(np.exp(-clock / time)), abs=1e-4)
        # leaps come some 8 times a second: 16 000 of them leave an error of 0.012
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.05)


def test_faded_frozen_and_fluttering_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(53)
    h, T = 1e-3, 0.02
    law = NoiseLaw("faded_echo", 1.0, components=(Component(1.0, T, shape="fading"),))
    z = draw_noise(law, 2_000_000, h, rng)
    # brightness is exponentially distributed: its logarithm, less its mean, is Gumbel's
    scale = np.pi / np.sqrt(6.0)
    for level in (-4.0, -2.0, -0.5, 0.5, 1.2):
        below = -np.expm1(-np.exp(level * scale - np.euler_gamma))
        assert np.mean(z < level) == pytest.approx(below, abs=0.01)
    assert np.mean(z**3) == pytest.approx(-12.0 * np.sqrt(6.0) * 1.2020569 / np.pi**3, rel=0.1)
    R = autocorrelation(law, 100, h)
    k = np.arange(1.0, 4000.0)
    for lag in (1, 3, 20, 60):
        # both logarithms in Laguerre's polynomials, which remember r^2k each, in shares of 1/k^2
        share = np.exp(-2.0 * lag * h / T * k) / k**2
        assert R[lag] == pytest.approx(np.sum(share) / (np.pi**2 / 6.0), abs=1e-4)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.02)

    T = 0.5
    law = NoiseLaw("wandering_spot", 1.0, components=(Component(1.0, T, shape="landscape"),))
    R = autocorrelation(law, 2000, h)
    for lag in (1, 50, 1999):
        # over all distances that a walk may have come by then
        d = np.sqrt(2.0 * lag * h / T) * np.linspace(-9.0, 9.0, 200_001)
        bell = np.exp(-(np.linspace(-9.0, 9.0, 200_001) ** 2) / 2.0)
        assert R[lag] == pytest.approx(np.sum(np.exp(-np.abs(d)) * bell) / np.sum(bell), abs=1e-6)
    z = np.array([draw_noise(law, 2000, h, rng) for _ in range(3000)])
    # a Gaussian height at any one time
    assert z.std() == pytest.approx(1.0, abs=0.03) and np.mean(z**4) == pytest.approx(3.0, abs=0.25)
    for lag in (1, 50, 500, 1999):
        assert np.mean(z[:, lag] * z[:, 0]) == pytest.approx(R[lag], abs=0.08)
    # but of moves, which are as large as the root of a Gaussian's modulus, the fourth moment is
    # 3 pi/2 over the squared second
    moves = np.diff(z, axis=1)
    assert np.mean(moves**4) / np.mean(moves**2) ** 2 == pytest.approx(1.5 * np.pi, rel=0.05)
    assert np.mean(moves**2) == pytest.approx(2.0 * (1.0 - R[1]), rel=0.02)

    T, depth = 0.01, 0.2
    part = Component(1.0, T, shape="fluttering", depth=depth)
    law = NoiseLaw("fluttering_loop", 1.0, components=(part,))
    z = draw_noise(law, 2_000_000, h, rng)
    assert z.std() == pytest.approx(1.0, abs=0.03)
    R = autocorrelation(law, 100, h)
    assert np.allclose(R, np.exp(-np.arange(100) * h / T))
    for lag in (1, 10, 40):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.03)
    # Student's law: x' = -x/T with kicks of variance 2 (1 - depth + depth x^2)/T; steps of a fifth
    # of T change its wings, not its middle
    degrees = 1.0 + 1.0 / depth
    width = np.sqrt((1.0 - depth) / depth / degrees)
    for level in (-2.0, -1.0, -0.3, 0.5, 1.5):
        assert np.mean(z < level) == pytest.approx(stdtr(degrees, level / width), abs=0.012)
    # the larger it is, the larger is what comes next
    e, before = z[1:] - np.exp(-h / T) * z[:-1], np.abs(z[:-1])
    loss = -np.expm1(-2.0 * h / T)
    for low, high in ((0.0, 0.2), (0.9, 1.1), (1.8, 2.2)):
        some = (before > low) & (before < high)
        grown = (1.0 - depth + depth * np.mean(before[some] ** 2)) * loss
        assert np.mean(e[some] ** 2) == pytest.approx(grown, rel=0.06)


def test_counts_retuned_noise_and_chaos_are_what_they_say() -> None:
    rng = np.random.default_rng(48)
    h = 1e-3
    rate = 0.8
    law = NoiseLaw("few_photons", 1.0, components=(Component(1.0, shape="counts", rate=rate),))
    z = draw_noise(law, 400_000, h, rng)
    found = z * np.sqrt(rate) + rate
    # whole numbers, as often as Poisson has them, and none after the other
    assert np.abs(found - np.rint(found)).max() < 1e-9 and found.min() > -1e-9
    for k in range(6):
        assert np.mean(np.rint(found) == k) == pytest.approx(poisson.pmf(k, rate), abs=3e-3)
    assert np.mean(z**3) == pytest.approx(rate**-0.5, abs=0.05)
    assert np.mean(z**4) - 3.0 == pytest.approx(1.0 / rate, abs=0.3)
    assert autocorrelation(law, 3, h).tolist() == [1.0, 0.0, 0.0]
    assert abs(np.mean(z[1:] * z[:-1])) < 0.01

    part = Component(1.0, 0.05, shape="retuned", depth=0.04)
    law = NoiseLaw("retuned_filter", 1.0, components=(part,))
    R = autocorrelation(law, 200, h)
    assert R[0] == pytest.approx(1.0, abs=1e-9)
    paces = 0.05 * 0.04 ** ((np.arange(20_000) + 0.5) / 20_000)
    for lag in (1, 5, 50, 199):
        assert R[lag] == pytest.approx(np.mean(np.exp(-lag * h / paces)), abs=1e-6)
    found, sizes = [], []
    for _ in range(300):
        z = draw_noise(law, 20_000, h, rng)
        sizes.append(z.std())
        one = float(np.mean(z[1:] * z[:-1]) / np.mean(z**2))
        found.append(-h / np.log(one))
        # each record is of one pace
        e = z[1:] - one * z[:-1]
        assert abs(np.mean(e[1:] * e[:-1])) < 0.04 * np.mean(e**2)
        assert np.mean(e**4) / np.mean(e**2) ** 2 == pytest.approx(3.0, abs=0.25)
    # and as loud as the others: correlated over 2 T, the slowest has 200 of its own
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.02) and np.std(sizes) < 0.06
    place = np.log(np.array(found) / 0.05) / np.log(0.04)
    assert np.quantile(place, [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.1)

    turn = 0.65
    law = NoiseLaw("chaotic_laser", 1.0, components=(Component(1.0, shape="chaos", depth=turn),))
    z = draw_noise(law, 400_000, h, rng)
    x = z / np.sqrt(12.0) + 0.5
    # any level as likely, never beyond, and the next one is certain
    assert x.min() > -1e-12 and x.max() < 1.0 + 1e-12
    for at in (0.1, 0.5, 0.8):
        assert np.mean(x < at) == pytest.approx(at, abs=5e-3)
    following = np.where(x < turn, x / turn, (1.0 - x) / (1.0 - turn))[:-1]
    assert np.abs(x[1:] - following).max() < 1e-12
    R = autocorrelation(law, 4, h)
    assert pytest.approx([1.0, 0.3, 0.09, 0.027]) == R
    for lag in (1, 2, 3):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.01)
    # two stretches have nothing in common
    other = draw_noise(law, 400_000, h, rng)
    assert abs(np.mean(z * other)) < 0.01


@pytest.mark.parametrize("name", [*OPEN_LAWS, *RESERVE_LAWS])
def test_the_laws_called_heavy_tailed_are_those_whose_innovations_are(name: str) -> None:
    for seed in range(3):
        for interval in (1e-3, 1e-2):
            rng = np.random.default_rng(seed)
            law = draw_law(name, rng, 1.0)
            R = autocorrelation(law, 61, interval)
            predictor = solve_toeplitz(R[:-1], R[1:])
            z = draw_noise(law, 60_000, interval, rng)
            e = lfilter(np.concatenate([[1.0], -predictor]), [1.0], z)[60:]
            excess = np.mean(e**4) / np.mean(e**2) ** 2 - 3.0
            # two standard errors of 1500 independent samples; 60 000 leave one of 0.02
            assert (excess > 2.0 * np.sqrt(24.0 / 1500)) == (name in HEAVY_TAILED)


def test_wild_samples_keep_the_variance_and_fatten_the_tails() -> None:
    rig = case(wild_samples=4.0)
    rng = np.random.default_rng(2)
    plain = draw_noise(rig.noise, 200_000, 0.01, rng)
    wild = draw_noise(rig.noise, 200_000, 0.01, rng, (0.01, 5.0))
    assert wild.std() == pytest.approx(plain.std(), rel=0.05)
    assert np.mean(np.abs(wild) > 5.0) > 1e-3
    assert np.mean(np.abs(plain) > 5.0) < 1e-4


def test_noise_grows_with_concentration() -> None:
    rig = replace(draw_case(3, size="small"), tau_v=0.1, lsb=0.0)
    rig = replace(rig, noise=replace(rig.noise, sigma0=0.01, sigma1=0.03))
    campaign, ideal = make_campaign(rig), clean_signals(rig)
    for step in rig.steps:
        edges = phase_edges(rig, step)
        t = sample_times(step)
        residual = campaign[step.name].values - ideal[step.name]
        expected = {"baseline": 0.01, "plateau": 0.0}
        grown = 0.03**2 * rig.relative_concentration(step)
        expected["plateau"] = np.sqrt(0.01**2 + grown)
        for phase, sd in expected.items():
            part = residual[(t > edges[phase][0] + 1) & (t < edges[phase][1])]
            # several hundred samples, correlated over a few at most
            assert part.std() == pytest.approx(sd, rel=0.2)
