"""How fast CO2 reaches the ring: diffusion through the ZIF-8/PDMS coating.

The coating is a disc (or, in the planar geometry, a strip) of ZIF-8 on the chip under PDMS.
With mu the concentration as a fraction of its final value and s the storage capacity of a layer
relative to PDMS (the partition coefficient in ZIF-8, 1 in PDMS), Fick's law reads

    s dmu/dt = div(s D grad mu),   mu = 1 on top and on the outer side,   no flux below,

and both mu and the flux s D dmu/dn are continuous at the interface, so that the concentration
s mu jumps there by the partition coefficient (paper Sec. III-D and eq. 19, where it is 1).
The probe sits 220 nm above the chip at the radius of the ring.

Two independent routes lead to the response at the probe. :func:`solve` is the finite element
method on scikit-fem: biquadratic elements on a graded mesh and TR-BDF2 steps under error control;
it makes no use of the simple shape of the domain.  :func:`modal` separates the variables (Bessel
functions or cosines across, spectral elements upwards), takes milliseconds and returns the
response as a sum of exponentials, which :func:`reduced` shortens to a few of them for the
``sensor_diffusion`` effect.  :func:`infer_d_zif8` reads the diffusivity off a posterior of tau.

The lateral extent of the coating is not published; :func:`find_outer_radius` finds the radius
that meets the published 12.9 ms, and :func:`outer_radius_table` says how much hangs on it.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.polynomial import chebyshev, legendre
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq, least_squares
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu
from scipy.special import j0, j1, jn_zeros, ndtr, ndtri

from bayes_sensor.campaign import FloatArray
from bayes_sensor.readers.quantities import Kind, read_quantity

LEVEL_63 = 1.0 - math.exp(-1.0)
"""the 63.2 % at which one first-order lag has its time constant"""

GEOMETRIES = ("axisymmetric", "planar")
EQUIVALENTS = ("tau63", "tau_fit", "tau_moment")

_LENGTH = Kind("a length", "m", "1.5 um")
_DIFFUSIVITY = Kind("a diffusivity", "m^2/s", "2.6e-11 m^2/s")


# --------------------------------------------------------------------------- the coating


@dataclass(frozen=True)
class Coating:
    """Dimensions (m) and diffusivities (m2/s) of the coating; the defaults are the paper's.

    Paper Sec. III-D gives all but ``outer_radius``; 17.4 um is the value at which the finite
    element response reaches 63.2 % after the published 12.9 ms (:func:`find_outer_radius`).
    ``outer_radius=math.inf`` is a coating without a side: diffusion from the top alone.

    >>> Coating(d_zif8=2.6e-11).thickness
    8.5e-06
    >>> Coating().with_quantities(outer_radius="16 um").outer_radius
    1.6e-05

    Raises
    ------
    ValueError
        If a length or diffusivity is not positive or the probe lies outside the coating.
    """

    ring_radius: float = 10e-6
    """m, distance of the probe from the axis (planar: from the plane of symmetry)"""
    outer_radius: float = 17.4e-6
    """m, where the coating ends sideways; may be ``math.inf``"""
    thickness_zif8: float = 1.5e-6
    """m"""
    thickness_pdms: float = 7.0e-6
    """m"""
    d_zif8: float = 1.71e-10
    """m2/s (paper ref. 21)"""
    d_pdms: float = 4.2e-9
    """m2/s (paper ref. 22)"""
    probe_height: float = 220e-9
    """m above the chip"""
    partition: float = 1.0
    """concentration in ZIF-8 over that in PDMS at equilibrium"""
    geometry: str = "axisymmetric"
    """one of :data:`GEOMETRIES`"""

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name == "geometry":
                continue
            value = getattr(self, item.name)
            may_be_zero = item.name in ("ring_radius", "probe_height")
            may_be_infinite = item.name == "outer_radius"
            good = isinstance(value, int | float | np.number) and (
                value >= 0 if may_be_zero else value > 0
            )
            if not good or not (may_be_infinite or math.isfinite(value)):
                sign = "zero or more" if may_be_zero else "positive"
                hint = '; with_quantities reads "1.5 um"' if isinstance(value, str) else ""
                raise ValueError(
                    f"coating: {item.name} must be a {sign} number in SI units, got {value!r}{hint}"
                )
            object.__setattr__(self, item.name, float(value))
        if self.geometry not in GEOMETRIES:
            raise ValueError(
                f"coating: geometry must be one of {', '.join(GEOMETRIES)}, got '{self.geometry}'"
            )
        if self.outer_radius <= self.ring_radius:
            raise ValueError(
                f"coating: outer_radius must exceed ring_radius, but {self.outer_radius:g} m is "
                f"not above {self.ring_radius:g} m; the probe would lie outside the coating"
            )
        if self.probe_height >= self.thickness:
            raise ValueError(
                f"coating: probe_height must lie below the top, but {self.probe_height:g} m is "
                f"not below {self.thickness:g} m (thickness_zif8 + thickness_pdms)"
            )

    @property
    def thickness(self) -> float:
        """m, both layers together."""
        return self.thickness_zif8 + self.thickness_pdms

    def with_quantities(self, **quantities: str) -> Coating:
        """The coating with fields replaced by text with a unit, such as ``"17.5 um"``.

        Raises
        ------
        ValueError
            If a name is unknown, a unit is missing, unknown or of the wrong dimension, or the
            value is not allowed.
        """
        known = [item.name for item in fields(self) if item.name not in ("geometry", "partition")]
        values: dict[str, Any] = {}
        for name, text in quantities.items():
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
                raise ValueError(f"coating: there is no quantity '{name}'; {hint}")
            kind = _DIFFUSIVITY if name.startswith("d_") else _LENGTH
            values[name] = read_quantity(text, kind, name)
        return replace(self, **values)


# --------------------------------------------------------------------------- sums of exponentials


@dataclass(frozen=True, eq=False)
class ReducedResponse:
    """A step response that is a sum of exponentials.

    y(t) = 1 - sum_k a_k exp(-lambda_k t),  sum_k a_k = 1.  Its transfer function is
    sum_k a_k / (1 + s/lambda_k): behind any input, the sensor's output is the sum over k of a_k
    times the output of one first-order lag with time constant 1/lambda_k.

    >>> lag = ReducedResponse(np.array([1.0]), np.array([20.0]), 0.0)
    >>> round(lag.tau63, 9), round(lag.tau_fit, 9), round(lag.tau_moment, 9)
    (0.05, 0.05, 0.05)
    """

    amplitude: FloatArray
    """(n,) a_k, of either sign"""
    rate: FloatArray
    """(n,) lambda_k, 1/s, positive"""
    max_error: float
    """largest |y - y_modal| on a grid of times, 0 where the sum is the modal one"""

    def __post_init__(self) -> None:
        amplitude, rate = (np.array(a, dtype=float) for a in (self.amplitude, self.rate))
        if amplitude.ndim != 1 or amplitude.shape != rate.shape or not (rate > 0).all():
            raise ValueError(
                "reduced response: expected as many positive rates as amplitudes, got shapes "
                f"{rate.shape} and {amplitude.shape}"
            )
        for name, array in (("amplitude", amplitude), ("rate", rate)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def step(self, t: FloatArray | float) -> FloatArray:
        """Step response at t (s), of the shape of t; 0 before the step."""
        elapsed = np.maximum(np.asarray(t, dtype=float), 0.0)
        risen: FloatArray = 1.0 - np.exp(-elapsed[..., None] * self.rate) @ self.amplitude
        return risen

    def scaled(self, factor: float) -> ReducedResponse:
        """The same shape, ``factor`` times slower (all diffusivities divided by it)."""
        return replace(self, rate=self.rate / factor)

    def with_tau63(self, tau: float) -> ReducedResponse:
        """The same shape, slowed until 63.2 % is reached at tau (s)."""
        return self.scaled(tau / self.tau63)

    def time_to(self, level: float) -> float:
        """s, when the response reaches ``level``, a fraction between 0 and 1."""
        if not 0 < level < 1:
            raise ValueError(f"time_to: level must lie between 0 and 1, got {level}")
        latest = math.log(2 * np.abs(self.amplitude).sum() / (1 - level)) / self.rate.min()
        return float(brentq(lambda t: float(self.step(t)) - level, 0.0, latest, xtol=1e-9 * latest))

    @cached_property
    def tau63(self) -> float:
        """s, time to 63.2 %."""
        return self.time_to(LEVEL_63)

    @cached_property
    def tau_moment(self) -> float:
        """s, integral of 1 - y = sum a_k / lambda_k: the lag that delays as much on average."""
        return float(np.sum(self.amplitude / self.rate))

    @cached_property
    def tau_fit(self) -> float:
        """s, the single lag closest to y in least squares over all t > 0.

        Setting the derivative of the integral of (y - 1 + exp(-t/tau))^2 to zero gives
        sum_k a_k / (1 + lambda_k tau)^2 = 1/4.
        """

        def slope(tau: float) -> float:
            return float(np.sum(self.amplitude / (1 + self.rate * tau) ** 2)) - 0.25

        return float(brentq(slope, 0.02 / self.rate.max(), 50 / self.rate.min(), rtol=1e-12))


@lru_cache(maxsize=128)
def modal(coating: Coating, degree: int = 16) -> ReducedResponse:
    """The response by separation of variables, exact to about seven digits after 0.1 tau63.

    Across the coating the solution is a series of J0(beta r) with J0(beta R) = 0 (planar:
    cos(beta x) with cos(beta R) = 0); for each beta the rest is a layered slab that loses
    s D beta^2 mu sideways, solved by one Legendre element of the given degree per layer.  The
    series is damped at its end by exp(-36 (m/n)^8), which only touches times before the front
    arrives.  Layers whose diffusivities differ a thousandfold leave three digits.  (Crank, The
    Mathematics of Diffusion, 2nd ed., eq. 5.22 for the Bessel series.)

    >>> round(1e3 * modal(Coating()).tau63, 1)
    12.9
    """
    nodes, weights, derivative, barycentric = _legendre_element(degree)
    size = 2 * degree + 1
    stiffness, storage, loss = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    layers = (
        (coating.thickness_zif8, coating.partition, coating.d_zif8),
        (coating.thickness_pdms, 1.0, coating.d_pdms),
    )
    for layer, (height, capacity, diffusivity) in enumerate(layers):
        i = slice(layer * degree, (layer + 1) * degree + 1)
        conductivity = capacity * diffusivity
        stiffness[i, i] += conductivity * 2 / height * (derivative.T * weights) @ derivative
        storage[i] += capacity * height / 2 * weights
        loss[i] += conductivity * height / 2 * weights

    # The last node is the top, where 1 - mu vanishes.
    stiffness, storage, loss = stiffness[:-1, :-1], storage[:-1], loss[:-1]
    root = np.sqrt(storage)
    beta, across = _lateral_modes(coating)
    matrices = stiffness / np.outer(root, root) + beta[:, None, None] ** 2 * np.diag(loss / storage)
    rate, vectors = np.linalg.eigh(matrices)

    z, bottom = coating.probe_height, coating.thickness_zif8
    layer, local = (
        (0, 2 * z / bottom - 1)
        if z <= bottom
        else (1, 2 * (z - bottom) / coating.thickness_pdms - 1)
    )
    at_probe = np.zeros(size)
    at_probe[layer * degree : (layer + 1) * degree + 1] = _interpolation_row(
        nodes, barycentric, local
    )
    seen = np.einsum("i,mij->mj", at_probe[:-1] / root, vectors)
    filled = np.einsum("i,mij->mj", root, vectors)
    return ReducedResponse((across[:, None] * seen * filled).ravel(), rate.ravel(), 0.0)


@lru_cache(maxsize=8)
def _legendre_element(degree: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Gauss-Lobatto nodes and weights on [-1, 1], differentiation matrix, barycentric weights."""
    last = np.zeros(degree + 1)
    last[degree] = 1.0
    # newer numpy hands the roots on as complex numbers, though all are real
    inner = np.sort(np.real(legendre.legroots(legendre.legder(last))))
    nodes = np.concatenate(([-1.0], inner, [1.0]))
    weights = 2 / (degree * (degree + 1) * legendre.legval(nodes, last) ** 2)
    gaps = nodes[:, None] - nodes[None, :] + np.eye(degree + 1)
    barycentric = 1 / gaps.prod(axis=1)
    derivative = barycentric[None, :] / barycentric[:, None] / gaps
    np.fill_diagonal(derivative, 0.0)
    np.fill_diagonal(derivative, -derivative.sum(axis=1))
    return nodes, weights, derivative, barycentric


def _interpolation_row(nodes: FloatArray, barycentric: FloatArray, x: float) -> FloatArray:
    """Values at x of the Lagrange polynomials on ``nodes``."""
    distance = x - nodes
    if np.abs(distance).min() < 1e-14:
        return (np.abs(distance) < 1e-14).astype(float)
    row: FloatArray = barycentric / distance
    row /= row.sum()
    return row


def _lateral_modes(coating: Coating) -> tuple[FloatArray, FloatArray]:
    """Wave numbers beta (1/m) across the coating and the weight of each at the probe."""
    h1, h2 = coating.thickness_zif8, coating.thickness_pdms
    side = coating.outer_radius - coating.ring_radius
    # What enters from the side dies out within the thickness, or farther where ZIF-8 conducts so
    # well under a poor PDMS that gas spreads along it.
    spread = math.sqrt(coating.partition * coating.d_zif8 * h1 * h2 / coating.d_pdms)
    if side > 12 * max(coating.thickness, spread):
        return np.zeros(1), np.ones(1)
    delay = h1**2 / (2 * coating.d_zif8) + h2 * (2 * coating.partition * h1 + h2) / (
        2 * coating.d_pdms
    )
    shortest = min(side, math.sqrt(coating.d_zif8 * delay))
    waves = coating.outer_radius * max(16 / (math.pi * shortest), 25 / side)
    n = int(min(max(math.ceil(waves), 32), 512))
    damping = np.exp(-36 * (np.arange(n) / n) ** 8)
    x = coating.ring_radius / coating.outer_radius
    if coating.geometry == "planar":
        zeros = (np.arange(n) + 0.5) * math.pi
        across = 2 * np.sin(zeros) / zeros * np.cos(zeros * x)
    else:
        zeros = jn_zeros(0, n)
        across = 2 / (zeros * j1(zeros)) * j0(zeros * x)
    beta = np.asarray(zeros / coating.outer_radius, dtype=np.float64)
    return beta, across * damping


@lru_cache(maxsize=256)
def reduced(coating: Coating, n: int = 6) -> ReducedResponse:
    """The response of a coating as n exponentials that start at 0 with slope 0 and end at 1.

    Amplitudes and rates minimise the squared distance from :func:`modal` over 0.01 to 12 mean
    delays; the two conditions at the start are met exactly.  Neighbouring rates keep a ratio of
    at least 1.3, so that the amplitudes stay small and lose no digits in a convolution.
    ``max_error`` states what was left.

    >>> response = reduced(Coating())
    >>> bool(response.max_error < 3e-4 and abs(response.amplitude.sum() - 1) < 1e-12)
    True
    """
    if not 2 <= n <= 12:
        raise ValueError(f"reduced: n must lie between 2 and 12, got {n}")
    full = modal(coating)
    delay = full.tau_moment
    t = np.concatenate((np.geomspace(0.01, 12, 150), np.linspace(0.02, 4, 150)))
    remaining = 1 - full.step(t * delay)

    def rates(u: FloatArray) -> FloatArray:
        steps = math.log(1.3) + np.exp(u[1:])
        rate: FloatArray = np.exp(u[0] + np.concatenate(([0.0], np.cumsum(steps))))
        return rate

    def amplitudes(rate: FloatArray) -> FloatArray:
        conditions = np.stack((np.ones(n), rate))
        basis, triangle = np.linalg.qr(conditions.T, mode="complete")
        amplitude = basis[:, :2] @ np.linalg.solve(triangle[:2].T, [1.0, 0.0])
        if n > 2:
            free = np.exp(-t[:, None] * rate) @ basis
            rest = remaining - np.exp(-t[:, None] * rate) @ amplitude
            amplitude = amplitude + basis[:, 2:] @ np.linalg.lstsq(free[:, 2:], rest)[0]
        return amplitude

    def misfit(u: FloatArray) -> FloatArray:
        rate = rates(u)
        return np.exp(-t[:, None] * rate) @ amplitudes(rate) - remaining

    start = np.concatenate(([math.log(full.rate.min() * delay)], np.full(n - 1, math.log(0.7))))
    lowest = np.concatenate(([-5.0], np.full(n - 1, -12.0)))
    highest = np.concatenate(([5.0], np.full(n - 1, 1.5)))
    u = least_squares(misfit, start, bounds=(lowest, highest)).x
    return ReducedResponse(amplitudes(rates(u)), rates(u) / delay, float(np.abs(misfit(u)).max()))


# --------------------------------------------------------------------------- finite elements


@dataclass(frozen=True, eq=False)
class System:
    """The finite element system M w' = -K w for what is still missing, w = 1 - mu."""

    mass: csc_matrix
    """(n_dof, n_dof) of the free degrees of freedom"""
    stiffness: csc_matrix
    """(n_dof, n_dof) 1/s times the unit of mass"""
    load: FloatArray
    """(n_dof,) integral of each shape function times the capacity: w(0) = 1 tested against it"""
    probe: int
    """index of the free degree of freedom at the probe"""
    r: FloatArray
    """(n_r,) m, grid lines across"""
    z: FloatArray
    """(n_z,) m, grid lines upwards"""
    grid: Any
    """(n_z, n_r) index of the free degree of freedom at each crossing, -1 where mu = 1"""

    @property
    def n_dof(self) -> int:
        """Free degrees of freedom."""
        return len(self.load)

    def tau_moment(self) -> float:
        """s, integral of w at the probe over all time: K x = load."""
        return float(_factor(self.stiffness).solve(self.load)[self.probe])


def assemble(coating: Coating, level: int = 1) -> System:
    """Mass and stiffness of the coating in biquadratic elements; each level halves every cell.

    The base mesh has lines through the probe and the interface and is finer towards the
    interface, the ring and the outer side.
    """
    # Imported here: the fast route needs none of it and should not wait for it.
    from skfem import Basis, BilinearForm, ElementQuad2, MeshQuad

    r, z = _grid_lines(coating)
    for _ in range(level):
        r, z = (np.insert(x, np.arange(1, len(x)), (x[1:] + x[:-1]) / 2) for x in (r, z))
    basis = Basis(MeshQuad.init_tensor(r, z), ElementQuad2(), intorder=5)
    axisymmetric = coating.geometry == "axisymmetric"

    def by_layer(w: Any, in_zif8: float, in_pdms: float) -> FloatArray:
        area = w.x[0] if axisymmetric else 1.0
        return area * np.where(w.x[1] < coating.thickness_zif8, in_zif8, in_pdms)

    def mass_form(u: Any, v: Any, w: Any) -> Any:
        return by_layer(w, coating.partition, 1.0) * u * v

    def stiffness_form(u: Any, v: Any, w: Any) -> Any:
        conductivity = by_layer(w, coating.partition * coating.d_zif8, coating.d_pdms)
        return conductivity * (u.grad[0] * v.grad[0] + u.grad[1] * v.grad[1])

    mass, stiffness = (BilinearForm(form).assemble(basis) for form in (mass_form, stiffness_form))
    at_r, at_z = basis.doflocs
    fixed = np.isclose(at_z, z[-1], rtol=1e-9, atol=0)
    if math.isfinite(coating.outer_radius):
        fixed |= np.isclose(at_r, r[-1], rtol=1e-9, atol=0)
    free = np.flatnonzero(~fixed)
    number = np.full(len(fixed), -1)
    number[free] = np.arange(len(free))
    vertices = basis.nodal_dofs[0]
    points = basis.mesh.p
    column, row = np.searchsorted(r, points[0] - 1e-15), np.searchsorted(z, points[1] - 1e-15)
    grid = np.empty((len(z), len(r)), dtype=int)
    grid[row, column] = number[vertices]
    probe_r = coating.ring_radius if math.isfinite(coating.outer_radius) else 0.0
    probe = np.argmin(np.hypot(at_r[free] - probe_r, at_z[free] - coating.probe_height))
    return System(
        mass=mass[free][:, free].tocsc(),
        stiffness=stiffness[free][:, free].tocsc(),
        load=np.asarray(mass.sum(axis=1)).ravel()[free],
        probe=int(probe),
        r=r,
        z=z,
        grid=grid,
    )


def _grid_lines(coating: Coating) -> tuple[FloatArray, FloatArray]:
    """Grid lines of the base mesh, across and upwards, m."""

    def graded(start: float, end: float, first: float, growth: float) -> FloatArray:
        """Lines from start to end in cells that begin near ``first`` and widen by ``growth``."""
        ends = np.cumsum(first * growth ** np.arange(64))
        ends = ends[: np.searchsorted(ends, abs(end - start)) + 1]
        return np.append(start + (end - start) * np.append(0.0, ends[:-1] / ends[-1]), end)

    h1, h2 = coating.thickness_zif8, coating.thickness_pdms
    top, probe, ring = coating.thickness, coating.probe_height, coating.ring_radius
    if math.isinf(coating.outer_radius):
        r = [np.array([0.0, top])]
    else:
        side = coating.outer_radius - ring
        r = [graded(ring, coating.outer_radius, min(side, top) / 3, 1.3)]
        if ring > 0:
            r.append(graded(ring, 0.0, min(side, top, ring) / 3, 1.7))
    if 0 < probe < h1:
        lower, upper = [0.0, probe, (probe + h1) / 2, h1], []
    else:
        lower, upper = [0.0, h1 / 3, 2 * h1 / 3, h1], [probe] if probe > h1 else []
    z = [np.array(lower), np.array(upper), graded(h1, top, min(h1, h2) / 3, 1.5)]
    return np.unique(np.concatenate(r)), np.unique(np.concatenate(z))


def _factor(matrix: csc_matrix) -> Any:
    """Sparse factors of a symmetric positive definite matrix."""
    return splu(
        matrix,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


@dataclass(frozen=True, eq=False)
class March:
    """A run through time: the steps taken and the solution after each."""

    times: FloatArray
    """(n_steps + 1,) s"""
    probe: FloatArray
    """(n_steps + 1,) mu at the probe"""
    slope: FloatArray
    """(n_steps + 1,) 1/s, its time derivative from the differential equation"""
    states: list[FloatArray]
    """w = 1 - mu after each step, (n_dof,) each; empty unless asked for"""

    def interpolant(self) -> CubicHermiteSpline:
        """The probe response between the steps: piecewise cubic through values and slopes."""
        return CubicHermiteSpline(self.times, self.probe, self.slope)


def march(
    system: System,
    tolerance: float | None = None,
    *,
    step: float | None = None,
    until: float = math.inf,
    remaining: float = 1e-5,
    keep_states: bool = False,
) -> March:
    """Step from w = 1 with TR-BDF2 until ``until`` (s) or until ``remaining`` is left at the probe.

    TR-BDF2 is L-stable and second order, with an error estimate from its embedded third-order
    formula (Hosea and Shampine, Appl. Numer. Math. 20, 1996, 21-37).  ``tolerance`` bounds the
    estimated error of a step, at the probe and in the root mean square over the coating;
    alternatively ``step`` (s) fixes the step.  The start is the L2 projection of w = 1, which
    conflicts with w = 0 at the boundary; an L-stable method keeps its order there after the
    first steps (Thomee, Galerkin Finite Element Methods for Parabolic Problems, Ch. 7).
    """
    if (tolerance is None) == (step is None):
        raise ValueError("march: give either a tolerance or a fixed step")
    mass, stiffness, load, probe = system.mass, system.stiffness, system.load, system.probe
    d, q = 1 - math.sqrt(0.5), math.sqrt(2) / 4
    total = load.sum()
    mass_factor = _factor(mass)
    w = mass_factor.solve(load)
    k1 = -mass_factor.solve(stiffness @ w)
    t, factor = 0.0, None
    h = step if step is not None else 1e-6 * system.tau_moment()
    rows = [(t, w[probe], k1[probe])]
    states = [w] if keep_states else []
    while t < until * (1 - 1e-12) and abs(w[probe]) > remaining:
        if factor is None:
            factor = _factor((mass + d * h * stiffness).tocsc())
        known = w + d * h * k1
        k2 = (factor.solve(mass @ known) - known) / (d * h)
        known = w + q * h * (k1 + k2)
        new = factor.solve(mass @ known)
        k3 = (new - known) / (d * h)
        if tolerance is not None:
            estimate = (4 * q - 1) / 3 * k1 - k2 / 3 + 2 * d / 3 * k3
            estimate = h * factor.solve(mass @ estimate)
            error = max(math.sqrt(estimate @ (mass @ estimate) / total), abs(estimate[probe]))
            change = 0.9 * (tolerance / max(error, 1e-300)) ** (1 / 3)
            if error > tolerance:
                h, factor = h * max(0.25, min(0.7, change)), None
                continue
        t, w, k1 = t + h, new, k3
        rows.append((t, w[probe], k1[probe]))
        if keep_states:
            states.append(w)
        # A new step needs new factors, so small changes are not worth it.
        if tolerance is not None and change > 1.5:
            h, factor = h * min(change, 4.0), None
    times, left, slope = np.array(rows).T
    return March(times, 1 - left, -slope, states)


@dataclass(frozen=True, eq=False)
class Response:
    """What the finite element solution says about one coating.

    The concentration is a fraction of its final value everywhere.
    """

    coating: Coating
    times: FloatArray
    """(n_t,) s, the accepted steps, from 0"""
    probe: FloatArray
    """(n_t,) response at the probe"""
    t10: float
    """s"""
    tau63: float
    """s, time to 63.2 %, the paper's time constant"""
    t90: float
    """s"""
    tau_fit: float
    """s, the single lag closest in least squares over time"""
    tau_moment: float
    """s, integral of 1 - response: the single lag with the same mean delay"""
    lag_max_error: float
    """largest distance of the response from the single lag ``tau_fit``"""
    lag_rms_error: float
    """its root mean square over the first 5 tau_fit"""
    r: FloatArray
    """(n_r,) m, mesh lines across"""
    z: FloatArray
    """(n_z,) m, mesh lines upwards"""
    snapshot_times: FloatArray
    """(n_snapshots,) s"""
    snapshots: FloatArray
    """(n_snapshots, n_z, n_r) concentration at the crossings of the mesh lines"""
    n_dof: int
    n_steps: int
    tolerance: float
    """relative change of t10, tau63 and t90 that was asked for"""
    last_change: float
    """relative change of t10, tau63 and t90 at the last refinement of mesh and steps"""
    status: str = ""
    """empty, or a sentence saying why the tolerance was not met"""

    def step(self, t: FloatArray | float) -> FloatArray:
        """Response at t (s), linear between the accepted steps."""
        response = np.interp(t, self.times, self.probe, left=0.0, right=1.0)
        return np.asarray(response, dtype=float)

    def to_json(self) -> dict[str, Any]:
        """The content of ``diffusion.json``: units in the keys, no NaN or infinity."""
        coating = self.coating
        lateral = 1e6 * coating.outer_radius if math.isfinite(coating.outer_radius) else None
        return {
            "t10_ms": 1e3 * self.t10,
            "tau63_ms": 1e3 * self.tau63,
            "t90_ms": 1e3 * self.t90,
            "rise_ms": 1e3 * (self.t90 - self.t10),
            "tau_fit_ms": 1e3 * self.tau_fit,
            "tau_moment_ms": 1e3 * self.tau_moment,
            "lag_max_error": self.lag_max_error,
            "lag_rms_error": self.lag_rms_error,
            "n_dof": self.n_dof,
            "n_steps": self.n_steps,
            "tolerance": self.tolerance,
            "last_change": self.last_change if math.isfinite(self.last_change) else None,
            "status": self.status,
            "probe": {
                "r_um": 1e6 * coating.ring_radius,
                "z_um": 1e6 * coating.probe_height,
                "t_ms": (1e3 * self.times).tolist(),
                "response": self.probe.tolist(),
            },
            "coating": {
                "geometry": coating.geometry,
                "ring_radius_um": 1e6 * coating.ring_radius,
                "outer_radius_um": lateral,
                "thickness_zif8_um": 1e6 * coating.thickness_zif8,
                "thickness_pdms_um": 1e6 * coating.thickness_pdms,
                "d_zif8_m2_per_s": coating.d_zif8,
                "d_pdms_m2_per_s": coating.d_pdms,
                "probe_height_um": 1e6 * coating.probe_height,
                "partition": coating.partition,
            },
        }


def solve(
    coating: Coating | None = None,
    tolerance: float = 5e-4,
    *,
    snapshot_times: Sequence[float] | None = None,
    max_level: int = 3,
) -> Response:
    """Finite element response of a coating (the paper's by default).

    Mesh cells are halved and the error allowed per time step divided by 8 (steps half as long)
    until t10, tau63 and t90 all change by less than ``tolerance`` (relative).  Both errors fall
    at least fourfold each time, so the change bounds the error of the result.
    ``snapshot_times`` (s) are by default 0.1, 0.5, 1 and 2 tau63.

    >>> response = solve(Coating(d_zif8=2.6e-11), tolerance=2e-3)
    >>> round(1e3 * response.tau63)
    49
    """
    coating = Coating() if coating is None else coating
    if not 1e-7 < tolerance < 0.1:
        raise ValueError(
            f"solve: tolerance must lie between 1e-7 and 0.1, got {tolerance}; try 5e-4"
        )
    landmarks, change, per_step = None, math.inf, 8e-4
    for level in range(max_level + 1):
        system, per_step = assemble(coating, level), per_step / 8
        run = march(system, per_step, keep_states=True)
        spline = run.interpolant()
        previous, landmarks = (
            landmarks,
            [_first_crossing(spline, run, x) for x in (0.1, LEVEL_63, 0.9)],
        )
        if previous is not None:
            change = float(np.max(np.abs(np.array(previous) / landmarks - 1)))
        if change < tolerance:
            break
    assert landmarks is not None  # max_level + 1 >= 1 rounds
    status = ""
    if change >= tolerance:
        status = (
            f"not converged: the last refinement still changed a response time by {change:.2g} "
            f"(relative), {tolerance:.2g} was asked for; ask for less or raise max_level"
        )
    t10, tau63, t90 = landmarks
    fine = np.interp(np.arange(8 * len(run.times) - 7) / 8, np.arange(len(run.times)), run.times)
    tau_fit, lag_max, lag_rms = fit_single_lag(fine, spline(fine))
    wanted = np.asarray(
        [0.1 * tau63, 0.5 * tau63, tau63, 2 * tau63] if snapshot_times is None else snapshot_times,
        dtype=float,
    )
    return Response(
        coating=coating,
        times=run.times,
        probe=run.probe,
        t10=t10,
        tau63=tau63,
        t90=t90,
        tau_fit=tau_fit,
        tau_moment=system.tau_moment(),
        lag_max_error=lag_max,
        lag_rms_error=lag_rms,
        r=system.r,
        z=system.z,
        snapshot_times=wanted,
        snapshots=np.array([_snapshot(system, run, t) for t in wanted]),
        n_dof=system.n_dof,
        n_steps=len(run.times) - 1,
        tolerance=tolerance,
        last_change=change,
        status=status,
    )


def _first_crossing(spline: CubicHermiteSpline, run: March, level: float) -> float:
    """s, when the interpolated probe response first reaches ``level``."""
    i = int(np.argmax(run.probe >= level))
    return float(brentq(lambda t: float(spline(t)) - level, run.times[i - 1], run.times[i]))


def _snapshot(system: System, run: March, t: float) -> FloatArray:
    """(n_z, n_r) concentration at time t, linear between two steps; between 0 and 1."""
    i = int(np.clip(np.searchsorted(run.times, t), 1, len(run.times) - 1))
    share = float(np.clip((t - run.times[i - 1]) / (run.times[i] - run.times[i - 1]), 0, 1))
    w = (1 - share) * run.states[i - 1] + share * run.states[i]
    return 1 - np.clip(np.where(system.grid >= 0, w[system.grid], 0.0), 0.0, 1.0)


def fit_single_lag(t: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """The first-order lag nearest to a step response, and how far off it stays.

    Minimises the integral of (y - 1 + exp(-t/tau))^2; its stationary point satisfies
    integral of t exp(-t/tau) (1 - y) = tau^2 / 4.

    Parameters
    ----------
    t, y
        (n,) increasing times from 0 (s) to where y has reached 1, and the response at them.

    Returns
    -------
    tau (s), largest distance, root mean square distance over the first 5 tau

    >>> t = np.linspace(0, 1, 2001)
    >>> round(fit_single_lag(t, 1 - np.exp(-t / 0.05))[0], 5)
    0.05
    """

    def slope(tau: float) -> float:
        return float(np.trapezoid(t * np.exp(-t / tau) * (1 - y), t)) / tau**2 - 0.25

    mean_delay = float(np.trapezoid(1 - y, t))
    tau = float(brentq(slope, mean_delay / 20, 20 * mean_delay))
    distance = np.abs(y - 1 + np.exp(-t / tau))
    near = t <= 5 * tau
    mean_square = float(np.trapezoid(distance[near] ** 2, t[near])) / float(t[near][-1])
    return tau, float(distance.max()), math.sqrt(mean_square)


# --------------------------------------------------------------------------- the outer radius


def find_outer_radius(tau63: float = 12.9e-3, coating: Coating | None = None) -> float:
    """m, the outer radius at which the probe reaches 63.2 % after tau63 (s).

    The default is the paper's 12.9 ms; the radius it implies is that of ``Coating()``.

    >>> round(1e6 * find_outer_radius(), 1)
    17.4
    """
    coating = Coating() if coating is None else coating

    def excess(log_side: float) -> float:
        outer = coating.ring_radius + math.exp(log_side)
        return modal(replace(coating, outer_radius=outer)).tau63 - tau63

    # Beyond 13 thicknesses the side no longer matters to the probe.
    nearest, farthest = (math.log(f * coating.thickness) for f in (0.02, 13.0))
    if excess(nearest) > 0 or excess(farthest) < 0:
        longest = modal(replace(coating, outer_radius=math.inf)).tau63
        raise ValueError(
            f"find_outer_radius: no radius gives {1e3 * tau63:g} ms; this coating reaches 63.2 % "
            f"after at most {1e3 * longest:.4g} ms, without a side"
        )
    return coating.ring_radius + math.exp(brentq(excess, nearest, farthest, xtol=1e-12))


@dataclass(frozen=True)
class RadiusRow:
    """One line of :func:`outer_radius_table`."""

    outer_radius: float
    """m"""
    tau63: tuple[float, ...]
    """s, one per ZIF-8 diffusivity"""
    t90: tuple[float, ...]
    """s, one per ZIF-8 diffusivity"""


def outer_radius_table(
    outer_radii: Sequence[float] = (14e-6, 15e-6, 16e-6, 17e-6, 17.4e-6, 18e-6, 20e-6, math.inf),
    d_zif8: Sequence[float] = (1.71e-10, 2.6e-11),
    coating: Coating | None = None,
) -> list[RadiusRow]:
    """How the two published response times hang on the unpublished outer radius.

    One row per radius (m), one column per ZIF-8 diffusivity (m2/s): the paper's literature value
    and the lowered one.
    """
    coating = Coating() if coating is None else coating
    rows = []
    for outer in outer_radii:
        responses = [modal(replace(coating, outer_radius=outer, d_zif8=d)) for d in d_zif8]
        rows.append(
            RadiusRow(
                outer,
                tuple(response.tau63 for response in responses),
                tuple(response.time_to(0.9) for response in responses),
            )
        )
    return rows


# --------------------------------------------------------------------------- the inverse

DEFAULT_TOLERANCES: Mapping[str, float] = {
    "d_pdms": 0.2,
    "thickness_zif8": 0.1,
    "thickness_pdms": 0.1,
    "outer_radius": 0.0,
}
"""relative standard deviation of what is not known exactly about the coating"""

_TRUNCATION = 4.0  # standard deviations at which the tolerances end


@runtime_checkable
class Law(Protocol):
    """A distribution with the methods of a frozen ``scipy.stats`` law that are used here."""

    def cdf(self, x: Any, /) -> Any: ...
    def sf(self, x: Any, /) -> Any: ...
    def ppf(self, q: Any, /) -> Any: ...


@dataclass(frozen=True, eq=False)
class TauMap:
    """A smooth map from diffusivity and dimensions to a response time, for thousands of draws.

    log(tau) is a Chebyshev polynomial in log(D_ZIF8/D_PDMS) and the logarithms of those
    dimensions that have a tolerance; D_PDMS itself only scales time.
    """

    coating: Coating
    names: tuple[str, ...]
    """dimensions that vary"""
    half_width: tuple[float, ...]
    """of log(dimension / nominal), one per name"""
    coefficients: FloatArray
    """(n_x, n_1, ..) Chebyshev coefficients of log(tau / s) at nominal D_PDMS"""
    max_error: float
    """largest relative error of tau against :func:`modal` at points between the nodes"""

    D_RANGE = (1e-13, 1e-7)
    """m2/s at nominal D_PDMS, where the polynomial holds"""

    @property
    def centre_and_half(self) -> tuple[float, float]:
        """Centre and half width of log D_ZIF8 (at nominal D_PDMS)."""
        low, high = np.log(self.D_RANGE)
        return (low + high) / 2, (high - low) / 2

    def at(self, logs: FloatArray) -> FloatArray:
        """(n, n_x) coefficients in D alone, for ``logs`` (n_names, n) of dimension / nominal."""
        result = np.broadcast_to(self.coefficients, (logs.shape[1], *self.coefficients.shape))
        for log, half in zip(logs[::-1], self.half_width[::-1], strict=True):
            vander = chebyshev.chebvander(log / half, result.shape[-1] - 1)
            result = np.einsum("n...k,nk->n...", result, vander)
        return result

    def log_tau(self, log_d: FloatArray, coefficients: FloatArray) -> FloatArray:
        """(n,) log(tau) at log D_ZIF8 (n,), given :meth:`at`; tau goes as 1/D below range."""
        centre, half = self.centre_and_half
        x = np.clip((log_d - centre) / half, -1.0, 1.0)
        value: FloatArray = np.sum(
            chebyshev.chebvander(x, coefficients.shape[1] - 1) * coefficients, axis=1
        )
        # Below the range PDMS takes no time and tau goes as h^2/D.
        value = value + np.maximum(centre - half - log_d, 0.0)
        return value

    def invert(self, log_tau: FloatArray, coefficients: FloatArray) -> FloatArray:
        """(n,) log D_ZIF8 at which log(tau) is met; +inf beyond the top of the range."""
        centre, half = self.centre_and_half
        low = np.full(len(log_tau), centre - half)
        slowest = self.log_tau(low, coefficients)
        low = low - np.maximum(log_tau - slowest, 0.0)
        high = np.full(len(log_tau), centre + half)
        none_left = log_tau <= self.log_tau(high, coefficients)
        for _ in range(48):
            middle = (low + high) / 2
            too_slow = self.log_tau(middle, coefficients) > log_tau
            low, high = np.where(too_slow, middle, low), np.where(too_slow, high, middle)
        return np.where(none_left, np.inf, (low + high) / 2)


@lru_cache(maxsize=16)
def tau_map(
    coating: Coating, half_width: tuple[tuple[str, float], ...] = (), equivalent: str = "tau63"
) -> TauMap:
    """Build a :class:`TauMap` from modal solves at Chebyshev nodes, and check it between them.

    ``half_width`` lists the dimensions that vary with the half width of their logarithm;
    ``equivalent`` is the response time mapped, one of :data:`EQUIVALENTS`.
    """
    names = tuple(name for name, _ in half_width)
    widths = tuple(width for _, width in half_width)

    def log_tau(log_d: float, logs: Sequence[float]) -> float:
        changed = {
            name: getattr(coating, name) * math.exp(log)
            for name, log in zip(names, logs, strict=True)
        }
        response = modal(replace(coating, d_zif8=math.exp(log_d), **changed), 12)
        return math.log(getattr(response, equivalent))

    blank = TauMap(coating, names, widths, np.zeros(1), 0.0)
    centre, half = blank.centre_and_half
    # Degrees that leave errors near 1e-4: the bend of log tau in log D is sharp, in the
    # dimensions it is close to a straight line.
    sizes = [29] + [5 if width < 0.5 else 8 for width in widths]
    nodes = [chebyshev.chebpts1(size) for size in sizes]
    values = np.empty(sizes)
    for index in np.ndindex(*sizes):
        x = [axis[i] for axis, i in zip(nodes, index, strict=True)]
        logs = [u * width for u, width in zip(x[1:], widths, strict=True)]
        values[index] = log_tau(centre + half * x[0], logs)
    for axis, (points, size) in enumerate(zip(nodes, sizes, strict=True)):
        to_coefficients = np.linalg.inv(chebyshev.chebvander(points, size - 1))
        values = np.moveaxis(np.tensordot(to_coefficients, values, (1, axis)), 0, axis)
    built = replace(blank, coefficients=values)

    between = np.random.default_rng(0).uniform(-1, 1, (40, len(sizes)))
    log_d = centre + half * between[:, 0]
    logs = between[:, 1:].T * np.array(widths)[:, None]
    guess = built.log_tau(log_d, built.at(logs))
    truth = np.array([log_tau(d, row) for d, row in zip(log_d, logs.T, strict=True)])
    return replace(built, max_error=float(np.abs(np.expm1(guess - truth)).max()))


@dataclass(frozen=True, eq=False)
class DiffusivityPosterior:
    """What a posterior of tau says about the diffusivity of ZIF-8; see :func:`infer_d_zif8`."""

    d_zif8: FloatArray
    """(n_draws,) m2/s; +inf where tau is too short for any resistance of ZIF-8"""
    tau: FloatArray
    """(n_draws,) s, the draws of tau used"""
    tau_literature: FloatArray
    """(n_draws,) s, the response time at the literature value, over the tolerances"""
    d_literature: float
    """m2/s"""
    tail_probability: float
    """two-sided: 2 min(P(D <= D_lit), P(D >= D_lit)), at most 1"""
    tail_resolution: float
    """smallest tail probability the draws of tau can show; 0 for a law"""
    tolerances: Mapping[str, float]
    equivalent: str
    """which response time stands for tau"""
    map_error: float
    """largest relative error of the map from D to tau"""

    @property
    def fraction_unbounded(self) -> float:
        """Share of draws with no finite diffusivity (tau shorter than at the top of the map)."""
        return float(np.mean(np.isinf(self.d_zif8)))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Equal-tailed interval of D_ZIF8, m2/s; an end may be +inf."""
        return _equal_tailed(self.d_zif8, level)

    @property
    def median(self) -> float:
        """m2/s, may be +inf."""
        return float(np.quantile(self.d_zif8, 0.5, method="inverted_cdf"))

    def ratio_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Equal-tailed interval of tau over the response time at the literature value."""
        return _equal_tailed(self.tau / self.tau_literature, level)

    @property
    def ratio(self) -> float:
        """Median of tau over the response time at the literature value; 1 where they agree."""
        return float(np.median(self.tau / self.tau_literature))

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        low, high = self.interval()
        # Farther out the answer is the assumed shape of the tails, not the data.
        floor = max(self.tail_resolution, 1e-6)
        p = max(self.tail_probability, floor)
        at_most = "at most " if self.tail_probability <= floor else ""
        inside = low <= self.d_literature <= high
        upper = f"{high:.2g}" if math.isfinite(high) else "no upper limit"
        return (
            f"D_ZIF8 is {low:.2g} to {upper} m2/s at 95 %; the literature value "
            f"{self.d_literature:.3g} m2/s lies {'inside' if inside else 'outside'} "
            f"(two-sided tail probability {at_most}{p:.2g})."
        )

    def to_json(self) -> dict[str, Any]:
        """Summary with units in the keys; null where an end is unbounded."""

        def finite(x: float) -> float | None:
            return x if math.isfinite(x) else None

        result: dict[str, Any] = {"d_zif8_m2_per_s": {"median": finite(self.median)}}
        for label, level in (("68", 0.68), ("95", 0.95), ("997", 0.997)):
            low, high = self.interval(level)
            result["d_zif8_m2_per_s"] |= {f"lo{label}": finite(low), f"hi{label}": finite(high)}
        low, high = self.ratio_interval()
        literature_low, literature_high = _equal_tailed(self.tau_literature, 0.95)
        return result | {
            "d_literature_m2_per_s": self.d_literature,
            "tau_literature_ms": {
                "median": 1e3 * float(np.median(self.tau_literature)),
                "lo95": 1e3 * literature_low,
                "hi95": 1e3 * literature_high,
            },
            "ratio": {"median": self.ratio, "lo95": low, "hi95": high},
            "tail_probability": self.tail_probability,
            "tail_resolution": self.tail_resolution,
            "fraction_unbounded": self.fraction_unbounded,
            "tolerances": dict(self.tolerances),
            "equivalent": self.equivalent,
            "map_error": self.map_error,
            "sentence": self.sentence,
        }


def _equal_tailed(draws: FloatArray, level: float) -> tuple[float, float]:
    # A draw, not a mix of two: mixing with an infinite one gives NaN.
    ends = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2], method="inverted_cdf")
    return float(ends[0]), float(ends[1])


def infer_d_zif8(
    tau: FloatArray | Law,
    coating: Coating | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
    equivalent: str = "tau63",
    n_draws: int = 20_000,
    seed: int | np.random.Generator = 0,
) -> DiffusivityPosterior:
    """Posterior of the ZIF-8 diffusivity from a posterior of the sensor's time constant.

    D_PDMS, the thicknesses and the outer radius are log-normal around the coating's values with
    the relative standard deviations in ``tolerances`` (:data:`DEFAULT_TOLERANCES`, truncated at
    four standard deviations), independent of tau.  For every joint draw the equation
    tau63(D_ZIF8, dimensions, D_PDMS) = tau is solved for D_ZIF8.  The prior on D_ZIF8 is thus
    the one that the prior on tau implies.  A draw of tau so short that it would take more than
    1e-7 m2/s (24 times PDMS) counts as an infinite diffusivity.

    The statistic that judges the literature value (the ``d_zif8`` of ``coating``) is the
    two-sided posterior tail probability p = 2 min(P(D <= D_lit), P(D >= D_lit)), equivalently
    2 min(P(tau >= tau_lit), P(tau <= tau_lit)) with tau_lit the response time at D_lit over the
    tolerances.  It is no p-value of a test on fresh data and no probability that D_lit is true.
    It is computed over all pairs of tau and dimensions, so that draws resolve
    ``tail_resolution`` = 2 / number of draws.

    Parameters
    ----------
    tau
        (n,) s, posterior draws; or a frozen ``scipy.stats`` law in seconds, cut at 0.  The
        published 48.1 ms with its 3 sigma bound of 5.6 ms is ``norm(0.0481, 0.0056 / 3)``.
    tolerances
        Replaces single entries of the default.
    equivalent
        Which response time of the coating stands for tau: "tau63" (the paper's), "tau_fit" or
        "tau_moment".

    >>> from scipy.stats import norm
    >>> published = infer_d_zif8(norm(0.0481, 0.0056 / 3), seed=1)
    >>> published.tail_probability < 1e-3
    True

    Raises
    ------
    ValueError
        If tau holds no positive draw, or a tolerance is unknown, negative or too large.
    """
    coating = Coating() if coating is None else coating
    spreads = _checked_tolerances(coating, tolerances)
    if equivalent not in EQUIVALENTS:
        raise ValueError(
            f"infer_d_zif8: equivalent must be one of {', '.join(EQUIVALENTS)}, got '{equivalent}'"
        )
    rng = np.random.default_rng(seed)
    if isinstance(tau, Law):
        below = float(tau.cdf(0.0))
        if not below < 1 - 1e-9:
            raise ValueError(
                "infer_d_zif8: the law of tau has no mass above 0 s; give it in seconds"
            )
        tau_draws = np.asarray(tau.ppf(rng.uniform(below, 1.0, n_draws)), dtype=float)
        tau_draws = np.maximum(tau_draws, 1e-12)
    else:
        given = np.asarray(tau, dtype=float).ravel()
        if len(given) < 2 or not np.isfinite(given).all() or not (given >= 0).all():
            raise ValueError(
                f"infer_d_zif8: expected at least 2 finite draws of tau in s, none negative, got "
                f"{len(given)} with smallest {given.min() if len(given) else 'none'}"
            )
        n_draws = max(n_draws, len(given))
        tau_draws = np.maximum(given[np.arange(n_draws) % len(given)], 1e-12)

    log_sd = {name: math.sqrt(math.log1p(spread**2)) for name, spread in spreads.items()}
    edge = ndtr(-_TRUNCATION)
    logs = {name: sd * ndtri(rng.uniform(edge, 1 - edge, n_draws)) for name, sd in log_sd.items()}
    varying = tuple(
        (name, _TRUNCATION * sd) for name, sd in log_sd.items() if name != "d_pdms" and sd > 0
    )
    table = tau_map(coating, varying, equivalent)
    # Time scales with 1/D_PDMS at a fixed ratio of the diffusivities.
    shift = logs["d_pdms"]
    coefficients = table.at(np.reshape([logs[name] for name in table.names], (-1, n_draws)))
    log_d = table.invert(np.log(tau_draws) + shift, coefficients) + shift
    log_literature = np.full(n_draws, math.log(coating.d_zif8)) - shift
    tau_literature = np.exp(table.log_tau(log_literature, coefficients) - shift)

    if isinstance(tau, Law):
        shorter = float(np.mean((np.asarray(tau.cdf(tau_literature)) - below) / (1 - below)))
        longer = float(np.mean(np.asarray(tau.sf(tau_literature)) / (1 - below)))
        resolution = 0.0
    else:
        ordered = np.sort(given)
        shorter = float(np.mean(np.searchsorted(ordered, tau_literature, "right"))) / len(given)
        longer = 1 - float(np.mean(np.searchsorted(ordered, tau_literature, "left"))) / len(given)
        resolution = 2 / len(given)
    return DiffusivityPosterior(
        d_zif8=np.exp(log_d),
        tau=tau_draws,
        tau_literature=tau_literature,
        d_literature=coating.d_zif8,
        tail_probability=min(2 * min(shorter, longer), 1.0),
        tail_resolution=resolution,
        tolerances=spreads,
        equivalent=equivalent,
        map_error=table.max_error,
    )


def _checked_tolerances(
    coating: Coating, tolerances: Mapping[str, float] | None
) -> dict[str, float]:
    """The default tolerances with those given put in, or a ValueError."""
    spreads = dict(DEFAULT_TOLERANCES)
    for name, value in (tolerances or {}).items():
        if name not in spreads:
            raise ValueError(
                f"infer_d_zif8: there is no tolerance '{name}'; known: {', '.join(spreads)}"
            )
        if not 0 <= value <= 0.5:
            raise ValueError(
                f"infer_d_zif8: the tolerance of {name} must lie between 0 and 0.5 (relative "
                f"standard deviation), got {value}"
            )
        spreads[name] = float(value)
    if math.isinf(coating.outer_radius):
        spreads["outer_radius"] = 0.0
    smallest = coating.outer_radius * math.exp(
        -_TRUNCATION * math.sqrt(math.log1p(spreads["outer_radius"] ** 2))
    )
    if smallest < 1.05 * coating.ring_radius:
        raise ValueError(
            f"infer_d_zif8: with a tolerance of {spreads['outer_radius']:g} the outer radius would "
            f"reach down to {1e6 * smallest:.3g} um, with the ring at "
            f"{1e6 * coating.ring_radius:.3g} um; give a smaller tolerance"
        )
    return spreads
