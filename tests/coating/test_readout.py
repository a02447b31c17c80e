"""The optical readout and response times, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from bayes_sensor.coating.noise_budget import Receiver, noise_budget, noise_scales
from bayes_sensor.coating.readout import (
    TABLE_II_BASELINE,
    TABLE_II_CONCENTRATION,
    TABLE_II_RISE,
    Cladding,
    Readout,
    Ring,
    curvature,
    linear_range,
    matched_readout,
    nonlinearity,
)
from bayes_sensor.rig.cascade import cascade_response
from bayes_sensor.rig.response_times import response_time_table, response_times

LORENTZIAN, ALL_PASS = Ring(), Ring(shape="all-pass")
RINGS = [LORENTZIAN, ALL_PASS]


# --- spectra


def test_lorentzian_dip():
    ring = LORENTZIAN
    assert ring.width == pytest.approx(ring.resonance / ring.q)
    assert float(ring.transmission(0.0)) == pytest.approx(10**-1.5)
    for sign in (-1, 1):
        half = float(ring.transmission(sign * ring.width / 2))
        assert half == pytest.approx((1 + ring.floor) / 2)
    assert float(ring.transmission(1e-6)) == pytest.approx(1, abs=1e-8)


def test_lorentzian_is_steepest_at_its_width_over_two_root_three():
    ring = LORENTZIAN
    assert ring.steepest_detuning == pytest.approx(ring.width / (2 * math.sqrt(3)))
    d = np.linspace(0, 2 * ring.width, 200_001)
    assert d[np.argmax(ring.slope(d))] == pytest.approx(ring.steepest_detuning, rel=1e-4)
    # the slope there: depth * 3 sqrt(3)/(4 w) = depth * 1.299/w
    steepest = (1 - ring.floor) * 3 * math.sqrt(3) / (4 * ring.width)
    assert float(ring.slope(ring.steepest_detuning)) == pytest.approx(steepest)


def test_all_pass_ring_follows_from_its_coefficients():
    ring = ALL_PASS
    r, a = ring.coefficients
    assert 0 < a < r < 1
    phase = 2 * math.pi * np.linspace(-0.5, 0.5, 101)
    d = phase / (2 * math.pi) * ring.free_spectral_range
    field = (r - a * np.exp(1j * phase)) / (1 - r * a * np.exp(1j * phase))
    np.testing.assert_allclose(ring.transmission(d), np.abs(field) ** 2, atol=1e-12)
    assert float(ring.transmission(0.0)) == pytest.approx(ring.floor)
    # one free spectral range on, the dip is back
    np.testing.assert_allclose(
        ring.transmission(d + ring.free_spectral_range), ring.transmission(d), atol=1e-10
    )


def test_all_pass_dip_is_a_lorentzian_at_high_finesse():
    finesse = [
        Ring(q=q, shape="all-pass").free_spectral_range / Ring(q=q).width for q in (2e4, 2e5)
    ]
    off = []
    for q in (2e4, 2e5):
        d = np.linspace(-3, 3, 301) * Ring(q=q).width
        off.append(
            np.abs(Ring(q=q, shape="all-pass").transmission(d) - Ring(q=q).transmission(d)).max()
        )
    assert off[0] < 1 / finesse[0] and off[1] < 0.02 * off[0]  # second order in 1/finesse
    near = Ring(q=2e5, shape="all-pass")
    assert near.steepest_detuning == pytest.approx(near.width / (2 * math.sqrt(3)), rel=1e-3)


@pytest.mark.parametrize("ring", RINGS, ids=lambda ring: ring.shape)
def test_slope_and_curvature_are_derivatives(ring):
    d, h = np.linspace(-2, 2, 41) * ring.width, 1e-4 * ring.width
    slope = (ring.transmission(d + h) - ring.transmission(d - h)) / (2 * h)
    bend = (ring.slope(d + h) - ring.slope(d - h)) / (2 * h)
    # central differences: relative error of order 1e-8 of the largest value
    np.testing.assert_allclose(ring.slope(d), slope, atol=1e-6 * np.abs(slope).max())
    np.testing.assert_allclose(ring.curvature(d), bend, atol=1e-6 * np.abs(bend).max())


@pytest.mark.parametrize("ring", RINGS, ids=lambda ring: ring.shape)
def test_the_voltage_has_no_curvature_where_the_flank_is_steepest(ring):
    for sign in (1, -1):  # a redshift raises the voltage on the short side
        wavelength = ring.resonance - sign * ring.steepest_detuning
        readout = Readout(ring, Cladding(), wavelength)
        assert sign * float(readout.slope(0.0)) > 0
        assert float(readout.local_curvature(0.0)) == pytest.approx(0, abs=1e-6)


# --- voltage against concentration


@pytest.mark.parametrize("ring", RINGS, ids=lambda ring: ring.shape)
def test_matched_readout_shows_table_ii(ring):
    readout = matched_readout(ring=ring)
    levels = readout.voltage([0.0, TABLE_II_CONCENTRATION])
    np.testing.assert_allclose(levels, [TABLE_II_BASELINE, TABLE_II_BASELINE + TABLE_II_RISE])
    assert readout.wavelength == 1574.4e-9 < readout.ring.resonance
    # the middle of the three concentrations was not used: 1.92 and 1.88 V in Table II
    rise = float(readout.voltage(1 / 7) - readout.voltage(0.0))
    assert rise == pytest.approx((1.92 + 1.88) / 2, rel=0.05)
    # the spectrum moves to longer wavelengths and the laser sees what voltage() says
    sweep = np.linspace(1574.2e-9, 1574.6e-9, 8001)
    dips = [sweep[np.argmin(readout.spectrum(sweep, c))] for c in (0.0, 0.1)]
    assert dips[1] - dips[0] == pytest.approx(10 * 2.755e-12, abs=1e-13)
    at_laser = readout.spectrum(np.array([readout.wavelength]), 0.1)
    assert at_laser == pytest.approx(readout.voltage(0.1))


def test_slope_and_local_curvature_of_the_voltage():
    readout = matched_readout()
    c, h = np.linspace(0.01, 0.2, 20), 1e-5
    slope = (readout.voltage(c + h) - readout.voltage(c - h)) / (2 * h)
    bend = (readout.slope(c + h) - readout.slope(c - h)) / (2 * h)
    np.testing.assert_allclose(readout.slope(c), slope, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(readout.local_curvature(c), bend / (2 * slope**2), atol=1e-5)


def test_levels_that_no_dip_gives_are_refused():
    with pytest.raises(ValueError, match=r"no detuning of this ring.*deeper dip"):
        matched_readout(ring=Ring(extinction=3.0))
    with pytest.raises(ValueError, match="rise must be a positive number"):
        matched_readout(rise=-1.0)


# --- linearity


def steepest(ring: Ring, cladding: Cladding | None = None) -> Readout:
    """A readout that reaches the steepest point at a fraction of 0.2."""
    cladding = cladding or Cladding()
    offset = 20 * cladding.redshift_per_percent
    return Readout(ring, cladding, ring.resonance - ring.steepest_detuning + offset)


def test_linear_range_of_a_lorentzian():
    readout = steepest(LORENTZIAN)
    assert readout.steepest_concentration == pytest.approx(0.2)
    per_fraction = 100 * readout.cladding.redshift_per_percent
    for wanted in (1e-4, 1e-3):
        found = linear_range(readout, wanted)
        # V = s u + k u^3 with k/s = -3/4 per squared half width: the line through the ends at
        # +-u is missed by (3/4) u^2/(3 sqrt 3) of the span
        half = LORENTZIAN.width / 2 * math.sqrt(4 * math.sqrt(3) * wanted)
        assert (found.high - found.low) / 2 * per_fraction == pytest.approx(half, rel=0.05)
        assert found.nonlinearity == pytest.approx(wanted, rel=1e-6)
        assert found.slope == pytest.approx(float(readout.slope(0.2)), rel=3 * 3.5 * wanted)
    wide, narrow = (linear_range(readout, wanted) for wanted in (0.05, 0.01))
    assert wide.low < narrow.low < 0.2 < narrow.high < wide.high


def test_linear_range_is_cut_at_zero_gas():
    found = linear_range(matched_readout(), 0.05)
    assert found.low == 0 and found.nonlinearity <= 0.05


def test_linear_range_out_of_reach():
    past = Readout(LORENTZIAN, Cladding(), LORENTZIAN.resonance - LORENTZIAN.width)
    with pytest.raises(ValueError, match="past the steepest point"):
        linear_range(past)
    with pytest.raises(ValueError, match="wanted must lie between"):
        linear_range(steepest(LORENTZIAN), 0.0)
    with pytest.raises(ValueError, match="expected low below high"):
        nonlinearity(past, 0.1, 0.1)


def test_curvature_changes_sign_at_the_steepest_point():
    # a small range before, at and behind the steepest point
    small = 2e-3
    bends = []
    for shift in (-0.05, -small / 2, 0.05):
        readout = steepest(LORENTZIAN)
        start = readout.wavelength - 100 * readout.cladding.redshift_per_percent * (0.2 + shift)
        bends.append(curvature(replace(readout, wavelength=start), small))
    assert bends[0] > 0.05 and abs(bends[1]) < 1e-3 and bends[2] < -0.05


def test_curvature_over_a_small_range_is_the_local_one():
    readout = matched_readout()
    at = replace(readout, wavelength=readout.wavelength - 10e-12)
    # the slope of the line through the ends differs from that at 0 in the first order
    assert curvature(at, 1e-4) == pytest.approx(float(at.local_curvature(0.0)), rel=0.01)


# --- noise


def test_noise_budget_against_its_formulas():
    readout = matched_readout()
    receiver = Receiver(2e5, 3e-12, 1e-13, 1e-12, 1000.0)
    c = np.linspace(0, 0.2, 21)
    budget = noise_budget(readout, c, receiver)
    v = readout.voltage(c)
    np.testing.assert_allclose(budget.shot, 2 * 1.602176634e-19 * (v / 2e5) * 1000 * 2e5**2)
    np.testing.assert_allclose(budget.thermal, 9e-24 * 1000 * 4e10)
    np.testing.assert_allclose(budget.intensity, 1e-13 * 1000 * v**2)
    np.testing.assert_allclose(
        budget.total, budget.shot + budget.thermal + budget.intensity + budget.jitter
    )
    np.testing.assert_allclose(budget.sd**2, budget.total)


def test_jitter_acts_through_the_slope():
    readout, rng = matched_readout(), np.random.default_rng(2)
    sigma = 0.05e-12  # m, small enough for the first order
    budget = noise_budget(readout, 0.08, Receiver(wavelength_jitter=sigma))
    jittered = [
        float(replace(readout, wavelength=readout.wavelength + d).voltage(0.08))
        for d in sigma * rng.standard_normal(4000)
    ]
    # the sample variance of 4000 draws is good to some 2 %
    assert np.var(jittered) == pytest.approx(float(budget.jitter), rel=0.08)
    # smallest at the bottom of the dip, where the baseline is: a hump over the concentration
    c = np.linspace(0, 0.17, 200)
    jitter = noise_budget(readout, c).jitter
    assert c[np.argmax(jitter)] == pytest.approx(readout.steepest_concentration, abs=2e-3)


def test_noise_scales_of_a_budget():
    # steepest point at the end of the range: the variance grows all the way
    cladding = Cladding(sensitivity=40e-9)
    readout = matched_readout(ring=Ring(q=1.5e4, extinction=25.0), cladding=cladding)
    c_ref = readout.steepest_concentration
    sigma0, sigma1 = noise_scales(readout, c_ref=c_ref)
    ends = noise_budget(readout, np.array([0.0, c_ref])).total
    assert sigma1 > 0 and sigma0**2 + sigma1**2 == pytest.approx(ends[1], rel=0.25)
    # without jitter the rest is smooth and tiny: microvolts
    quiet = noise_scales(readout, Receiver(wavelength_jitter=1e-18), c_ref)
    assert quiet[0] < 1e-5 and quiet[1] < 2e-5
    # laser far above the range in use: the variance falls, which sigma1 cannot show
    past = replace(readout, wavelength=readout.ring.resonance - 2 * readout.ring.width)
    assert noise_scales(past)[1] == 0


# --- refusals


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ring(q=0.0), "ring: q must be a positive number"),
        (lambda: Ring(extinction=math.nan), "extinction must be"),
        (lambda: Ring(shape="gaussian"), "shape must be one of lorentzian, all-pass"),
        (lambda: Ring(q=300.0), "does not fit the free spectral range"),
        (lambda: Cladding(sensitivity=-1.0), "cladding: sensitivity must be"),
        (lambda: Readout(Ring(), Cladding(), full_scale=math.inf), "readout: full_scale must be"),
        (lambda: Receiver(bandwidth=0.0), "receiver: bandwidth must be"),
        (lambda: response_times([]), "expected .n_lags"),
        (lambda: response_times([-0.1, 0.2]), "none negative"),
        (lambda: response_times([0.0, 0.0]), "not all zero"),
        (lambda: response_times([math.inf]), "must be finite"),
    ],
)
def test_what_cannot_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# --- response times


def test_single_lag():
    tau = np.array([[1e-3, 0.0481], [0.3, 20.0]])
    times = response_times([tau])
    np.testing.assert_allclose(times.t10, -np.log(0.9) * tau, rtol=1e-12)
    np.testing.assert_allclose(times.t63, tau, rtol=1e-12)
    np.testing.assert_allclose(times.t90, 2.302585092994046 * tau, rtol=1e-12)
    np.testing.assert_allclose(times.rise, 2.1972245773362196 * tau, rtol=1e-12)
    assert response_times([0.2]).t90.shape == ()


def test_two_lags_against_their_closed_form():
    a, b = 0.8, 0.05

    def y(t):
        return 1 - (a * math.exp(-t / a) - b * math.exp(-t / b)) / (a - b)

    times = response_times([a, b])
    for level, t in ((0.1, times.t10), (1 - math.exp(-1), times.t63), (0.9, times.t90)):
        assert float(t) == pytest.approx(brentq(lambda t, p=level: y(t) - p, 1e-9, 9), rel=1e-10)
    assert response_times([b, a]).t90 == pytest.approx(times.t90, rel=1e-12)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_equal_lags_against_the_erlang_law(n):
    # 1 - y = exp(-t/tau) sum_k (t/tau)^k / k!
    def missing(t):
        return math.exp(-t) * sum(t**k / math.factorial(k) for k in range(n))

    expected = brentq(lambda t: missing(t) - 0.1, 0.1, 30)
    assert float(response_times([1.0] * n).t90) == pytest.approx(expected, rel=1e-10)


def test_coinciding_time_constants_are_a_smooth_limit():
    gaps = np.array([0.0, 1e-14, 1e-12, 1e-9, 1e-6, 1e-3])
    t90 = response_times([np.full(6, 0.5), 0.5 * (1 + gaps), 0.5 * (1 - gaps)]).t90
    # to second order in the gap nothing changes; 1e-9 is what the recursion keeps in between
    np.testing.assert_allclose(t90[:5], t90[0], rtol=1e-9)
    assert t90[5] == pytest.approx(t90[0], rel=1e-6)


def test_whole_chain_of_the_paper_over_draws():
    tau = np.linspace(0.0, 0.2, 50)
    flow = np.array([[4.5], [9.0]]) / 0.06  # mL/s
    chain = response_times([0.8577, 58.23 / flow, tau])
    assert chain.t90.shape == (2, 50)
    assert (np.diff(chain.t90, axis=1) > 0).all() and (chain.t90[0] > chain.t90[1]).all()
    for i, j in ((0, 0), (0, 30), (1, 49)):
        taus = [0.8577, 58.23 / flow[i, 0], max(tau[j], 1e-12)]
        for level, t in ((0.1, chain.t10), (0.9, chain.t90)):
            at = cascade_response(np.array([t[i, j]]), taus, 0.0)
            assert float(at[0]) == pytest.approx(level, abs=1e-8)


def test_a_lag_of_zero_passes_everything_on():
    assert float(response_times([0.3, 0.0]).t90) == pytest.approx(
        float(response_times([0.3]).t90), rel=1e-8
    )


def test_table_of_response_times():
    rng = np.random.default_rng(3)
    tau, tau_v = rng.uniform(0.01, 0.1, 400), rng.normal(0.86, 0.01, 400)
    volume = rng.normal(58.2, 0.5, 400)
    table = response_time_table(tau, tau_v, volume, [150.0, 75.0, 75.0], level=0.9)
    assert table["system"].tolist() == ["sensor", "chain", "chain"]
    assert table["total_flow_L_per_min"].tolist()[1:] == pytest.approx([4.5, 9.0])
    assert math.isnan(table["total_flow_L_per_min"][0])
    low, middle, high = np.quantile(math.log(10) * tau, [0.05, 0.5, 0.95])
    alone = table.loc[0, ["t90_lo_s", "t90_s", "t90_hi_s"]].tolist()
    assert alone == pytest.approx([low, middle, high], rel=1e-9)
    slow = response_times([tau_v, volume / 75.0, tau])
    assert table.loc[1, "rise_s"] == pytest.approx(np.median(slow.rise))
    assert table.loc[1, "t63_s"] > table.loc[2, "t63_s"]


def test_table_of_response_times_says_what_is_wrong():
    draws = np.full(3, 0.5)
    with pytest.raises(ValueError, match="as many draws"):
        response_time_table(draws, draws[:2], draws, [75.0])
    with pytest.raises(ValueError, match="positive numbers in mL/s"):
        response_time_table(draws, draws, draws, [0.0])
    with pytest.raises(ValueError, match="level must lie"):
        response_time_table(draws, draws, draws, [75.0], level=95.0)


def test_a_free_spectral_range_is_one_more_wavelength_around_the_ring() -> None:
    ring = Ring()
    turns = ring.group_index * 2.0 * np.pi * ring.radius / ring.resonance
    # of n wavelengths to n + 1; the group index is the slope of the optical path by 1 / wavelength
    away = ring.resonance * turns / (turns + 1.0)
    assert ring.free_spectral_range == pytest.approx(ring.resonance - away, rel=2.0 / turns)
    assert ring.free_spectral_range == pytest.approx(9.17e-9, rel=1e-3)
