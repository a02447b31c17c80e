"""Slow power on the plateaus that the baseline has not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import expon, norm

from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch
from bayes_sensor.diagnosis.signals import plateau_noise
from bayes_sensor.diagnosis.signals.plateau_noise import look_for_plateau_noise
from tests.support.planted_effects import design, measured, noise

NOISES = ("white", "ar1", "slow", "walk", "paced")


def gusts(n, rng):
    """Of half a second, with a standard deviation of one."""
    made = lfilter([1.0], [1.0, -0.98], rng.standard_normal(n))
    return made / made.std()


def stretches(rng, kind="white", louder=1.0, plateau=0.0, carrier=0.0, records=(0, 1, 2, 3)):
    made = []
    for k in range(4):
        for level in (0, 1, 0):
            samples = noise(2000, rng, kind, slow=1.0) * (louder if level else 1.0)
            size = (plateau if level else carrier) if k in records else 0.0
            made.append(Stretch(k, level, samples + size * gusts(2000, rng), 20.0 * len(made)))
    return made


def log_bayes_factor(some):
    return look_for_plateau_noise(design(), some)[0].log_bayes_factor


@pytest.mark.parametrize("kind", NOISES)
def test_noise_of_any_spectrum_is_steady(kind):
    rng = np.random.default_rng(3)
    values = np.array([log_bayes_factor(stretches(rng, kind)) for _ in range(24)])
    # odds of e^3 to one turn up once in e^3 times; the prior is far below
    assert np.median(values) < -1.0 and np.sum(values > 3.0) <= 2 and values.max() < 5.0


def one_over_f(n, rng, corner=20.0, interval=1e-3):
    """White noise and, below the corner in Hz, 1/f noise: cut from one four times as long."""
    f = np.fft.rfftfreq(4 * n, interval)
    f[0] = f[1]
    shaped = np.fft.rfft(rng.standard_normal(4 * n)) * np.sqrt(1.0 + corner / f)
    made: np.ndarray = np.fft.irfft(shaped, 4 * n)[:n]
    return made


def test_noise_that_rises_to_low_frequencies_is_steady_though_the_baselines_are_short():
    rng = np.random.default_rng(9)
    values = []
    for _ in range(24):
        # a baseline of 10 s shows little below a quarter of a hertz, a plateau of 50 s a lot
        some = [
            Stretch(k, level, one_over_f(10000 if level else 2000, rng), 20.0 * (2 * k + level))
            for k in range(4) for level in (0, 1)
        ]  # fmt: skip
        values.append(log_bayes_factor(some))
    # by chance the few slow ordinates of a baseline are all small now and then
    assert np.median(values) < -1.0 and np.sum(np.array(values) > 3.0) <= 2, sorted(values)


@pytest.mark.parametrize("louder", [0.3, 5.0])
def test_how_loud_the_plateaus_are_does_not_matter(louder):
    alike, other = (stretches(np.random.default_rng(3), "ar1", x) for x in (1.0, louder))
    assert log_bayes_factor(other) == pytest.approx(log_bayes_factor(alike), abs=1e-6)


@pytest.mark.parametrize("records", [(0, 1, 2, 3), (2,)])
@pytest.mark.parametrize("kind", ["white", "ar1"])
def test_what_comes_with_the_gas_in_all_or_one_of_the_records_is_found(kind, records):
    size = (0.3 if kind == "white" else 2.5) * (1.0 if len(records) > 1 else 3.0)
    rng = np.random.default_rng(4)
    values = [
        log_bayes_factor(stretches(rng, kind, 2.0, 2.0 * size, records=records)) for _ in range(4)
    ]
    assert min(values) > 4.0


def test_what_is_on_the_baseline_too_is_noise():
    rng = np.random.default_rng(5)
    same = [log_bayes_factor(stretches(rng, "white", 1.0, 0.5, 0.5)) for _ in range(8)]
    only = [log_bayes_factor(stretches(rng, "white", 1.0, 0.0, 0.5)) for _ in range(8)]
    assert max(same) < 2.0 and max(only) < 0.0


def test_strength_tells_the_excess_and_how_fast_it_is():
    rng = np.random.default_rng(6)
    found = look_for_plateau_noise(design(), stretches(rng, "white", 1.0, 0.5))[0]
    # white noise has 2 h in V^2/Hz, and gusts 4 T of theirs below 1/(2 pi T), T half a second
    assert found.strength["unsteady_Hz"] == pytest.approx(1.0 / np.pi, rel=0.5)
    assert found.strength["unsteady_excess"] == pytest.approx(4 * 0.5 * 0.25 / 0.02, rel=0.7)


@pytest.mark.parametrize(("sd", "slow", "_"), plateau_noise.RECORDS)
def test_gains_are_those_of_exponential_ordinates(sd, slow, _):
    rng = np.random.default_rng(7)
    f = np.arange(1, 40) * 0.2
    power, expected = rng.exponential(2.0, len(f)), np.linspace(1.6, 1.1, len(f))
    nothing, gains = plateau_noise.record_evidence(
        plateau_noise.Ordinates(f, power), expected, sd, slow
    )
    nodes = np.linspace(-6.0, 6.0, 1201)
    weights = norm.pdf(nodes) / norm.pdf(nodes).sum()

    def likelihood(more):
        # averaged over the record's own slow level
        lift = sd / (1.0 + (f / slow) ** 2)
        each = [
            np.prod(expon.pdf(power, scale=expected * np.exp(z * lift) * more)
                    ** plateau_noise.INDEPENDENT)
            for z in nodes
        ]  # fmt: skip
        return float(weights @ each)

    assert nothing == pytest.approx(np.log(likelihood(1.0)), abs=0.1)
    for i, excess in enumerate(plateau_noise.EXCESSES):
        for j, cutoff in enumerate(plateau_noise.CUTOFFS):
            direct = likelihood(1.0 + excess / (1.0 + (f / cutoff) ** 2))
            assert nothing + gains[i, j] == pytest.approx(np.log(direct), abs=0.1)


def test_records_too_coarse_in_time_or_without_a_baseline_tell_nothing():
    rng = np.random.default_rng(8)
    some = stretches(rng)
    slow = design(interval=0.1)
    assert look_for_plateau_noise(slow, some) == []
    assert look_for_plateau_noise(design(), [s for s in some if s.level]) == []
    assert look_for_plateau_noise(design(), [s for s in some if not s.level]) == []


def test_streaks_of_gas_are_something_unlisted():
    campaign = measured({}, seed=14)
    rng = np.random.default_rng(15)
    experiments = []
    for e in campaign:
        on = (e.t > e.commanded_on + 0.8) & (e.t < e.commanded_off + 0.5)
        experiments.append(replace(e, y=e.y + 0.008 * on * gusts(len(e.t), rng)))
    gap = diagnose_gap(replace(campaign, experiments=tuple(experiments)), bootstrap=0,
                       separate=False, hidden=False)  # fmt: skip
    found = next(f for f in gap.findings if f.name == "unsteady")
    assert found.log_odds > 2.2 and gap.verdict.kind == "unlisted"
    assert "less steady" in gap.verdict.sentence
