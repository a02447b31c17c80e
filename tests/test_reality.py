"""The independent reality as a whole: what it rests on, nothing wrong, any cause, campaigns.

What single causes do is in the files of their places; a test of several is where its first acts.
"""

from __future__ import annotations

import ast
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayes_sensor.reality as reality
import bayes_sensor.reality.causes as causes
from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.reality import (
    CAUSES,
    OPEN_LAWS,
    RESERVE_LAWS,
    Case,
    acting_places,
    clean_signals,
    draw_case,
    make_campaign,
    sample_times,
    without_causes,
)
from tests.reality_cases import case, solved

CONTRACT_NAMES = (
    "flow_switching valve_asymmetry valve_second_order two_rate_valve finite_stroke dead_volume "
    "axial_dispersion flow_settling flow_error sensor_diffusion sorption_asymmetry slow_sorption "
    "optical_nonlinearity baseline_drift baseline_step gain_drift carry_over mains_pickup "
    "daq_filter heavy_tails quantisation"
).split()
MEAN_CAUSES = [name for name, cause in CAUSES.items() if not cause.noise]


# --------------------------------------------------------------------------- independence


def test_reality_imports_nothing_but_the_campaign_and_numerics() -> None:
    allowed = {"bayes_sensor.campaign", "bayes_sensor.reality", "numpy", "scipy", "numba"}
    files = sorted(Path(reality.__file__).parent.rglob("*.py"))
    assert len(files) >= 5
    seen = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{file.name}:{node.lineno}: relative import"
                names = [node.module or ""]
            for name in names:
                parts = name.split(".")
                root = ".".join(parts[:2]) if parts[0] == "bayes_sensor" else parts[0]
                seen.add(root)
                assert root in allowed or root in sys.stdlib_module_names, (
                    f"{file.name}:{node.lineno}: {name}"
                )
    assert "bayes_sensor.campaign" in seen  # the walk did look at imports


def test_no_two_causes_share_a_name() -> None:
    # the mapping of all would keep the last of them without a word
    files = sorted(Path(causes.__file__).parent.glob("*.py"))
    places = [getattr(causes, f.stem) for f in files if f.stem not in ("__init__", "cause")]
    assert sum(len(place.CAUSES) for place in places) == len(reality.CAUSES)


def test_every_effect_of_the_catalogue_has_a_counterpart_and_many_causes_have_no_name() -> None:
    listed = {name for cause in CAUSES.values() for name in cause.listed_as}
    assert listed == set(CONTRACT_NAMES)
    unlisted = [cause for cause in CAUSES.values() if not cause.listed]
    assert len(unlisted) >= 10
    assert len([cause for cause in unlisted if not cause.reserve]) >= 8
    assert len([cause for cause in unlisted if cause.reserve]) == 8
    assert not any(cause.reserve for cause in CAUSES.values() if cause.listed)
    assert (len(OPEN_LAWS), len(RESERVE_LAWS)) == (77, 3)
    assert not set(OPEN_LAWS) & set(RESERVE_LAWS)
    assert all(cause.turn.__doc__ for cause in CAUSES.values())


# --------------------------------------------------------------------------- nothing wrong


@pytest.mark.parametrize("size", ["paper", "varied", "small"])
def test_with_nothing_wrong_it_is_the_cascade(size: str) -> None:
    rig = draw_case(4, size=size)
    step = rig.steps[1]
    taus = rig.tau_v, rig.V / step.total_flow, rig.tau

    def cascade(u: float, x: FloatArray) -> list[float]:
        return [(u - x[0]) / taus[0], (x[0] - x[1]) / taus[1], (x[1] - x[2]) / taus[2]]

    _, states = solved(rig, cascade, 3, k=1)
    y = clean_signals(rig)[step.name]
    # the stated tolerance is 1e-4; straight lines between nodes leave a few 1e-6
    assert np.abs((y - step.y0) / step.beta - states[:, 2]).max() < 1e-5


def test_nodes_may_be_few() -> None:
    # the oracle asks for a few hundred times only: same values as on the full grid
    rig = case(flow_follows_valve=1.0, slow_sites=0.1, lorentzian_flank=0.5)
    full = clean_signals(rig)
    for step in rig.steps:
        t = sample_times(step)
        few = t[:: len(t) // 211]
        y = clean_signals(rig, {s.name: few if s is step else t for s in rig.steps})[step.name]
        assert np.abs(y - np.interp(few, t, full[step.name])).max() < 2e-5 * step.beta


# --------------------------------------------------------------------------- causes


@pytest.mark.parametrize("name", MEAN_CAUSES)
def test_a_cause_vanishes_with_its_strength_and_shows_without(name: str) -> None:
    rig, highest = case(), CAUSES[name].highest
    ideal = clean_signals(rig)
    off = clean_signals(replace(rig, strengths={name: 0.0}))
    weak = clean_signals(replace(rig, strengths={name: 1e-3 * highest}))
    strong = clean_signals(replace(rig, strengths={name: highest}))
    assert all(np.array_equal(off[k], ideal[k]) for k in ideal)
    assert all(np.isfinite(strong[k]).all() for k in ideal)

    def rms(other: dict[str, FloatArray]) -> float:
        return float(np.sqrt(np.mean([np.mean((other[k] - ideal[k]) ** 2) for k in ideal])))

    assert rms(strong) > 1e-4  # V
    # clocks and jumps of time move a steep signal: their effect grows like the root at worst
    assert rms(weak) < 0.1 * rms(strong)


@pytest.mark.parametrize("name", [name for name, cause in CAUSES.items() if cause.noise])
def test_a_noise_cause_leaves_the_mean_alone(name: str) -> None:
    rig = case(**{name: CAUSES[name].highest})
    ideal = without_causes(rig)
    for k, y in clean_signals(rig).items():
        assert np.array_equal(y, clean_signals(ideal)[k])
        assert not np.array_equal(make_campaign(rig)[k].y, make_campaign(ideal)[k].y)


def test_a_cause_draws_its_shape_from_the_seed_and_not_from_its_strength() -> None:
    # twice the strength of a drift that is linear in it is twice the drift
    rig = case()
    ideal = clean_signals(rig)
    one = clean_signals(replace(rig, strengths={"thermal_drift": 0.02}))
    two = clean_signals(replace(rig, strengths={"thermal_drift": 0.04}))
    for k in ideal:
        assert np.allclose(two[k] - ideal[k], 2.0 * (one[k] - ideal[k]), atol=1e-12)
    other = clean_signals(replace(rig, seed=12, strengths={"thermal_drift": 0.02}))
    assert not np.allclose(other["1"], one["1"])


def test_unknown_causes_are_refused() -> None:
    with pytest.raises(CampaignError, match="no cause 'gremlin'; there are flow_follows_valve"):
        make_campaign(case(gremlin=1.0))


# --------------------------------------------------------------------------- campaigns


def test_a_case_makes_the_same_campaign_again_and_survives_json() -> None:
    rig = case(wall_pockets=0.1, mains_hum=0.02)
    again = Case.from_json(rig.to_json())
    assert again == rig
    one, two = make_campaign(rig), make_campaign(again)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.values, b.values)
        assert np.allclose(a.values / rig.lsb, np.rint(a.values / rig.lsb), atol=1e-6)
    other = make_campaign(replace(rig, seed=rig.seed + 1))
    assert not np.array_equal(other["1"].values, one["1"].values)


def test_switches_follow_commands_even_on_a_bad_clock() -> None:
    for name in (
        "running_off_clock",
        "lost_samples",
        "hurried_timer",
        "repeated_buffer",
        "overtaking_packets",
        "running_down_meter",
    ):
        rig = draw_case(21, {name: CAUSES[name].highest}, size="small")
        seen = reality.as_recorded(rig)
        for e, step in zip(make_campaign(rig), seen.steps, strict=True):
            assert e.commanded_on is not None and e.commanded_off is not None
            assert e.commanded_on < step.t0 < e.commanded_off < step.tf < step.duration


@pytest.mark.parametrize(
    ("name", "phases", "least"),
    [
        ("flow_follows_valve", {"rise", "fall"}, 0.95),
        ("closing_spring", {"fall"}, 0.9),
        ("emptying_bottle", {"plateau", "fall"}, 0.95),
        ("plunger_stroke", {"rise", "fall"}, 0.95),
        ("residue", {"baseline", "onset", "rise", "plateau"}, 0.9),
        ("mains_dip", {"plateau"}, 0.95),
        ("dead_leg", {"fall", "tail"}, 0.999),
        ("trapped_plug", {"onset", "rise"}, 0.95),
        ("sites_that_keep", {"plateau", "fall", "tail"}, 0.95),
        ("sluggish_lock", {"rise", "fall"}, 0.999),
        ("held_readings", {"rise", "fall"}, 0.95),
        ("shared_nitrogen", {"plateau", "fall"}, 0.9),
        ("creeping_regulator", {"fall", "tail"}, 0.999),
        ("returning_exhaust", {"plateau", "fall", "tail"}, 0.95),
        ("flipping_cages", {"rise", "plateau", "fall"}, 0.99),
        ("swinging_column", {"rise", "plateau", "fall"}, 0.99),
        ("warm_driver", {"plateau", "fall", "tail"}, 0.95),
        ("hurried_timer", {"rise", "fall"}, 0.95),
        ("snapping_regulator", {"rise", "plateau", "fall"}, 0.999),
        ("pinched_hose", {"rise", "fall"}, 0.99),
        ("sticky_hose", {"rise", "fall"}, 0.99),
        ("permeable_hose", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("peeling_coating", {"plateau", "fall"}, 0.99),
        ("diode_detector", {"fall", "tail"}, 0.999),
        ("repeated_buffer", {"rise", "fall"}, 0.99),
        ("weak_holding_current", {"rise", "plateau", "fall"}, 0.999),
        ("cooling_bubbler", {"rise", "plateau", "fall"}, 0.999),
        ("pairing_gas", {"rise", "fall"}, 0.9),
        ("displaced_water", {"rise", "plateau", "fall"}, 0.999),
        ("self_heating_ring", {"rise", "plateau", "fall"}, 0.95),
        ("hunting_lock", {"rise", "fall"}, 0.9),
        ("grain_in_seat", {"fall", "tail"}, 0.999),
        ("stale_test_gas", {"rise", "plateau"}, 0.99),
        ("jet_across", {"rise", "fall"}, 0.95),
        ("heat_of_sorption", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("jolted_fibre", {"rise", "plateau", "fall"}, 0.9),
        ("overtaking_packets", {"rise", "fall"}, 0.95),
        ("throttling_hose", {"rise", "fall"}, 0.9),
        ("sticking_needle", {"rise", "plateau", "fall"}, 0.99),
        ("cold_spot", {"plateau", "fall"}, 0.95),
        ("swirling_gas", {"rise", "fall"}, 0.99),
        ("splitting_molecules", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("second_mode", {"rise", "plateau", "fall"}, 0.95),
        ("hot_output_stage", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("sparse_logger", {"rise", "fall"}, 0.8),
        ("stiff_grease", {"rise", "fall"}, 0.95),
        ("washing_bottle", {"rise", "plateau"}, 0.95),
        ("heavy_gas_in_pit", {"rise", "fall"}, 0.9),
        ("converting_film", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("sun_on_the_cell", {"rise", "plateau", "fall"}, 0.99),
        ("leaking_reference", {"plateau", "fall", "tail"}, 0.99),
        ("rms_receiver", {"rise", "fall"}, 0.95),
        ("unequal_valves", {"onset", "rise", "plateau", "fall"}, 0.99),
        ("spitting_bottle", {"rise", "plateau", "fall"}, 0.999),
        ("streaky_inlet", {"rise", "plateau", "fall"}, 0.999),
        ("glassy_rim", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("pulsing_ring", {"rise", "plateau", "fall"}, 0.99),
        ("log_receiver", {"rise", "fall", "tail"}, 0.95),
        ("running_down_meter", {"rise", "fall"}, 0.95),
        ("wound_up_controller", {"rise", "plateau"}, 0.999),
        ("alternating_dryers", {"baseline", "plateau", "tail"}, 0.5),
        ("gurgling_hose", {"rise", "fall"}, 0.99),
        ("spreading_islands", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("undecided_laser", {"rise", "plateau", "fall"}, 0.99),
        ("averaging_meter", {"rise", "fall"}, 0.95),
        ("sipping_chromatograph", {"rise", "plateau", "fall"}, 0.999),
        ("laminar_hose", {"rise", "fall"}, 0.99),
        ("late_impurity", {"plateau", "fall"}, 0.95),
        ("creeping_piezo", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("overloaded_amplifier", {"rise", "plateau", "fall"}, 0.999),
        ("thrifty_historian", {"baseline", "onset", "plateau", "tail"}, 0.6),
        ("soft_start", {"rise", "plateau"}, 0.999),
        ("hasty_purge", {"fall"}, 0.99),
        ("capillary_condensation", {"rise", "plateau", "fall"}, 0.99),
        ("dead_pixels", {"rise", "plateau", "fall"}, 0.999),
        ("automatic_gain", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("clogging_filter", {"rise", "fall"}, 0.99),
        ("bobbing_float", {"rise", "plateau"}, 0.99),
        ("bubbling_exhaust", {"rise", "plateau", "fall"}, 0.99),
        ("poisoned_coating", {"rise", "plateau", "fall"}, 0.99),
        ("smoothing_parabola", {"baseline", "onset", "rise", "plateau", "fall"}, 0.99),
        ("late_main_stage", {"rise", "plateau"}, 0.99),
        ("trial_click", {"baseline", "onset"}, 0.99),
        ("dammed_test_gas", {"rise", "plateau"}, 0.99),
        ("condensate_trap", {"rise", "fall"}, 0.99),
        ("dry_test_gas", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("fixed_window", {"rise", "fall"}, 0.99),
        ("averaged_repeats", {"baseline", "onset", "rise", "plateau", "fall"}, 0.99),
        ("snapping_diaphragm", {"rise", "fall"}, 0.99),
        ("yielding_carrier", {"rise", "plateau", "fall"}, 0.999),
        ("analyser_loop", {"rise", "fall"}, 0.99),
        ("igniting_coating", {"plateau", "fall"}, 0.98),
        ("bent_beam", {"rise", "fall"}, 0.999),
        ("blanked_ranging", {"rise", "fall"}, 0.99),
        ("hurried_display", {"rise", "fall"}, 0.99),
        ("shut_between_ports", {"rise", "fall"}, 0.99),
        ("ozone_lamp", {"rise", "plateau", "fall"}, 0.999),
        ("long_fibre", {"rise", "fall"}, 0.95),
        ("flaring_catalyst", {"rise", "plateau", "fall"}, 0.99),
        ("swinging_pen", {"rise", "plateau", "fall"}, 0.99),
        ("distrustful_filter", {"rise", "fall"}, 0.99),
        ("stiff_check_valve", {"rise", "fall"}, 0.99),
        ("warming_coil", {"rise", "plateau", "fall"}, 0.999),
        ("foreign_gas_factor", {"rise", "plateau", "fall"}, 0.999),
        ("filling_from_below", {"rise", "fall"}, 0.99),
        ("uneven_bonds", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("missed_fringes", {"rise", "plateau", "fall"}, 0.999),
        ("valve_turned_by_hand", {"rise", "fall"}, 0.99),
        ("unstable_controller", {"rise", "plateau", "fall"}, 0.999),
        ("resting_fan", {"rise", "plateau", "fall"}, 0.99),
        ("blistering_coating", {"fall", "tail"}, 0.999),
        ("light_across_inlet", {"rise", "plateau", "fall"}, 0.999),
        ("searching_stage", {"fall", "tail"}, 0.999),
        ("dying_battery", {"plateau", "fall"}, 0.99),
        ("sweeping_selector", {"rise", "fall"}, 0.99),
        ("rubber_balloon", {"plateau", "fall"}, 0.98),
        ("heavy_exhaust_riser", {"fall"}, 0.95),
        ("deliquescent_salt", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("bowing_chip", {"plateau", "fall"}, 0.99),
        ("slipping_phase_lock", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("lossy_archive", {"baseline", "onset", "rise", "plateau", "fall"}, 0.98),
        ("drying_wick", {"plateau", "fall"}, 0.999),
        ("worn_sampling_valve", {"baseline", "plateau", "tail"}, 0.8),
        ("loosening_glass", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("drying_drop", {"rise", "fall"}, 0.95),
        ("glowing_phosphor", {"rise", "fall"}, 0.95),
        ("leaking_shutter", {"rise", "plateau", "fall", "tail"}, 0.98),
        ("counted_charges", {"rise", "fall", "tail"}, 0.99),
        ("shape_memory_valve", {"rise", "fall"}, 0.99),
        ("twin_syringes", {"rise", "plateau", "fall"}, 0.999),
        ("flushed_backwards", {"fall"}, 0.99),
        ("cooperative_chains", {"plateau", "fall", "tail"}, 0.99),
        ("compressor_on_mains", {"rise", "plateau", "fall"}, 0.95),
        ("drooping_clamp", {"rise", "plateau", "fall"}, 0.95),
        ("climbing_baseline", {"rise", "plateau", "fall"}, 0.999),
        ("slamming_plunger", {"fall"}, 0.99),
        ("squeezed_bag", {"rise", "plateau", "fall"}, 0.999),
        ("neighbours_airlock", {"plateau", "fall"}, 0.95),
        ("stacked_layers", {"fall", "tail"}, 0.999),
        ("unwashed_pores", {"rise", "plateau", "fall"}, 0.99),
        ("heated_hose", {"rise", "plateau", "fall"}, 0.99),
        ("standing_water", {"rise", "fall"}, 0.99),
        ("glimmering_reagent", {"rise", "plateau", "fall"}, 0.999),
        ("avalanching_crystal", {"rise", "plateau", "fall"}, 0.99),
        ("grainy_fibre", {"rise", "plateau", "fall"}, 0.999),
        ("chart_on_screen", {"plateau", "fall", "tail"}, 0.98),
        ("flattened_record", {"baseline", "plateau", "tail"}, 0.9),
        ("tidal_stream", {"rise", "fall"}, 0.99),
        ("ripening_gas", {"rise", "fall"}, 0.99),
        ("late_nucleus", {"plateau", "fall", "tail"}, 0.99),
        ("starved_grains", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("slideshow_screen", {"plateau", "fall", "tail"}, 0.9),
        ("one_bit_link", {"rise", "fall"}, 0.95),
    ],
)
def test_places_where_causes_act(name: str, phases: set[str], least: float) -> None:
    shares = acting_places(case(**{name: 0.5 * CAUSES[name].highest}))
    assert sum(shares.values()) == pytest.approx(1.0)
    assert sum(v for (_, phase), v in shares.items() if phase in phases) > least


def test_parameters_are_drawn_afresh() -> None:
    some = [draw_case(seed, size="varied") for seed in range(12)]
    assert len({len(rig.steps) for rig in some}) > 2
    assert len({rig.steps[0].interval for rig in some}) > 1
    assert np.std(np.log([rig.tau for rig in some])) > 0.2
    for rig in some:
        assert rig.tau < rig.tau_v
        flows = [step.total_flow for step in rig.steps]
        assert max(flows) > 1.6 * min(flows)
    with pytest.raises(CampaignError, match="expected one of paper, varied, small"):
        draw_case(1, size="huge")


def test_seven_minutes_of_experiments_at_a_millisecond_take_less_than_two_seconds() -> None:
    rig = draw_case(2, {"flow_follows_valve": 1.0, "slow_sites": 0.1, "layered_coating": 1.0})
    make_campaign(case(flow_follows_valve=1.0, slow_sites=0.1, layered_coating=1.0))  # compile
    begin = time.process_time()
    campaign = make_campaign(rig)
    assert time.process_time() - begin < 2.0
    assert campaign.n_samples == 840_000
