"""The compiled algebra of refits against plain numpy."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from bayes_sensor.diagnosis.evidence.block_least_squares import (
    broyden_update,
    normal_equations,
    whiten,
)

BINS, N = (5, 3, 4), 9
OF_BINS = np.cumsum([0, *BINS])
# two shared coordinates; experiments with three, two and two of their own
PLACES = np.array([[0, 1, 2, 3, 4], [0, 1, 5, 6, -1], [0, 1, 7, 8, -1]])


@pytest.fixture
def rng():
    return np.random.RandomState(3)


@pytest.fixture
def derivatives(rng):
    made = rng.normal(size=(sum(BINS), PLACES.shape[1]))
    made[OF_BINS[1] :, -1] = 0.0
    return made


def dense(derivatives):
    made = np.zeros((len(derivatives), N))
    for a, b, places in zip(OF_BINS[:-1], OF_BINS[1:], PLACES, strict=True):
        used = places >= 0
        made[a:b, places[used]] = derivatives[a:b, used]
    return made


@pytest.mark.parametrize("columns", [None, 4])
def test_every_experiment_is_whitened_by_its_own_factor(rng, columns):
    factors = [rng.normal(size=(n, n)) for n in BINS]
    values = rng.normal(size=sum(BINS) if columns is None else (sum(BINS), columns))
    made = whiten(np.concatenate([f.ravel() for f in factors]), OF_BINS, values)
    assert np.allclose(made, block_diag(*factors) @ values, rtol=1e-13, atol=1e-13)


def test_normal_equations_are_those_of_the_dense_derivatives(rng, derivatives):
    residual = rng.normal(size=sum(BINS))
    normal, gradient = normal_equations(derivatives, residual, OF_BINS, PLACES, N)
    whole = dense(derivatives)
    assert np.allclose(normal, whole.T @ whole, rtol=1e-13, atol=1e-13)
    assert np.allclose(gradient, whole.T @ residual, rtol=1e-13, atol=1e-13)


def test_broyden_makes_the_least_change_that_a_step_asks_for(rng, derivatives):
    moved, gained = rng.normal(size=N), rng.normal(size=sum(BINS))
    moved[7:] = 0.0
    scale = rng.uniform(0.5, 2.0, N)
    new = derivatives.copy()
    broyden_update(new, gained, moved, scale, OF_BINS, PLACES)
    assert np.allclose(dense(new) @ moved, gained)  # the secant
    # least in the norm of the scaled coordinates: every row moves along scale * moved alone
    for a, b, places in zip(OF_BINS[:-1], OF_BINS[1:], PLACES, strict=True):
        used = places >= 0
        change = (new - derivatives)[a:b]
        assert np.all(change[:, ~used] == 0.0)
        along = (scale * moved)[places[used]]
        along /= np.linalg.norm(along)
        rest = change[:, used] - np.outer(change[:, used] @ along, along)
        assert np.allclose(rest, 0.0, atol=1e-13)


def test_broyden_leaves_an_experiment_at_rest_as_it_is(rng, derivatives):
    moved = np.zeros(N)
    moved[5] = 1.0  # of the second experiment alone
    new = derivatives.copy()
    broyden_update(new, rng.normal(size=sum(BINS)), moved, np.ones(N), OF_BINS, PLACES)
    other = np.r_[0 : OF_BINS[1], OF_BINS[2] : OF_BINS[3]]
    assert np.array_equal(new[other], derivatives[other])
    assert not np.allclose(new[OF_BINS[1] : OF_BINS[2]], derivatives[OF_BINS[1] : OF_BINS[2]])
