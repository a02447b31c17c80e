"""The closed form against high-precision arithmetic, Euler against the closed form, the layout."""

from decimal import Decimal, localcontext
from itertools import permutations

import numpy as np
import pytest
from scipy.linalg import expm

from bayes_sensor.campaign import CampaignError
from bayes_sensor.likelihood.density import grid_response
from bayes_sensor.rig.cascade import (
    Cascade,
    cascade_response,
    cascade_sensitivities,
    euler_response,
    predict,
    pulse,
    time_constants,
)
from bayes_sensor.rig.chain import fill_grid
from bayes_sensor.rig.layout import Layout
from tests.support.campaigns import paper_design, paper_theta, small_design, small_theta

PAPER = (0.8577, 0.05823 / 0.075, 0.0481)  # experiment 1: V/Q at 4.5 L/min
TIMES = np.concatenate([[-1.0, 0.0], np.geomspace(1e-6, 60.0, 60)])


def exact_response(s: float, taus: tuple[float, ...]) -> float:
    """1 - sum_j tau_j^2 exp(-s/tau_j) / prod_(k != j) (tau_j - tau_k), in 120 digits.

    Equal time constants are moved apart by 1e-40, which changes the value by about as much.
    """
    if s <= 0:
        return 0.0
    with localcontext() as context:
        context.prec = 120
        exact = [
            Decimal(float(tau)) * (1 + Decimal(j) * Decimal("1e-40")) for j, tau in enumerate(taus)
        ]
        total = Decimal(1)
        for j, tau in enumerate(exact):
            c = tau * tau
            for k, other in enumerate(exact):
                if k != j:
                    c /= tau - other
            total -= c * (-Decimal(float(s)) / tau).exp()
        return float(total)


@pytest.mark.parametrize("taus", list(permutations(PAPER)))
def test_the_response_is_exact_for_any_order_of_the_time_constants(taus) -> None:
    expected = [exact_response(s, taus) for s in TIMES]
    # a few roundings of a value below one
    np.testing.assert_allclose(cascade_response(TIMES, taus, 0.0), expected, atol=2e-15, rtol=0)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 0.03, 0.3])
@pytest.mark.parametrize("triple", [False, True])
def test_nearly_equal_time_constants_lose_no_digits(gap: float, triple: bool) -> None:
    taus = (0.8577, 0.8577 * (1 + gap), 0.8577 * (1 - gap) if triple else 0.0481)
    expected = [exact_response(s, taus) for s in TIMES]
    np.testing.assert_allclose(cascade_response(TIMES, taus, 0.0), expected, atol=1e-13, rtol=0)


def test_textbook_partial_fractions_fail_where_the_response_does_not() -> None:
    # negative control: the reference discriminates at the tolerance used above
    taus = (0.8577, 0.8577 * (1 + 1e-9), 0.0481)
    plain = [
        1 - sum(t**2 * np.exp(-s / t) / np.prod([t - o for o in taus if o != t]) for t in taus)
        for s in TIMES[2:]
    ]
    expected = [exact_response(s, taus) for s in TIMES[2:]]
    assert np.abs(np.array(plain) - expected).max() > 1e-9


@pytest.mark.parametrize("taus", [PAPER, (0.4, 0.4, 0.4), (1e-4, 2.0, 30.0)])
def test_the_response_solves_the_differential_equations(taus) -> None:
    # the matrix exponential of the three states and the constant input
    generator = np.zeros((4, 4))
    for j, tau in enumerate(taus):
        generator[j, j] = -1 / tau
        generator[j, j - 1 if j else 3] = 1 / tau
    for s in (0.01, 0.3, 2.0):
        expected = (expm(generator * s) @ [0, 0, 0, 1])[2]
        assert cascade_response(np.array([s]), taus, 0.0)[0] == pytest.approx(expected, abs=1e-13)


def test_up_and_down_is_the_difference_of_two_steps() -> None:
    t = np.linspace(0, 30, 500)
    up, later = cascade_response(t, PAPER, 2.3), cascade_response(t, PAPER, 11.7)
    np.testing.assert_allclose(cascade_response(t, PAPER, 2.3, 11.7), up - later, atol=1e-16)
    assert up[-1] == pytest.approx(1.0, abs=1e-9) and later[t <= 11.7].max() == 0.0


@pytest.mark.parametrize("which", ["t0", "tf"])
def test_the_response_is_continuous_in_the_switch_times(which: str) -> None:
    t = np.arange(0, 20, 1e-3)
    for edge in (3.0, 3.00031):  # on and off the grid

        def at(value: float) -> np.ndarray:
            up, down = (value, 9.0) if which == "t0" else (1.0, value)
            return cascade_response(t, PAPER, up, down)

        # the response is Lipschitz: its slope never exceeds 1 over the slowest time constant
        assert np.abs(at(edge + 1e-7) - at(edge - 1e-7)).max() <= 2e-7 / 0.8577 + 1e-15
        euler = [
            euler_response(t, 1e-3, PAPER, *((v, 9.0) if which == "t0" else (1.0, v)))
            for v in (edge - 1e-7, edge + 1e-7, edge + 4e-4)
        ]
        jump = np.abs(euler[1] - euler[0]).max()  # Euler: a whole sample, or nothing
        assert jump > 1e-4 if edge == 3.0 else jump == 0.0 == np.abs(euler[2] - euler[0]).max()


@pytest.mark.parametrize(
    "taus", [PAPER, (0.8577, 0.8577, 0.0481), (0.5, 0.5 * (1 + 1e-9), 0.5), (0.02, 0.7, 0.9)]
)
@pytest.mark.parametrize("tf", [None, 6.1])
def test_sensitivities_match_finite_differences(taus, tf) -> None:
    t = np.linspace(0.0, 15.0, 301) + 0.0007  # off the switch times, where slopes have kinks
    analytic = cascade_sensitivities(t, taus, 1.3, tf)

    def response(p: np.ndarray) -> np.ndarray:
        return cascade_response(t, p[:3], p[3], tf if tf is None else p[4])

    p = np.array([*taus, 1.3, 0.0 if tf is None else tf])
    for j in range(5):
        step = np.zeros(5)
        step[j] = 1e-4 * p[j]
        # fourth order: the error is about step^4, below 1e-9 here except for the kink of x''
        difference = (
            (
                8 * (response(p + step) - response(p - step))
                - (response(p + 2 * step) - response(p - 2 * step))
            )
            / (12 * step[j])
            if step[j]
            else np.zeros(len(t))
        )
        np.testing.assert_allclose(analytic[:, j], difference, atol=1e-6, rtol=1e-6)


def test_the_jacobian_of_the_mean_matches_finite_differences() -> None:
    campaign = small_design(n=2, fall=[True, False])
    layout = Layout.of(campaign)
    theta = layout.flat(small_theta(campaign))
    model = Cascade()
    for e in campaign:
        analytic = model.jacobian(e.t, theta, layout, e)
        for j, name in enumerate(layout.mean_names):
            step = np.zeros(len(theta))
            step[j] = 1e-5 * max(theta[j], 0.1)
            difference = (
                model.mean(e.t, theta + step, layout, e) - model.mean(e.t, theta - step, layout, e)
            ) / (2 * step[j])
            np.testing.assert_allclose(analytic[:, j], difference, atol=1e-4, err_msg=name)
            if name.endswith("]") and f"[{e.name}]" not in name:
                assert not analytic[:, j].any()


def test_euler_converges_at_first_order_and_its_bias_at_1_ms_is_measured() -> None:
    worst = []
    for h in (8e-3, 4e-3, 2e-3, 1e-3):
        t = np.arange(round(20 / h)) * h
        exact = cascade_response(t, PAPER, 2.0, 12.0)
        worst.append(np.abs(euler_response(t, h, PAPER, 2.0, 12.0) - exact).max())
    orders = np.log2(np.array(worst[:-1]) / worst[1:])
    np.testing.assert_allclose(orders, 1.0, atol=0.05)
    # at the paper's settings with a switch on the grid: 0.34 mV at a step of 1.8 V
    assert worst[-1] == pytest.approx(1.93e-4, rel=0.01)


@pytest.mark.parametrize("tf", [None, 7.0011])
def test_the_recurrence_on_a_grid_is_the_closed_form(tf) -> None:
    for e in small_design(n=1, interval=1e-3):
        for taus in ((0.3, 0.2, 0.1), (0.3, 0.3, 0.3), (0.3, 0.2, 1e-7), (90.0, 0.2, 0.1)):
            for t0 in (-3.0, 2.0, 2.0037, 30.0):
                expected = cascade_response(e.t, taus, t0, tf)
                found = grid_response(e, np.array(taus), t0, tf)
                np.testing.assert_allclose(found, expected, atol=2e-13)


def test_the_published_parameters_predict_the_published_plateaus() -> None:
    campaign = paper_design(interval=0.01)
    means = predict(campaign, paper_theta())
    for e in campaign:
        before, plateau = means[e.name][e.t < 20], means[e.name][(e.t > 60) & (e.t < 79)]
        theta = paper_theta()["experiments"][e.name]
        np.testing.assert_allclose(before, theta["y0_V"], rtol=1e-12)
        np.testing.assert_allclose(plateau, theta["y0_V"] + theta["beta_V"], rtol=1e-9)


def test_the_mean_by_euler_is_the_papers() -> None:
    campaign = small_design(n=1)
    theta = small_theta(campaign)
    by_euler = predict(campaign, theta, Cascade("euler"))["a"]
    exact = predict(campaign, theta)["a"]
    assert 1e-3 < np.abs(by_euler - exact).max() < 0.1


# --- parameters


@pytest.mark.parametrize("fall", [[True, True], [True, False], [False, False]])
@pytest.mark.parametrize("per_experiment", [False, True])
def test_the_layout_round_trips(fall, per_experiment: bool) -> None:
    campaign = small_design(n=2, fall=fall)
    layout = Layout.of(campaign, noise_per_experiment=per_experiment, extra=("drift",))
    vector = np.arange(1.0, len(layout) + 1)
    nested = layout.nested(vector)
    np.testing.assert_array_equal(layout.flat(nested), vector)
    assert len(set(layout.names)) == len(layout)
    assert [layout.index(name) for name in layout.names] == list(range(len(layout)))
    for k, name in enumerate(layout.experiments):
        kinds = [layout.names[i] for i in layout.local[k] if i >= 0]
        assert all(n.endswith(f"[{name}]") for n in kinds) and len(kinds) == 3 + fall[k]
        assert ("tf_s" in nested["experiments"][name]) == fall[k]
        assert [layout.names[i].split("[")[0] for i in layout.noise[k]] == [
            "phi",
            "sigma0_V",
            "sigma1_V",
        ]


def test_a_vector_without_noise_gets_one_that_cannot_be_mistaken() -> None:
    layout = Layout.of(small_design(n=1))
    full = layout.flat(np.ones(layout.n_mean))
    assert full[layout.index("phi")] == 0.0 and np.isnan(full[layout.index("sigma0_V")])
    assert "sigma0_V" not in layout.nested(full)


def test_shared_noise_serves_a_layout_with_noise_per_experiment() -> None:
    campaign = small_design(n=2)
    layout = Layout.of(campaign, noise_per_experiment=True)
    vector = layout.flat(small_theta(campaign, phi=0.7))
    assert (vector[layout.noise[:, 0]] == 0.7).all()


def test_layout_errors_say_what_was_expected() -> None:
    campaign = small_design(n=1)
    layout = Layout.of(campaign)
    theta = small_theta(campaign)
    del theta["V_mL"]
    with pytest.raises(CampaignError, match="theta lacks V_mL; expected the keys of fit.json"):
        layout.flat(theta)
    with pytest.raises(CampaignError, match=r"theta has shape \(4,\); expected \(10,\)"):
        layout.flat(np.ones(4))
    with pytest.raises(KeyError, match="no parameter 'tau'; there are tau_s"):
        layout.index("tau")
    with pytest.raises(CampaignError, match="method must be 'exact' or 'euler', but is 'rk4'"):
        Cascade("rk4")
    with pytest.raises(CampaignError, match="time constants must be positive"):
        time_constants(0.1, -0.2, 10.0, 50.0)


def test_a_layout_cannot_be_changed_through_what_it_gives_away() -> None:
    campaign = small_design(n=1)
    layout = Layout.of(campaign)
    for names in (layout.names, layout.mean_names, layout.noise_names):
        names.append("another")
    assert len(layout) == len(layout.names) == 10 and layout.n_mean == 7
    vector = layout.flat(small_theta(campaign))
    again = layout.flat(vector)
    again[0] = -1.0
    assert vector[0] > 0.0


@pytest.mark.parametrize(
    ("key", "hint"),
    [
        ("sigma1", r"but got 'sigma1'; did you mean 'sigma1_V'\?"),
        ("sigma0_V_", r"did you mean 'sigma0_V'\?"),
        ("rho", "but got 'rho'; known are tau_s, .* phi, sigma0_V, sigma1_V"),
        ("drift", "but got 'drift'; known are"),  # an effect's, which this layout has not
        ("t0_s", r"but got 't0_s'; write 't0_s\[a\]' and the like"),
    ],
)
def test_a_misspelt_parameter_is_refused(key: str, hint: str) -> None:
    campaign = small_design(n=1)
    theta = small_theta(campaign)
    with pytest.raises(CampaignError, match=f"theta: expected names of parameters, {'.*'}{hint}"):
        Layout.of(campaign).flat({**theta, key: 0.5})
    theta["experiments"]["a"]["sigma1"] = 0.1
    with pytest.raises(CampaignError, match=r"'sigma1\[a\]'; did you mean 'sigma1_V\[a\]'"):
        Layout.of(campaign).flat(theta)


def test_what_the_package_writes_beside_the_parameters_is_read() -> None:
    campaign = small_design(n=2)
    theta = {**small_theta(campaign), "signal_unit": "mV", "effects": {"baseline_drift": {}}}
    expected = Layout.of(campaign).flat(small_theta(campaign))
    np.testing.assert_array_equal(Layout.of(campaign).flat(theta), expected)
    # parameters of an experiment that is not there, a fall that was not recorded, own noise
    theta["experiments"]["a"]["phi"] = 0.3
    alone = Layout.of(small_design(n=1, fall=False))
    np.testing.assert_array_equal(alone.flat(theta)[:6], expected[:6])


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_time_constant_is_positive_and_finite(place: int, value: float) -> None:
    values = [0.05, 0.8, 60.0]
    values[place] = value
    with pytest.raises(CampaignError, match="time constants must be positive"):
        time_constants(*values, total_flow=100.0)


@pytest.mark.parametrize("begin", [-1e5, -1000.0, 0.0, 1e5])
def test_the_response_on_a_grid_does_not_depend_on_the_clock(begin: float) -> None:
    t = 0.01 * np.arange(2000)
    taus = np.array([0.3, 0.2, 0.1])
    found = cascade_response(t + begin, taus, begin + 2.0, begin + 8.0)
    on_the_grid = np.empty(len(t))
    fill_grid(begin, 0.01, np.sort(1.0 / taus), pulse(begin + 2.0, begin + 8.0), on_the_grid)
    # a time near 1e5 s has 1.5e-11 s of rounding
    np.testing.assert_allclose(on_the_grid, found, atol=1e-9)
    np.testing.assert_allclose(found, cascade_response(t, taus, 2.0, 8.0), atol=1e-9)
