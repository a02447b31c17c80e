"""The data of a campaign reduced once to mesh nodes, so that a likelihood costs microseconds.

Between the switch times the mean and the variance are smooth, so sums over samples such as
``sum w(t_i) d_i d_(i-1)`` may be taken with ``w`` interpolated from a few nodes: each node keeps the
Lagrange-weighted sums of 1, d_i, d_(i-1), d_i^2 and d_i d_(i-1), where d = y - m_ref.  Blocks are
narrow where a switch time may fall and grow as the exponentials die away (error of polynomial
interpolation at Chebyshev nodes: Trefethen, Approximation Theory and Approximation Practice,
2013, ch. 8).  The first and last sample of every stretch of consecutive samples are kept exactly,
and with them the pairs across gaps.

Outside the region for which the mesh was built the exact full pass answers instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log, pi, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.likelihood import (
    Problem,
    as_problem,
    experiment_log_likelihood,
    mean_and_variance,
)
from bayes_sensor.likelihood import log_likelihood as full_log_likelihood

from bayes_sensor.model import (
    Cascade,
    Theta,
    cascade_response,
    cascade_sensitivities,
    local_parameters,
    step_response,
)
from bayes_sensor.noise import lag_coefficient, scale_squared

K = 8
"""nodes per block"""
# Interpolation tolerance for a decaying exponential of unit amplitude, and how much narrower than
# its own mesh products such as x^2/s^2 want it; both set by the measured error of the likelihood.
TOLERANCE = 1e-7
NARROWER = 1.0
# Widest block, in slowest time constants, in which a switch time may fall.
WINDOW_BLOCK = 0.03
COINCIDENT = 1e-3
"""relative distance of time constants below which partial fractions give way to the stable form"""
_FAST = {"reassoc", "contract", "arcp", "nsz"}
_CHEBYSHEV = 0.5 - 0.5 * np.cos((2 * np.arange(K) + 1) * pi / (2 * K))
_OFFSETS = np.stack([np.arange(K) + 0.5, _CHEBYSHEV])  # in samples, and in block widths


class Arrays(NamedTuple):
    """The mesh of a whole campaign; blocks, edge samples and runs of all experiments in a row."""

    local: np.ndarray  # (n_exp, 4) positions of y0, beta, t0, tf in theta
    noise: np.ndarray  # (n_exp, 3) positions of phi, sigma0, sigma1
    blocks: np.ndarray  # (n_exp + 1,) first block of each experiment
    runs: np.ndarray  # (n_exp + 1,) first run of each experiment
    setting: np.ndarray  # (n_exp, 4) interval, total flow, variance weight, interval/reference
    n_samples: np.ndarray  # (n_exp,)
    base: np.ndarray  # (n_blocks,) s, half a sample before the block's first sample
    kind: np.ndarray  # (n_blocks,) 0: pointwise; k: 8 2^k samples
    follows: np.ndarray  # (n_blocks,) whether the block starts where the previous one ends
    moments: np.ndarray  # (n_blocks, 5, K) of 1, d, d_lag, d^2, d d_lag
    reference: np.ndarray  # (n_blocks, 2, K) reference mean at the node and one sample before
    reference_s2: np.ndarray  # (n_blocks, K)
    log_s2: np.ndarray  # (n_exp,) sum of the reference log s^2 over the blocks' samples
    edge_t: np.ndarray  # (n_runs, 2) s, first and last sample of each run
    edge_y: np.ndarray  # (n_runs, 2)
    distance: np.ndarray  # (n_runs,) samples since the previous run's last sample
    pairs: np.ndarray  # (n_exp,) pairs of neighbouring samples
    low: np.ndarray  # (n_theta,) region of the mesh
    high: np.ndarray  # (n_theta,)
    n_kinds: int


# --------------------------------------------------------------------------- kernels


@njit(cache=True, error_model="numpy")
def _partial_fractions(taus, c):  # pragma: no cover - compiled
    # c_j with x3 = 1 - sum c_j exp(-s/tau_j); False when two time constants nearly coincide
    for j in range(3):
        c[j] = taus[j] * taus[j]
        for k in range(3):
            if k != j:
                gap = taus[j] - taus[k]
                if abs(gap) < COINCIDENT * taus[j]:
                    return False
                c[j] /= gap
    return True


@njit(cache=True, error_model="numpy")
def _tables(h, taus, n_kinds, table, stride):  # pragma: no cover - compiled
    # table[kind, j, q] = exp(-offset_q/tau_j); stride[kind, j] = exp(-width/tau_j).  Doubling the
    # block squares both, so only the smallest blocks need exponentials.
    for j in range(3):
        unit = exp(-h / taus[j])
        half = sqrt(unit)
        for q in range(K):
            table[0, j, q] = half
            half *= unit
        stride[0, j] = unit**8
        if n_kinds > 1:
            for q in range(K):
                table[1, j, q] = exp(-16.0 * h * _CHEBYSHEV[q] / taus[j])
            stride[1, j] = stride[0, j] ** 2
        for kind in range(2, n_kinds):
            stride[kind, j] = stride[kind - 1, j] ** 2
            if stride[kind, j] < 1e-150:
                stride[kind, j] = 0.0
            for q in range(K):
                value = table[kind - 1, j, q] ** 2
                table[kind, j, q] = value if value > 1e-150 else 0.0
    # values below 1e-150 count as zero: denormal numbers would slow the sums down


@njit(cache=True, error_model="numpy")
def _node_time(base, kind, h, q):  # pragma: no cover - compiled
    if kind == 0:
        return base + (q + 0.5) * h
    return base + 8.0 * 2.0**kind * h * _CHEBYSHEV[q]


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _add_edge(
    first, last, base, kind, follows, h, taus, c, edge, sign, table, stride, x, xl, E
):  # pragma: no cover - compiled
    # Adds sign * x3(t - edge) at the nodes to x and at one sample before them to xl, and keeps the
    # three exponentials in E (n_blocks, 3, K), zero where the step has not come yet.
    l0, l1, l2 = exp(h / taus[0]) * c[0], exp(h / taus[1]) * c[1], exp(h / taus[2]) * c[2]
    e0 = e1 = e2 = 0.0
    active = False
    for b in range(first, last):
        k = kind[b]
        width = 8.0 * 2.0**k * h
        if base[b] + width <= edge:
            E[b, :, :] = 0.0
            continue
        s = base[b] - edge
        if active and follows[b]:
            step = kind[b - 1]
            e0 *= stride[step, 0]
            e1 *= stride[step, 1]
            e2 *= stride[step, 2]
        else:
            e0, e1, e2 = exp(-s / taus[0]), exp(-s / taus[1]), exp(-s / taus[2])
            active = True
        if e0 < 1e-150:
            e0 = 0.0
        if e1 < 1e-150:
            e1 = 0.0
        if e2 < 1e-150:
            e2 = 0.0
        if s < h:
            for q in range(K):
                u = _node_time(base[b], k, h, q) - edge
                f0, f1, f2 = e0 * table[k, 0, q], e1 * table[k, 1, q], e2 * table[k, 2, q]
                if u <= 0.0:
                    f0 = f1 = f2 = 0.0
                else:
                    x[b, q] += sign * (1.0 - (c[0] * f0 + c[1] * f1 + c[2] * f2))
                    if u > h:
                        xl[b, q] += sign * (1.0 - (l0 * f0 + l1 * f1 + l2 * f2))
                E[b, 0, q], E[b, 1, q], E[b, 2, q] = f0, f1, f2
        else:
            for q in range(K):
                f0, f1, f2 = e0 * table[k, 0, q], e1 * table[k, 1, q], e2 * table[k, 2, q]
                x[b, q] += sign * (1.0 - (c[0] * f0 + c[1] * f1 + c[2] * f2))
                xl[b, q] += sign * (1.0 - (l0 * f0 + l1 * f1 + l2 * f2))
                E[b, 0, q], E[b, 1, q], E[b, 2, q] = f0, f1, f2


@njit(cache=True, error_model="numpy")
def _stable_edge(
    first, last, base, kind, h, rates, edge, sign, x, xl
):  # pragma: no cover - compiled
    for b in range(first, last):
        for q in range(K):
            u = _node_time(base[b], kind[b], h, q) - edge
            x[b, q] += sign * step_response(u, rates)
            xl[b, q] += sign * step_response(u - h, rates)


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _sums(first, last, moments, reference, s2r, x, xl, y0, beta, v0, v1):  # pragma: no cover
    # A = sum r_i^2, B = sum r_i r_(i-1), change of sum log s^2, over the blocks' samples
    A = B = change = tail = 0.0
    for b in range(first, last):
        for q in range(K):
            d = y0 + beta * x[b, q] - reference[b, 0, q]
            dl = y0 + beta * xl[b, q] - reference[b, 1, q]
            s2 = v0 + v1 * x[b, q]
            s2l = v0 + v1 * xl[b, q]
            n, m1, m2 = moments[b, 0, q], moments[b, 1, q], moments[b, 2, q]
            both = s2 * s2l
            around = s2 + s2r[b, q]
            inverse = 1.0 / (both * around)  # one division serves 1/s^2, 1/(s s_lag) and z
            A += (moments[b, 3, q] - 2.0 * d * m1 + d * d * n) * (inverse * around * s2l)
            B += (moments[b, 4, q] - d * m2 - dl * m1 + d * dl * n) * (
                inverse * around * sqrt(both)
            )
            z = (s2 - s2r[b, q]) * (inverse * both)
            z2 = z * z
            tail += n * z2 * z2 * z2 * z2 * z2
            change += n * 2.0 * z * (1.0 + z2 * (1 / 3 + z2 * (0.2 + z2 * (1 / 7 + z2 / 9))))
    if tail > 1e-7:  # what the series leaves out would show; take logarithms
        change = 0.0
        for b in range(first, last):
            for q in range(K):
                change += moments[b, 0, q] * log((v0 + v1 * x[b, q]) / s2r[b, q])
    return A, B, change


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _gram_sums(first, last, moments, reference, s2r, x, xl, y0, beta, v0, v1, A, B):
    # The same for the basis (residual at y0, beta; 1; x): symmetric A (3, 3) and B (3, 3)
    ee = e1 = ex = oo = ox = xx = 0.0
    bee = be1 = bex = boo = box = bxx = 0.0
    change = tail = 0.0
    for b in range(first, last):  # pragma: no cover - compiled
        for q in range(K):
            u, ul = x[b, q], xl[b, q]
            d = y0 + beta * u - reference[b, 0, q]
            dl = y0 + beta * ul - reference[b, 1, q]
            s2 = v0 + v1 * u
            s2l = v0 + v1 * ul
            n, m1, m2 = moments[b, 0, q], moments[b, 1, q], moments[b, 2, q]
            both = s2 * s2l
            around = s2 + s2r[b, q]
            inverse = 1.0 / (both * around)
            w = inverse * around * s2l
            p = inverse * around * sqrt(both)
            r, rl = m1 - d * n, m2 - dl * n
            ee += (moments[b, 3, q] - 2.0 * d * m1 + d * d * n) * w
            e1 += r * w
            ex += r * u * w
            oo += n * w
            ox += n * u * w
            xx += n * u * u * w
            bee += (moments[b, 4, q] - d * m2 - dl * m1 + d * dl * n) * p
            be1 += 0.5 * (r + rl) * p
            bex += 0.5 * (r * ul + rl * u) * p
            boo += n * p
            box += 0.5 * n * (u + ul) * p
            bxx += n * u * ul * p
            z = (s2 - s2r[b, q]) * (inverse * both)
            z2 = z * z
            tail += n * z2 * z2 * z2 * z2 * z2
            change += n * 2.0 * z * (1.0 + z2 * (1 / 3 + z2 * (0.2 + z2 * (1 / 7 + z2 / 9))))
    if tail > 1e-7:
        change = 0.0
        for b in range(first, last):
            for q in range(K):
                change += moments[b, 0, q] * log((v0 + v1 * x[b, q]) / s2r[b, q])
    A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2] = ee, e1, ex, oo, ox, xx
    B[0, 0], B[0, 1], B[0, 2], B[1, 1], B[1, 2], B[2, 2] = bee, be1, bex, boo, box, bxx
    return change


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _gradient_sums(
    first, last, base, kind, h, t0, tf, lag_on, moments, reference, s2r, x, xl, E_on, E_off,
    y0, beta, v0, v1, phi, out,
):  # fmt: skip  # pragma: no cover - compiled
    # Besides A, B and the log term: out (16,) with the derivatives of log L by y0, beta, v0, v1
    # and, for each edge, G_j = sum of E_j g and H_j = sum of s E_j g, g the derivative by x3.
    # Nothing is stored inside the loop, so that it runs several nodes at a time.
    A = B = change = tail = 0.0
    g_y0 = g_beta = g_v0 = g_v1 = 0.0
    P0 = P1 = P2 = R0 = R1 = R2 = 0.0
    N0 = N1 = N2 = S0 = S1 = S2 = 0.0
    a = -0.5 * (1.0 + phi * phi) / (1.0 - phi * phi)
    c = phi / (1.0 - phi * phi)
    l0, l1, l2 = lag_on[0], lag_on[1], lag_on[2]
    for b in range(first, last):
        k = kind[b]
        width = 8.0 * 2.0**k * h
        unit = h if k == 0 else width
        row = min(k, 1)
        start, start_off = base[b] - t0, base[b] - tf
        on_mixed = -width < start < h
        off_mixed = -width < start_off < h
        for q in range(K):
            u, ul = x[b, q], xl[b, q]
            d = y0 + beta * u - reference[b, 0, q]
            dl = y0 + beta * ul - reference[b, 1, q]
            s2 = v0 + v1 * u
            s2l = v0 + v1 * ul
            n, m1, m2 = moments[b, 0, q], moments[b, 1, q], moments[b, 2, q]
            both = s2 * s2l
            around = s2 + s2r[b, q]
            inverse = 1.0 / (both * around)
            w = inverse * around * s2l
            wl = inverse * around * s2
            p = inverse * around * sqrt(both)
            r = d * n - m1
            rl = dl * n - m2
            a_node = (moments[b, 3, q] - 2.0 * d * m1 + d * d * n) * w
            b_node = (moments[b, 4, q] - d * m2 - dl * m1 + d * dl * n) * p
            A += a_node
            B += b_node
            z = (s2 - s2r[b, q]) * (inverse * both)
            z2 = z * z
            tail += n * z2 * z2 * z2 * z2 * z2
            change += n * 2.0 * z * (1.0 + z2 * (1 / 3 + z2 * (0.2 + z2 * (1 / 7 + z2 / 9))))
            g_m = 2.0 * a * w * r + c * p * rl
            g_ml = c * p * r
            g_s = (-a * a_node - 0.5 * c * b_node - 0.5 * n) * w
            g_sl = -0.5 * c * b_node * wl
            g_y0 += g_m + g_ml
            g_beta += g_m * u + g_ml * ul
            g_v0 += g_s + g_sl
            g_v1 += g_s * u + g_sl * ul
            g = beta * g_m + v1 * g_s
            gl = beta * g_ml + v1 * g_sl
            s = start + unit * _OFFSETS[row, q]
            sl = s - h
            # one sample before a node just after the step, the step had not come yet
            gl_on = gl
            if on_mixed:
                gl_on = gl if sl > 0.0 else 0.0
            P0 += E_on[b, 0, q] * (g + l0 * gl_on)
            P1 += E_on[b, 1, q] * (g + l1 * gl_on)
            P2 += E_on[b, 2, q] * (g + l2 * gl_on)
            R0 += E_on[b, 0, q] * (s * g + l0 * sl * gl_on)
            R1 += E_on[b, 1, q] * (s * g + l1 * sl * gl_on)
            R2 += E_on[b, 2, q] * (s * g + l2 * sl * gl_on)
            s = start_off + unit * _OFFSETS[row, q]
            sl = s - h
            gl_off = gl
            if off_mixed:
                gl_off = gl if sl > 0.0 else 0.0
            N0 += E_off[b, 0, q] * (g + l0 * gl_off)
            N1 += E_off[b, 1, q] * (g + l1 * gl_off)
            N2 += E_off[b, 2, q] * (g + l2 * gl_off)
            S0 += E_off[b, 0, q] * (s * g + l0 * sl * gl_off)
            S1 += E_off[b, 1, q] * (s * g + l1 * sl * gl_off)
            S2 += E_off[b, 2, q] * (s * g + l2 * sl * gl_off)
    if tail > 1e-7:
        change = 0.0
        for b in range(first, last):
            for q in range(K):
                change += moments[b, 0, q] * log((v0 + v1 * x[b, q]) / s2r[b, q])
    out[0], out[1], out[2], out[3] = g_y0, g_beta, g_v0, g_v1
    out[4], out[5], out[6], out[7], out[8], out[9] = P0, P1, P2, R0, R1, R2
    out[10], out[11], out[12], out[13], out[14], out[15] = N0, N1, N2, S0, S1, S2
    return A, B, change


@njit(cache=True, error_model="numpy")
def _inside(theta, low, high):  # pragma: no cover - compiled
    for i in range(len(theta)):
        if not (low[i] <= theta[i] <= high[i]):
            return False
    return True


@njit(cache=True, error_model="numpy")
def _across(phi, phi_reference, steps, distance):  # pragma: no cover - compiled
    return phi**distance if phi_reference < 0 else phi_reference ** (steps * distance)


@njit(cache=True, error_model="numpy")
def _per_sample(phi_reference, steps):  # pragma: no cover - compiled
    whole = np.rint(steps)
    if abs(steps - whole) < 1e-9 * max(1.0, steps):
        return phi_reference ** int(whole)
    return phi_reference**steps


@njit(cache=True, error_model="numpy")
def _constants(theta, k, mesh, taus):  # pragma: no cover - compiled
    # Time constants of experiment k (valve, manifold, sensor) and its two switch times.  A sensor
    # far faster than a block is replaced by a slower one with the same delay: exp(h/tau) would
    # overflow, and the response differs by a second-order term below 1e-9 of the step.
    h = mesh.setting[k, 0]
    taus[0] = theta[1]
    taus[1] = theta[2] / mesh.setting[k, 1]
    taus[2] = theta[0]
    t0 = theta[mesh.local[k, 2]]
    tf = theta[mesh.local[k, 3]] if mesh.local[k, 3] >= 0 else np.inf
    least = mesh.setting[k, 4]
    if taus[2] < least:
        t0 += taus[2] - least
        tf += taus[2] - least
        taus[2] = least
    return h, t0, tf


@njit(cache=True, error_model="numpy")
def _responses(k, mesh, taus, t0, tf, h, c, x, xl, E_on, E_off, table, stride):  # pragma: no cover
    # x3 at the nodes and one sample before; False when the stable (slow) form was used
    first, last = mesh.blocks[k], mesh.blocks[k + 1]
    x[first:last] = 0.0
    xl[first:last] = 0.0
    if _partial_fractions(taus, c):
        _tables(h, taus, mesh.n_kinds, table, stride)
        _add_edge(
            first, last, mesh.base, mesh.kind, mesh.follows, h, taus, c, t0, 1.0, table, stride,
            x, xl, E_on,
        )  # fmt: skip
        if tf < np.inf:
            _add_edge(
                first, last, mesh.base, mesh.kind, mesh.follows, h, taus, c, tf, -1.0, table, stride,
                x, xl, E_off,
            )  # fmt: skip
        return True
    rates = np.sort(1.0 / taus)
    _stable_edge(first, last, mesh.base, mesh.kind, h, rates, t0, 1.0, x, xl)
    if tf < np.inf:
        _stable_edge(first, last, mesh.base, mesh.kind, h, rates, tf, -1.0, x, xl)
    return False


@njit(cache=True, error_model="numpy")
def _edge_responses(k, mesh, taus, t0, tf, xe):  # pragma: no cover - compiled
    slowest = max(taus[0], taus[1], taus[2])
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        for side in range(2):
            value = 0.0
            for edge, sign in ((t0, 1.0), (tf, -1.0)):
                s = mesh.edge_t[run, side] - edge
                if s > 45.0 * slowest:
                    value += sign
                elif s > 0.0:
                    value += sign * step_response(s, np.sort(1.0 / taus))
            xe[run, side] = value


@njit(cache=True, error_model="numpy")
def _combine(k, mesh, phi, phi_reference, A, B, re, log_s2):  # pragma: no cover - compiled
    # log L of one experiment from block sums and standardised residuals of the edge samples
    rest = 1.0 - phi * phi
    squares = (1.0 + phi * phi) * A - 2.0 * phi * B
    total = mesh.pairs[k] * log(rest) + log_s2 + mesh.n_samples[k] * log(2.0 * pi)
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        a, b = re[run, 0], re[run, 1]
        squares += phi * phi * (a * a - b * b)
        if run == mesh.runs[k]:
            total += a * a
        else:
            across = _across(phi, phi_reference, mesh.setting[k, 3], mesh.distance[run])
            e = a - across * re[run - 1, 1]
            total += e * e / (1.0 - across * across) + log(1.0 - across * across)
    return -0.5 * (total + squares / rest)


@njit(cache=True, error_model="numpy")
def _edge_log(k, mesh, s2e):  # pragma: no cover - compiled
    # log s^2 of the first sample of every run; the last one is in the blocks
    total = 0.0
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        total += log(s2e[run, 0])
    return total


@njit(cache=True, error_model="numpy")
def _value(theta, mesh, x, xl, E_on, E_off, each):  # pragma: no cover - compiled
    # each (n_exp,): filled with every experiment's part
    taus, c = np.empty(3), np.empty(3)
    table, stride = np.empty((mesh.n_kinds, 3, K)), np.empty((mesh.n_kinds, 3))
    xe = np.empty((len(mesh.distance), 2))
    re = np.empty((len(mesh.distance), 2))
    s2e = np.empty((len(mesh.distance), 2))
    total = 0.0
    for k in range(len(mesh.local)):
        h, t0, tf = _constants(theta, k, mesh, taus)
        phi_reference, sigma0, sigma1 = (
            theta[mesh.noise[k, 0]], theta[mesh.noise[k, 1]], theta[mesh.noise[k, 2]]
        )  # fmt: skip
        phi = _per_sample(phi_reference, mesh.setting[k, 3])
        y0, beta = theta[mesh.local[k, 0]], theta[mesh.local[k, 1]]
        v0, v1 = sigma0 * sigma0, sigma1 * sigma1 * mesh.setting[k, 2]
        _responses(k, mesh, taus, t0, tf, h, c, x, xl, E_on, E_off, table, stride)
        _edge_responses(k, mesh, taus, t0, tf, xe)
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            for side in range(2):
                s2e[run, side] = v0 + v1 * xe[run, side]
                re[run, side] = (mesh.edge_y[run, side] - y0 - beta * xe[run, side]) / sqrt(
                    s2e[run, side]
                )
        A, B, change = _sums(
            mesh.blocks[k], mesh.blocks[k + 1], mesh.moments, mesh.reference, mesh.reference_s2,
            x, xl, y0, beta, v0, v1,
        )  # fmt: skip
        log_s2 = mesh.log_s2[k] + change + _edge_log(k, mesh, s2e)
        each[k] = _combine(k, mesh, phi, phi_reference, A, B, re, log_s2)
        total += each[k]
    return total


@njit(cache=True, error_model="numpy")
def _value_and_gradient(theta, mesh, x, xl, E_on, E_off, gradient):  # pragma: no cover
    taus, c = np.empty(3), np.empty(3)
    sums, lags = np.empty(16), np.empty(3)
    table, stride = np.empty((mesh.n_kinds, 3, K)), np.empty((mesh.n_kinds, 3))
    xe = np.empty((len(mesh.distance), 2))
    re = np.empty((len(mesh.distance), 2))
    s2e = np.empty((len(mesh.distance), 2))
    gre = np.empty((len(mesh.distance), 2))
    gradient[:] = 0.0
    total = 0.0
    for k in range(len(mesh.local)):
        first, last = mesh.blocks[k], mesh.blocks[k + 1]
        i_y0, i_beta, i_t0, i_tf = mesh.local[k]
        i_phi, i_s0, i_s1 = mesh.noise[k]
        h, t0, tf = _constants(theta, k, mesh, taus)
        phi_reference, sigma0, sigma1 = theta[i_phi], theta[i_s0], theta[i_s1]
        steps, weight = mesh.setting[k, 3], mesh.setting[k, 2]
        phi = _per_sample(phi_reference, steps)
        y0, beta = theta[i_y0], theta[i_beta]
        v0, v1 = sigma0 * sigma0, sigma1 * sigma1 * weight
        if i_tf < 0:
            E_off[first:last] = 0.0
        if not _responses(k, mesh, taus, t0, tf, h, c, x, xl, E_on, E_off, table, stride):
            return np.nan  # nearly equal time constants: the caller takes the stable route
        _edge_responses(k, mesh, taus, t0, tf, xe)
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            for side in range(2):
                s2e[run, side] = v0 + v1 * xe[run, side]
                re[run, side] = (mesh.edge_y[run, side] - y0 - beta * xe[run, side]) / sqrt(
                    s2e[run, side]
                )
        for j in range(3):
            lags[j] = exp(h / taus[j])
        A, B, change = _gradient_sums(
            first, last, mesh.base, mesh.kind, h, t0, tf if i_tf >= 0 else 1e300, lags,
            mesh.moments, mesh.reference, mesh.reference_s2, x, xl, E_on, E_off,
            y0, beta, v0, v1, phi, sums,
        )  # fmt: skip
        log_s2 = mesh.log_s2[k] + change + _edge_log(k, mesh, s2e)
        total += _combine(k, mesh, phi, phi_reference, A, B, re, log_s2)

        # phi: of the block sums, then of the pairs across gaps
        rest = 1.0 - phi * phi
        squares = (1.0 + phi * phi) * A - 2.0 * phi * B
        d_squares = 2.0 * phi * A - 2.0 * B
        g_across = 0.0
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            a, b = re[run, 0], re[run, 1]
            squares += phi * phi * (a * a - b * b)
            d_squares += 2.0 * phi * (a * a - b * b)
            gre[run, 0] = -phi * phi * a / rest
            gre[run, 1] = phi * phi * b / rest
            if run == mesh.runs[k]:
                gre[run, 0] -= a
            else:
                distance = mesh.distance[run]
                across = _across(phi, phi_reference, steps, distance)
                left = 1.0 - across * across
                e = a - across * re[run - 1, 1]
                gre[run, 0] -= e / left
                gre[run - 1, 1] += across * e / left
                d_log = e * re[run - 1, 1] / left - across * e * e / left**2 + across / left
                slope = distance * phi ** (distance - 1) if phi_reference < 0 else 0.0
                if phi_reference > 0:
                    slope = steps * distance * across / phi_reference
                    g_across += d_log * slope
                elif phi_reference < 0:
                    g_across += d_log * slope * _phi_slope(phi, phi_reference, steps)
        g_phi = -0.5 * (d_squares / rest + 2.0 * phi * squares / rest**2)
        g_phi += mesh.pairs[k] * phi / rest
        gradient[i_phi] += g_phi * _phi_slope(phi, phi_reference, steps) + g_across

        # edge samples: residual r = (y - m)/s
        g_v0, g_v1 = sums[2], sums[3]
        g_y0, g_beta = sums[0], sums[1]
        rates = np.sort(1.0 / taus)
        slowest = 1.0 / rates[0]
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            for side in range(2):
                g_m = -gre[run, side] / sqrt(s2e[run, side])
                g_s2 = -0.5 * gre[run, side] * re[run, side] / s2e[run, side]
                if side == 0:
                    g_s2 -= 0.5 / s2e[run, side]
                g_y0 += g_m
                g_beta += g_m * xe[run, side]
                g_v0 += g_s2
                g_v1 += g_s2 * xe[run, side]
                g_x = beta * g_m + v1 * g_s2
                for edge, sign, i_edge in ((t0, 1.0, i_t0), (tf, -1.0, i_tf)):
                    s = mesh.edge_t[run, side] - edge
                    if 0.0 < s < 60.0 * slowest:
                        slope_edge = 0.0
                        for j in range(3):
                            f = exp(-s / taus[j])
                            slope_edge -= c[j] * f / taus[j]
                            d_tau = -c[j] * f * s / taus[j] ** 2
                            for m in range(3):
                                d_tau -= _d_coefficient(c, taus, m, j) * exp(-s / taus[m])
                            _add_tau(gradient, theta, mesh, k, j, sign * g_x * d_tau)
                        gradient[i_edge] += sign * g_x * slope_edge
        gradient[i_y0] += g_y0
        gradient[i_beta] += g_beta
        gradient[i_s0] += 2.0 * sigma0 * g_v0
        gradient[i_s1] += 2.0 * sigma1 * weight * g_v1

        for edge, sign, i_edge in ((t0, 1.0, i_t0), (tf, -1.0, i_tf)):
            if edge == np.inf:
                continue
            G, H = (sums[4:7], sums[7:10]) if sign > 0 else (sums[10:13], sums[13:16])
            for j in range(3):
                d_tau = -c[j] * H[j] / taus[j] ** 2
                for m in range(3):
                    d_tau -= _d_coefficient(c, taus, m, j) * G[m]
                _add_tau(gradient, theta, mesh, k, j, sign * d_tau)
                gradient[i_edge] -= sign * c[j] * G[j] / taus[j]
        if theta[0] < mesh.setting[k, 4]:
            gradient[0] += gradient[i_t0]
            if i_tf >= 0:
                gradient[0] += gradient[i_tf]
    return total


@njit(cache=True, error_model="numpy")
def _phi_slope(phi, phi_reference, steps):  # pragma: no cover - compiled
    # derivative of phi_reference ** steps
    if steps == 1.0:
        return 1.0
    if phi_reference == 0.0:
        return 0.0
    return steps * phi / phi_reference


@njit(cache=True, error_model="numpy")
def _d_coefficient(c, taus, m, j):  # pragma: no cover - compiled
    # derivative of c_m by tau_j
    if m != j:
        return c[m] / (taus[m] - taus[j])
    value = 2.0 / taus[j]
    for n in range(3):
        if n != j:
            value -= 1.0 / (taus[j] - taus[n])
    return c[j] * value


@njit(cache=True, error_model="numpy")
def _add_tau(gradient, theta, mesh, k, j, value):  # pragma: no cover - compiled
    if j == 0:
        gradient[1] += value
    elif j == 1:
        gradient[2] += value / mesh.setting[k, 1]
    elif theta[0] >= mesh.setting[k, 4]:
        gradient[0] += value
    # a sensor faster than that acts as a pure delay, see _constants: the caller adds that part


@njit(cache=True, error_model="numpy")
def _marginal(theta, mesh, x, xl, E_on, E_off, best, factor):  # pragma: no cover - compiled
    # log L with every y0, beta integrated out under flat priors; best (n_exp, 2) their conditional
    # means, factor (n_exp, 3) the conditional precision's Cholesky factor (l11, l21, l22)
    taus, c = np.empty(3), np.empty(3)
    table, stride = np.empty((mesh.n_kinds, 3, K)), np.empty((mesh.n_kinds, 3))
    xe = np.empty((len(mesh.distance), 2))
    s2e = np.empty((len(mesh.distance), 2))
    basis = np.empty((len(mesh.distance), 2, 3))
    A, B, Q = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    total = 0.0
    for k in range(len(mesh.local)):
        first, last = mesh.blocks[k], mesh.blocks[k + 1]
        h, t0, tf = _constants(theta, k, mesh, taus)
        phi_reference, sigma0, sigma1 = (
            theta[mesh.noise[k, 0]], theta[mesh.noise[k, 1]], theta[mesh.noise[k, 2]]
        )  # fmt: skip
        phi = _per_sample(phi_reference, mesh.setting[k, 3])
        rest = 1.0 - phi * phi
        # any y0, beta serves as origin: the mesh's own reference keeps the numbers small
        y0, beta = mesh.setting[k, 5], mesh.setting[k, 6]
        v0, v1 = sigma0 * sigma0, sigma1 * sigma1 * mesh.setting[k, 2]
        _responses(k, mesh, taus, t0, tf, h, c, x, xl, E_on, E_off, table, stride)
        _edge_responses(k, mesh, taus, t0, tf, xe)
        change = _gram_sums(
            first, last, mesh.moments, mesh.reference, mesh.reference_s2,
            x, xl, y0, beta, v0, v1, A, B,
        )  # fmt: skip
        logs = mesh.log_s2[k] + change + mesh.n_samples[k] * log(2.0 * pi)
        logs += mesh.pairs[k] * log(rest)
        for i in range(3):
            for j in range(i, 3):
                Q[i, j] = ((1.0 + phi * phi) * A[i, j] - 2.0 * phi * B[i, j]) / rest
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            for side in range(2):
                s2e[run, side] = v0 + v1 * xe[run, side]
                w = 1.0 / sqrt(s2e[run, side])
                basis[run, side, 0] = (mesh.edge_y[run, side] - y0 - beta * xe[run, side]) * w
                basis[run, side, 1] = w
                basis[run, side, 2] = xe[run, side] * w
            logs += log(s2e[run, 0])
            across = 0.0
            if run > mesh.runs[k]:
                across = _across(phi, phi_reference, mesh.setting[k, 3], mesh.distance[run])
                logs += log(1.0 - across * across)
            for i in range(3):
                a = basis[run, 0, i]
                for j in range(i, 3):
                    Q[i, j] += (
                        phi
                        * phi
                        / rest
                        * (a * basis[run, 0, j] - basis[run, 1, i] * basis[run, 1, j])
                    )
                    if run == mesh.runs[k]:
                        Q[i, j] += a * basis[run, 0, j]
                    else:
                        u = a - across * basis[run - 1, 1, i]
                        v = basis[run, 0, j] - across * basis[run - 1, 1, j]
                        Q[i, j] += u * v / (1.0 - across * across)
        l11 = sqrt(Q[1, 1])
        l21 = Q[1, 2] / l11
        l22 = sqrt(Q[2, 2] - l21 * l21)
        u1 = Q[0, 1] / l11
        u2 = (Q[0, 2] - l21 * u1) / l22
        best[k, 1] = u2 / l22
        best[k, 0] = (u1 - l21 * best[k, 1]) / l11
        best[k, 0] += y0
        best[k, 1] += beta
        factor[k, 0], factor[k, 1], factor[k, 2] = l11, l21, l22
        total += -0.5 * (logs + Q[0, 0] - u1 * u1 - u2 * u2) - log(l11) - log(l22) + log(2.0 * pi)
    return total


@njit(cache=True, error_model="numpy")
def _values(thetas, mesh, x, xl, E_on, E_off, each, inside):  # pragma: no cover - compiled
    for i in range(len(thetas)):
        inside[i] = _inside(thetas[i], mesh.low, mesh.high)
        if inside[i]:
            _value(thetas[i], mesh, x, xl, E_on, E_off, each[i])


@njit(cache=True, error_model="numpy")
def _marginals(thetas, mesh, x, xl, E_on, E_off, values, best, factor, inside):  # pragma: no cover
    for i in range(len(thetas)):
        inside[i] = _inside(thetas[i], mesh.low, mesh.high)
        if inside[i]:
            values[i] = _marginal(thetas[i], mesh, x, xl, E_on, E_off, best[i], factor[i])


@njit(cache=True, error_model="numpy")
def _general(k, mesh, phi, phi_reference, m, ml, s2, s2l, me, s2e):  # pragma: no cover - compiled
    # log L of experiment k for any smooth mean and variance given at the nodes and edge samples
    first = mesh.blocks[k]
    A = B = log_s2 = 0.0
    for b in range(len(m)):
        for q in range(K):
            d = m[b, q] - mesh.reference[first + b, 0, q]
            dl = ml[b, q] - mesh.reference[first + b, 1, q]
            n, m1, m2, m3, m4 = mesh.moments[first + b, :, q]
            A += (m3 - 2.0 * d * m1 + d * d * n) / s2[b, q]
            B += (m4 - d * m2 - dl * m1 + d * dl * n) / sqrt(s2[b, q] * s2l[b, q])
            log_s2 += n * log(s2[b, q])
    re = np.empty((len(mesh.distance), 2))
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        for side in range(2):
            i = run - mesh.runs[k]
            re[run, side] = (mesh.edge_y[run, side] - me[i, side]) / sqrt(s2e[i, side])
        log_s2 += log(s2e[run - mesh.runs[k], 0])
    return _combine(k, mesh, phi, phi_reference, A, B, re, log_s2)


# --------------------------------------------------------------------------- building the mesh


def _lagrange(points: FloatArray) -> FloatArray:
    """(n, K) values of the K Lagrange polynomials of the Chebyshev nodes on [0, 1] at ``points``."""
    weights = (-1.0) ** np.arange(K) * np.sin((2 * np.arange(K) + 1) * pi / (2 * K))
    distance = points[:, None] - _CHEBYSHEV
    hit = np.abs(distance) < 1e-14
    distance[hit] = 1.0
    terms = weights / distance
    values = terms / terms.sum(axis=1, keepdims=True)
    rows = hit.any(axis=1)
    values[rows] = hit[rows]
    return values


@dataclass(frozen=True)
class Region:
    """Box of the flat vector for which a mesh is built; (n_theta,) each."""

    low: FloatArray
    high: FloatArray


def _blocks_of_run(
    first: int, last: int, e: Experiment, windows: list[tuple[float, float]], width_after, narrow
) -> list[tuple[int, int, int]]:
    """(start, samples, kind) of the blocks covering samples first .. last - 1 of one run."""
    h, t_first = e.interval, e.t[0]
    blocks = []
    i = first
    longest = max(8.0, (last - first) / 6.0)
    while i < last:
        t = t_first + i * h
        allowed = longest * h
        for low, high in windows:
            if t >= high:
                allowed = min(allowed, max(narrow, width_after(t - high)))
            elif t >= low:
                allowed = min(allowed, narrow)
        kind = 0
        # a block may reach up to a window, or into it only when narrow
        while True:
            n = 16 * 2**kind
            end = t + n * h
            if n > last - i or n * h > allowed:
                break
            if n * h > narrow and any(low < end and t < high for low, high in windows):
                break
            kind += 1
        n = 8 * 2**kind
        blocks.append((i, min(n, last - i), kind))
        i += n
    return blocks


def _width_after(taus: FloatArray):
    """Block width (s) at a time s after the last possible switch, for time constants (n, 3)."""
    coefficients = []
    for row in taus:
        for j in range(3):
            others = [row[j] - row[m] for m in range(3) if m != j]
            c = row[j] ** 2 / max(abs(others[0] * others[1]), (0.05 * row[j]) ** 2)
            coefficients.append((row[j], c))
    tau, c = np.array(coefficients).T
    factorial = float(np.prod(np.arange(1, K + 1)))

    def width(s: float) -> float:
        with np.errstate(over="ignore"):
            growth = np.exp(np.minimum(s / tau, 600.0))
        return float(
            NARROWER * np.min(4.0 * tau * (TOLERANCE * factorial * growth / (2.0 * c)) ** (1.0 / K))
        )

    return width


def build(problem: Problem, vector: FloatArray, region: Region, data: bool = True) -> Arrays:
    """The mesh of a campaign (or design) around ``vector`` for all theta inside ``region``.

    ``data=False`` leaves the data out (counts only), as does a design.
    """
    layout, campaign = problem.layout, problem.campaign
    low, high = region.low, region.high
    blocks, runs = [0], [0]
    setting = np.zeros((len(campaign), 7))
    base: list[float] = []
    kinds: list[int] = []
    follows: list[bool] = []
    moments, reference, reference_s2 = [], [], []
    log_s2, edge_t, edge_y, distance, pairs = [], [], [], [], []
    cache: dict[int, FloatArray] = {}
    for k, e in enumerate(campaign):
        h = e.interval
        i_y0, i_beta, i_t0, i_tf = layout.local[k]
        width_after, narrow = _widths(vector, region, e)
        # a sensor faster than this is replaced by a delay: no exponential may overflow
        least = max(16.0 * h, narrow) / 300.0
        windows = [(low[i] - least - h, high[i] + h) for i in (i_t0, i_tf) if i >= 0]
        setting[k] = (
            h,
            e.total_flow,
            problem.noise.weight(campaign, e),
            problem.steps(e),
            least,
            vector[i_y0],
            vector[i_beta],
        )
        with_data = data and e.y is not None
        if with_data:
            mean, _ = mean_and_variance(problem, vector, k)
            d = e.values - mean
        previous = -1
        n_pairs = 0
        first_block = len(base)
        for a, b in e.runs:
            edge_t.append((e.t[a], e.t[b - 1]))
            edge_y.append((e.values[a], e.values[b - 1]) if with_data else (0.0, 0.0))
            distance.append(a - previous)
            previous = b - 1
            n_pairs += b - a - 1
            run_start = len(base)
            for start, n, kind in _blocks_of_run(a + 1, b, e, windows, width_after, narrow):
                if kind == 0:
                    L = np.eye(n, K)
                else:
                    if n not in cache:
                        cache[n] = _lagrange((np.arange(n) + 0.5) / n)
                    L = cache[n]
                stack = np.zeros((5, n))
                stack[0] = 1.0
                if with_data:
                    stack[1], stack[2] = d[start : start + n], d[start - 1 : start + n - 1]
                    stack[3], stack[4] = stack[1] ** 2, stack[1] * stack[2]
                moments.append(stack @ L)
                follows.append(len(base) > run_start)
                base.append(e.t[0] + (start - 0.5) * h)
                kinds.append(kind)
        times = _node_times(np.array(base[first_block:]), np.array(kinds[first_block:]), h)
        node_mean, node_s2 = _at(problem, vector, e, k, times)
        lag_mean, _ = _at(problem, vector, e, k, times - h)
        reference.append(np.stack([node_mean, lag_mean], axis=1))
        reference_s2.append(node_s2)
        counts = np.array([m[0] for m in moments[first_block:]]).reshape(-1, K)
        log_s2.append(float((counts * np.log(node_s2)).sum()))
        pairs.append(n_pairs)
        blocks.append(len(base))
        runs.append(len(distance))
    return Arrays(
        local=layout.local,
        noise=layout.noise,
        blocks=np.array(blocks),
        runs=np.array(runs),
        setting=setting,
        n_samples=np.array([e.n_samples for e in campaign], dtype=float),
        base=np.array(base, dtype=float),
        kind=np.array(kinds, dtype=np.int64),
        follows=np.array(follows, dtype=bool),
        moments=np.array(moments, dtype=float).reshape(-1, 5, K),
        reference=np.concatenate(reference),
        reference_s2=np.concatenate(reference_s2),
        log_s2=np.array(log_s2),
        edge_t=np.array(edge_t, dtype=float),
        edge_y=np.array(edge_y, dtype=float),
        distance=np.array(distance, dtype=float),
        pairs=np.array(pairs, dtype=float),
        low=np.ascontiguousarray(low, dtype=float),
        high=np.ascontiguousarray(high, dtype=float),
        n_kinds=max([0, *kinds]) + 1,
    )


def _widths(vector: FloatArray, region: Region, e: Experiment):
    """Block width after a switch as a function of time, and the width where a switch may fall."""
    low, high = region.low, region.high
    candidates = np.array(
        [
            (tau_v, V / e.total_flow, tau)
            for tau in np.geomspace(max(low[0], 1e-3 * high[0]), high[0], 5)
            for tau_v in (low[1], high[1])
            for V in (low[2], high[2])
        ]
    )
    slowest = max(vector[0], vector[1], vector[2] / e.total_flow)
    return _width_after(candidates), WINDOW_BLOCK * slowest


def _node_times(base: FloatArray, kind: np.ndarray, h: float) -> FloatArray:
    """(n_blocks, K) s."""
    pointwise = (np.arange(K) + 0.5) * h
    spread = 8.0 * 2.0 ** kind[:, None] * h * _CHEBYSHEV
    return base[:, None] + np.where(kind[:, None] == 0, pointwise, spread)


def _at(problem, vector, e, k, times):
    """Mean and variance of one experiment at any times, in the shape of ``times``."""
    layout, model = problem.layout, problem.model
    _, sigma0, sigma1 = vector[layout.noise[k]]
    flat = np.ascontiguousarray(times).ravel()
    x = model.response(flat, vector, layout, e)
    mean = model.mean(flat, vector, layout, e)
    s2 = scale_squared(x, sigma0, sigma1, problem.noise.weight(problem.campaign, e))
    return mean.reshape(times.shape), s2.reshape(times.shape)


# --------------------------------------------------------------------------- the record


@dataclass(frozen=True)
class Nodes:
    """Weighted points that stand for the samples of one experiment.

    For a mean m that is smooth between switches, ``sum_i (y_i - m(t_i))^2`` is a constant plus
    ``sum count (y - m(t))^2``, and ``sum_i f(t_i)`` is ``sum count f(t)``.
    """

    t: FloatArray
    """(n,) s"""
    count: FloatArray
    """(n,) how many samples the point stands for"""
    y: FloatArray
    """(n,) V, their weighted mean; the reference mean for a design"""


class Compressed:
    """A campaign's data reduced to a mesh; evaluates likelihoods in microseconds.

    Made by :func:`compress`.  ``region`` is the box of theta for which the mesh was built: outside
    it, :meth:`log_likelihood` and the others use the exact full pass (slow, never wrong);
    ``n_full_passes`` counts how often that happened.  One object is not to be shared by threads.
    """

    def __init__(self, problem: Problem, vector: FloatArray, region: Region) -> None:
        self.problem = problem
        self.reference = vector
        self.region = region
        self.arrays = build(problem, vector, region)
        self.n_full_passes = 0
        shape = (len(self.arrays.base), K)
        self._x, self._xl = np.zeros(shape), np.zeros(shape)
        self._each = np.zeros(len(problem.campaign))
        self._E_on, self._E_off = (np.zeros((shape[0], 3, K)) for _ in range(2))
        self._cascade = type(problem.model) is Cascade and problem.model.method == "exact"

    @property
    def n_nodes(self) -> int:
        """Nodes of all experiments together."""
        return len(self.arrays.base) * K

    def _fast(self, theta: FloatArray) -> bool:
        return self._cascade and bool(_inside(theta, self.arrays.low, self.arrays.high))

    def _vector(self, theta: Theta) -> FloatArray:
        vector = theta if isinstance(theta, np.ndarray) else self.problem.layout.flat(theta)
        if vector.shape != self.arrays.low.shape:
            vector = self.problem.layout.flat(vector)
        return np.ascontiguousarray(vector, dtype=float)

    def _full(self, theta: FloatArray) -> float:
        self.n_full_passes += 1
        n_exp = len(self.problem.campaign)
        return sum(experiment_log_likelihood(self.problem, theta, k) for k in range(n_exp))

    def log_likelihood(self, theta: Theta) -> float:
        """The exact log-likelihood to within the mesh's error (see :meth:`error`)."""
        vector = self._vector(theta)
        if not self._fast(vector):
            return self._outside(vector)
        return _value(vector, self.arrays, self._x, self._xl, self._E_on, self._E_off, self._each)

    def _outside(self, vector: FloatArray) -> float:
        if not self._cascade and self._inside_mean(vector):
            return self._general(vector)
        return self._full(vector)

    def _inside_mean(self, vector: FloatArray) -> bool:
        return bool(_inside(vector, self.arrays.low, self.arrays.high))

    def _general(self, vector: FloatArray) -> float:
        problem, mesh = self.problem, self.arrays
        total = 0.0
        for k, e in enumerate(problem.campaign):
            phi_reference, sigma0, sigma1 = (float(v) for v in vector[problem.layout.noise[k]])
            phi = lag_coefficient(phi_reference, problem.steps(e))
            if not (abs(phi) < 1.0 and sigma0 > 0.0 and sigma1 >= 0.0):
                return -np.inf
            times = self.node_times(k)
            m, s2 = _at(problem, vector, e, k, times)
            ml, s2l = _at(problem, vector, e, k, times - e.interval)
            me, s2e = _at(problem, vector, e, k, mesh.edge_t[mesh.runs[k] : mesh.runs[k + 1]])
            total += _general(k, mesh, phi, phi_reference, m, ml, s2, s2l, me, s2e)
        return float(total)

    def value_and_gradient(self, theta: Theta) -> tuple[float, FloatArray]:
        """Log-likelihood and its gradient (n_theta,) by the flat vector."""
        vector = self._vector(theta)
        gradient = np.empty(len(vector))
        value = np.nan
        if self._fast(vector):
            value = _value_and_gradient(
                vector, self.arrays, self._x, self._xl, self._E_on, self._E_off, gradient
            )  # fmt: skip
        if np.isnan(value):
            return self.log_likelihood(vector), self._numerical_gradient(vector)
        return value, gradient

    def gradient(self, theta: Theta) -> FloatArray:
        """Gradient (n_theta,) of the log-likelihood."""
        return self.value_and_gradient(theta)[1]

    def _numerical_gradient(self, vector: FloatArray) -> FloatArray:
        # outside the mesh, or where partial fractions would cancel: central differences with the
        # step that balances rounding against curvature
        gradient = np.empty(len(vector))
        for i in range(len(vector)):
            step = 1e-5 * max(abs(vector[i]), 1e-3)
            up, down = vector.copy(), vector.copy()
            up[i] += step
            down[i] -= step
            gradient[i] = (self.log_likelihood(up) - self.log_likelihood(down)) / (2.0 * step)
        return gradient

    def marginal(self, theta: Theta) -> tuple[float, FloatArray, FloatArray]:
        """Log-likelihood with every y0 and beta integrated out under flat priors.

        Returns (value, best, factor): ``best`` (n_experiments, 2) the conditional means of y0 and
        beta, ``factor`` (n_experiments, 3) the Cholesky factor (l11, l21, l22) of their
        conditional precision.  ``theta``'s own y0 and beta are not used.  Raises CampaignError
        outside the region (the caller re-meshes) and for models other than the cascade.
        """
        vector = self._vector(theta)
        n_exp = len(self.problem.campaign)
        vector = vector.copy()
        vector[self.problem.layout.local[:, :2]] = self.reference[self.problem.layout.local[:, :2]]
        if not self._fast(vector):
            return self._marginal_outside(vector)
        best, factor = np.empty((n_exp, 2)), np.empty((n_exp, 3))
        value = _marginal(
            vector, self.arrays, self._x, self._xl, self._E_on, self._E_off, best, factor
        )
        return value, best, factor

    def log_likelihoods(self, thetas: FloatArray) -> FloatArray:
        """(n, n_experiments) log-likelihood of every experiment at each row of ``thetas``."""
        thetas = np.ascontiguousarray(thetas, dtype=float)
        each = np.zeros((len(thetas), len(self.problem.campaign)))
        inside = np.zeros(len(thetas), dtype=bool)
        if self._cascade:
            _values(thetas, self.arrays, self._x, self._xl, self._E_on, self._E_off, each, inside)
        for i in np.flatnonzero(~inside):
            self.n_full_passes += 1
            for k in range(each.shape[1]):
                each[i, k] = experiment_log_likelihood(self.problem, thetas[i], k)
        return each

    def marginals(self, thetas: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """:meth:`marginal` for every row of ``thetas`` (n, n_theta): (n,), (n, n_exp, 2), (n, n_exp, 3)."""
        local = self.problem.layout.local
        thetas = np.array(thetas, dtype=float)
        thetas[:, local[:, :2]] = self.reference[local[:, :2]]
        n_exp = len(self.problem.campaign)
        values = np.zeros(len(thetas))
        best, factor = np.zeros((len(thetas), n_exp, 2)), np.ones((len(thetas), n_exp, 3))
        inside = np.zeros(len(thetas), dtype=bool)
        if self._cascade:
            _marginals(
                thetas, self.arrays, self._x, self._xl, self._E_on, self._E_off,
                values, best, factor, inside,
            )  # fmt: skip
        for i in np.flatnonzero(~inside):
            values[i], best[i], factor[i] = self._marginal_outside(thetas[i])
        return values, best, factor

    def _marginal_outside(self, vector: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        # log L is quadratic in (y0, beta) of each experiment: six values of the full pass fix it
        problem = self.problem
        local = problem.layout.local
        n_exp = len(problem.campaign)
        best, factor = np.zeros((n_exp, 2)), np.ones((n_exp, 3))
        total = 0.0
        self.n_full_passes += 1
        for k in range(n_exp):
            origin = vector[local[k, :2]]
            unit = max(abs(origin[1]), 1e-3)

            def at(u, w, k=k, origin=origin, unit=unit):
                trial = vector.copy()
                trial[local[k, :2]] = origin + unit * np.array([u, w])
                return experiment_log_likelihood(problem, trial, k)

            f00 = at(0.0, 0.0)
            if not np.isfinite(f00):
                return -np.inf, best, factor
            fp0, fm0, f0p, f0m, fpp = at(1, 0), at(-1, 0), at(0, 1), at(0, -1), at(1, 1)
            g = np.array([fp0 - fm0, f0p - f0m]) / 2.0
            hxx, hyy = 2 * f00 - fp0 - fm0, 2 * f00 - f0p - f0m
            hxy = fp0 + f0p - fpp - f00
            precision = np.array([[hxx, hxy], [hxy, hyy]])
            if not (hxx > 0 and np.linalg.det(precision) > 0):
                return -np.inf, best, factor
            move = np.linalg.solve(precision, g)
            best[k] = origin + unit * move
            lower = np.linalg.cholesky(precision / unit**2)
            factor[k] = lower[0, 0], lower[1, 0], lower[1, 1]
            total += f00 + 0.5 * g @ move - log(lower[0, 0] * lower[1, 1]) + log(2.0 * pi)
        return total, best, factor

    def node_times(self, k: int) -> FloatArray:
        """(n_blocks, K) s, the nodes of experiment number ``k``."""
        mesh = self.arrays
        part = slice(mesh.blocks[k], mesh.blocks[k + 1])
        return _node_times(mesh.base[part], mesh.kind[part], mesh.setting[k, 0])

    def nodes(self, k: int) -> Nodes:
        """The weighted points of experiment number ``k``; points of weight 0 are left out."""
        mesh = self.arrays
        part = slice(mesh.blocks[k], mesh.blocks[k + 1])
        count = mesh.moments[part, 0].ravel()
        keep = count > 1e-9
        mean = mesh.reference[part, 0].ravel()[keep]
        mean = mean + mesh.moments[part, 1].ravel()[keep] / count[keep]
        runs = slice(mesh.runs[k], mesh.runs[k + 1])
        first = mesh.edge_y[runs, 0]
        if self.problem.campaign.experiments[k].y is None:
            e = self.problem.campaign.experiments[k]
            first, _ = _at(self.problem, self.reference, e, k, mesh.edge_t[runs, 0])
        return Nodes(
            np.concatenate([mesh.edge_t[runs, 0], self.node_times(k).ravel()[keep]]),
            np.concatenate([np.ones(len(first)), count[keep]]),
            np.concatenate([first, mean]),
        )

    def error(self, thetas: FloatArray) -> float:
        """Largest |compressed - full pass| of log L over the rows of ``thetas`` (n, n_theta)."""
        worst = 0.0
        passes = self.n_full_passes
        for row in np.atleast_2d(thetas):
            row = np.ascontiguousarray(row, dtype=float)
            full, fast = self._full(row), self.log_likelihood(row)
            if np.isfinite(full) or np.isfinite(fast):
                worst = max(worst, abs(full - fast))
        self.n_full_passes = passes
        return worst

    def information(self, theta: Theta) -> FloatArray:
        """Expected Fisher information (n_theta, n_theta) of the flat vector.

        Slepian-Bangs formula for a Gaussian with mean and covariance both depending on theta
        (Kay, Fundamentals of Statistical Signal Processing I, 1993, eq. 3.31):
        I_ab = m_a' C^-1 m_b + 1/2 tr(C^-1 C_a C^-1 C_b), with C = S R S, R of an AR(1).  The trace
        is taken within stretches of consecutive samples; the few pairs across gaps are left out
        of it.
        """
        vector = self._vector(theta)
        problem, mesh = self.problem, self.arrays
        layout = problem.layout
        total = np.zeros((len(vector), len(vector)))
        for k, e in enumerate(problem.campaign):
            phi_reference, sigma0, sigma1 = (float(v) for v in vector[layout.noise[k]])
            steps = problem.steps(e)
            phi = lag_coefficient(phi_reference, steps)
            rest = 1.0 - phi**2
            weight = problem.noise.weight(problem.campaign, e)
            times = self.node_times(k)
            count = mesh.moments[mesh.blocks[k] : mesh.blocks[k + 1], 0].ravel()
            J, u, s = self._scaled(vector, k, times.ravel(), sigma0, sigma1, weight)
            Jl, ul, _ = self._scaled(vector, k, times.ravel() - e.interval, sigma0, sigma1, weight)
            cross = (J * count[:, None]).T @ Jl
            info = ((1 + phi**2) * (J * count[:, None]).T @ J - phi * (cross + cross.T)) / rest
            runs = slice(mesh.runs[k], mesh.runs[k + 1])
            f, uf, _ = self._scaled(vector, k, mesh.edge_t[runs, 0], sigma0, sigma1, weight)
            last, ulast, _ = self._scaled(vector, k, mesh.edge_t[runs, 1], sigma0, sigma1, weight)
            info += phi**2 / rest * (f.T @ f - last.T @ last)
            info += np.outer(f[0], f[0])
            for i in range(1, len(f)):
                distance = mesh.distance[mesh.runs[k] + i]
                across = lag_coefficient(phi_reference, steps * distance)
                gap = f[i] - across * last[i - 1]
                info += np.outer(gap, gap) / (1.0 - across**2)
            # covariance: u = d log s by the parameters
            cross = (u * count[:, None]).T @ ul
            info += (1.0 + (1 + phi**2) / rest) * (u * count[:, None]).T @ u
            info -= phi**2 / rest * (cross + cross.T)
            info += (1.0 + 1.0 / rest) * uf.T @ uf
            slope = 1.0
            if steps != 1.0:
                slope = steps * phi / phi_reference if phi_reference != 0 else 0.0
            i_phi = layout.noise[k, 0]
            info[i_phi, i_phi] += mesh.pairs[k] * (1 + phi**2) / rest**2 * slope**2
            mixed = -2.0 * phi / rest * slope * (u.T @ count)
            mixed -= phi / rest * slope * (uf.sum(axis=0) - ulast.sum(axis=0))
            info[i_phi] += mixed
            info[:, i_phi] += mixed
            total += info
        return total

    def _scaled(self, vector, k, t, sigma0, sigma1, weight):
        """Derivatives of the mean over s (n_t, n), of log s (n_t, n), and s (n_t,) at times t."""
        problem = self.problem
        layout = problem.layout
        e = problem.campaign.experiments[k]
        if not self._cascade:
            return self._scaled_numerically(vector, k, t, weight)
        y0, beta, t0, tf = local_parameters(vector, layout, e.name)
        taus = np.array([vector[1], vector[2] / e.total_flow, vector[0]])
        x = cascade_response(t, taus, t0, tf)
        dx = cascade_sensitivities(t, taus, t0, tf)
        i_y0, i_beta, i_t0, i_tf = layout.local[k]
        slope = np.zeros((len(t), len(vector)))
        slope[:, 0], slope[:, 1], slope[:, 2] = dx[:, 2], dx[:, 0], dx[:, 1] / e.total_flow
        slope[:, i_t0] = dx[:, 3]
        if i_tf >= 0:
            slope[:, i_tf] = dx[:, 4]
        s2 = scale_squared(x, sigma0, sigma1, weight)
        s = np.sqrt(s2)
        J = beta * slope
        J[:, i_y0] = 1.0
        J[:, i_beta] = x
        u = 0.5 * sigma1**2 * weight * slope / s2[:, None]
        u[:, layout.noise[k, 1]] = sigma0 / s2
        u[:, layout.noise[k, 2]] = sigma1 * weight * x / s2
        return J / s[:, None], u, s

    def _scaled_numerically(self, vector, k, t, weight):
        problem = self.problem
        e = problem.campaign.experiments[k]
        _, s2 = _at(problem, vector, e, k, t)
        J, u = np.zeros((len(t), len(vector))), np.zeros((len(t), len(vector)))
        for i in range(len(vector)):
            step = 1e-6 * max(abs(vector[i]), 1e-3)
            up, down = vector.copy(), vector.copy()
            up[i] += step
            down[i] -= step
            m_up, s2_up = _at(problem, up, e, k, t)
            m_down, s2_down = _at(problem, down, e, k, t)
            J[:, i] = (m_up - m_down) / (2 * step)
            u[:, i] = (np.log(s2_up) - np.log(s2_down)) / (4 * step)
        s = np.sqrt(s2)
        return J / s[:, None], u, s


def default_region(problem: Problem, vector: FloatArray, spread: float = 7.0) -> Region:
    """The box that holds the posterior around ``vector`` to ``spread`` standard deviations.

    Spreads come from the expected information in the coordinates (tau^2, t0 + tau, tf + tau),
    in which the likelihood is close to Gaussian; t0 and tf may in addition move by all that tau
    can.  Directions about which the data say nothing are capped.
    """
    layout = problem.layout
    low, high = np.full(len(vector), -np.inf), np.full(len(vector), np.inf)
    slowest = {
        e.name: max(vector[0], vector[1], vector[2] / e.total_flow) for e in problem.campaign
    }
    low[:3], high[:3] = 0.5 * vector[:3], 2.0 * vector[:3]
    for k, e in enumerate(problem.campaign):
        for i in layout.local[k, 2:]:
            if i >= 0:
                width = 0.05 * slowest[e.name]
                low[i], high[i] = vector[i] - width, vector[i] + width
    rough = Compressed.__new__(Compressed)
    rough.problem, rough.reference = problem, vector
    rough.region = Region(low, high)
    rough.arrays = build(problem, vector, rough.region, data=False)
    rough._cascade = type(problem.model) is Cascade and problem.model.method == "exact"
    variances = _psi_variances(problem, vector, rough.information(vector))
    tau = vector[0]
    fastest = min(slowest.values())
    sd_square = min(sqrt(variances[0]), fastest**2)
    tau_high = min(sqrt(tau**2 + spread * sd_square), max(2.0 * tau, 3.0 * fastest))
    low[0], high[0] = 0.0, tau_high
    for i in (1, 2):
        sd = min(spread * sqrt(variances[i]), 4.0 * vector[i])
        low[i], high[i] = max(vector[i] - sd, 0.2 * vector[i]), vector[i] + sd
    for k, e in enumerate(problem.campaign):
        for i in layout.local[k, 2:]:
            if i >= 0:
                sd = min(spread * sqrt(variances[i]), 3.0 * slowest[e.name])
                low[i] = vector[i] + tau - tau_high - sd
                high[i] = vector[i] + tau + sd
    for row in layout.noise:
        low[row[0]], high[row[0]] = -1.0 + 1e-9, 1.0 - 1e-9
        low[row[1]], low[row[2]] = 1e-12, 0.0
    return Region(low, high)


def _psi_variances(problem: Problem, vector: FloatArray, information: FloatArray) -> FloatArray:
    """Variances of (tau^2, .., t0 + tau, tf + tau, ..) from the information on theta."""
    layout = problem.layout
    tau = max(vector[0], 1e-3 * max(vector[1], 1e-12))
    transform = np.eye(len(vector))  # d theta / d psi
    transform[0, 0] = 0.5 / tau
    for i in layout.local[:, 2:].ravel():
        if i >= 0:
            transform[i, 0] = -0.5 / tau
    info = transform.T @ information @ transform
    free = np.flatnonzero(np.diag(info) > 0)
    scale = 1.0 / np.sqrt(np.diag(info)[free])
    scaled = info[np.ix_(free, free)] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-12)
    variances = np.full(len(vector), np.inf)
    variances[free] = ((vectors**2) / values).sum(axis=1) * scale**2
    return variances


def compress(
    campaign: Campaign | Problem, theta: Theta, region: Region | None = None
) -> Compressed:
    """Reduce a campaign's data to a mesh around ``theta`` for fast likelihoods.

    ``theta`` should be near the maximum; without noise parameters the residuals' scatter and
    lag-one correlation stand in.  ``region`` (default: :func:`default_region`) is where the mesh
    is valid; outside, the full pass answers.  A design gives a mesh without data, good for
    ``information`` and ``nodes``.

    Raises CampaignError for a malformed theta.
    """
    problem = as_problem(campaign)
    vector = problem.layout.flat(theta).copy()
    if np.isnan(vector).any():
        vector = _with_rough_noise(problem, vector)
    return Compressed(problem, vector, region or default_region(problem, vector))


def _with_rough_noise(problem: Problem, vector: FloatArray) -> FloatArray:
    vector = vector.copy()
    layout = problem.layout
    squares, lags, n = 0.0, 0.0, 0
    for k, e in enumerate(problem.campaign):
        if e.y is None:
            raise CampaignError(
                f"experiment '{e.name}' is a design: theta needs phi, sigma0_V and sigma1_V"
            )
        zeroed = np.where(np.isnan(vector), 1.0, vector)
        r = (e.values - mean_and_variance(problem, zeroed, k)[0])[e.used]
        squares += float(r @ r)
        lags += float(r[1:] @ r[:-1])
        n += len(r)
    for row in layout.noise:
        if np.isnan(vector[row[1]]):
            vector[row[1]] = sqrt(max(squares / n, 1e-300))
            if vector[row[0]] == 0.0 and problem.noise.autocorrelation == "ar1":
                vector[row[0]] = float(np.clip(lags / max(squares, 1e-300), 0.0, 0.99))
    return vector


def log_likelihood(campaign: Campaign | Problem, theta: Theta, compressed: bool = False) -> float:
    """Exact Gaussian log-likelihood of all samples at ``theta``; -inf outside its range.

    ``compressed=True`` evaluates the same on a mesh built around ``theta``; for many evaluations
    keep the object that :func:`compress` returns instead.

    Raises CampaignError for a malformed ``theta`` or a design without data.
    """
    if compressed:
        mesh = compress(campaign, theta)
        return mesh.log_likelihood(mesh.problem.layout.flat(theta))
    return full_log_likelihood(campaign, theta)
