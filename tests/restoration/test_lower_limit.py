"""An input held above a limit, against samples of the dense Gaussian that obey it."""

import numpy as np
import pytest

from bayes_sensor.restoration.lower_limit import hold_above
from bayes_sensor.restoration.state_space import Model
from tests.restoration.test_kalman import dense, samples_of


def test_the_held_input_is_that_of_the_draws_that_obey_everywhere() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(12) * 1.0
    model = Model(2, 1.0, 4.0, (3.0,), 0.3, 0.4)
    yy, uy, uu = dense(model, t, np.zeros(12))
    y = np.linalg.cholesky(yy) @ rng.standard_normal(12) - 0.8
    weights = np.linalg.solve(yy, uy.T)
    mean, cov = weights.T @ y, uu - uy @ weights
    draws = (
        mean + rng.standard_normal((400_000, 12)) @ np.linalg.cholesky(cov + 1e-12 * np.eye(12)).T
    )
    obey = draws[(draws > -0.2).all(axis=1)]
    assert 2000 < len(obey) < 60_000  # the limit matters and there are draws enough
    samples = samples_of(t, y)
    # conditions at every sample: a resolution of three intervals
    m, v = hold_above(samples, model, -0.2, 3.0).smooth(model)
    sd = obey.std(axis=0)
    # Expectation propagation is an approximation; its error is known to be a few per cent of a sd
    assert np.abs(m - obey.mean(axis=0)).max() < 0.1 * sd.max()
    np.testing.assert_allclose(np.sqrt(v), sd, rtol=0.1)
    free = samples.smooth(model)[0]
    assert np.abs(free - obey.mean(axis=0)).max() > 0.5 * sd.max()


@pytest.mark.slow
def test_a_limit_far_below_changes_nothing() -> None:
    t = np.arange(50) * 1.0
    y = np.sin(t / 10.0)
    model = Model(1, 1.0, 10.0, (3.0,), 0.1, 0.0)
    samples = samples_of(t, y)
    for free, held in zip(
        samples.smooth(model), hold_above(samples, model, -50.0, 3.0).smooth(model), strict=True
    ):
        np.testing.assert_array_equal(free, held)
