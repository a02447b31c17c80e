"""Records that hold nothing to look at, or too little."""

import numpy as np

from bayes_sensor.diagnosis.budget import ar1_whiteness
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch, clean, innovations
from bayes_sensor.diagnosis.signals.events import event_blocks
from bayes_sensor.diagnosis.signals.mains import SEARCH
from bayes_sensor.diagnosis.signals.periodograms import find_line
from bayes_sensor.diagnosis.signals.tails import look_at_tails
from tests.support.campaigns import small_design


def test_few_samples_are_left_as_they_are() -> None:
    residual = np.array([0.0, 9.0, 0.0, 1.0, 2.0])
    out, spikes = clean(residual, np.array([True, False, True, True, True]))
    assert out.tolist() == [0.0, 0.0, 0.0, 1.0, 2.0] and spikes == 0


def test_no_pieces_hold_no_lines() -> None:
    assert find_line([], SEARCH) == []


def stretch_of(samples: np.ndarray) -> Stretch:
    return Stretch(experiment=0, level=0, samples=samples)


def test_a_record_of_zeros_has_no_tails() -> None:
    for samples in (np.zeros(100), np.zeros(500)):
        found = look_at_tails([stretch_of(samples)])
        assert found.log_bayes_factor == 0.0 and found.strength == {"tail_dof": float("inf")}
    assert (innovations(np.zeros(10), 4) == 0.0).all()


def test_a_long_record_is_thinned_and_says_the_same() -> None:
    rng = np.random.default_rng(3)
    wild = look_at_tails([stretch_of(rng.standard_t(3, 500_000))])
    assert wild.log_bayes_factor > 100.0 and wild.strength["tail_dof"] <= 4
    tame = look_at_tails([stretch_of(rng.standard_normal(500_000))])
    assert tame.log_bayes_factor < 0.0


def test_a_record_of_zeros_has_no_events() -> None:
    campaign = small_design(n=1)
    assert event_blocks(campaign, stretch_of(np.zeros(20_000))) is None
    assert event_blocks(campaign, stretch_of(np.zeros(100))) is None


def test_whiteness_leaves_out_short_and_empty_records() -> None:
    rng = np.random.default_rng(5)
    white = rng.standard_normal(4000)
    alone = ar1_whiteness([white])
    assert 0.001 < alone <= 1.0
    assert ar1_whiteness([white, np.zeros(4000), white[:50]]) == alone
    # an AR(2) is not whitened by an AR(1)
    wavy = np.zeros(4000)
    for i in range(2, 4000):
        wavy[i] = 0.2 * wavy[i - 1] + 0.6 * wavy[i - 2] + white[i]
    assert ar1_whiteness([wavy]) < 1e-10
