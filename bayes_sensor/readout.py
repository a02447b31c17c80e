"""From gas in the cladding to volts on the screen, and the times users of gas sensors quote.

CO2 raises the refractive index of the ZIF-8 cladding, the ring's resonance moves to longer
wavelengths, and a laser on the flank of the dip at 1574.400 nm turns the shift into a change of
transmitted power (paper Sec. II and Figs. 1-3).  The voltage is nearly affine in concentration
near the steepest point of the flank; what is left is the curvature that the
``optical_nonlinearity`` effect looks for.  The same flank turns jitter of the wavelength into
volts, most where it is steepest, which is one physical reason why noise grows with concentration.

The paper gives neither quality factor nor extinction nor shift.  The values chosen here are like
those of published devices: loaded Q 20 000 and 70 nm/RIU (De Vos et al., Opt. Express 15, 2007,
7610: silicon rings), index change per % CO2 from 7.4 pm/% at 188 nm/RIU (Kong et al., ACS Appl.
Mater. Interfaces 13, 2021, 58104: microcavity with a metal-organic framework film), 15 dB of
extinction (Bogaerts et al., Laser Photonics Rev. 6, 2012, 47: rings near critical coupling).
Only the voltage scale and the detuning come from the paper: they follow from the baseline and
the rise of its Table II (:func:`matched_readout`).

:func:`response_times` gives t10, t63, t90 and the rise time of any cascade of first-order lags.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from scipy.constants import elementary_charge
from scipy.optimize import brentq, nnls

from bayes_sensor.campaign import FloatArray
from bayes_sensor.model import impulse_response, step_response

if TYPE_CHECKING:
    import pandas as pd

SHAPES = ("lorentzian", "all-pass")


# --------------------------------------------------------------------------- the ring


@dataclass(frozen=True)
class Ring:
    """A microring beside one waveguide, described by what its spectrum shows.

    ``shape`` "lorentzian": T = 1 - A / (1 + (2 d/w)^2) with detuning d, full width at half depth
    w and depth A.  "all-pass", with loss: T = (a^2 - 2 r a cos p + r^2) / (1 - 2 r a cos p +
    (r a)^2) with round-trip phase p = 2 pi d / FSR (Bogaerts et al. 2012, eq. 2); the coupling r
    and the round-trip amplitude a follow from Q and extinction (:attr:`coefficients`).

    >>> ring = Ring()
    >>> round(1e12 * ring.width, 1), round(1e9 * ring.free_spectral_range, 2)
    (78.7, 9.17)

    Raises
    ------
    ValueError
        If a field is not positive or the shape is unknown.
    """

    resonance: float = 1574.4e-9
    """m, without test gas"""
    q: float = 2e4
    """loaded quality factor, resonance over full width at half depth"""
    extinction: float = 15.0
    """dB, transmission far off over that at the bottom of the dip"""
    radius: float = 10e-6
    """m"""
    group_index: float = 4.3
    """of a silicon wire (Bogaerts et al. 2012)"""
    shape: str = "lorentzian"
    """one of :data:`SHAPES`"""

    def __post_init__(self) -> None:
        _check_positive("ring", self, skip=("shape",))
        if self.shape not in SHAPES:
            raise ValueError(f"ring: shape must be one of {', '.join(SHAPES)}, got '{self.shape}'")
        if self.width > self.free_spectral_range / 4:
            raise ValueError(
                f"ring: a dip {1e12 * self.width:.4g} pm wide does not fit the free spectral range "
                f"of {1e12 * self.free_spectral_range:.4g} pm; raise q or lower radius"
            )

    @property
    def width(self) -> float:
        """m, full width at half depth, lambda / Q."""
        return self.resonance / self.q

    @property
    def free_spectral_range(self) -> float:
        """m, lambda^2 / (n_g 2 pi R)."""
        return self.resonance**2 / (self.group_index * 2 * math.pi * self.radius)

    @property
    def floor(self) -> float:
        """Transmission at the bottom of the dip."""
        return 10 ** (-self.extinction / 10)

    @cached_property
    def coefficients(self) -> tuple[float, float]:
        """(r, a): self-coupling and round-trip amplitude, the larger one first.

        From w = (1 - r a) FSR / (pi sqrt(r a)) and floor = ((r - a)/(1 - r a))^2 (Bogaerts et
        al. 2012); the spectrum does not tell r from a (under- from over-coupling).
        """
        ratio = math.pi * self.width / self.free_spectral_range
        root = (math.sqrt(ratio**2 + 4) - ratio) / 2
        product = root**2
        difference = math.sqrt(self.floor) * (1 - product)
        larger = (difference + math.sqrt(difference**2 + 4 * product)) / 2
        return larger, product / larger

    def transmission(self, detuning: FloatArray | float) -> FloatArray:
        """T at a detuning (m) from the resonance, of its shape; 1 far off a Lorentzian."""
        return self._derivatives(detuning)[0]

    def slope(self, detuning: FloatArray | float) -> FloatArray:
        """dT/d(detuning), 1/m."""
        return self._derivatives(detuning)[1]

    def curvature(self, detuning: FloatArray | float) -> FloatArray:
        """Second derivative of T by detuning, 1/m2."""
        return self._derivatives(detuning)[2]

    def _derivatives(self, detuning: FloatArray | float) -> tuple[FloatArray, ...]:
        d = np.asarray(detuning, dtype=float)
        if self.shape == "lorentzian":
            scale = 2 / self.width
            x, depth = d * scale, 1 - self.floor
            bell = 1 / (1 + x**2)
            return (
                1 - depth * bell,
                2 * depth * x * bell**2 * scale,
                2 * depth * (1 - 3 * x**2) * bell**3 * scale**2,
            )
        # T = 1 - C/(g - cos p) with g = (1 + (r a)^2)/(2 r a): the same dip, repeated.
        r, a = self.coefficients
        g = (1 + (r * a) ** 2) / (2 * r * a)
        strength = (1 - r**2) * (1 - a**2) / (2 * r * a)
        scale = 2 * math.pi / self.free_spectral_range
        sine, cosine = np.sin(d * scale), np.cos(d * scale)
        away = g - cosine
        return (
            1 - strength / away,
            strength * sine / away**2 * scale,
            strength * (cosine / away**2 - 2 * sine**2 / away**3) * scale**2,
        )

    @cached_property
    def steepest_detuning(self) -> float:
        """m, distance from the resonance at which the flank is steepest.

        w / (2 sqrt 3) for a Lorentzian.
        """
        lorentzian = self.width / (2 * math.sqrt(3))
        if self.shape == "lorentzian":
            return lorentzian
        # In units of the Lorentzian's distance: brentq's absolute tolerance is not for picometres.
        ratio = brentq(lambda x: float(self.curvature(x * lorentzian)), 0.5, 1.5)
        return float(ratio * lorentzian)


def _check_positive(where: str, record: object, skip: Sequence[str] = ()) -> None:
    for item in fields(record):  # type: ignore[arg-type]  # any of the records below
        value = getattr(record, item.name)
        if item.name not in skip and not (math.isfinite(value) and value > 0):
            raise ValueError(
                f"{where}: {item.name} must be a positive number in SI units, got {value!r}"
            )


@dataclass(frozen=True)
class Cladding:
    """How the resonance follows the gas: proportional to its fraction (Henry's law).

    >>> round(1e12 * Cladding().redshift_per_percent, 2)
    2.76
    """

    index_per_percent: float = 7.4e-12 / 188e-9
    """refractive index units per % CO2 at equilibrium (Kong et al. 2021)"""
    sensitivity: float = 70e-9
    """m per refractive index unit of the cladding (De Vos et al. 2007)"""

    def __post_init__(self) -> None:
        _check_positive("cladding", self)

    @property
    def redshift_per_percent(self) -> float:
        """m per % CO2."""
        return self.index_per_percent * self.sensitivity


# --------------------------------------------------------------------------- the readout


@dataclass(frozen=True)
class Readout:
    """A laser of fixed wavelength on the flank of the ring's dip, and a photoreceiver.

    V(c) = V_full T(lambda_laser - lambda_ring - 100 c redshift), with c the test-gas fraction.

    >>> readout = Readout(Ring(), Cladding(), wavelength=1574.37e-9, full_scale=4.0)
    >>> bool(readout.voltage(0.16) > readout.voltage(0.0))
    True
    """

    ring: Ring
    cladding: Cladding
    wavelength: float = 1574.4e-9
    """m, of the laser (paper Sec. II-C)"""
    full_scale: float = 4.0
    """V, far off the resonance"""

    def __post_init__(self) -> None:
        _check_positive("readout", self, skip=("ring", "cladding"))

    def detuning(self, concentration: FloatArray | float) -> FloatArray:
        """m, laser minus resonance at a test-gas fraction."""
        shift = 100 * np.asarray(concentration, dtype=float) * self.cladding.redshift_per_percent
        return self.wavelength - self.ring.resonance - shift

    def voltage(self, concentration: FloatArray | float) -> FloatArray:
        """V, of the shape of ``concentration`` (fractions)."""
        return self.full_scale * self.ring.transmission(self.detuning(concentration))

    def spectrum(self, wavelength: FloatArray, concentration: float = 0.0) -> FloatArray:
        """(n,) V when the laser is swept over ``wavelength`` (n,) m, as in the paper's Fig. 3."""
        moved = self.detuning(concentration) + np.asarray(wavelength) - self.wavelength
        return self.full_scale * self.ring.transmission(moved)

    def slope(self, concentration: FloatArray | float) -> FloatArray:
        """dV/dc, V per unit fraction."""
        per_fraction = -100 * self.cladding.redshift_per_percent
        return self.full_scale * per_fraction * self.ring.slope(self.detuning(concentration))

    def local_curvature(self, concentration: FloatArray | float) -> FloatArray:
        """V''/(2 V'^2), 1/V: the kappa of V - V(c0) = v + kappa v^2 with v = V'(c0)(c - c0)."""
        d = self.detuning(concentration)
        return self.ring.curvature(d) / (2 * self.full_scale * self.ring.slope(d) ** 2)

    @property
    def steepest_concentration(self) -> float:
        """Fraction at which the laser sits on the steepest point; negative if already beyond."""
        at_zero = float(self.detuning(0.0))
        return (at_zero + self.ring.steepest_detuning) / (100 * self.cladding.redshift_per_percent)


def excitation_wavelength(ring: Ring, side: str = "short") -> float:
    """m, the wavelength of steepest slope on the short or the long side of the dip.

    On the short side the voltage rises with a redshift, as it does in the paper.

    >>> ring = Ring()
    >>> round(1e12 * (ring.resonance - excitation_wavelength(ring)), 2)
    22.72
    """
    if side not in ("short", "long"):
        raise ValueError(f"excitation_wavelength: side must be 'short' or 'long', got '{side}'")
    return ring.resonance + (-1 if side == "short" else 1) * ring.steepest_detuning


# Table II of the paper: mean baseline of the seven experiments, and mean rise of the three at
# the highest concentration (1.5 of 9 L/min), V.
TABLE_II_BASELINE = (0.296 + 0.267 + 0.263 + 0.219 + 0.194 + 0.175 + 0.121) / 7
TABLE_II_RISE = (2.13 + 2.11 + 1.85) / 3
TABLE_II_CONCENTRATION = 1.5 / 9


def matched_readout(
    baseline: float = TABLE_II_BASELINE,
    rise: float = TABLE_II_RISE,
    concentration: float = TABLE_II_CONCENTRATION,
    *,
    ring: Ring | None = None,
    cladding: Cladding | None = None,
    wavelength: float = 1574.4e-9,
) -> Readout:
    """The readout whose voltage is ``baseline`` (V) without gas and rises by ``rise`` (V).

    The laser stays where it is; the resonance without gas and the full scale are solved for, on
    the side where a redshift raises the voltage.  The ratio baseline / (baseline + rise) =
    T(d) / T(d - shift) fixes the detuning d, because it falls from 1 far off the dip to
    T(0) / T(shift) at its bottom.

    >>> readout = matched_readout()
    >>> [round(float(readout.voltage(c)), 3) for c in (0.0, 1.5 / 9)]
    [0.219, 2.249]

    Raises
    ------
    ValueError
        If no detuning gives the ratio: the dip is too shallow or the shift too small.
    """
    ring = Ring() if ring is None else ring
    cladding = Cladding() if cladding is None else cladding
    for name, value in (("baseline", baseline), ("rise", rise), ("concentration", concentration)):
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"matched_readout: {name} must be a positive number, got {value!r}")
    ratio = baseline / (baseline + rise)
    shift = 100 * concentration * cladding.redshift_per_percent

    def moved(distance: float) -> Ring:
        return replace(ring, resonance=wavelength + distance)

    def excess(widths: float) -> float:
        distance = widths * ring.width
        low, high = moved(distance).transmission(np.array([-distance, -distance - shift]))
        return float(low / high) - ratio

    # Past a quarter of the free spectral range the next dip of an all-pass ring comes near.
    farthest = ring.free_spectral_range / (4 * ring.width)
    if excess(0.0) > 0 or excess(farthest) < 0:
        raise ValueError(
            f"matched_readout: no detuning of this ring gives {baseline:.4g} V rising by "
            f"{rise:.4g} V; the ratio {ratio:.3g} must lie above {excess(0.0) + ratio:.3g}; "
            "a deeper dip (extinction), a higher q or a larger redshift lowers that"
        )
    distance = float(brentq(excess, 0.0, farthest)) * ring.width
    scale = baseline / float(moved(distance).transmission(-distance))
    return Readout(moved(distance), cladding, wavelength, scale)


# --------------------------------------------------------------------------- linearity


def nonlinearity(readout: Readout, low: float, high: float) -> float:
    """Largest distance of V(c) from the line through its ends, as a share of the span.

    ``low`` and ``high`` are test-gas fractions (end-point nonlinearity).
    """
    if not low < high:
        raise ValueError(f"nonlinearity: expected low below high, got {low:g} and {high:g}")
    c = np.linspace(low, high, 401)
    v = readout.voltage(c)
    line = v[0] + (v[-1] - v[0]) * (c - low) / (high - low)
    span = float(np.ptp(v))
    return float(np.abs(v - line).max()) / span


@dataclass(frozen=True)
class LinearRange:
    """The range in which the readout is as linear as wanted."""

    low: float
    """test-gas fraction at the lower end, not below 0"""
    high: float
    """test-gas fraction at the upper end"""
    nonlinearity: float
    """end-point nonlinearity between them"""
    slope: float
    """V per unit fraction between them"""


def linear_range(readout: Readout, wanted: float = 0.01) -> LinearRange:
    """Widest range around the steepest point whose end-point nonlinearity is at most ``wanted``.

    The range extends equally to both sides of :attr:`Readout.steepest_concentration` (near it V
    is odd to third order, so that the error grows with the square of the width) and is cut at 0.
    For a narrow range on a Lorentzian the half width is (w/2) sqrt(4 sqrt(3) wanted).

    Raises
    ------
    ValueError
        If ``wanted`` is out of range or the steepest point is out of reach (below zero gas).
    """
    if not 1e-6 <= wanted <= 0.1:
        raise ValueError(f"linear_range: wanted must lie between 1e-6 and 0.1, got {wanted}")
    centre = readout.steepest_concentration
    if centre < 0:
        raise ValueError(
            "linear_range: the laser is past the steepest point already without gas; move it "
            f"{1e12 * abs(centre) * 100 * readout.cladding.redshift_per_percent:.3g} pm towards "
            "the resonance"
        )
    half_width = readout.ring.width / (200 * readout.cladding.redshift_per_percent)

    def excess(half: float) -> float:
        return nonlinearity(readout, centre - half, centre + half) - wanted

    half = float(brentq(excess, 1e-4 * half_width, 1.5 * half_width))
    low, high = max(centre - half, 0.0), centre + half
    rise = float(readout.voltage(high) - readout.voltage(low))
    return LinearRange(low, high, nonlinearity(readout, low, high), rise / (high - low))


def curvature(readout: Readout, high: float = TABLE_II_CONCENTRATION) -> float:
    """1/V, bend of the voltage over test-gas fractions 0 to ``high``.

    V - V(0) = s c + q c^2 in least squares, kappa = q / (s + q high)^2: with v = (s + q high) c
    the straight line that ends at the same voltage, V - V(0) = v + kappa v (v - v_high).  To
    first order in kappa this is v' + kappa v'^2 with another scale of v'.  Positive where the
    sensitivity grows with concentration.  It is the strength of the ``optical_nonlinearity``
    effect that the readout would produce.
    """
    c = np.linspace(0.0, high, 201)
    rise = readout.voltage(c) - readout.voltage(0.0)
    linear, quadratic = np.linalg.lstsq(np.column_stack((c, c**2)), rise)[0]
    return float(quadratic / (linear + quadratic * high) ** 2)


@dataclass(frozen=True, eq=False)
class CurvaturePrior:
    """What the voltage levels alone say about the curvature, see :func:`curvature_prior`."""

    mean: float
    """1/V"""
    sd: float
    """1/V"""
    draws: FloatArray
    """(n,) 1/V"""
    excluded: float
    """share of drawn devices that cannot give the voltages seen or are too far from linear"""


def curvature_prior(
    baseline: float = TABLE_II_BASELINE,
    rise: float = TABLE_II_RISE,
    concentration: float = TABLE_II_CONCENTRATION,
    *,
    spread: float = 0.3,
    extinction: tuple[float, float] = (10.0, 25.0),
    most_nonlinear: float = 0.1,
    n_draws: int = 2000,
    seed: int | np.random.Generator = 0,
) -> CurvaturePrior:
    """The curvature of devices that show a given baseline and rise.

    Q and redshift are log-normal around the defaults with relative standard deviation
    ``spread``, the extinction uniform between two values in dB; for each the detuning and the
    full scale follow from the voltages (:func:`matched_readout`), and from them
    :func:`curvature`.  Devices that cannot show these voltages are left out, and so are those
    with an end-point :func:`nonlinearity` above ``most_nonlinear``: the paper chose wavelength
    and concentrations to stay in the linear region (Sec. II-C).

    >>> prior = curvature_prior(n_draws=100)
    >>> 0 < prior.sd < 0.2
    True
    """
    rng = np.random.default_rng(seed)
    log_sd = math.sqrt(math.log1p(spread**2))
    ring, cladding = Ring(), Cladding()
    found = []
    for _ in range(n_draws):
        q, shift = np.exp(log_sd * rng.standard_normal(2))
        depth = rng.uniform(*extinction)
        try:
            readout = matched_readout(
                baseline,
                rise,
                concentration,
                ring=replace(ring, q=ring.q * q, extinction=depth),
                cladding=replace(cladding, sensitivity=cladding.sensitivity * shift),
            )
        except ValueError:
            continue
        if nonlinearity(readout, 0.0, concentration) <= most_nonlinear:
            found.append(curvature(readout, concentration))
    if len(found) < 2:
        raise ValueError(
            f"curvature_prior: hardly any ring gives {baseline:.4g} V rising by {rise:.4g} V "
            "nearly linearly; check that both are in V and the concentration is a fraction"
        )
    draws = np.array(found)
    return CurvaturePrior(
        float(draws.mean()), float(draws.std(ddof=1)), draws, 1 - len(found) / n_draws
    )


# --------------------------------------------------------------------------- noise


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
        _check_positive("receiver", self)


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


# --------------------------------------------------------------------------- response times


@dataclass(frozen=True, eq=False)
class ResponseTimes:
    """Times after a step (s), each of the shape of the draws given."""

    t10: FloatArray
    t63: FloatArray
    t90: FloatArray

    @property
    def rise(self) -> FloatArray:
        """s, from 10 % to 90 %."""
        return self.t90 - self.t10


@njit(cache=True)
def _time_to_level(level: float, rates: FloatArray) -> float:  # pragma: no cover - compiled
    # Newton kept inside a bracket that always holds the root: by Markov's inequality
    # 1 - y(t) <= sum(tau)/t.
    low, high = 0.0, 0.0
    for rate in rates:
        high += 1.0 / rate
    high /= 1.0 - level
    s = high * (1.0 - level)
    for _ in range(100):
        miss = step_response(s, rates) - level
        if miss > 0.0:
            high = s
        else:
            low = s
        slope = impulse_response(s, rates)
        new = s - miss / slope if slope > 0.0 else low - 1.0
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - s) <= 1e-13 * s:
            return new
        s = new
    return s


@njit(cache=True)
def _times_to_levels(
    levels: FloatArray, rates: FloatArray, out: FloatArray
) -> None:  # pragma: no cover - compiled
    for j in range(rates.shape[0]):
        for i in range(len(levels)):
            out[i, j] = _time_to_level(levels[i], rates[j])


def response_times(taus: Sequence[FloatArray | float] | FloatArray) -> ResponseTimes:
    """t10, t63, t90 of the step response of first-order lags in cascade.

    For one lag -tau ln(1 - p): t90 = 2.303 tau.  For several the exact step response is
    inverted, also where time constants coincide.  The system is linear, so the fall takes as
    long as the rise; where the flow differs between them (``flow_switching``) call it for each.

    Parameters
    ----------
    taus
        (n_lags, ...) s, zero or more, not all zero: lags first, draws behind.  The sensor alone
        is ``[tau]``, the whole chain at total flow Q ``[tau_v, V/Q, tau]`` (arrays of one shape,
        or numbers, broadcast against each other).

    >>> times = response_times([0.0481])
    >>> round(float(times.t90), 4), round(float(times.rise), 4)
    (0.1108, 0.1057)
    >>> response_times([0.8577, 0.0582 / 0.075, np.array([0.01, 0.0481])]).t90.round(2).tolist()
    [3.19, 3.23]

    Raises
    ------
    ValueError
        If there is no lag, one is negative or not finite, or all are zero.
    """
    lags = np.array(np.broadcast_arrays(*(np.asarray(tau, dtype=float) for tau in taus)))
    if lags.size == 0:
        raise ValueError(
            f"response_times: expected (n_lags, ...) time constants, got shape {lags.shape}"
        )
    total = lags.sum(axis=0)
    if not (np.isfinite(lags).all() and (lags >= 0).all() and (total > 0).all()):
        raise ValueError(
            "response_times: time constants must be finite, none negative and not all zero in a "
            f"draw; the smallest is {lags.min():g} s, the largest {lags.max():g} s"
        )
    # A lag of zero passes everything on; one of 1e-9 of the total cannot be told from it.
    lags = np.maximum(lags, 1e-9 * total)
    rates = np.sort(1.0 / lags.reshape(len(lags), -1).T, axis=1)
    out = np.empty((3, rates.shape[0]))
    _times_to_levels(np.array([0.1, 1 - math.exp(-1), 0.9]), rates, out)
    return ResponseTimes(*out.reshape(3, *lags.shape[1:]))


def response_time_table(
    tau: FloatArray,
    tau_v: FloatArray,
    volume: FloatArray,
    flows: Sequence[float] | FloatArray,
    level: float = 0.95,
) -> pd.DataFrame:
    """Response times of the sensor alone and of the whole chain at each flow, with intervals.

    One row for the sensor alone and one per total flow (rising); the chain is the valve, the
    chamber of time constant V/Q and the sensor.  t10, t63, t90 and rise (10 to 90 %) in s, each
    as its posterior median and equal-tailed interval of the given level (``_lo``, ``_hi``).  The
    chain is linear, so the fall takes as long as the rise at the same flow.

    Parameters
    ----------
    tau, tau_v
        (n,) s, posterior draws of the sensor's and the valve's time constant.
    volume
        (n,) mL, draws of the chamber's volume, from the same draws.
    flows
        total flows, mL/s (1 L/min is 16.67 mL/s); each is listed once.

    >>> table = response_time_table([0.0481] * 2, [0.8577] * 2, [58.23] * 2, [75.0, 150.0])
    >>> table[["system", "t63_s", "t90_s"]].round(3).values.tolist()
    [['sensor', 0.048, 0.111], ['chain', 1.802, 3.228], ['chain', 1.36, 2.529]]
    """
    import pandas as pd

    draws = [np.asarray(x, dtype=float) for x in (tau, tau_v, volume)]
    if draws[0].ndim != 1 or len(draws[0]) < 2 or any(x.shape != draws[0].shape for x in draws):
        raise ValueError(
            "response_time_table: expected as many draws (two or more) of tau, tau_v and volume, "
            f"got shapes {', '.join(str(x.shape) for x in draws)}"
        )
    rates = np.unique(np.asarray(flows, dtype=float))
    if rates.size == 0 or not (np.isfinite(rates).all() and rates[0] > 0):
        raise ValueError("response_time_table: flows must be positive numbers in mL/s")
    if not 0 < level < 1:
        raise ValueError(f"response_time_table: level must lie between 0 and 1, got {level}")
    sensor, valve, chamber = draws
    systems: list[tuple[str, float | None, ResponseTimes]] = [
        ("sensor", None, response_times([sensor]))
    ]
    for flow in rates:
        systems.append(
            ("chain", float(flow) * 0.06, response_times([valve, chamber / flow, sensor]))
        )
    rows = []
    for system, litres, times in systems:
        row: dict[str, str | float | None] = {"system": system, "total_flow_L_per_min": litres}
        for name in ("t10", "t63", "t90", "rise"):
            low, middle, high = np.quantile(
                getattr(times, name), [(1 - level) / 2, 0.5, (1 + level) / 2]
            )
            row |= {f"{name}_s": middle, f"{name}_lo_s": low, f"{name}_hi_s": high}
        rows.append(row)
    return pd.DataFrame(rows)
