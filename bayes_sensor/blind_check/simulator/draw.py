"""Rigs drawn at random: parameters, flows, durations, intervals and noise."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_sensor.blind_check.simulator.case import Case, Step
from bayes_sensor.blind_check.simulator.noise_laws import draw_law
from bayes_sensor.campaign import CampaignError

SIZES = ("paper", "varied", "small")
LITRES_PER_MINUTE = 1000.0 / 60.0  # mL/s


def draw_case(
    seed: int,
    strengths: Mapping[str, float] | None = None,
    law: str = "ar1",
    size: str = "paper",
) -> Case:
    """A rig with fresh parameters.

    ``paper``: seven experiments of 120 s at 1 ms; ``varied``: three to eight of 40 to 150 s at 1 to
    10 ms; ``small``: three of 30 s at 10 ms with larger steps over the noise.
    """
    if size not in SIZES:
        raise CampaignError(f"size: expected one of {', '.join(SIZES)}, got '{size}'")
    rng = np.random.default_rng([seed, 8, SIZES.index(size)])
    if size == "paper":
        n, duration, interval = 7, 120.0, 1e-3
    elif size == "varied":
        n = int(rng.integers(3, 9))
        duration = float(np.round(rng.uniform(40.0, 150.0)))
        interval = float(rng.choice([1e-3, 2e-3, 5e-3, 1e-2]))
    else:
        n, duration, interval = 3, 30.0, 1e-2
    tau = _log_normal(rng, 0.048, 0.6)
    tau_v = max(_log_normal(rng, 0.75, 0.35), 1.6 * tau)
    V = _log_normal(rng, 58.0, 0.3)
    if size == "small":
        tau_v, V = 0.6 * tau_v, 0.5 * V
    flows = _spread_flows(rng, n)
    low, high = np.sort(rng.uniform(0.06, 0.25, 2)).tolist()
    concentrations = rng.permutation(np.linspace(low, high, n))
    beta_full = rng.uniform(1.2, 2.5)
    power = rng.uniform(0.2, 1.0)
    steps = []
    for k in range(n):
        on = float(np.round(duration * rng.uniform(0.16, 0.26), 3))
        off = float(np.round(duration * rng.uniform(0.62, 0.75), 3))
        # set points of the controllers, in steps of 0.01 L/min
        test_gas = round(flows[k] * concentrations[k], 2) * LITRES_PER_MINUTE
        carrier = round(flows[k] * (1.0 - concentrations[k]), 2) * LITRES_PER_MINUTE
        flow = carrier + test_gas
        scale = (concentrations[k] / concentrations.max()) ** power
        steps.append(
            Step(
                name=str(k + 1),
                carrier_flow=carrier,
                test_gas_flow=test_gas,
                interval=interval,
                duration=duration,
                commanded_on=on,
                commanded_off=off,
                # the published delay lines (Sec. III-B) with some scatter, and an offset of its own
                t0=on + rng.uniform(0.1, 0.3) + 112.5 / flow * rng.uniform(0.9, 1.1),
                tf=off + rng.uniform(0.0, 0.1) + 74.5 / flow * rng.uniform(0.9, 1.1),
                y0=float(rng.uniform(0.1, 0.35)),
                beta=float(beta_full * scale * rng.uniform(0.9, 1.1)),
            )
        )
    sigma = beta_full * _log_normal(rng, 0.028 if size != "small" else 0.012, 0.4)
    noise = draw_law(law, rng, sigma)
    return Case(
        seed, tau, tau_v, V, tuple(steps), noise, strengths or {}, lsb=sigma / rng.uniform(40, 400)
    )


def _log_normal(rng: np.random.Generator, median: float, spread: float) -> float:
    """Within two and a half standard deviations."""
    return float(median * np.exp(spread * np.clip(rng.standard_normal(), -2.5, 2.5)))


def _spread_flows(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n,) L/min, over a factor of two to four, in any order."""
    low = rng.uniform(2.0, 4.5)
    flows = low * np.exp(np.linspace(0.0, np.log(rng.uniform(2.0, 4.0)), n))
    return rng.permutation(flows * rng.uniform(0.93, 1.07, n))
