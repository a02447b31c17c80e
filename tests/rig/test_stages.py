"""The rig: stages, their parameters, and programmes; two kinds of stages that only tests know."""

import numpy as np
import pytest

from bayes_sensor.campaign import STAGES, CampaignError
from bayes_sensor.rig.cascade import cascade_response, cascade_sensitivities, time_constants
from bayes_sensor.rig.layout import SHARED
from bayes_sensor.rig.programme import Programme, RecordedInput
from bayes_sensor.rig.rig import PUBLISHED, Rig
from bayes_sensor.rig.stages import KINDS, StageKind
from bayes_sensor.rig.stages.stage import Passage

DELAY = StageKind(
    name="delay",
    symbol="delay",
    unit="s",
    depends_on_flow=False,
    passage=lambda delay, flow: Passage(delay=delay),
    slope=lambda delay, flow: Passage(delay=1.0),
)
"""a fixed delay"""
TUBE = StageKind(
    name="tube",
    symbol="V",
    unit="mL",
    depends_on_flow=True,
    passage=lambda volume, flow: Passage(delay=volume / flow),
    slope=lambda volume, flow: Passage(delay=1.0 / flow),
)
"""plug flow"""


def tanks(n: int) -> StageKind:
    """``n`` equal volumes in series; the parameter is that of all together."""
    return StageKind(
        name=f"{n} tanks",
        symbol="V",
        unit="mL",
        depends_on_flow=True,
        passage=lambda volume, flow: Passage((volume / n / flow,) * n),
        slope=lambda volume, flow: Passage((1.0 / n / flow,) * n),
    )


WITH_TOYS = {**KINDS, "delay": DELAY, "tube": TUBE, "3 tanks": tanks(3)}
TOY = Rig.parse(["wait: delay", "mixer: 3 tanks", "valve", "hose: tube", "sensor"], kinds=WITH_TOYS)
TOY_AT = np.array([0.05, 0.8, 0.3, 60.0, 15.0])
T = np.linspace(0.0, 20.0, 401)


# --- the published rig


def test_the_published_rig_is_the_default_one() -> None:
    assert PUBLISHED == Rig.parse(["valve", "manifold", "sensor"]) == Rig.parse(STAGES)
    assert PUBLISHED.names == SHARED and PUBLISHED.units == ("s", "s", "mL")
    shared, flow = np.array([0.0481, 0.8577, 58.23]), 75.0
    taus = PUBLISHED.taus(shared, flow)
    np.testing.assert_array_equal(taus, [0.8577, 58.23 / 75.0, 0.0481])
    np.testing.assert_array_equal(taus, time_constants(*shared, flow))
    pulse = Programme.pulse(2.3, 11.7)
    found = PUBLISHED.response(T, shared, flow, pulse)
    np.testing.assert_array_equal(found, cascade_response(T, taus, 2.3, 11.7))
    by = cascade_sensitivities(T, taus, 2.3, 11.7)
    found = PUBLISHED.sensitivities(T, shared, flow, pulse)
    np.testing.assert_allclose(found.parameters, by[:, [2, 0, 1]] / [1.0, 1.0, flow], rtol=1e-13)
    np.testing.assert_allclose(found.delay, by[:, 3] + by[:, 4], rtol=1e-12, atol=1e-15)
    switches = PUBLISHED.switch_sensitivities(T, shared, flow, pulse)
    np.testing.assert_array_equal(switches, by[:, 3:])


def test_sensitivities_of_the_published_rig_when_switches_cross() -> None:
    # a sampler may propose a step down before the step up
    taus = [0.8577, 0.388, 0.0481]
    crossed = cascade_sensitivities(T, taus, 11.7, 2.3)
    straight = cascade_sensitivities(T, taus, 2.3, 11.7)
    np.testing.assert_allclose(crossed[:, [4, 3]], -straight[:, 3:], atol=1e-15)
    found = cascade_response(T, taus, 11.7, 2.3)
    np.testing.assert_allclose(found, -cascade_response(T, taus, 2.3, 11.7), atol=1e-15)


# --- any rig


@pytest.mark.parametrize(
    ("texts", "names", "units"),
    [
        (["sensor"], ["tau_s"], ["s"]),
        (["cell", "sensor"], ["tau_s", "V_cell_mL"], ["s", "mL"]),
        (
            ["trap", "line", "manifold", "filter", "sensor", "probe: lag"],
            ["tau_s", "tau_filter_s", "tau_probe_s", "V_trap_mL", "V_line_mL", "V_mL"],
            ["s", "s", "s", "mL", "mL", "mL"],
        ),
        (["sensor: lag", " box : volume "], ["tau_s", "V_box_mL"], ["s", "mL"]),
    ],
)
def test_names_and_units_of_the_parameters(texts, names, units) -> None:
    rig = Rig.parse(texts)
    assert list(rig.names) == names and list(rig.units) == units
    shared = np.arange(1.0, len(names) + 1.0)
    by_name = dict(zip(names, shared))
    expected = [
        by_name[stage.parameter] / (50.0 if stage.kind.depends_on_flow else 1.0)
        for stage in rig.stages
    ]
    np.testing.assert_array_equal(rig.taus(shared, 50.0), expected)
    assert rig.delay(shared, 50.0) == 0.0


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        ([], "expected one to 6, got 0"),
        (["sensor", *(f"l{i}: lag" for i in range(6))], "expected one to 6, got 7"),
        (["valve", "manifold"], "exactly one called 'sensor', got 0 among valve, manifold"),
        (["sensor", "sensor"], "'sensor' and 'sensor' would both have the parameter tau_s"),
        (["valve", "sensor", "valve"], "rename one, as in 'valve2: lag'"),
        (["vlave", "sensor"], "'vlave' is no known stage; did you mean 'valve'?"),
        (["probe", "sensor"], 'any other is written with its kind, as in "probe: lag"'),
        (["probe: lagg", "sensor"], "has the kind 'lagg'; did you mean 'lag'?"),
        (["probe: pump", "sensor"], "known are lag, volume"),
        (["valve: volume", "sensor"], "a valve is a lag; write 'valve' or rename it"),
        (["my valve: lag", "sensor"], "expected a name of letters, digits and '_'"),
        ([": lag", "sensor"], "expected a name of letters"),
        (["v: lag", "sensor"], "that is what the valve's parameter is called by"),
    ],
)
def test_a_rig_that_cannot_be_is_refused(texts: list[str], said: str) -> None:
    with pytest.raises(CampaignError) as caught:
        Rig.parse(texts)
    assert said in str(caught.value)


def test_what_is_known_of_the_sensor_is_one_of_three_words() -> None:
    assert Rig.parse(["sensor"], "slower").sensor_is == "slower"
    with pytest.raises(CampaignError, match="expected one of faster, slower, unknown"):
        Rig.parse(["sensor"], "slow")


def test_lags_that_commute() -> None:
    rig = Rig.parse(["valve", "line", "filter", "sensor"])
    assert rig.lags_that_commute() == ("tau_s", "tau_v_s", "tau_filter_s")
    assert rig.lags_that_commute(one_flow=True) == (*rig.lags_that_commute(), "V_line_mL")
    # three equal lags cannot be taken for another one; a delay has none
    assert TOY.lags_that_commute() == TOY.lags_that_commute(one_flow=True) == ("tau_s", "tau_v_s")
    one_tank = Rig.parse(["mixer: 1 tanks", "sensor"], kinds={**KINDS, "1 tanks": tanks(1)})
    assert one_tank.lags_that_commute(one_flow=True) == ("tau_s", "V_mixer_mL")


def test_flows_may_be_left_out_where_nothing_depends_on_them() -> None:
    rig = Rig.parse(["valve", "sensor"])
    assert not rig.needs_flow and rig.taus(np.array([1.0, 2.0])).tolist() == [2.0, 1.0]
    assert rig.sensitivities(T, np.array([1.0, 2.0]), None, Programme.pulse(1.0)).delay.shape == (
        len(T),
    )
    with pytest.raises(CampaignError, match="stage 'manifold' depends on the total flow"):
        PUBLISHED.taus(np.ones(3))


def test_time_constants_may_be_draws() -> None:
    shared = np.array([[0.05, 0.06], [0.8, 0.9], [58.0, 60.0]])
    assert PUBLISHED.taus(shared, 75.0).shape == (3, 2)
    for bad in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(CampaignError, match="must be positive, but those of valve, manifold"):
            PUBLISHED.taus(np.array([0.05, bad, 58.0]), 75.0)


# --- another kind of stage is one file


def test_every_kind_is_found_by_its_file() -> None:
    assert set(KINDS) == {"lag", "volume"}
    assert all(kind.name == name for name, kind in KINDS.items())


def test_a_kind_only_needs_its_lags_and_its_delay() -> None:
    assert TOY.names == ("tau_s", "delay_wait_s", "tau_v_s", "V_mixer_mL", "V_hose_mL")
    assert TOY.units == ("s", "s", "s", "mL", "mL")
    np.testing.assert_allclose(TOY.taus(TOY_AT, 50.0), [0.4, 0.4, 0.4, 0.3, 0.05])
    assert TOY.delay(TOY_AT, 50.0) == pytest.approx(0.8 + 0.3)


def test_tanks_in_series_answer_as_erlang_says() -> None:
    rig = Rig.parse(["mixer: 3 tanks", "sensor"], kinds=WITH_TOYS)
    x = T / 0.4
    erlang = 1.0 - np.exp(-x) * (1.0 + x + x**2 / 2.0)
    # the sensor delays by its time constant, in the limit of a short one
    found = rig.response(T + 1e-9, np.array([1e-9, 60.0]), 50.0, Programme.pulse(0.0))
    np.testing.assert_allclose(found, erlang, atol=1e-9)


def test_a_delay_moves_the_response() -> None:
    rig = Rig.parse(["wait: delay", "sensor"], kinds=WITH_TOYS)
    alone, programme = Rig.parse(["sensor"]), Programme.pulse(2.0, 9.0)
    found = rig.response(T, np.array([0.7, 1.3]), None, programme)
    expected = alone.response(T, np.array([0.7]), None, programme.later(1.3))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    "programme",
    [
        Programme.pulse(1.013, 7.017),
        Programme.steps([(1.013, 0.3), (3.017, 1.0), (8.019, 0.2)], rest=0.1),
        RecordedInput(T, np.sin(T)),
    ],
    ids=["pulse", "staircase", "recorded"],
)
@pytest.mark.parametrize("interval", [None, 0.05])
@pytest.mark.parametrize("rig", [PUBLISHED, TOY], ids=["published", "toys"])
def test_sensitivities_match_finite_differences(rig: Rig, interval, programme) -> None:
    at = TOY_AT if rig is TOY else np.array([0.3, 0.3, 30.0])
    found = rig.sensitivities(T, at, 50.0, programme, interval)

    def response(p: np.ndarray, later: float = 0.0) -> np.ndarray:
        return rig.response(T, p, 50.0, programme.later(later), interval)

    def quotient(step: np.ndarray, later: float, by: float) -> np.ndarray:
        # fourth order: the error is about the fourth power of the relative step
        a, b, c, d = (response(at + k * step, k * later) for k in (-2, -1, 1, 2))
        return (8.0 * (c - b) - (d - a)) / (12.0 * by)

    scale = np.ptp(response(at))
    for j, name in enumerate(rig.names):
        step = np.zeros(len(at))
        step[j] = 1e-4 * at[j]
        expected = quotient(step, 0.0, step[j])
        # a kink of the input within the step: its curvature is one over the shortest lag
        atol = 2e-4 * scale / at[j]
        np.testing.assert_allclose(found.parameters[:, j], expected, atol=atol, err_msg=name)
    expected = quotient(np.zeros(len(at)), 1e-5, 1e-5)
    np.testing.assert_allclose(found.delay, expected, atol=1e-3 * np.abs(expected).max())
    if isinstance(programme, Programme):
        by_time = rig.switch_sensitivities(T, at, 50.0, programme, interval)
        np.testing.assert_allclose(by_time.sum(axis=1), found.delay, atol=1e-12, rtol=1e-10)


def test_what_was_there_before_the_record_stays() -> None:
    # a settled chain passes a constant on
    at = np.array([0.05, 0.8, 58.0])
    for programme in (
        Programme.steps([(30.0, 0.2)], rest=0.7),
        RecordedInput(np.array([30.0, 40.0]), np.array([0.7, 0.2])),
    ):
        x = PUBLISHED.response(np.array([0.0, 29.0, 90.0]), at, 75.0, programme)
        np.testing.assert_allclose(x, [0.7, 0.7, 0.2], rtol=1e-14)


# --- programmes


def test_programmes_say_the_same_in_several_ways() -> None:
    pulse = Programme.pulse(1.0, 3.0)
    for other in (
        Programme.pulses([1.0], [3.0]),
        Programme.edges([1.0, 3.0]),
        Programme.steps([(1.0, 1.0), (3.0, 0.0)]),
        Programme(np.array([3.0, 1.0]), np.array([-1.0, 1.0])),
    ):
        np.testing.assert_array_equal(other.drive.times, pulse.drive.times)
        np.testing.assert_array_equal(other.levels, pulse.levels)
    assert Programme.pulse(2.0).levels.tolist() == [1.0]
    down = Programme.edges([1.0, 3.0], up=False)
    assert down.rest == 1.0 and down.levels.tolist() == [0.0, 1.0]
    assert pulse.later(0.5).times.tolist() == [1.5, 3.5]
    assert pulse.at([4.0, 3.5]).levels.tolist() == [-1.0, 0.0]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Programme.pulse(3.0, 1.0), "time 2 (1 s) follows time 1 (3 s)"),
        (lambda: Programme.pulses([1.0, 2.0, 3.0], [1.5]), "got 3 on and 1 off"),
        (lambda: Programme.pulses([1.0], [1.5, 2.0]), "got 1 on and 2 off"),
        (lambda: Programme.pulses([1.0, 2.0], [2.0]), "time 3 (2 s) follows time 2 (2 s)"),
        (lambda: Programme.pulse(np.nan), "time 1 is nan"),
        (lambda: Programme.steps([(1.0, 0.5), (2.0, 0.5)]), "step 2 goes to 0.5, where it is"),
        (lambda: Programme.steps([]), "expected as many times as heights, one or more"),
        (lambda: Programme(np.ones(2), np.ones(3)), "got shapes (2,) and (3,)"),
        (lambda: Programme(np.ones(1), np.array([np.inf])), "the height of switch 1 is inf"),
        (lambda: RecordedInput(np.ones(2), np.ones(2)), "times must rise"),
        (lambda: RecordedInput(np.arange(3.0), np.ones(2)), "a value for every time"),
        (lambda: RecordedInput(np.arange(2.0), np.array([1.0, np.nan])), "sample 2 (at 1 s)"),
    ],
)
def test_a_programme_that_cannot_be_is_refused(make, said: str) -> None:
    with pytest.raises(CampaignError) as caught:
        make()
    assert said in str(caught.value)
