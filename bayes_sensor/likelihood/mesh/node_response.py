"""Response of the cascade at the nodes of the mesh and at edge samples of runs, compiled."""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from math import exp, sqrt

import numpy as np

from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.mesh.mesh_arrays import CHEBYSHEV, K
from bayes_sensor.rig.chain import step_response
from bayes_sensor.rig.partial_fractions import partial_fractions
from bayes_sensor.rig.sorting import rising_rates

COINCIDENT = 1e-3
"""relative distance of time constants below which partial fractions give way to the stable form"""
FAR = 40.0
"""slowest time constants after which the response at an edge sample is 1: e^-40 is 4e-18"""
OVER = 1e-17
"""exponentials below this count as zero: with the least entry of the tables, 1e-290, they would
become denormal numbers, which cost a hundred times as much"""
_FAST = {"reassoc", "contract", "arcp", "nsz"}


@compiled(inside=True)
def _nearly_coincide(taus):
    # whether two time constants are so close that partial fractions cancel
    for j in range(3):
        for k in range(3):
            if k != j and abs(taus[j] - taus[k]) < COINCIDENT * taus[j]:
                return True
    return False


@compiled(inside=True)
def exponential_tables(h, taus, n_kinds, table, stride):
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


@compiled(fastmath=_FAST)
def add_edge(
    first, last, base, time, kind, follows, h, taus, c, edge, sign, table, stride, x, xl, E
):
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


@compiled(inside=True)
def _stable_edge(first, last, time, h, rates, edge, sign, x, xl):
    for i in range(first * K, last * K):
        u = time[i] - edge
        x[i] += sign * step_response(u, rates)
        xl[i] += sign * step_response(u - h, rates)


@compiled(inside=True, forceinline=True)
def time_constants_of(theta, k, mesh, taus):
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


@compiled(inside=True, forceinline=True)
def node_responses(k, mesh, taus, t0, tf, h, c, room, table, stride):
    # x3 at the nodes and one sample before.  Returns whether partial fractions served (else the
    # stable, slow form did), and the blocks between which either step acts.
    first, last = mesh.blocks[k], mesh.blocks[k + 1]
    for i in range(first * K, last * K):
        room.x[i] = room.xl[i] = 0.0
    if not _nearly_coincide(taus):
        partial_fractions(taus, c)
        exponential_tables(h, taus, mesh.n_kinds, table, stride)
        on_begin, on_end = add_edge(
            first, last, mesh.base, mesh.time, mesh.kind, mesh.follows, h, taus, c, t0, 1.0,
            table, stride, room.x, room.xl, room.E_on,
        )  # fmt: skip
        off_begin, off_end = last, last
        if tf < np.inf:
            off_begin, off_end = add_edge(
                first, last, mesh.base, mesh.time, mesh.kind, mesh.follows, h, taus, c, tf, -1.0,
                table, stride, room.x, room.xl, room.E_off,
            )  # fmt: skip
        return True, (on_begin, on_end, off_begin, off_end)
    rates = rising_rates(taus)
    _stable_edge(first, last, mesh.time, h, rates, t0, 1.0, room.x, room.xl)
    if tf < np.inf:
        _stable_edge(first, last, mesh.time, h, rates, tf, -1.0, room.x, room.xl)
    return False, (first, first, first, first)


@compiled(inside=True, forceinline=True)
def edge_responses(k, mesh, taus, t0, tf, c, separate, xe):
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
                    value += sign * step_response(s, rising_rates(taus))
            xe[run, side] = value
