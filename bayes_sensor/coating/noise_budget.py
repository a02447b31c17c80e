"""Where the noise of the voltage comes from: receiver, laser, and their sum."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.constants import elementary_charge
from scipy.optimize import nnls

from bayes_sensor.campaign import FloatArray
from bayes_sensor.coating.readout import TABLE_II_CONCENTRATION, Readout, check_positive


@dataclass(frozen=True)
class Receiver:
    """Where the noise of the voltage comes from; values typical of the parts, not measured.

    The paper names a New Focus 2053 photoreceiver and a Santec TSL-510 laser but no settings.
    """

    transimpedance: float = 1e5
    """V/A"""
    current_noise: float = 1e-12
    """A/sqrt(Hz), thermal and amplifier noise at the input"""
    intensity_noise: float = 1e-14
    """1/Hz, relative (-140 dB/Hz)"""
    wavelength_jitter: float = 0.5e-12
    """m, root mean square of laser against resonance; silicon rings drift some 70 pm/K"""
    bandwidth: float = 500.0
    """Hz, half the sampling rate of the paper"""

    def __post_init__(self) -> None:
        check_positive("receiver", self)


@dataclass(frozen=True, eq=False)
class NoiseBudget:
    """Variances of the voltage, V2, each of the shape of ``concentration``."""

    concentration: FloatArray
    shot: FloatArray
    """2 e I B G^2 with the photocurrent I = V/G"""
    thermal: FloatArray
    """i_n^2 B G^2"""
    intensity: FloatArray
    """RIN B V^2"""
    jitter: FloatArray
    """(dV/dlambda)^2 sigma_lambda^2"""
    total: FloatArray = field(init=False)
    """sum of the four"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "total", self.shot + self.thermal + self.intensity + self.jitter)

    @property
    def sd(self) -> FloatArray:
        """V, square root of the total."""
        return np.sqrt(self.total)


def noise_budget(
    readout: Readout, concentration: FloatArray | float, receiver: Receiver | None = None
) -> NoiseBudget:
    """Variance of the voltage by source at given test-gas fractions (first order in the jitter).

    Shot and intensity noise grow with the voltage; jitter acts through the slope, smallest at
    the bottom of the dip, where the paper's baseline lies, and largest at the steepest point.
    """
    receiver = Receiver() if receiver is None else receiver
    c = np.asarray(concentration, dtype=float)
    v, gain, band = readout.voltage(c), receiver.transimpedance, receiver.bandwidth
    per_wavelength = readout.full_scale * readout.ring.slope(readout.detuning(c))
    return NoiseBudget(
        concentration=c,
        shot=2 * elementary_charge * band * gain * v,
        thermal=np.full_like(v, receiver.current_noise**2 * band * gain**2),
        intensity=receiver.intensity_noise * band * v**2,
        jitter=(per_wavelength * receiver.wavelength_jitter) ** 2,
    )


def noise_scales(
    readout: Readout,
    receiver: Receiver | None = None,
    c_ref: float = TABLE_II_CONCENTRATION,
) -> tuple[float, float]:
    """(sigma0, sigma1), V: the budget in the terms of the project's noise model.

    Least squares of the variance on sigma0^2 + sigma1^2 c/c_ref over fractions 0 to ``c_ref``,
    neither below 0.  The variance by jitter is a hump around the steepest point, so the straight
    line is as good as the operating range stays on its near side.
    """
    c = np.linspace(0.0, c_ref, 101)
    total = noise_budget(readout, c, receiver).total
    scale = float(total.max())
    squares, _ = nnls(np.column_stack((np.ones_like(c), c / c_ref)), total / scale)
    sigma0, sigma1 = np.sqrt(squares * scale)
    return float(sigma0), float(sigma1)
