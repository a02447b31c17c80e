"""Whether the noise law describes the residuals: correlation, variance and rounding, in words."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np
from scipy.special import erfc

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.fitted_noise import Spread, fitted_variances, rough_places
from bayes_sensor.likelihood.noise import VARIANCES
from bayes_sensor.residuals.autocorrelation import autocorrelation
from bayes_sensor.residuals.converter_step import lattice_step
from bayes_sensor.residuals.series import FittedNoise
from bayes_sensor.residuals.variance_check import (
    FACTOR,
    VarianceCheck,
    check_variance,
    local_squares,
)

MEMORIES_APART = 2.0
"""times by which the memories of two experiments differ before noise of their own is advised"""
CONCENTRATION_EDGES = np.array([0.0, 0.02, 0.2, 0.4, 0.6, 0.8, 1.0])
"""of the highest concentration: bins in which the variance is checked"""
SLOPE_EDGES = np.array([0.0, 0.05, 0.2, 0.4, 0.7, 1.0])
"""of the largest |dx3/dt|: the same"""
COARSE = sqrt(6.0)
"""standard deviations of the residuals in a converter's step at which rounding, of variance
step^2/12, makes up half of their variance"""
NEGLIGIBLE = 1e-4
"""of the larger level's variance, below which no level is taken to be"""
TAKE_AS_THEY_ARE = "Sandwich, block bootstrap and jackknife take the residuals as they are."
"""what to compare with where the noise law does not describe them"""
TOO_COARSE = (
    "Here sandwich and block bootstrap fail as well: the converter's step exceeds the noise, and "
    "rounding is neither independent of the signal nor averaged out (with steps of 8 to 16 times "
    "the noise their 95 % intervals held the truth in 20 to 75 % of simulated campaigns). Record "
    "with a finer range."
)
BY_GAS, BY_SLOPE = "of the highest concentration", "of the largest slope"


@dataclass(frozen=True, eq=False, kw_only=True)
class NoiseJudgement:
    """What all checks say together."""

    checks: dict[str, dict[str, Any]]
    """``correlation``, ``variance_concentration``, ``variance_slope``, ``rounding``: each with
    ``adequate``, ``p_value`` and ``factor`` (measured over what the law says), and its numbers"""
    adequate: bool
    """whether the noise law passes every check"""
    verdict: str
    """the same as a sentence with its numbers"""
    recommendation: str
    """what to compare with where it does not; else empty"""

    @property
    def doubt(self) -> str:
        """Why intervals that rest on the noise law are not to be trusted; empty where they are."""
        return "" if self.adequate else f"{self.verdict} {self.recommendation}"


def judge(noise: FittedNoise, correlation: FloatArray) -> NoiseJudgement:
    """Correlation, variance and rounding: what fails, with its numbers and what helps.

    ``correlation``: the autocorrelation of all residuals, as far as it was taken.
    """
    correlated = _correlation_check(noise, correlation)
    by_gas, by_slope = _variance_checks(noise)
    rounding = _rounding_check(noise)
    said = correlated["sentence"]
    failing = "" if correlated["adequate"] else said
    failing = f"{failing} {_variance_sentence(noise, by_gas, by_slope)}".strip()
    failing = f"{failing} {rounding['sentence']}".strip()
    beyond = "" if rounding["adequate"] else f" {TOO_COARSE}"
    return NoiseJudgement(
        checks={
            "correlation": correlated,
            "variance_concentration": by_gas.to_json(),
            "variance_slope": by_slope.to_json(),
            "rounding": rounding,
        },
        adequate=not failing,
        verdict=failing or said + _variances_agree(by_gas, by_slope),
        recommendation=f"{TAKE_AS_THEY_ARE}{beyond}" if failing else "",
    )


# --------------------------------------------------------------------------- correlation


def _correlation_check(noise: FittedNoise, correlation: FloatArray) -> dict[str, Any]:
    """Whether AR(1) is adequate, and why, from the residuals' autocorrelation and the whitened."""
    campaign, phi = noise.problem.campaign, noise.slowest
    h, n = campaign.reference_interval, campaign.n_samples
    ratio, expected_sd = noise.slow_part
    # the first lag at which the AR(1)'s correlation has died away, of those that are known
    known = np.flatnonzero(np.isfinite(correlation))
    lag = int(known[min(int(np.searchsorted(known, noise.fades)), len(known) - 1)])
    found, expected = float(correlation[lag]), float(noise.correlation(np.array([lag]))[0])
    # a third more slow power widens intervals by a sixth: what is smaller does not matter
    slow = abs(ratio - 1.0) > max(4.0 * expected_sd, 0.33)
    # sd of a sample autocorrelation of AR(1) data at long lags (Bartlett)
    sd = sqrt((1.0 + phi**2) / max(1.0 - phi**2, 1e-9) / n)
    far = abs(found - expected) > max(5.0 * sd, 0.05)
    whitened = autocorrelation(noise.joined("e"), 5)
    left = float(np.max(np.abs(whitened[1:]))) if len(whitened) > 5 else 0.0
    near = left > max(5.0 / sqrt(n), 0.05)
    own = noise.vector[noise.problem.layout.noise[:, 0]]
    least, most = (f"{v:.3g}" for v in (own.min(), own.max()))
    span = least if least == most else f"{least} to {most}"
    law = f"AR(1) with phi = {span} at {h * 1e3:g} ms"
    amount, are = ("more", "too narrow") if ratio > 1.0 else ("less", "not exact")
    reasons = [
        f"they hold {ratio:.3g} times the slow power it allows ({amount} than it says)" * slow,
        f"their correlation at {lag * h * 1e3:.3g} ms is {found:.2f}, not {expected:.2f}" * far,
        f"correlation up to {left:.2f} is left after whitening" * near,
    ]
    sentence = (
        f"{law} describes the residuals: whitened, their slow part is {ratio:.2f} times that of "
        f"white noise and no correlation at short lags exceeds {max(left, 0.005):.2g}."
    )
    if any(reasons):
        sentence = (
            f"{law} does not describe the residuals: {'; '.join(filter(None, reasons))}; "
            f"intervals that rest on AR(1) are then {are}.{_own_each(noise)}"
        )
    return {
        "adequate": not any(reasons),
        "p_value": float(erfc(abs(ratio - 1.0) / expected_sd / sqrt(2.0))),
        "factor": ratio,
        "lag_s": lag * h,
        "at_lag": found,
        "law_at_lag": expected,
        "left_after_whitening": left,
        "sentence": sentence,
    }


def _own_each(noise: FittedNoise) -> str:
    """What to do where one coefficient stands for experiments that differ; else empty."""
    law, campaign = noise.problem.noise, noise.problem.campaign
    # with other intervals, neighbours are not as far apart in all of them
    if law.per_experiment or law.autocorrelation != "ar1" or not campaign.same_interval:
        return ""
    loudest = max(float(np.std(s.r)) for s in noise.series)
    found = sorted(
        (phi, len(s.r), e.name)
        for e, s in zip(campaign, noise.series, strict=True)
        if np.std(s.r) > 1e-6 * loudest and (phi := s.quick.lag_one) is not None
    )
    if len(found) < 2:
        return ""
    (least, n_least, low), (most, n_most, high) = found[0], found[-1]
    error = sqrt(max(1.0 - least**2, 0.0) / n_least + max(1.0 - most**2, 0.0) / n_most)
    if most - least < 5.0 * error or 1.0 - least < MEMORIES_APART * (1.0 - most):
        return ""
    return (
        f" Neighbouring samples correlate by {least:.2f} in experiment {low} and by "
        f"{most:.2f} in {high}: with `per_experiment = true` under [noise] of --config, or "
        "Noise(per_experiment=True), each has noise of its own."
    )


# --------------------------------------------------------------------------- variance


def _variance_checks(noise: FittedNoise) -> tuple[VarianceCheck, VarianceCheck]:
    """The variance law against concentration, and against the slope of the response."""
    whites = _at_the_laws_best(noise)
    return (
        check_variance(whites, noise.concentrations, CONCENTRATION_EDGES),
        check_variance(whites, noise.slopes, SLOPE_EDGES, each=True),
    )


def _at_the_laws_best(noise: FittedNoise) -> list[FloatArray]:
    """(n,) whitened residuals of every experiment, by the variance law at its own best.

    The law is on trial here, not one estimate of its parameters: squares of correlated residuals
    tell them less well than those of whitened ones, less what is slow.
    """
    law, campaign = noise.problem.noise, noise.problem.campaign
    spreads, variables = [], []
    for e, s in zip(campaign, noise.series, strict=True):
        variable = law.weight(campaign, e) * np.maximum(s.x, 0.0)
        variable = np.minimum(variable, 1.0) if law.fading else variable
        inner = slice(2, len(s.e) - 2)
        r2, steps = local_squares(s.e) * s.s[inner] ** 2, noise.problem.steps(e)
        places = rough_places(e)
        spreads.append(
            Spread(r2, variable[inner], s.r, variable, s.used, steps, law.fading, places)
        )
        variables.append(variable)
    whites = []
    for k, (s, variable) in enumerate(zip(noise.series, variables, strict=True)):
        own = spreads[k : k + 1] if law.per_experiment else spreads
        v0 = v1 = 0.0
        if any(len(each.r2) for each in own):
            v0, v1 = fitted_variances(own, law.variance != "constant")
        least = NEGLIGIBLE * max(v0, v1)
        if least > 0.0:
            s2 = spreads[k].law(max(v0, least), max(v1, law.fading * least), variable)
        whites.append(s.e * s.s / np.sqrt(s2) if least > 0.0 else s.e)
    return whites


def _variance_sentence(noise: FittedNoise, by_gas: VarianceCheck, by_slope: VarianceCheck) -> str:
    """What the variance law fails in, and what helps; empty where it does not."""
    told, falls = [], False
    if not by_gas.adequate:
        low, high = float(by_gas.factor[0]), float(by_gas.factor[-1])
        ends = (
            f"the measured variance is {low:.2g} times the law's at {_range(by_gas, 0)} {BY_GAS} "
            f"and {high:.2g} times at {_range(by_gas, -1)}"
        )
        falls = low > 1.0 > high and low > FACTOR * high
        if falls:
            told.append(f"the noise falls with gas: {ends}")
        elif high > 1.0 > low and high > FACTOR * low:
            told.append(f"the noise rises with gas by more than it says: {ends}")
        else:
            told.append(f"against concentration {_worst_bin(by_gas)} {BY_GAS}")
    if not by_slope.adequate:
        word = "rises" if by_slope.trend > 1.0 else "falls"
        told.append(
            f"the noise {word} with the slope of the response: {_worst_bin(by_slope)} {BY_SLOPE}"
        )
    if not told:
        return ""
    return (
        f'The variance law (variance = "{noise.problem.noise.variance}") does not describe the '
        f"residuals: {'; '.join(told)}; intervals that rest on it are then not to be trusted."
        f"{_better_law(noise, falls)}"
    )


def _variances_agree(*found: VarianceCheck) -> str:
    factors = [float(v) for check in found if check.p_value is not None for v in check.factor]
    if not factors:
        return ""
    return (
        " In bins of concentration and of the response's slope their variance is "
        f"{min(factors):.2g} to {max(factors):.2g} times the law's."
    )


def _range(check: VarianceCheck, i: int) -> str:
    return f"{100.0 * check.low[i]:.3g} to {100.0 * check.high[i]:.3g} %"


def _worst_bin(check: VarianceCheck) -> str:
    i = check.worst
    assert i is not None  # a check that fails has bins
    return f"the measured variance is {check.factor[i]:.2g} times the law's at {_range(check, i)}"


def _better_law(noise: FittedNoise, falls: bool) -> str:
    """A variance law that describes the residuals, or may at least fall with gas as they do."""
    tried = noise.problem.noise
    for law in VARIANCES:
        other = replace(noise, problem=replace(noise.problem, noise=replace(tried, variance=law)))
        fits = all(check.adequate for check in _variance_checks(other))
        if law != tried.variance and fits:
            return f" The law {law!r} describes them: {_ask_for(law)}"
    if falls and not tried.fading:
        return f" Noise that falls with gas can be fitted, if not exactly: {_ask_for('levels')}"
    return ""


def _ask_for(law: str) -> str:
    return f'write `variance = "{law}"` under [noise] of --config, or Noise("{law}").'


# --------------------------------------------------------------------------- rounding


def _rounding_check(noise: FittedNoise) -> dict[str, Any]:
    """The converter's step against the residuals, slow misfit left out, where it is largest."""
    found = []
    for e, s in zip(noise.problem.campaign, noise.series, strict=True):
        step, sd = lattice_step(e.values[e.used]), float(np.std(s.quick.r))
        if step > 0.0 and sd > 0.0:
            found.append((step / sd, step, e.name))
    ratio, step, name = max(found, default=(0.0, 0.0, ""))
    sentence = (
        f"The converter's step in experiment {name} ({step:.3g} "
        f"{noise.problem.campaign.signal_unit}) is {ratio:.2g} times the residuals' standard "
        "deviation: they are rounding errors more than noise."
    )
    return {
        "adequate": ratio <= COARSE,
        "p_value": None,
        "factor": ratio or None,
        "step_V": step or None,
        "sentence": sentence if ratio > COARSE else "",
    }
