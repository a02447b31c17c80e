"""One record in another unit, on another clock, upside down or in another file: one answer.

A metamorphic suite: what is measured does not depend on the unit of the signal, on where its zero
and that of the clock are, nor on the order and format of the files.  Time constants agree to a
relative 1e-6, flags and warnings entirely.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from bayes_sensor.bounds import compare_bounds
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.diagnosis.data.bins import LONGEST, limit_lengths
from bayes_sensor.fit import Fit, fit_least_squares
from bayes_sensor.fit.identifiability import least_noise
from bayes_sensor.io.check import campaign_remarks
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.default_priors import default_priors
from bayes_sensor.likelihood.density import log_likelihood
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import sample_posterior
from bayes_sensor.posterior.posterior import Posterior
from bayes_sensor.residuals import diagnose_residuals
from tests.support.campaigns import small_problem

CLOSE = 1e-6
STEP = 1.5
"""V, the height of the responses, about"""
SCALES = {f"times {scale:g}": {"scale": scale} for scale in (1e-15, 1e-12, 1e12)}
UPSIDE_DOWN = {"upside down": {"scale": -1.0}, "times -1e-12": {"scale": -1e-12}}
OFFSETS = {
    f"{steps:+g} steps": {"offset": steps * STEP} for steps in (1e3, -1e6)
}  # fmt: skip
OFFSETS["times 1e-12, +1e6 steps"] = {"scale": 1e-12, "offset": 1e-12 * 1e6 * STEP}
CLOCKS = {f"{shift:+g} s": {"shift": shift} for shift in (-1e3, 1e6)}
ORDERS = {"another order": {"order": (2, 0, 1)}}
CHANGES: dict[str, dict[str, Any]] = {**SCALES, **UPSIDE_DOWN, **OFFSETS, **CLOCKS, **ORDERS}
SAME_DRAWS = [name for name in CHANGES if name not in ORDERS]
"""changes that leave every random number where it was"""


@cache
def measured(sigma: float = 0.005, fault: str = "") -> Campaign:
    """Three experiments; ``fault``: with a kink that no cascade has, or one without a step."""
    problem, _ = small_problem(n=3, sigma=sigma, interval=0.02)
    campaign = problem.campaign
    if fault == "kink":  # a second, slower response that no cascade has
        more = {
            e.name: e.values + 0.15 * np.clip((e.t - 2.5) / 3.0, 0.0, 1.0) * (e.t < 7.0)
            for e in campaign
        }
        campaign = campaign.with_data(more)
    if fault == "no step":
        quiet = {"b": 0.002 * np.random.default_rng(5).standard_normal(len(campaign["b"].t))}
        campaign = campaign.with_data(quiet)
    return campaign


def changed(
    campaign: Campaign,
    scale: float = 1.0,
    offset: float = 0.0,
    shift: float = 0.0,
    order: tuple[int, ...] | None = None,
) -> Campaign:
    """The same measurement times ``scale`` plus ``offset``, on a clock ``shift`` s ahead."""
    moved = [
        replace(
            e,
            y=scale * e.values + offset,
            t=e.t + shift,
            commanded_on=None if e.commanded_on is None else e.commanded_on + shift,
            commanded_off=None if e.commanded_off is None else e.commanded_off + shift,
        )
        for e in campaign
    ]
    return replace(campaign, experiments=tuple(moved[i] for i in order or range(len(moved))))


def scale_of(change: str) -> float:
    return abs(CHANGES[change].get("scale", 1.0))


def words(sentences: Any) -> list[str]:
    """Sentences without their numbers, which are scaled."""
    return sorted(re.sub(r"-?\d+(\.\d+)?(e[-+]?\d+)?", "#", text) for text in sentences)


@cache
def fitted(change: str = "", sigma: float = 0.005, fault: str = "") -> tuple[Campaign, Fit]:
    campaign = measured(sigma, fault)
    campaign = changed(campaign, **CHANGES[change]) if change else campaign
    return campaign, fit_least_squares(campaign, seed=1)


@cache
def sampled(change: str = "") -> Posterior:
    campaign, fit = fitted(change)
    return sample_posterior(campaign, fit, seed=1, sampler="independence")


# --------------------------------------------------------------------------- check and fit


def assert_same_fit(found: Fit, expected: Fit, scale: float = 1.0, within: float = CLOSE) -> None:
    assert found.theta_hat[:3] == pytest.approx(expected.theta_hat[:3], rel=within)
    phi = expected.names.index("phi")
    assert found.theta_hat[phi] == pytest.approx(expected.theta_hat[phi], rel=within)
    assert found.rms == pytest.approx(scale * expected.rms, rel=within)
    for name, values in expected.parameters["experiments"].items():
        beta = found.parameters["experiments"][name]["beta_V"]
        assert abs(beta) == pytest.approx(scale * abs(values["beta_V"]), rel=within)
    for each in ("converged", "status", "step_seen", "at_bound"):
        assert getattr(found, each) == getattr(expected, each)
    assert found.swarms["agree"] == expected.swarms["agree"]
    assert words(found.warnings) == words(expected.warnings)
    assert words([found.cannot_tell, found.twin]) == words([expected.cannot_tell, expected.twin])
    assert found.euler is not None and expected.euler is not None
    assert found.euler["converged"] == expected.euler["converged"]


@pytest.mark.parametrize("change", CHANGES)
def test_fit_is_the_same(change: str) -> None:
    _, expected = fitted()
    campaign, found = fitted(change)
    assert found.converged
    assert_same_fit(found, expected, scale_of(change))
    assert words(campaign_remarks(campaign)) == words(campaign_remarks(fitted()[0]))


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_low_noise_and_a_high_one_are_the_same(change: str) -> None:
    # noise of 1e-4 steps; 1e6 steps away the floats themselves are rounded to 2e-10 steps, which is
    # 2e-6 of such noise, so that the time constants are known to a few hundred parts in 1e9 only
    assert_same_fit(fitted(change, 1e-4)[1], fitted("", 1e-4)[1], scale_of(change), 1e-5)
    assert not fitted(change, 1e-4)[1].cannot_tell
    # at a tenth of a step tau ends on its lower bound, which a refinement nears step by step: where
    # other digits are rounded it ends elsewhere within its tolerance, a millionth of V's spread
    loose = CLOSE if change in SCALES else 3e-5
    assert_same_fit(fitted(change, 0.15)[1], fitted("", 0.15)[1], scale_of(change), loose)


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("fault", ["kink", "no step"])
def test_warnings_are_the_same(change: str, fault: str) -> None:
    expected, found = fitted("", fault=fault), fitted(change, fault=fault)
    assert expected[1].warnings
    if fault == "kink" or change not in ORDERS:
        assert words(found[1].warnings) == words(expected[1].warnings)
    else:  # where there is nothing to find, random numbers decide at which bound a search ends
        seen = [[w for w in words(fit.warnings) if "not visible" in w] for _, fit in
                (found, expected)]  # fmt: skip
        assert seen[0] == seen[1] != []
    assert found[1].converged == expected[1].converged
    remarks = words(campaign_remarks(expected[0]))
    assert words(campaign_remarks(found[0])) == remarks and (fault == "kink" or remarks)


@pytest.mark.parametrize("change", CHANGES)
def test_diagnostics_of_residuals_are_the_same(change: str) -> None:
    expected, found = (diagnose_residuals(*fitted(name)) for name in ("", change))
    scale = scale_of(change)
    assert found.adequate == expected.adequate
    assert words([found.verdict]) == words([expected.verdict])
    assert found.spectrum["slow_to_ar1"] == pytest.approx(
        expected.spectrum["slow_to_ar1"], rel=CLOSE
    )
    assert found.histogram["bin_V"] == pytest.approx(scale * expected.histogram["bin_V"], rel=1e-9)
    assert words([found.histogram["note"]]) == words([expected.histogram["note"]])
    for name, own in expected.experiments.items():
        assert found.experiments[name]["rms_V"] == pytest.approx(scale * own["rms_V"], rel=CLOSE)
    if change not in ORDERS:  # residuals of experiments stand in a row
        before = expected.ljung_box["before"]["statistic"]
        assert found.ljung_box["before"]["statistic"] == pytest.approx(before, rel=CLOSE)


@pytest.mark.parametrize("offset", [0.0, 1e6 * STEP])
@pytest.mark.parametrize("scale", [1e-15, 1.0, 1e12])
def test_rounding_is_no_noise_and_noise_no_rounding(scale: float, offset: float) -> None:
    campaign = measured()
    problem = Problem(campaign)
    theta = problem.layout.flat(fitted()[1].theta_hat)
    noise_free = {}
    for k, e in enumerate(campaign):
        y0, beta = theta[problem.layout.local[k, :2]]
        x = problem.model.response(e.t, theta, problem.layout, e)
        noise_free[e.name] = y0 + beta * x
    plain = changed(campaign.with_data(noise_free), scale, scale * offset)
    assert "rounding" in fit_least_squares(plain, euler=False).cannot_tell
    noisy = changed(measured(1e-4), scale, scale * offset)
    assert least_noise(noisy) < 0.01 * scale * 1e-4
    assert not fit_least_squares(noisy, euler=False).cannot_tell


# --------------------------------------------------------------------------- likelihood, priors


@pytest.mark.parametrize("scale", [1e-15, 1e-12, 1e12])
def test_log_likelihood_shifts_by_the_unit_alone(scale: float) -> None:
    campaign, fit = fitted()
    other, again = fitted(f"times {scale:g}")
    shift = campaign.n_samples * np.log(scale)
    for compressed in (False, True):
        expected = log_likelihood(campaign, fit.theta_hat) - shift
        if compressed:
            from bayes_sensor.likelihood.mesh import log_likelihood as fast

            found = fast(other, again.theta_hat, compressed=True)
        else:
            found = log_likelihood(other, again.theta_hat)
        # the promise of the mesh is 1e-3
        assert found == pytest.approx(expected, abs=1e-3 if compressed else 1e-6)


@pytest.mark.parametrize("change", SCALES | OFFSETS)
def test_priors_are_scaled(change: str) -> None:
    laws = []
    for name in ("", change):
        problem = Problem(fitted(name)[0])
        laws.append(default_priors(problem.campaign, problem.layout))
    for name, law in laws[0].items():
        scale = scale_of(change) if name.startswith("sigma") else 1.0
        assert laws[1][name].kind == law.kind
        assert laws[1][name].a == pytest.approx(scale * law.a, rel=CLOSE)
        assert laws[1][name].b == pytest.approx(law.b, rel=CLOSE)


# --------------------------------------------------------------------------- posterior, bounds


@pytest.mark.parametrize("change", SAME_DRAWS)
def test_independence_posterior_is_the_same(change: str) -> None:
    expected, found = sampled(), sampled(change)
    assert expected.sampler == found.sampler == "independence"
    assert found.draws[:, :3] == pytest.approx(expected.draws[:, :3], rel=CLOSE)
    assert found.converged == expected.converged
    assert words(found.warnings) == words(expected.warnings)
    assert words(found.reasons) == words(expected.reasons)
    # volts are scaled, and turned with the signal
    sigma0 = scale_of(change) * expected.of("sigma0_V")
    assert found.of("sigma0_V") == pytest.approx(sigma0, rel=CLOSE)
    beta = CHANGES[change].get("scale", 1.0) * expected.of("beta_V[b]")
    assert found.of("beta_V[b]") == pytest.approx(beta, rel=CLOSE)


def test_independence_posterior_in_another_order_is_the_same_law() -> None:
    # other random numbers fall to each parameter; 4000 draws hold quantiles to a tenth of the sd
    expected, found = sampled(), sampled("another order")
    assert found.converged == expected.converged
    sd = expected.draws[:, :3].std(axis=0)
    for q in (0.16, 0.5, 0.84):
        apart = np.quantile(found.draws[:, :3], q, axis=0) - np.quantile(
            expected.draws[:, :3], q, axis=0
        )
        assert (np.abs(apart) < 0.15 * sd).all()


@cache
def bounds_of(change: str = "") -> Mapping[str, Any]:
    campaign, fit = fitted(change)
    found: Mapping[str, Any] = compare_bounds(campaign, fit, sampled(change)).to_json()["methods"]
    return found


@pytest.mark.parametrize("change", CHANGES)
def test_every_bound_is_the_same(change: str) -> None:
    expected, found = bounds_of(), bounds_of(change)
    assert list(found) == list(expected)
    for method, bound in expected.items():
        if method == "crlb_iid_one_percent_step" and change in CLOCKS:
            continue  # steps of 1 % of the switch times, as published, know the clock's zero
        if method in ("block_bootstrap", "posterior") and change in ORDERS:
            continue  # other random numbers
        for name in ("tau_s", "tau_v_s", "V_mL"):
            numbers = {k: v for k, v in bound["parameters"][name].items() if v is not None}
            assert numbers
            got = {k: v for k, v in found[method]["parameters"][name].items() if v is not None}
            assert got == pytest.approx(numbers, rel=CLOSE), (method, name)


# --------------------------------------------------------------------------- gap

PROBABLE = 1e-5
"""probabilities this close: a refit ends within a tolerance of its optimum"""


@cache
def diagnosed(change: str = "", fault: str = "kink", without: tuple[str, ...] = ()) -> Any:
    campaign, fit = fitted(change, fault=fault)
    gap = diagnose_gap(
        campaign, fit, bootstrap=10, hidden=False, separate=False, follow=False, without=without
    )
    seen = [(f.name, len(f.places)) for f in gap.findings if f.probability > 0.5]
    return gap.to_json() | {"seen": seen}


@pytest.mark.slow
@pytest.mark.parametrize("change", ["times 1e-15", "times 1e+12", "times -1e-12", *CLOCKS])
def test_diagnosis_is_the_same(change: str) -> None:
    assert_same_diagnosis(diagnosed(change), diagnosed(), change)


@pytest.mark.slow
@pytest.mark.parametrize("change", ["times 1e-12", "upside down"])
def test_diagnosis_of_nothing_is_the_same(change: str) -> None:
    assert_same_diagnosis(diagnosed(change, ""), diagnosed("", ""), change)


@pytest.mark.slow
@pytest.mark.parametrize("change", OFFSETS)
def test_diagnosis_far_from_zero_is_the_same(change: str) -> None:
    # a lamp that fades takes the whole voltage with it: that effect alone knows where zero is
    without = ("gain_drift",)
    found, expected = (diagnosed(name, "kink", without) for name in (change, ""))
    assert_same_diagnosis(found, expected, change)


def assert_same_diagnosis(found: Any, expected: Any, change: str) -> None:
    verdict = expected["verdict"]
    for key in ("kind", "effects", "family"):
        assert found["verdict"][key] == verdict[key]
    assert found["verdict"]["probability"] == pytest.approx(verdict["probability"], abs=PROBABLE)
    probabilities = {row["effect"]: row["probability"] for row in expected["which"]}
    assert {row["effect"]: row["probability"] for row in found["which"]} == pytest.approx(
        probabilities, abs=PROBABLE
    )
    scale = scale_of(change)
    budget = expected["budget"]
    assert found["budget"]["noise_floor_rms_V"] == pytest.approx(
        scale * budget["noise_floor_rms_V"], rel=CLOSE
    )
    assert found["budget"]["p_value"] == pytest.approx(budget["p_value"], abs=1e-3)
    for here, there in zip(found["where"], expected["where"], strict=True):
        assert (here["experiment"], here["phase"]) == (there["experiment"], there["phase"])
        assert here["share"] == pytest.approx(there["share"], abs=1e-4)
        excess = scale * there["excess_rms_V"]
        assert here["excess_rms_V"] == pytest.approx(excess, rel=1e-3, abs=1e-6 * scale)
    assert found["seen"] == expected["seen"]


@pytest.mark.slow
def test_kink_is_seen_at_all() -> None:
    # else the diagnoses above would agree about nothing
    assert diagnosed()["verdict"]["kind"] != "none"
    assert diagnosed("", "")["verdict"]["kind"] == "none"


# --------------------------------------------------------------------------- files

UNITS = {"V": 1.0, "mV": 1e3, "uA": 1e6, "pA": 1e12, "A": 1e-12, "ppm": 7e4}
"""signal_unit -> factor on the numbers that stand in the file"""


def written(folder: Path, unit: str, suffix: str, offset: float = 0.0) -> Campaign:
    """The campaign from files in this unit and format."""
    lines = ['title = "files"']
    for e in measured():
        y = UNITS[unit] * (e.values + offset)
        name = f"{e.name}.{suffix}"
        if suffix == "csv":
            rows = np.column_stack([e.t, y])
            text = "time_s,signal\n" + "\n".join(f"{t:.17g},{v:.17g}" for t, v in rows)
            (folder / name).write_text(text + "\n")
        elif suffix == "npz":
            np.savez(folder / name, time_s=e.t, signal=y)
        else:
            savemat(folder / name, {"time_s": e.t, "signal": y})
        lines += [
            "[[experiment]]", f'name = "{e.name}"', f'file = "{name}"', 'signal = "signal"',
            f'carrier_flow = "{e.carrier_flow} mL/s"', f'test_gas_flow = "{e.test_gas_flow} mL/s"',
            'commanded_on = "1.8 s"', 'commanded_off = "6.8 s"', f'signal_unit = "{unit}"',
        ]  # fmt: skip
    (folder / "campaign.toml").write_text("\n".join(lines) + "\n")
    return read_campaign(folder / "campaign.toml")


@pytest.mark.parametrize(
    ("unit", "suffix", "offset"),
    [
        *((unit, "csv", 0.0) for unit in UNITS),
        ("V", "npz", 0.0), ("A", "npz", 0.0), ("pA", "mat", 0.0), ("V", "mat", 0.0),
        ("mV", "npz", 1e6 * STEP), ("A", "csv", -1e6 * STEP), ("pA", "mat", 1e6 * STEP),
    ],
)  # fmt: skip
def test_units_and_readers_give_the_same(
    tmp_path: Path, unit: str, suffix: str, offset: float
) -> None:
    campaign = written(tmp_path, unit, suffix, offset)
    found, expected = fit_least_squares(campaign, seed=1), fitted()[1]
    scale = 1.0 if unit in ("V", "mV") else UNITS[unit]
    assert campaign.signal_unit == ("V" if unit in ("V", "mV") else unit)
    # which lag is the sensor's is not in these files, and changes no number
    assert_same_fit(found, expected, scale)
    assert words(campaign_remarks(campaign)) == words(campaign_remarks(fitted()[0]))


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_a_value_out_of_proportion_is_refused_in_every_unit(tmp_path: Path, scale: float) -> None:
    written(tmp_path, "A", "csv")
    e = measured()["a"]
    y = scale * e.values
    y[5] = 1e14 * scale
    np.savetxt(tmp_path / "a.csv", np.column_stack([e.t, y]), header="time_s,signal", comments="",
               delimiter=",")  # fmt: skip
    with pytest.raises(CampaignError, match=r"row 7.*out of all proportion"):
        read_campaign(tmp_path / "campaign.toml")


def test_bins_of_just_the_longest_length_stay_whole_however_they_are_rounded() -> None:
    # the widest bins after a switch are as long as a bin may be: halved by one digit in the
    # sixteenth place, they made another noise floor and another probability
    longest = LONGEST * 0.853277924
    for length in longest * (1.0 + np.array([-1e-15, 0.0, 1e-15, 1e-10])):
        for clock in (0.0, 1e6):
            edges = clock + np.array([0.0, length, length + 1.5 * longest])
            assert len(limit_lengths(edges, 0.02, longest)) == 4
