"""Samples coded for the page: exact to the rounding step, small, cut down where there are many."""

import base64
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.fit.samples import (
    FRACTION,
    LONGEST_RUN,
    Samples,
    coded,
    load_samples,
    make_samples,
    polygon,
    rice,
    save_samples,
    thinned,
)
from bayes_sensor.likelihood.density import mean_and_variance, simulate
from bayes_sensor.likelihood.problem import Problem
from tests.support.campaigns import small_design, small_theta


def unrice(k: int, code: bytes, n: int) -> list[int]:
    """Rice's code read bit by bit, as the page's script does."""
    bits = iter("".join(f"{byte:08b}" for byte in code))
    values, value = [], 0
    for _ in range(n):
        ones = 0
        while ones < LONGEST_RUN and next(bits) == "1":
            ones += 1
        width = 32 if ones == LONGEST_RUN else k
        word = int("0" + "".join(next(bits) for _ in range(width)), 2)
        u = word if ones == LONGEST_RUN else (ones << k) + word
        value += -(u + 1) // 2 if u % 2 else u // 2
        values.append(value)
    return values


@given(st.lists(st.integers(-(2**29), 2**29), min_size=1, max_size=60))
@settings(max_examples=60, deadline=None)
def test_rice_is_undone_exactly_for_any_integers(values: list[int]) -> None:
    k, code = rice(np.array(values))
    assert unrice(k, code, len(values)) == values


def test_rice_needs_little_more_than_the_entropy() -> None:
    rng = np.random.default_rng(5)
    n = 50_000
    x = np.zeros(n)
    for i in range(1, n):  # AR(1) of phi .8
        x[i] = 0.8 * x[i - 1] + 0.6 * rng.standard_normal()
    values = np.rint(FRACTION * x).astype(int)
    _, code = rice(values)
    steps = np.diff(values)
    p = np.unique(steps, return_counts=True)[1] / len(steps)
    entropy = float(-(p * np.log2(p)).sum())
    assert entropy < 8 * len(code) / n < 1.12 * entropy


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    """Two experiments of 1 200 samples with a masked stretch, the second without a step down."""
    design = small_design(fall=(True, False), masked=[(5.0, 5.6)])
    return simulate(Problem(design), small_theta(design), seed=4)


@pytest.fixture(scope="module")
def fit(campaign: Campaign) -> SimpleNamespace:
    """As much of a fit as samples need."""
    return SimpleNamespace(theta_hat=small_theta(campaign))


def test_samples_are_the_data_to_half_a_step_and_the_model_is_close(
    campaign: Campaign, fit: SimpleNamespace
) -> None:
    made = make_samples(campaign, fit)
    problem = Problem(campaign)
    vector = problem.layout.flat(fit.theta_hat)
    for k, (each, e) in enumerate(zip(made, campaign)):
        used = e.used
        np.testing.assert_allclose(each.t, e.t[used], rtol=0, atol=1e-9)
        y = each.offset + each.step * each.values
        assert np.abs(y - e.values[used]).max() <= 0.5 * each.step * (1 + 1e-9)
        mean, variance = mean_and_variance(problem, vector, k)
        assert each.step == pytest.approx(np.sqrt(variance.min()) / FRACTION)
        t, model, sd = each.model
        assert len(t) < 0.2 * len(e.t)
        off = np.interp(e.t, t, model) - mean
        assert np.abs(off).max() <= 0.5 * each.step * (1 + 1e-9)
        assert np.abs(np.interp(e.t, t, sd) - np.sqrt(variance)).max() < each.step
    assert made[1].runs.tolist() == [[0, 500, 1], [560, 640, 1]]


def test_samples_are_saved_and_read_back(
    campaign: Campaign, fit: SimpleNamespace, tmp_path: Path
) -> None:
    made = make_samples(campaign, fit)
    save_samples(tmp_path / "samples.npz", made)
    for a, b in zip(made, load_samples(tmp_path / "samples.npz"), strict=True):
        assert (a.name, a.start, a.interval, a.offset, a.step) == (
            b.name, b.start, b.interval, b.offset, b.step,
        )  # fmt: skip
        for name in ("runs", "values", "model"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert [p.name for p in tmp_path.iterdir()] == ["samples.npz"]
    (tmp_path / "samples.npz").write_bytes(b"PK\x03\x04")
    with pytest.raises(CampaignError, match="expected saved samples"):
        load_samples(tmp_path / "samples.npz")


def test_one_wild_sample_does_not_break_the_code(campaign: Campaign, fit: SimpleNamespace) -> None:
    e = campaign.experiments[0]
    y = e.values.copy()
    y[100] = 1e12
    wild = replace(campaign, experiments=(replace(e, y=y), *campaign.experiments[1:]))
    each = make_samples(wild, fit)[0]
    k, code = rice(each.values)
    assert unrice(k, code, 200)[100] * each.step + each.offset == pytest.approx(1e12)


def test_what_the_page_reads(campaign: Campaign, fit: SimpleNamespace) -> None:
    each = make_samples(campaign, fit)[1]
    record = coded(each)
    assert record["n"] == len(each.values) == 1140
    bits = base64.b64decode(record["bits"])
    assert unrice(record["k"], bits, record["n"]) == each.values.tolist()
    index = np.frombuffer(base64.b64decode(record["model_t"]), "<u4")
    np.testing.assert_allclose(record["start"] + 0.01 * index, each.model[0])
    model = np.frombuffer(base64.b64decode(record["model"]), "<f4")
    np.testing.assert_allclose(model, each.model[1], rtol=1e-6)


def test_thinning_keeps_the_switches_whole_and_every_extreme() -> None:
    rng = np.random.default_rng(2)
    values = np.rint(50 * rng.standard_normal(100_000)).astype(np.int64)
    values[70_123] = 4000
    whole = Samples(
        "1", 0.0, 1e-3, 0.0, 0.01, np.array([(0, 60_000, 1), (60_500, 40_000, 1)]), values,
        np.zeros((3, 2)),
    )  # fmt: skip
    less = thinned(whole, [20.0], 2.0, 12_000)
    assert 8_000 < len(less.values) < 13_000
    assert less.values.max() == 4000 and less.values.min() == values.min()
    t, t_less = whole.t, less.t
    near, near_less = np.abs(t - 20.0) < 1.99, np.abs(t_less - 20.0) < 1.99
    np.testing.assert_allclose(t_less[near_less], t[near])
    np.testing.assert_array_equal(less.values[near_less], values[near])
    assert (np.diff(t_less) > 0).all()
    assert thinned(whole, [20.0], 2.0, 100_000) is whole
    assert len(thinned(whole, [20.0], 50.0, 10_000).values) < 12_000  # all is near: all is thinned


def test_a_polygon_of_a_line_has_two_nodes() -> None:
    t = np.linspace(0, 1, 500)
    assert polygon(t, 3 * t + 1, 1e-9).tolist() == [0, 499]
    y = 1 - np.exp(-5 * t)
    nodes = polygon(t, y, 1e-3)
    assert np.abs(np.interp(t, t[nodes], y[nodes]) - y).max() <= 1e-3
    assert len(nodes) < 30
