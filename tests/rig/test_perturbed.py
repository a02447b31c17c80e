"""The rig's kernel against the closed form and against a general-purpose integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis import CATALOGUE
from bayes_sensor.diagnosis.effects.effect_model import with_effects
from bayes_sensor.diagnosis.effects.rig_view import check_settings, coating_modes
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import cascade_response
from bayes_sensor.rig.exponential import HIGHEST, LOWEST, exponentials
from bayes_sensor.rig.imperfections import FIRST, INDEX, settings_vector
from bayes_sensor.rig.perturbed import rig_mean
from tests.support.campaigns import paper_design, paper_theta

T = np.linspace(0.0, 60.0, 1201)
T0, TF = 10.3333, 35.1111
NO_MODES = (np.zeros(0), np.zeros(0))


def parameters(tau=0.0481, tau_v=0.8577, tau_m=0.7, concentration=0.15, **settings):
    first = [tau, tau_v, tau_m, 0.0, 1.0, T0, TF, concentration, 0.0, 30.0]
    return np.concatenate([first, settings_vector(settings)])


def test_exponentials_are_right_to_their_last_bits():
    small = np.geomspace(1e-300, 1.0, 301)
    x = np.concatenate([np.linspace(LOWEST, HIGHEST, 20001), small, -small, [0.0, -0.0]])
    made = x.copy()
    exponentials(made)
    assert np.max(np.abs(made / np.exp(x) - 1.0)) < 4.5e-16
    assert (made[-2:] == 1.0).all()
    beyond = np.array([-1e300, -np.inf, -709.0, 710.0, np.inf])
    exponentials(beyond)
    np.testing.assert_allclose(beyond, np.exp([LOWEST] * 3 + [HIGHEST] * 2), rtol=4.5e-16)


@pytest.mark.parametrize(
    "taus",
    [
        (0.0481, 0.8577, 0.388),
        (0.2, 0.86, 1.2),
        (0.001, 0.5, 0.5),
        (0.5, 0.9, 0.3),
        (0.02, 0.02, 0.3),
    ],
)
def test_neutral_settings_are_the_closed_form(taus):
    tau, tau_v, tau_m = taus
    x = rig_mean(T, parameters(tau, tau_v, tau_m), *NO_MODES)
    exact = cascade_response(T, [tau_v, tau_m, tau], T0, TF)
    assert np.max(np.abs(x - exact)) < 2e-5


def integrated(p):
    """x3, low-passed, by LSODA from the differential equations of every stage."""

    def get(name):
        return p[FIRST + INDEX[name]]

    tau, tau_v, tau_m, _, _, t0, tf, c = p[:8]
    ramp, bend, kappa = get("stroke"), get("stroke_bend"), get("inertia")

    def command(t):
        up = np.clip((t - t0) / ramp, 0, 1) if ramp > 0 else float(t >= t0)
        down = np.clip((t - tf) / ramp, 0, 1) if ramp > 0 else float(t >= tf)
        return (1 - bend) * (up - down) + bend * (up**2 - down**2)

    def slopes(t, s):
        x1, v1, slow, x2, pocket, tank, x3, site, low = s
        u = command(t)
        lag = tau_v * get("valve_factor")
        if t >= tf:
            lag *= get("closing_ratio") * (1 + get("closing_bend") * (x1 / open_at_tf - 0.5))
        dx1, dv1 = (
            (v1, (u - x1 - lag * v1) / (kappa * lag**2)) if kappa > 0 else ((u - x1) / lag, 0)
        )
        dslow = (u - slow) / get("slow_valve_time")
        open_ = x1 + get("slow_valve_share") * (slow - x1)
        if t > t0:
            swing = np.cos(get("settling_swing") * (t - t0))
            open_ *= 1 - get("settling_share") * swing * np.exp(-(t - t0) / get("settling_time"))
        lost, a = get("flow_switching") * c, get("tank_share")
        rate = get("flow_factor") / tau_m / (1 - a) / (get("emptying_ratio") if t >= tf else 1.0)
        k = get("pocket_share") / get("pocket_time")
        flow = 1 - lost + lost * open_
        dx2 = rate * (open_ * (flow if get("premixed") else 1) - flow * x2) + k * (pocket - x2)
        inlet = tank if a > 0 else x2
        dtank = (x2 - tank) * get("flow_factor") / (tau_m * a) if a > 0 else 0.0

        def slower(drive):
            if get("release_width") > 0:
                return get("release_ratio") ** (0.5 - 0.5 * np.tanh(drive / get("release_width")))
            return get("release_ratio") if drive < 0.0 else 1.0

        dx3 = (inlet - x3) / (tau * get("sensor_factor") * slower(inlet - x3))
        dsite = (inlet - site) / (get("slow_site_time") * slower(inlet - site))
        total = x3 + get("slow_site_share") * (site - x3)
        dlow = (total - low) / get("filter") if get("filter") > 0 else 0.0
        return [dx1, dv1, dslow, dx2, (x2 - pocket) / get("pocket_time"), dtank, dx3, dsite, dlow]

    state, out, open_at_tf = np.zeros(9), np.zeros_like(T), 1.0
    for start, end in ((t0, tf), (tf, T[-1])):
        inside = (start < T) & (end >= T)
        at = np.append(T[inside], end)
        solved = solve_ivp(
            slopes, (start, end), state, method="LSODA", t_eval=np.unique(at),
            rtol=1e-9, atol=1e-11, max_step=0.05,
        )  # fmt: skip
        state = solved.y[:, -1]
        open_at_tf = state[0]
        y = solved.y[:, : inside.sum()]
        total = y[6] + get("slow_site_share") * (y[7] - y[6])
        out[inside] = y[8] if get("filter") > 0 else total
    return out


@pytest.mark.parametrize(
    "settings",
    [
        {"flow_switching": 1.0},
        {"flow_switching": 0.6, "premixed": 1.0},
        {"closing_ratio": 1.5},
        {"closing_ratio": 1.3, "closing_bend": 0.4},
        {"closing_bend": -1.2},
        {"inertia": 0.1},
        {"inertia": 0.25},
        {"inertia": 0.4},
        {"stroke": 0.4},
        {"stroke": 0.4, "stroke_bend": 1.0},
        {"stroke": 1.5, "stroke_bend": 0.4, "closing_ratio": 1.2},
        {"slow_valve_share": 0.1, "slow_valve_time": 5.0},
        {"settling_share": 0.3, "settling_time": 0.4},
        {"settling_share": -0.3, "settling_time": 0.8, "settling_swing": 2.0},
        {"pocket_share": 0.2, "pocket_time": 0.5, "flow_switching": 1.0},
        {"tank_share": 0.3},
        {"release_ratio": 3.0},
        {"slow_site_share": 0.05, "slow_site_time": 10.0},
        {"slow_site_share": 0.1, "slow_site_time": 3.0, "release_ratio": 3.0},
        {"filter": 0.05},
        {"valve_factor": 1.2, "sensor_factor": 0.7, "emptying_ratio": 1.3},
        {"flow_factor": 1.1, "tank_share": 0.1, "pocket_share": 0.05, "filter": 0.02,
         "slow_site_share": 0.1, "slow_site_time": 3.0, "closing_ratio": 1.2,
         "flow_switching": 1.0},
    ],
    ids=lambda s: "+".join(s),
)  # fmt: skip
def test_every_stage_agrees_with_an_integrator(settings):
    p = parameters(**settings)
    assert np.max(np.abs(rig_mean(T, p, *NO_MODES) - integrated(p))) < 6e-5


@pytest.mark.parametrize(("ratio", "width"), [(2.0, 0.05), (3.0, 0.01), (0.4, 0.02)])
def test_a_release_that_sets_in_gradually_agrees_with_an_integrator(ratio, width):
    # the rate is constant within a cell of the grid, and follows the state in steps
    p = parameters(0.2, release_ratio=ratio, release_width=width)
    x = rig_mean(T, p, *NO_MODES)
    assert np.max(np.abs(x - integrated(p))) < 4e-4
    abrupt = rig_mean(T, parameters(0.2, release_ratio=ratio), *NO_MODES)
    assert np.max(np.abs(x - abrupt)) > 1e-3  # and it matters


def test_a_sensor_in_equilibrium_does_not_decide_by_rounding_how_fast_others_release():
    settings = {"slow_site_share": 0.1, "slow_site_time": 20.0, "release_ratio": 3.0}
    x = rig_mean(T, parameters(0.05, 0.3, 0.3, **settings), *NO_MODES)
    for tiny in np.linspace(-1e-11, 1e-11, 9):
        moved = parameters(0.05 * (1.0 + tiny), 0.3, 0.3 * (1.0 + tiny), **settings)
        assert np.max(np.abs(rig_mean(T, moved, *NO_MODES) - x)) < 1e-9


def test_a_spread_of_slow_sites_is_a_sum_of_lags():
    slow = {"slow_site_share": 0.2, "slow_site_time": 6.0, "slow_site_spread": 3.0}
    x = rig_mean(T, parameters(**slow), *NO_MODES)
    exact = sum(
        share * cascade_response(T, [0.8577, 0.7, lag], T0, TF)
        for share, lag in ((0.8, 0.0481), (0.1, 6.0), (0.05, 2.0), (0.05, 18.0))
    )
    assert np.max(np.abs(x - exact)) < 2e-5


@pytest.mark.parametrize(("rise", "fall"), [(0.9, 0.9), (0.3, 0.0), (0.0, 6.0), (40.0, 40.0)])
def test_a_part_that_comes_later_is_a_second_response(rise, fall):
    x = rig_mean(T, parameters(late_share=0.4, late_rise=rise, late_fall=fall), *NO_MODES)
    taus = [0.8577, 0.7, 0.0481]
    late = cascade_response(T, taus, T0 + rise, 1e30) - cascade_response(T, taus, TF + fall, 1e30)
    exact = 0.6 * cascade_response(T, taus, T0, TF) + 0.4 * late
    assert np.max(np.abs(x - exact)) < 2e-5


def test_the_coating_is_a_sum_of_lags():
    share, ratio = coating_modes()
    assert share.sum() == pytest.approx(1.0, abs=1e-6)
    x = rig_mean(T, parameters(tau=0.2, coating=1.0), share, ratio)
    exact = sum(
        a * cascade_response(T, [0.8577, 0.7, 0.2 * r], T0, TF)
        for a, r in zip(share, ratio, strict=True)
    )
    assert np.max(np.abs(x - exact)) < 2e-5


def test_readout_terms_add_up():
    p = parameters(drift=1e-3, drift_curve=1e-5, drift_twist=3e-7, step=0.05, step_time=40.0,
                   gain_drift=1e-3, gain_curve=2e-5, gain_twist=-4e-7, curvature=0.1)  # fmt: skip
    p[3], p[4] = 0.2, 1.5
    v = 1.5 * cascade_response(T, [0.8577, 0.7, 0.0481], T0, TF)
    opened, since = T - T0, T - 30.0
    gain = 1 + 1e-3 * opened + 2e-5 * opened**2 - 4e-7 * opened**3
    drift = 0.2 + 1e-3 * since + 1e-5 * since**2 + 3e-7 * since**3
    wanted = v * (1 + 0.1 * (v - 1.5)) * gain + drift + 0.05 * (T >= 40.0)
    assert np.max(np.abs(rig_mean(T, p, *NO_MODES) - wanted)) < 5e-5


def test_a_fading_light_takes_the_baseline_with_it():
    settings = {"gain_drift": 1e-3, "gain_curve": 2e-5, "drift": 1e-3}
    p = parameters(gain_of_all=1.0, **settings)
    p[3], p[4] = 0.2, 1.5
    steady = parameters(drift=0.0)
    steady[3], steady[4] = p[3], p[4]
    opened, since = T - T0, T - 30.0
    gain = 1 + 1e-3 * opened + 2e-5 * opened**2
    wanted = rig_mean(T, steady, *NO_MODES) * gain + 1e-3 * since
    assert np.max(np.abs(rig_mean(T, p, *NO_MODES) - wanted)) < 1e-12


def test_a_step_follows_the_fall_and_settles():
    without = rig_mean(T, parameters(), *NO_MODES)
    p = parameters(step=0.05, step_with_fall=1.0, step_time=0.5, step_width=2.0)
    wanted = 0.05 * -np.expm1(-np.maximum(T - TF - 0.5, 0.0) / 2.0)
    assert np.max(np.abs(rig_mean(T, p, *NO_MODES) - without - wanted)) < 1e-12


def test_carried_gas_leaves_with_the_manifold():
    p = parameters(carry_over=0.1)
    x = rig_mean(T, p, *NO_MODES)
    early = T < 5.0
    lag = (0.7 * np.exp(-T / 0.7) - 0.0481 * np.exp(-T / 0.0481)) / (0.7 - 0.0481)
    assert np.max(np.abs(x[early] - 0.1 * lag[early])) < 1e-9


def test_gas_leaves_walls_over_a_spread_of_time_constants():
    one = {"carry_over": 0.1, "carry_time": 6.0}
    x = rig_mean(T, parameters(**one, carry_spread=3.0), *NO_MODES)
    parts = [(0.05, 6.0), (0.025, 18.0), (0.025, 2.0)]
    before = T < 5.0  # nothing but what is left
    lags = sum(
        share * (slow * np.exp(-T / slow) - 0.0481 * np.exp(-T / 0.0481)) / (slow - 0.0481)
        for share, slow in parts
    )
    assert np.max(np.abs(x[before] - lags[before])) < 1e-9
    # without a spread it is the single time constant's, whichever way that is asked for
    single = rig_mean(T, parameters(**one), *NO_MODES)
    nearly = rig_mean(T, parameters(**one, carry_spread=1.0 + 1e-9), *NO_MODES)
    assert np.max(np.abs(nearly - single)) < 1e-9


def test_unknown_settings_are_named():
    with pytest.raises(CampaignError, match="did you mean 'closing_ratio'"):
        check_settings("mine", {"closing_ration": 1.0})


@pytest.mark.parametrize("name", [n for n, e in CATALOGUE.items() if e.on_mean])
def test_an_effect_at_its_null_is_the_cascade(name):
    effect = CATALOGUE[name]
    campaign = paper_design(0.01)
    held = {**effect.plausible, **effect.null}
    strengths = {}
    for form in effect.forms:
        problem = with_effects(
            Problem(campaign), [f"{name}:{form.name}" if form.name else name], held=held
        )
        strengths = {s.name for part in problem.model.strengths for s in part}
        if not strengths:  # a form at full strength has no null
            continue
        missing = strengths - set(held)
        problem = with_effects(
            Problem(campaign), [f"{name}:{form.name}" if form.name else name],
            held={**held, **dict.fromkeys(missing, 1.0)},
        )  # fmt: skip
        vector = problem.layout.flat(paper_theta())
        e = campaign.experiments[2]
        exact = Problem(campaign).model.mean(e.t, vector, problem.layout, e)
        assert np.max(np.abs(problem.model.mean(e.t, vector, problem.layout, e) - exact)) < 1e-4
