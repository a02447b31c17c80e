"""The response at the probe by finite elements on scikit-fem and TR-BDF2 steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from bayes_sensor.campaign import FloatArray
from bayes_sensor.coating.layers import LEVEL_63, Coating
from bayes_sensor.display import record_card


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

    _repr_html_ = record_card

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
