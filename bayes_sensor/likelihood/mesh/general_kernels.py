"""Log-likelihood over the mesh from any model's values at the nodes, compiled."""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from math import log, sqrt

import numpy as np

from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.mesh.ar1_terms import combined, slopes_of_edges
from bayes_sensor.likelihood.mesh.mesh_arrays import K


@compiled()
def general(k, mesh, phi, phi_reference, m, ml, me, s2, s2l, s2e):
    # log L of experiment k for any smooth mean and variance given at the nodes and edge samples
    first = mesh.blocks[k]
    A = B = log_s2 = 0.0
    for b in range(len(m)):
        for q in range(K):
            i = (first + b) * K + q
            d = m[b, q] - mesh.reference[0, i]
            dl = ml[b, q] - mesh.reference[1, i]
            n, m1, m2 = mesh.moments[0, i], mesh.moments[1, i], mesh.moments[2, i]
            m3, m4 = mesh.moments[3, i], mesh.moments[4, i]
            A += (m3 - 2.0 * d * m1 + d * d * n) / s2[b, q]
            B += (m4 - d * m2 - dl * m1 + d * dl * n) / sqrt(s2[b, q] * s2l[b, q])
            log_s2 += n * log(s2[b, q])
    re = np.empty((len(mesh.distance), 2))
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        for side in range(2):
            i = run - mesh.runs[k]
            re[run, side] = (mesh.edge_y[run, side] - me[i, side]) / sqrt(s2e[i, side])
        log_s2 += log(s2e[run - mesh.runs[k], 0])
    return combined(k, mesh, phi, phi_reference, A, B, re, log_s2)


@compiled()
def general_gradient(
    k, mesh, phi, phi_reference, m, ml, me, s2, s2l, s2e, g_m, g_ml, g_me, g_s2, g_s2l, g_s2e
):
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
            n, m1, m2 = mesh.moments[0, i], mesh.moments[1, i], mesh.moments[2, i]
            m3, m4 = mesh.moments[3, i], mesh.moments[4, i]
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
    value = combined(k, mesh, phi, phi_reference, A, B, re, log_s2)
    g_phi = slopes_of_edges(k, mesh, phi, phi_reference, A, B, re, gre)
    for run in range(start, mesh.runs[k + 1]):
        for side in range(2):
            i = run - start
            g_me[i, side] = -gre[run, side] / sqrt(s2e[i, side])
            g_s2e[i, side] = -0.5 * gre[run, side] * re[run, side] / s2e[i, side]
            if side == 0:
                g_s2e[i, side] -= 0.5 / s2e[i, side]
    return value, g_phi
