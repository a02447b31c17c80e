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
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from bayes_sensor.campaign import FloatArray
from bayes_sensor.display import record_card

SHAPES = ("lorentzian", "all-pass")


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

    _repr_html_ = record_card

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
        check_positive("ring", self, skip=("shape",))
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


def check_positive(where: str, record: object, skip: Sequence[str] = ()) -> None:
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
        check_positive("cladding", self)

    @property
    def redshift_per_percent(self) -> float:
        """m per % CO2."""
        return self.index_per_percent * self.sensitivity


@dataclass(frozen=True)
class Readout:
    """A laser of fixed wavelength on the flank of the ring's dip, and a photoreceiver.

    V(c) = V_full T(lambda_laser - lambda_ring - 100 c redshift), with c the test-gas fraction.

    >>> readout = Readout(Ring(), Cladding(), wavelength=1574.37e-9, full_scale=4.0)
    >>> bool(readout.voltage(0.16) > readout.voltage(0.0))
    True
    """

    _repr_html_ = record_card

    ring: Ring
    cladding: Cladding
    wavelength: float = 1574.4e-9
    """m, of the laser (paper Sec. II-C)"""
    full_scale: float = 4.0
    """V, far off the resonance"""

    def __post_init__(self) -> None:
        check_positive("readout", self, skip=("ring", "cladding"))

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
