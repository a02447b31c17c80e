"""Compiled sums over the mesh: values, gradients and marginals of the log-likelihood.

Everything here works on :class:`Arrays` and plain arrays of scratch space, sized by the caller.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from contextlib import ExitStack, contextmanager, suppress
from math import exp, log, pi, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from filelock import lock_descriptor
from numba import njit

from bayes_sensor.rig.cascade import step_response

K = 8
"""nodes per block"""
COINCIDENT = 1e-3
"""relative distance of time constants below which partial fractions give way to the stable form"""
FAR = 40.0
"""slowest time constants after which the response at an edge sample is 1: e^-40 is 4e-18"""
OVER = 1e-17
"""exponentials below this count as zero: with the least entry of the tables, 1e-290, they would
become denormal numbers, which cost a hundred times as much"""
_FAST = {"reassoc", "contract", "arcp", "nsz"}
CHEBYSHEV = 0.5 - 0.5 * np.cos((2 * np.arange(K) + 1) * pi / (2 * K))


class Arrays(NamedTuple):
    """The mesh of a whole campaign; blocks, edge samples and runs of all experiments in a row."""

    local: np.ndarray  # (n_exp, 4) positions of y0, beta, t0, tf in theta
    noise: np.ndarray  # (n_exp, 3) positions of phi, sigma0, sigma1
    blocks: np.ndarray  # (n_exp + 1,) first block of each experiment
    runs: np.ndarray  # (n_exp + 1,) first run of each experiment
    setting: np.ndarray  # (n_exp, 8) interval, total flow, variance weight, interval/reference,
    # least tau that is no delay, the reference's y0 and beta, share of sigma0^2 that fades; y0 is
    # the level that means and edge samples below count from, so that a signal far from zero keeps
    # its digits
    n_samples: np.ndarray  # (n_exp,)
    base: np.ndarray  # (n_blocks,) s, half a sample before the block's first sample
    kind: np.ndarray  # (n_blocks,) 0: pointwise; k: 8 2^k samples
    follows: np.ndarray  # (n_blocks,) whether the block starts where the previous one ends
    time: np.ndarray  # (n_nodes,) s; the nodes of all blocks in a row, K each
    moments: np.ndarray  # (5, n_nodes) of 1, d, d_lag, d^2, d d_lag
    reference: np.ndarray  # (2, n_nodes) reference mean at the node and one sample before
    reference_s2: np.ndarray  # (n_nodes,)
    log_s2: np.ndarray  # (n_exp,) sum of the reference log s^2 over the blocks' samples
    edge_t: np.ndarray  # (n_runs, 2) s, first and last sample of each run
    edge_y: np.ndarray  # (n_runs, 2)
    distance: np.ndarray  # (n_runs,) samples since the previous run's last sample
    pairs: np.ndarray  # (n_exp,) pairs of neighbouring samples
    low: np.ndarray  # (n_theta,) region of the mesh
    high: np.ndarray  # (n_theta,)
    n_kinds: int


class Room(NamedTuple):
    """Scratch for one evaluation, so that none is allocated inside."""

    x: np.ndarray  # (n_nodes,) response at the nodes
    xl: np.ndarray  # (n_nodes,) and one sample before them
    E_on: np.ndarray  # (3, n_nodes) exponentials since the step up
    E_off: np.ndarray  # (3, n_nodes) .. and since the step down


def make_room(n_nodes: int) -> Room:
    """Scratch for a mesh of so many nodes."""
    one, three = (n_nodes,), (3, n_nodes)
    return Room(np.zeros(one), np.zeros(one), np.zeros(three), np.zeros(three))


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
                table[1, j, q] = exp(-16.0 * h * CHEBYSHEV[q] / taus[j])
            stride[1, j] = stride[0, j] ** 2
        for kind in range(2, n_kinds):
            stride[kind, j] = stride[kind - 1, j] ** 2
            if stride[kind, j] < 1e-290:
                stride[kind, j] = 0.0
            for q in range(K):
                value = table[kind - 1, j, q] ** 2
                table[kind, j, q] = value if value > 1e-290 else 0.0
    # values below 1e-290 count as zero: denormal numbers would slow the sums down, while e^600 of
    # a step inside a block (see least in mesh.py) still meets its inverse here


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _add_edge(
    first, last, base, time, kind, follows, h, taus, c, edge, sign, table, stride, x, xl, E
):  # pragma: no cover - compiled
    # Adds sign * x3(t - edge) at the nodes to x and at one sample before them to xl.  Keeps the
    # three exponentials in E (3, n_nodes) where the step acts: from the block in which it comes
    # to that before which it is over; returns these two blocks.
    l0, l1, l2 = exp(h / taus[0]) * c[0], exp(h / taus[1]) * c[1], exp(h / taus[2]) * c[2]
    e0 = e1 = e2 = 0.0
    begin, end = last, last
    for b in range(first, last):
        k = kind[b]
        if base[b] + 8.0 * 2.0**k * h <= edge:
            continue
        s = base[b] - edge
        if begin < last and follows[b]:
            step = kind[b - 1]
            e0 *= stride[step, 0]
            e1 *= stride[step, 1]
            e2 *= stride[step, 2]
        else:
            e0, e1, e2 = exp(-s / taus[0]), exp(-s / taus[1]), exp(-s / taus[2])
        if begin == last:
            begin = b
        if e0 < OVER:
            e0 = 0.0
        if e1 < OVER:
            e1 = 0.0
        if e2 < OVER:
            e2 = 0.0
        i = b * K
        if s >= h and e0 + e1 + e2 == 0.0:
            end = b
            for j in range(i, last * K):
                x[j] += sign
                xl[j] += sign
            break
        here, before = x[i : i + K], xl[i : i + K]
        E0, E1, E2 = E[0, i : i + K], E[1, i : i + K], E[2, i : i + K]
        if s < h:
            for q in range(K):
                u = time[i + q] - edge
                f0, f1, f2 = e0 * table[k, 0, q], e1 * table[k, 1, q], e2 * table[k, 2, q]
                if u <= 0.0:
                    f0 = f1 = f2 = 0.0
                else:
                    here[q] += sign * (1.0 - (c[0] * f0 + c[1] * f1 + c[2] * f2))
                    if u > h:
                        before[q] += sign * (1.0 - (l0 * f0 + l1 * f1 + l2 * f2))
                E0[q], E1[q], E2[q] = f0, f1, f2
        else:
            for q in range(K):
                f0, f1, f2 = e0 * table[k, 0, q], e1 * table[k, 1, q], e2 * table[k, 2, q]
                here[q] += sign * (1.0 - (c[0] * f0 + c[1] * f1 + c[2] * f2))
                before[q] += sign * (1.0 - (l0 * f0 + l1 * f1 + l2 * f2))
                E0[q], E1[q], E2[q] = f0, f1, f2
    return begin, end


@njit(cache=True, error_model="numpy")
def _stable_edge(first, last, time, h, rates, edge, sign, x, xl):  # pragma: no cover - compiled
    for i in range(first * K, last * K):
        u = time[i] - edge
        x[i] += sign * step_response(u, rates)
        xl[i] += sign * step_response(u - h, rates)


@njit(cache=True, error_model="numpy")
def _logarithms(n, s2r, x, v0, v1):  # pragma: no cover - compiled
    # change of sum log s^2 where the series in the loops below would not do
    change = 0.0
    for i in range(len(n)):
        change += n[i] * log((v0 + v1 * x[i]) / s2r[i])
    return change


# The loops over nodes below store nothing and run over slices, whose indices cannot be negative,
# so that the compiler takes several nodes at a time.
# log s^2 is taken as 2 atanh(z), z = (s2 - s2r)/(s2 + s2r), by its series; ``tail`` tells whether
# what the series leaves out would show.


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _sums(first, last, moments, reference, s2r, x, xl, y0, beta, v0, v1):  # pragma: no cover
    # A = sum r_i^2, B = sum r_i r_(i-1), change of sum log s^2, over the blocks' samples
    A = B = change = tail = 0.0
    i, j = first * K, last * K
    m0, m1, m2 = moments[0, i:j], moments[1, i:j], moments[2, i:j]
    m3, m4 = moments[3, i:j], moments[4, i:j]
    ref, ref_l, ref_s2 = reference[0, i:j], reference[1, i:j], s2r[i:j]
    on, before = x[i:j], xl[i:j]
    for i in range(len(m0)):
        d = y0 + beta * on[i] - ref[i]
        dl = y0 + beta * before[i] - ref_l[i]
        s2 = v0 + v1 * on[i]
        s2l = v0 + v1 * before[i]
        n = m0[i]
        both = s2 * s2l
        around = s2 + ref_s2[i]
        inverse = 1.0 / (both * around)  # one division serves 1/s^2, 1/(s s_lag) and z
        A += (m3[i] - 2.0 * d * m1[i] + d * d * n) * (inverse * around * s2l)
        B += (m4[i] - d * m2[i] - dl * m1[i] + d * dl * n) * (inverse * around * sqrt(both))
        z = (s2 - ref_s2[i]) * (inverse * both)
        z2 = z * z
        tail += n * z2 * z2 * z2 * z2 * z2
        change += n * 2.0 * z * (1.0 + z2 * (1 / 3 + z2 * (0.2 + z2 * (1 / 7 + z2 / 9))))
    if tail > 1e-7:
        change = _logarithms(m0, ref_s2, on, v0, v1)
    return A, B, change


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _gram_sums(first, last, moments, reference, s2r, x, xl, y0, beta, v0, v1, A, B):
    # The same for the basis (residual at y0, beta; 1; x): symmetric A (3, 3) and B (3, 3)
    ee = e1 = ex = oo = ox = xx = 0.0
    bee = be1 = bex = boo = box = bxx = 0.0
    change = tail = 0.0
    i, j = first * K, last * K
    m0, m1, m2 = moments[0, i:j], moments[1, i:j], moments[2, i:j]
    m3, m4 = moments[3, i:j], moments[4, i:j]
    ref, ref_l, ref_s2 = reference[0, i:j], reference[1, i:j], s2r[i:j]
    on, before = x[i:j], xl[i:j]
    for i in range(len(m0)):  # pragma: no cover - compiled
        u, ul = on[i], before[i]
        d = y0 + beta * u - ref[i]
        dl = y0 + beta * ul - ref_l[i]
        s2 = v0 + v1 * u
        s2l = v0 + v1 * ul
        n = m0[i]
        both = s2 * s2l
        around = s2 + ref_s2[i]
        inverse = 1.0 / (both * around)
        w = inverse * around * s2l
        p = inverse * around * sqrt(both)
        r, rl = m1[i] - d * n, m2[i] - dl * n
        ee += (m3[i] - 2.0 * d * m1[i] + d * d * n) * w
        e1 += r * w
        ex += r * u * w
        oo += n * w
        ox += n * u * w
        xx += n * u * u * w
        bee += (m4[i] - d * m2[i] - dl * m1[i] + d * dl * n) * p
        be1 += 0.5 * (r + rl) * p
        bex += 0.5 * (r * ul + rl * u) * p
        boo += n * p
        box += 0.5 * n * (u + ul) * p
        bxx += n * u * ul * p
        z = (s2 - ref_s2[i]) * (inverse * both)
        z2 = z * z
        tail += n * z2 * z2 * z2 * z2 * z2
        change += n * 2.0 * z * (1.0 + z2 * (1 / 3 + z2 * (0.2 + z2 * (1 / 7 + z2 / 9))))
    if tail > 1e-7:
        change = _logarithms(m0, ref_s2, on, v0, v1)
    A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2] = ee, e1, ex, oo, ox, xx
    B[0, 0], B[0, 1], B[0, 2], B[1, 1], B[1, 2], B[2, 2] = bee, be1, bex, boo, box, bxx
    return change


@njit(cache=True, error_model="numpy", fastmath=_FAST)
def _slopes(
    first, last, time, edge, h, lags, E, moments, reference, s2r, x, xl,
    y0, beta, v0, v1, phi, out, by_edge,
):  # fmt: skip  # pragma: no cover - compiled
    # Adds A, B, change, tail and the derivatives of log L by y0, beta, v0, v1 to out (8,), and to
    # by_edge (6,) G_j = sum of E_j g and H_j = sum of s E_j g with g the derivative by x3, for
    # the step at ``edge``, over blocks first .. last - 1.
    A = B = change = tail = 0.0
    g_y0 = g_beta = g_v0 = g_v1 = 0.0
    P0 = P1 = P2 = R0 = R1 = R2 = T0 = T1 = T2 = 0.0
    a = -0.5 * (1.0 + phi * phi) / (1.0 - phi * phi)
    c = phi / (1.0 - phi * phi)
    l0, l1, l2 = lags[0], lags[1], lags[2]
    i, j = first * K, last * K
    m0, m1, m2 = moments[0, i:j], moments[1, i:j], moments[2, i:j]
    m3, m4 = moments[3, i:j], moments[4, i:j]
    ref, ref_l, ref_s2 = reference[0, i:j], reference[1, i:j], s2r[i:j]
    on, before = x[i:j], xl[i:j]
    t, E0, E1, E2 = time[i:j], E[0, i:j], E[1, i:j], E[2, i:j]
    for i in range(len(m0)):
        u, ul = on[i], before[i]
        d = y0 + beta * u - ref[i]
        dl = y0 + beta * ul - ref_l[i]
        s2 = v0 + v1 * u
        s2l = v0 + v1 * ul
        n = m0[i]
        both = s2 * s2l
        around = s2 + ref_s2[i]
        inverse = 1.0 / (both * around)
        w = inverse * around * s2l
        wl = inverse * around * s2
        p = inverse * around * sqrt(both)
        r = d * n - m1[i]
        rl = dl * n - m2[i]
        a_node = (m3[i] - 2.0 * d * m1[i] + d * d * n) * w
        b_node = (m4[i] - d * m2[i] - dl * m1[i] + d * dl * n) * p
        A += a_node
        B += b_node
        z = (s2 - ref_s2[i]) * (inverse * both)
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
        s = t[i] - edge
        g = beta * g_m + v1 * g_s
        # one sample before a node just after the step, the step had not come yet
        gl = beta * g_ml + v1 * g_sl if s > h else 0.0
        f0, f1, f2 = E0[i] * (g + l0 * gl), E1[i] * (g + l1 * gl), E2[i] * (g + l2 * gl)
        P0 += f0
        P1 += f1
        P2 += f2
        R0 += s * f0
        R1 += s * f1
        R2 += s * f2
        T0 += E0[i] * gl
        T1 += E1[i] * gl
        T2 += E2[i] * gl
    out[0] += A
    out[1] += B
    out[2] += change
    out[3] += tail
    out[4] += g_y0
    out[5] += g_beta
    out[6] += g_v0
    out[7] += g_v1
    by_edge[0] += P0
    by_edge[1] += P1
    by_edge[2] += P2
    by_edge[3] += R0 - h * l0 * T0
    by_edge[4] += R1 - h * l1 * T1
    by_edge[5] += R2 - h * l2 * T2


@njit(cache=True, error_model="numpy")
def _clear(E, first, last):  # pragma: no cover - compiled
    # (assigning to a slice of rows would cost ten times as much)
    if first < last:
        for row in E:
            part = row[first * K : last * K]
            for i in range(len(part)):
                part[i] = 0.0


# What may reorder sums is compiled by itself before whatever calls it.  A program that finds its
# callers in the cache would else run the copy inside these, which can add up in another order, and
# the first run after an installation would differ from all later ones in the last digits.  For
# the same reason one process at a time compiles them: numba names what it compiles by a count of
# its process, and callers cached by one process would not find the sums cached by another.
_ALONE = (
    (_add_edge, "i8, i8, f8[::1], f8[::1], i8[::1], b1[::1], f8, f8[::1], f8[::1], f8, f8, "
                "f8[:, :, ::1], f8[:, ::1], f8[::1], f8[::1], f8[:, ::1]"),
    (_sums, "i8, i8, f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8, f8, f8, f8"),
    (_gram_sums, "i8, i8, f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8, f8, f8, f8, "
                 "f8[:, ::1], f8[:, ::1]"),
    (_slopes, "i8, i8, f8[::1], f8, f8, f8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], "
              "f8[::1], f8[::1], f8, f8, f8, f8, f8, f8[::1], f8[::1]"),
)  # fmt: skip


@contextmanager
def _one_process(folder):
    # nothing is locked where files cannot be (a file system without locks)
    with ExitStack() as stack:
        with suppress(OSError):
            Path(folder).mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(open(Path(folder) / "kernels.lock", "a"))
            lock_descriptor(file.fileno())
        yield


if hasattr(_sums, "compile"):  # a plain function where compilation is switched off
    with _one_process(_sums.stats.cache_path):
        for _kernel, _types in _ALONE:
            _kernel.compile(f"({_types})")


@njit(cache=True, error_model="numpy", inline="always")
def _gradient_sums(
    k, mesh, room, acts, t0, tf, lags, y0, beta, v0, v1, phi, out, by_on, by_off, unused
):  # pragma: no cover - compiled
    # A, B and change over the blocks of experiment k; out[4:8], by_on, by_off (6,): derivatives.
    # acts: first and last block of either step's action; unused (8,): scratch
    first, last = mesh.blocks[k], mesh.blocks[k + 1]
    h = mesh.setting[k, 0]
    data = (mesh.moments, mesh.reference, mesh.reference_s2, room.x, room.xl)
    out[:] = 0.0
    by_on[:] = 0.0
    by_off[:] = 0.0
    on_begin, on_end, off_begin, off_end = acts
    # few long loops: each block goes to the step that acts there or, in the rest, to either
    middle = min(max(off_begin, on_begin), last)
    _clear(room.E_on, first, on_begin)
    _clear(room.E_on, on_end, middle)
    _slopes(
        first, middle, mesh.time, t0, h, lags, room.E_on, *data, y0, beta, v0, v1, phi, out, by_on
    )
    _clear(room.E_off, middle, off_begin)
    _clear(room.E_off, off_end, last)
    _slopes(
        middle, last, mesh.time, tf, h, lags, room.E_off, *data, y0, beta, v0, v1, phi, out, by_off
    )
    if on_end > middle:  # the step up still acts after the step down
        _slopes(
            middle, on_end, mesh.time, t0, h, lags, room.E_on, *data, y0, beta, v0, v1, phi,
            unused, by_on,
        )  # fmt: skip
    if off_begin < middle:  # .. or was preceded by it
        _slopes(
            off_begin, min(off_end, middle), mesh.time, tf, h, lags, room.E_off, *data, y0, beta,
            v0, v1, phi, unused, by_off,
        )  # fmt: skip
    if out[3] > 1e-7:
        i, j = first * K, last * K
        out[2] = _logarithms(mesh.moments[0, i:j], mesh.reference_s2[i:j], room.x[i:j], v0, v1)
    return out[0], out[1], out[2]


@njit(cache=True, error_model="numpy")
def inside_box(theta, low, high):  # pragma: no cover - compiled
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


@njit(cache=True, error_model="numpy", inline="always")
def _variances(sigma0, sigma1, weight, fading):  # pragma: no cover - compiled
    # v0, v1 of s^2 = v0 + v1 x3, as noise.scale_squared has it between 0 and the highest level
    v0 = sigma0 * sigma0
    return v0, (sigma1 * sigma1 - fading * v0) * weight


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
def _responses(k, mesh, taus, t0, tf, h, c, room, table, stride):  # pragma: no cover - compiled
    # x3 at the nodes and one sample before.  Returns whether partial fractions served (else the
    # stable, slow form did), and the blocks between which either step acts.
    first, last = mesh.blocks[k], mesh.blocks[k + 1]
    room.x[first * K : last * K] = 0.0
    room.xl[first * K : last * K] = 0.0
    if _partial_fractions(taus, c):
        _tables(h, taus, mesh.n_kinds, table, stride)
        on_begin, on_end = _add_edge(
            first, last, mesh.base, mesh.time, mesh.kind, mesh.follows, h, taus, c, t0, 1.0,
            table, stride, room.x, room.xl, room.E_on,
        )  # fmt: skip
        off_begin, off_end = last, last
        if tf < np.inf:
            off_begin, off_end = _add_edge(
                first, last, mesh.base, mesh.time, mesh.kind, mesh.follows, h, taus, c, tf, -1.0,
                table, stride, room.x, room.xl, room.E_off,
            )  # fmt: skip
        return True, (on_begin, on_end, off_begin, off_end)
    rates = np.sort(1.0 / taus)
    _stable_edge(first, last, mesh.time, h, rates, t0, 1.0, room.x, room.xl)
    if tf < np.inf:
        _stable_edge(first, last, mesh.time, h, rates, tf, -1.0, room.x, room.xl)
    return False, (first, first, first, first)


@njit(cache=True, error_model="numpy", inline="always")
def _edge_responses(k, mesh, taus, t0, tf, c, separate, xe):  # pragma: no cover - compiled
    # x3 at the first and last sample of every run
    over = FAR * max(taus[0], taus[1], taus[2])
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        for side in range(2):
            value = 0.0
            for edge, sign in ((t0, 1.0), (tf, -1.0)):
                s = mesh.edge_t[run, side] - edge
                if s > over:
                    value += sign
                elif s > 0.0 and separate:
                    for j in range(3):
                        value -= sign * c[j] * exp(-s / taus[j])
                    value += sign
                elif s > 0.0:
                    value += sign * step_response(s, np.sort(1.0 / taus))
            xe[run, side] = value


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
def _edge_log(k, mesh, s2e):  # pragma: no cover - compiled
    # log s^2 of the first sample of every run; the last one is in the blocks
    total = 0.0
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        total += log(s2e[run, 0])
    return total


@njit(cache=True, error_model="numpy")
def value(theta, mesh, room, each):  # pragma: no cover - compiled
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
        if not abs(phi) < 1.0:  # a negative phi has no root for a shorter interval
            each[:] = -np.inf
            return -np.inf
        y0, beta = theta[mesh.local[k, 0]] - mesh.setting[k, 5], theta[mesh.local[k, 1]]
        v0, v1 = _variances(sigma0, sigma1, mesh.setting[k, 2], mesh.setting[k, 7])
        separate, _ = _responses(k, mesh, taus, t0, tf, h, c, room, table, stride)
        _edge_responses(k, mesh, taus, t0, tf, c, separate, xe)
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            for side in range(2):
                s2e[run, side] = v0 + v1 * xe[run, side]
                re[run, side] = (mesh.edge_y[run, side] - y0 - beta * xe[run, side]) / sqrt(
                    s2e[run, side]
                )
        A, B, change = _sums(
            mesh.blocks[k], mesh.blocks[k + 1], mesh.moments, mesh.reference, mesh.reference_s2,
            room.x, room.xl, y0, beta, v0, v1,
        )  # fmt: skip
        log_s2 = mesh.log_s2[k] + change + _edge_log(k, mesh, s2e)
        each[k] = _combine(k, mesh, phi, phi_reference, A, B, re, log_s2)
        total += each[k]
    return total


@njit(cache=True, error_model="numpy", inline="always")
def _slopes_of_edges(k, mesh, phi, phi_reference, A, B, re, gre):  # pragma: no cover - compiled
    # Derivative of log L by phi_reference, of the block sums and of the pairs across gaps; gre:
    # filled with the derivatives by the standardised residuals re of the edge samples
    steps = mesh.setting[k, 3]
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
            if phi_reference > 0:
                g_across += d_log * steps * distance * across / phi_reference
            elif phi_reference < 0:
                slope = distance * phi ** (distance - 1)
                g_across += d_log * slope * _phi_slope(phi, phi_reference, steps)
    g_phi = -0.5 * (d_squares / rest + 2.0 * phi * squares / rest**2)
    g_phi += mesh.pairs[k] * phi / rest
    return g_phi * _phi_slope(phi, phi_reference, steps) + g_across


@njit(cache=True, error_model="numpy")
def value_and_gradient(theta, mesh, room, gradient):  # pragma: no cover
    taus, c = np.empty(3), np.empty(3)
    sums, unused, lags = np.empty(8), np.zeros(8), np.empty(3)
    by_on, by_off, G, g_tau = np.empty(6), np.empty(6), np.empty(3), np.empty(3)
    table, stride = np.empty((mesh.n_kinds, 3, K)), np.empty((mesh.n_kinds, 3))
    xe = np.empty((len(mesh.distance), 2))
    re = np.empty((len(mesh.distance), 2))
    s2e = np.empty((len(mesh.distance), 2))
    gre = np.empty((len(mesh.distance), 2))
    gradient[:] = 0.0
    total = 0.0
    for k in range(len(mesh.local)):
        i_y0, i_beta, i_t0, i_tf = mesh.local[k]
        i_phi, i_s0, i_s1 = mesh.noise[k]
        h, t0, tf = _constants(theta, k, mesh, taus)
        phi_reference, sigma0, sigma1 = theta[i_phi], theta[i_s0], theta[i_s1]
        steps, weight, fading = mesh.setting[k, 3], mesh.setting[k, 2], mesh.setting[k, 7]
        phi = _per_sample(phi_reference, steps)
        y0, beta = theta[i_y0] - mesh.setting[k, 5], theta[i_beta]
        v0, v1 = _variances(sigma0, sigma1, weight, fading)
        separate, acts = _responses(k, mesh, taus, t0, tf, h, c, room, table, stride)
        if not separate:
            return np.nan  # nearly equal time constants: the caller takes the stable route
        _edge_responses(k, mesh, taus, t0, tf, c, separate, xe)
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            for side in range(2):
                s2e[run, side] = v0 + v1 * xe[run, side]
                re[run, side] = (mesh.edge_y[run, side] - y0 - beta * xe[run, side]) / sqrt(
                    s2e[run, side]
                )
        for j in range(3):
            lags[j] = exp(h / taus[j])
        A, B, change = _gradient_sums(
            k, mesh, room, acts, t0, tf, lags, y0, beta, v0, v1, phi, sums, by_on, by_off, unused
        )
        log_s2 = mesh.log_s2[k] + change + _edge_log(k, mesh, s2e)
        total += _combine(k, mesh, phi, phi_reference, A, B, re, log_s2)

        gradient[i_phi] += _slopes_of_edges(k, mesh, phi, phi_reference, A, B, re, gre)

        # edge samples: residual r = (y - m)/s
        g_y0, g_beta, g_v0, g_v1 = sums[4], sums[5], sums[6], sums[7]
        over = FAR * max(taus[0], taus[1], taus[2])
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
                s = mesh.edge_t[run, side] - t0
                if 0.0 < s < over:
                    _add_exponentials(s, taus, g_x, by_on)
                s = mesh.edge_t[run, side] - tf
                if 0.0 < s < over:
                    _add_exponentials(s, taus, g_x, by_off)
        gradient[i_y0] += g_y0
        gradient[i_beta] += g_beta
        gradient[i_s0] += 2.0 * sigma0 * (g_v0 - fading * weight * g_v1)
        gradient[i_s1] += 2.0 * sigma1 * weight * g_v1

        # x3 = 1 - sum c_j E_j after the step up, less the same after the step down
        g_t0 = g_tf = 0.0
        for j in range(3):
            g_t0 -= c[j] * by_on[j] / taus[j]
            g_tf += c[j] * by_off[j] / taus[j]
            G[j] = by_on[j] - by_off[j]
            g_tau[j] = -c[j] * (by_on[3 + j] - by_off[3 + j]) / taus[j] ** 2
        for j in range(3):
            inner = 2.0 / taus[j]  # d log c_j / d tau_j
            for m in range(3):
                if m != j:
                    inverse = 1.0 / (taus[j] - taus[m])
                    inner -= inverse
                    g_tau[j] += c[m] * inverse * G[m]
            g_tau[j] -= c[j] * inner * G[j]
        gradient[i_t0] += g_t0
        if i_tf >= 0:
            gradient[i_tf] += g_tf
        gradient[1] += g_tau[0]
        gradient[2] += g_tau[1] / mesh.setting[k, 1]
        if theta[0] >= mesh.setting[k, 4]:
            gradient[0] += g_tau[2]
        else:  # a sensor faster than that acts as a pure delay, see _constants
            gradient[0] += g_t0 + g_tf
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
def _add_exponentials(s, taus, g, by_edge):  # pragma: no cover - compiled
    # adds one sample's part to the sums of E_j g and s E_j g
    for j in range(3):
        f = g * exp(-s / taus[j])
        by_edge[j] += f
        by_edge[3 + j] += s * f


@njit(cache=True, error_model="numpy")
def marginal(theta, mesh, room, best, factor):  # pragma: no cover - compiled
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
        if not abs(phi) < 1.0:
            return -np.inf
        rest = 1.0 - phi * phi
        # any y0, beta serves as origin: the mesh's own reference keeps the numbers small
        y0, beta = 0.0, mesh.setting[k, 6]
        v0, v1 = _variances(sigma0, sigma1, mesh.setting[k, 2], mesh.setting[k, 7])
        separate, _ = _responses(k, mesh, taus, t0, tf, h, c, room, table, stride)
        _edge_responses(k, mesh, taus, t0, tf, c, separate, xe)
        change = _gram_sums(
            first, last, mesh.moments, mesh.reference, mesh.reference_s2,
            room.x, room.xl, y0, beta, v0, v1, A, B,
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
        best[k, 0] += mesh.setting[k, 5]
        best[k, 1] += beta
        factor[k, 0], factor[k, 1], factor[k, 2] = l11, l21, l22
        total += -0.5 * (logs + Q[0, 0] - u1 * u1 - u2 * u2) - log(l11) - log(l22) + log(2.0 * pi)
    return total


@njit(cache=True, error_model="numpy")
def values(thetas, mesh, room, each, inside):  # pragma: no cover - compiled
    for i in range(len(thetas)):
        inside[i] = inside_box(thetas[i], mesh.low, mesh.high)
        if inside[i]:
            value(thetas[i], mesh, room, each[i])


@njit(cache=True, error_model="numpy")
def marginals(thetas, mesh, room, values, best, factor, inside):  # pragma: no cover
    for i in range(len(thetas)):
        inside[i] = inside_box(thetas[i], mesh.low, mesh.high)
        if inside[i]:
            values[i] = marginal(thetas[i], mesh, room, best[i], factor[i])


@njit(cache=True, error_model="numpy")
def general(k, mesh, phi, phi_reference, m, ml, me, s2, s2l, s2e):  # pragma: no cover - compiled
    # log L of experiment k for any smooth mean and variance given at the nodes and edge samples
    first = mesh.blocks[k]
    A = B = log_s2 = 0.0
    for b in range(len(m)):
        for q in range(K):
            i = (first + b) * K + q
            d = m[b, q] - mesh.reference[0, i]
            dl = ml[b, q] - mesh.reference[1, i]
            n, m1, m2, m3, m4 = mesh.moments[:, i]
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


@njit(cache=True, error_model="numpy")
def general_gradient(
    k, mesh, phi, phi_reference, m, ml, me, s2, s2l, s2e, g_m, g_ml, g_me, g_s2, g_s2l, g_s2e
):  # pragma: no cover - compiled
    # The same with the derivatives by every mean and variance, in the shapes of those; also the
    # derivative by phi_reference
    first = mesh.blocks[k]
    A = B = log_s2 = 0.0
    by_A = -0.5 * (1.0 + phi * phi) / (1.0 - phi * phi)
    by_B = phi / (1.0 - phi * phi)
    for b in range(len(m)):
        for q in range(K):
            i = (first + b) * K + q
            d = m[b, q] - mesh.reference[0, i]
            dl = ml[b, q] - mesh.reference[1, i]
            n, m1, m2, m3, m4 = mesh.moments[:, i]
            w, wl = 1.0 / s2[b, q], 1.0 / s2l[b, q]
            p = sqrt(w * wl)
            a_node = (m3 - 2.0 * d * m1 + d * d * n) * w
            b_node = (m4 - d * m2 - dl * m1 + d * dl * n) * p
            A += a_node
            B += b_node
            log_s2 += n * log(s2[b, q])
            g_m[b, q] = 2.0 * by_A * (d * n - m1) * w + by_B * (dl * n - m2) * p
            g_ml[b, q] = by_B * (d * n - m1) * p
            g_s2[b, q] = -(by_A * a_node + 0.5 * by_B * b_node + 0.5 * n) * w
            g_s2l[b, q] = -0.5 * by_B * b_node * wl
    re, gre = np.empty((len(mesh.distance), 2)), np.empty((len(mesh.distance), 2))
    start = mesh.runs[k]
    for run in range(start, mesh.runs[k + 1]):
        for side in range(2):
            i = run - start
            re[run, side] = (mesh.edge_y[run, side] - me[i, side]) / sqrt(s2e[i, side])
        log_s2 += log(s2e[run - start, 0])
    value = _combine(k, mesh, phi, phi_reference, A, B, re, log_s2)
    g_phi = _slopes_of_edges(k, mesh, phi, phi_reference, A, B, re, gre)
    for run in range(start, mesh.runs[k + 1]):
        for side in range(2):
            i = run - start
            g_me[i, side] = -gre[run, side] / sqrt(s2e[i, side])
            g_s2e[i, side] = -0.5 * gre[run, side] * re[run, side] / s2e[i, side]
            if side == 0:
                g_s2e[i, side] -= 0.5 / s2e[i, side]
    return value, g_phi
