"""Sums over the nodes of one experiment: squares, their derivatives and logarithms, compiled."""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from contextlib import ExitStack, contextmanager, suppress
from math import exp, log, sqrt
from pathlib import Path
from typing import Any

from filelock import lock_descriptor

from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.mesh.mesh_arrays import K
from bayes_sensor.likelihood.mesh.node_response import _FAST, add_edge


@compiled(inside=True)
def sum_of_logarithms(n, s2r, x, v0, v1):
    # change of sum log s^2 where the series in the loops below would not do
    change = 0.0
    for i in range(len(n)):
        change += n[i] * log((v0 + v1 * x[i]) / s2r[i])
    return change


# The loops over nodes below store nothing and run over slices, whose indices cannot be negative,
# so that the compiler takes several nodes at a time.
# log s^2 is taken as 2 atanh(z), z = (s2 - s2r)/(s2 + s2r), by its series; ``tail`` tells whether
# what the series leaves out would show.


@compiled(fastmath=_FAST)
def block_sums(first, last, moments, reference, s2r, x, xl, y0, beta, v0, v1):
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
        change = sum_of_logarithms(m0, ref_s2, on, v0, v1)
    return A, B, change


@compiled(fastmath=_FAST)
def gram_sums(first, last, moments, reference, s2r, x, xl, y0, beta, v0, v1, A, B):
    # The same for the basis (residual at y0, beta; 1; x): symmetric A (3, 3) and B (3, 3)
    ee = e1 = ex = oo = ox = xx = 0.0
    bee = be1 = bex = boo = box = bxx = 0.0
    change = tail = 0.0
    i, j = first * K, last * K
    m0, m1, m2 = moments[0, i:j], moments[1, i:j], moments[2, i:j]
    m3, m4 = moments[3, i:j], moments[4, i:j]
    ref, ref_l, ref_s2 = reference[0, i:j], reference[1, i:j], s2r[i:j]
    on, before = x[i:j], xl[i:j]
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
        change = sum_of_logarithms(m0, ref_s2, on, v0, v1)
    A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2] = ee, e1, ex, oo, ox, xx
    B[0, 0], B[0, 1], B[0, 2], B[1, 1], B[1, 2], B[2, 2] = bee, be1, bex, boo, box, bxx
    return change


@compiled(fastmath=_FAST)
def block_slopes(
    first, last, time, edge, h, lags, E, moments, reference, s2r, x, xl,
    y0, beta, v0, v1, phi, out, by_edge,
):  # fmt: skip
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


@compiled(inside=True)
def _clear(E, first, last):
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
_ALONE: tuple[tuple[Any, str], ...] = (
    (add_edge, "i8, i8, f8[::1], f8[::1], i8[::1], b1[::1], f8, f8[::1], f8[::1], f8, f8, "
                "f8[:, :, ::1], f8[:, ::1], f8[::1], f8[::1], f8[:, ::1]"),
    (block_sums, "i8, i8, f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8, f8, f8, f8"),
    (gram_sums, "i8, i8, f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1], f8, f8, f8, f8, "
                 "f8[:, ::1], f8[:, ::1]"),
    (block_slopes, "i8, i8, f8[::1], f8, f8, f8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], "
              "f8[::1], f8[::1], f8, f8, f8, f8, f8, f8[::1], f8[::1]"),
)  # fmt: skip


@contextmanager
def one_process(folder):
    # nothing is locked where files cannot be (a file system without locks)
    with ExitStack() as stack:
        with suppress(OSError):
            Path(folder).mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(open(Path(folder) / "kernels.lock", "a"))
            lock_descriptor(file.fileno())
        yield


if hasattr(_ALONE[0][0], "compile"):  # a plain function where compilation is switched off
    with one_process(_ALONE[0][0].stats.cache_path):
        for _kernel, _types in _ALONE:
            _kernel.compile(f"({_types})")


@compiled(inside=True, forceinline=True)
def gradient_sums(
    k, mesh, room, acts, t0, tf, lags, y0, beta, v0, v1, phi, out, by_on, by_off, unused
):
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
    block_slopes(
        first, middle, mesh.time, t0, h, lags, room.E_on, *data, y0, beta, v0, v1, phi, out, by_on
    )
    _clear(room.E_off, middle, off_begin)
    _clear(room.E_off, off_end, last)
    block_slopes(
        middle, last, mesh.time, tf, h, lags, room.E_off, *data, y0, beta, v0, v1, phi, out, by_off
    )
    if on_end > middle:  # the step up still acts after the step down
        block_slopes(
            middle, on_end, mesh.time, t0, h, lags, room.E_on, *data, y0, beta, v0, v1, phi,
            unused, by_on,
        )  # fmt: skip
    if off_begin < middle:  # .. or was preceded by it
        block_slopes(
            off_begin, min(off_end, middle), mesh.time, tf, h, lags, room.E_off, *data, y0, beta,
            v0, v1, phi, unused, by_off,
        )  # fmt: skip
    if out[3] > 1e-7:
        i, j = first * K, last * K
        out[2] = sum_of_logarithms(
            mesh.moments[0, i:j], mesh.reference_s2[i:j], room.x[i:j], v0, v1
        )
    return out[0], out[1], out[2]


@compiled(inside=True)
def add_exponentials(s, taus, g, by_edge):
    # adds one sample's part to the sums of E_j g and s E_j g
    for j in range(3):
        f = g * exp(-s / taus[j])
        by_edge[j] += f
        by_edge[3 + j] += s * f
