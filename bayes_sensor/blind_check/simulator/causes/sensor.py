"""The coating: how it takes up the gas and gives it back."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from bayes_sensor.blind_check.simulator.causes.cause import Causes, log_uniform, random_sign
from bayes_sensor.blind_check.simulator.numerics import (
    backlash,
    kept_for_good,
    langmuir,
    layered_film,
    steady_lag,
)
from bayes_sensor.blind_check.simulator.simulated_rig import Rig
from bayes_sensor.campaign import FloatArray

CAUSES = Causes()


@CAUSES.cause(("sensor_diffusion",), "delay", "share of tau", 1.0)
def layered_coating(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Part of the sensor's delay is diffusion through a film of two layers."""
    times, weights = layered_film(s * rig.tau)
    rig.tau *= 1.0 - s
    surface = rig.sensor

    def response(t: FloatArray, gas: FloatArray) -> FloatArray:
        modes = zip(times, weights, strict=True)
        inside = sum((w * steady_lag(t, gas, tau) for tau, w in modes), np.zeros(len(t)))
        return surface(t, inside)

    rig.sensor = response


@CAUSES.cause(("sorption_asymmetry",), "fall", "log of the rates", 1.2)
def gated_pores(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Pores open under load and close behind it: uptake is faster than release, or slower."""
    sign = 1.0 if rng.random() < 0.7 else -1.0
    width = log_uniform(rng, 0.002, 0.012)
    rig.sensor = lambda t, gas: np.asarray(langmuir(t, gas, rig.tau, 0.0, 0.0, sign * s, width))


@CAUSES.cause(("optical_nonlinearity", "sorption_asymmetry"), "fall", "K c", 1.0)
def saturating_sites(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Langmuir kinetics seen as they are: the isotherm's bend shows in the voltage, too."""
    c, scale = rig.relative, (1.0 + s * rig.relative) / rig.relative
    rig.sensor = lambda t, gas: np.asarray(langmuir(t, c * gas, rig.tau, s, 0.0, 0.0, 1.0) * scale)


@CAUSES.cause(("slow_sorption",), "tail", "share", 0.2)
def slow_sites(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Some sites fill and empty slowly, with a spread of times and a bent isotherm."""
    time, K = log_uniform(rng, 3.0, 15.0), 0.3
    quick, c, scale = rig.sensor, rig.relative, (1.0 + K * rig.relative) / rig.relative

    def response(t: FloatArray, gas: FloatArray) -> FloatArray:
        slow = langmuir(t, c * gas, 0.5 * time, K, 0.0, 0.0, 1.0)
        slow += langmuir(t, c * gas, 1.8 * time, K, 0.0, 0.0, 1.0)
        return (1.0 - s) * quick(t, gas) + s * 0.5 * scale * slow

    rig.sensor = response


@CAUSES.cause((), "fall", "log of the rates", 2.0, near=("sorption_asymmetry",))
def swelling_film(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The coating swells: the more it has taken up, the faster it takes up and gives off."""
    bend = random_sign(rng) * s
    rig.sensor = lambda t, gas: np.asarray(langmuir(t, gas, rig.tau, 0.0, bend, 0.0, 1.0))


@CAUSES.cause((), "ageing", "relative, an experiment", 0.4, per_experiment=True)
def ageing_coating(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The sensor slows down from experiment to experiment."""
    sign = 1.0 if rng.random() < 0.8 else -1.0
    rig.tau *= float(np.exp(sign * np.log1p(s) * rig.number))


@CAUSES.cause((), "fall", "share", 0.3)
def sensor_hysteresis(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """Uptake and release do not follow one line: part of the response has backlash."""
    straight = rig.sensor

    def response(t: FloatArray, gas: FloatArray) -> FloatArray:
        x = straight(t, gas)
        return x + s * (backlash(x, 0.25) - x)

    rig.sensor = response


# ------------------------------------------------------------------- kept for the final run


@CAUSES.cause((), "tail", "share", 0.4, near=("slow_sorption",), reserve=True)
def driven_out_water(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """The test gas is dry: it drives water out of the coating, whose loss takes the signal down.

    Afterwards the damp carrier brings the water back, half as fast again or half as slow.
    """
    time, ratio = log_uniform(rng, 4.0, 25.0), log_uniform(rng, 0.5, 2.0)
    dry = rig.sensor

    def response(t: FloatArray, gas: FloatArray) -> FloatArray:
        lost = np.asarray(langmuir(t, gas, time, 0.0, 0.0, 0.5 * float(np.log(ratio)), 0.1))
        return dry(t, gas) - s * lost

    rig.sensor = response


@CAUSES.cause((), "tail", "share", 0.4, near=("slow_sorption",), per_experiment=True, reserve=True)
def fresh_coating(rig: Rig, s: float, rng: Generator, own: Generator) -> None:
    """A fresh coating keeps part of the first gas that it meets for good.

    In the first experiment the signal therefore creeps up and does not come back to where it
    began; in the later ones these sites are full.
    """
    time = log_uniform(rng, 2.0, 20.0)
    if rig.number > 0:
        return
    used = rig.sensor

    def response(t: FloatArray, gas: FloatArray) -> FloatArray:
        return used(t, gas) + s * np.asarray(kept_for_good(t, gas, time))

    rig.sensor = response
