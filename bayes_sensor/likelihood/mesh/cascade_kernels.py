"""Log-likelihood of the cascade over the mesh: value, gradient and marginal, compiled."""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from math import exp, log, pi, sqrt

import numpy as np

from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.mesh.ar1_terms import (
    across_gap,
    combined,
    edge_log,
    per_sample,
    slopes_of_edges,
    variance_levels,
)
from bayes_sensor.likelihood.mesh.chain_responses import chain_responses
from bayes_sensor.likelihood.mesh.mesh_arrays import K
from bayes_sensor.likelihood.mesh.node_response import (
    FAR,
    edge_responses,
    node_responses,
    time_constants_of,
)
from bayes_sensor.likelihood.mesh.node_sums import (
    add_exponentials,
    block_sums,
    gradient_sums,
    gram_sums,
)


@compiled()
def inside_box(theta, low, high):
    for i in range(len(theta)):
        if not (low[i] <= theta[i] <= high[i]):
            return False
    return True


@compiled()
def values(thetas, mesh, room, each, inside):
    # each (n, n_exp): filled with every experiment's part where ``inside`` (n,) the mesh's region
    taus, c = np.empty(3), np.empty(3)
    table, stride = np.empty((mesh.n_kinds, 3, K)), np.empty((mesh.n_kinds, 3))
    xe = np.empty((len(mesh.distance), 2))
    re = np.empty((len(mesh.distance), 2))
    s2e = np.empty((len(mesh.distance), 2))
    for i in range(len(thetas)):
        theta = thetas[i]
        inside[i] = inside_box(theta, mesh.low, mesh.high)
        if not inside[i]:
            continue
        for k in range(len(mesh.local)):
            phi_reference, sigma0, sigma1 = (
                theta[mesh.noise[k, 0]], theta[mesh.noise[k, 1]], theta[mesh.noise[k, 2]]
            )  # fmt: skip
            phi = per_sample(phi_reference, mesh.setting[k, 3])
            if not abs(phi) < 1.0:  # a negative phi has no root for a shorter interval
                for j in range(len(mesh.local)):
                    each[i, j] = -np.inf
                break
            y0, beta = theta[mesh.local[k, 0]] - mesh.setting[k, 5], theta[mesh.local[k, 1]]
            v0, v1 = variance_levels(sigma0, sigma1, mesh.setting[k, 2], mesh.setting[k, 7])
            if mesh.is_pulse:
                h, t0, tf = time_constants_of(theta, k, mesh, taus)
                separate, _ = node_responses(k, mesh, taus, t0, tf, h, c, room, table, stride)
                edge_responses(k, mesh, taus, t0, tf, c, separate, xe)
            else:
                chain_responses(theta, k, mesh, room, xe)
            for run in range(mesh.runs[k], mesh.runs[k + 1]):
                for side in range(2):
                    s2e[run, side] = v0 + v1 * xe[run, side]
                    re[run, side] = (mesh.edge_y[run, side] - y0 - beta * xe[run, side]) / sqrt(
                        s2e[run, side]
                    )
            A, B, change = block_sums(
                mesh.blocks[k], mesh.blocks[k + 1], mesh.moments, mesh.reference, mesh.reference_s2,
                room.x, room.xl, y0, beta, v0, v1,
            )  # fmt: skip
            log_s2 = mesh.totals[k, 2] + change + edge_log(k, mesh, s2e)
            each[i, k] = combined(k, mesh, phi, phi_reference, A, B, re, log_s2)


@compiled()
def value_and_gradient(theta, mesh, room, gradient, done):
    # gradient (n_theta,): of the value returned, which is the sum over the experiments that are
    # ``done`` (n_exp,): time constants far enough apart for partial fractions, a phi with a law
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
        i_y0, i_beta, i_t0, i_tf = (
            mesh.local[k, 0], mesh.local[k, 1], mesh.local[k, 2], mesh.local[k, 3]
        )  # fmt: skip
        i_phi, i_s0, i_s1 = mesh.noise[k, 0], mesh.noise[k, 1], mesh.noise[k, 2]
        h, t0, tf = time_constants_of(theta, k, mesh, taus)
        phi_reference, sigma0, sigma1 = theta[i_phi], theta[i_s0], theta[i_s1]
        steps, weight, fading = mesh.setting[k, 3], mesh.setting[k, 2], mesh.setting[k, 7]
        phi = per_sample(phi_reference, steps)
        y0, beta = theta[i_y0] - mesh.setting[k, 5], theta[i_beta]
        v0, v1 = variance_levels(sigma0, sigma1, weight, fading)
        separate, acts = node_responses(k, mesh, taus, t0, tf, h, c, room, table, stride)
        done[k] = separate and abs(phi) < 1.0
        if not done[k]:
            continue
        edge_responses(k, mesh, taus, t0, tf, c, separate, xe)
        for run in range(mesh.runs[k], mesh.runs[k + 1]):
            for side in range(2):
                s2e[run, side] = v0 + v1 * xe[run, side]
                re[run, side] = (mesh.edge_y[run, side] - y0 - beta * xe[run, side]) / sqrt(
                    s2e[run, side]
                )
        for j in range(3):
            lags[j] = exp(h / taus[j])
        A, B, change = gradient_sums(
            k, mesh, room, acts, t0, tf, lags, y0, beta, v0, v1, phi, sums, by_on, by_off, unused
        )
        log_s2 = mesh.totals[k, 2] + change + edge_log(k, mesh, s2e)
        total += combined(k, mesh, phi, phi_reference, A, B, re, log_s2)

        gradient[i_phi] += slopes_of_edges(k, mesh, phi, phi_reference, A, B, re, gre)

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
                    add_exponentials(s, taus, g_x, by_on)
                s = mesh.edge_t[run, side] - tf
                if 0.0 < s < over:
                    add_exponentials(s, taus, g_x, by_off)
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
        else:  # a sensor faster than that acts as a pure delay, see time_constants_of
            gradient[0] += g_t0 + g_tf
    return total


@compiled()
def marginals(thetas, mesh, room, values, best, factor, inside):
    # values (n,): log L with every y0, beta integrated out under flat priors; best (n, n_exp, 2)
    # their conditional means, factor (n, n_exp, 3) the conditional precision's Cholesky factor
    # (l11, l21, l22); all where ``inside`` (n,) the mesh's region
    taus, c = np.empty(3), np.empty(3)
    table, stride = np.empty((mesh.n_kinds, 3, K)), np.empty((mesh.n_kinds, 3))
    xe = np.empty((len(mesh.distance), 2))
    s2e = np.empty((len(mesh.distance), 2))
    basis = np.empty((len(mesh.distance), 2, 3))
    A, B, Q = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(thetas)):
        theta, total = thetas[i], 0.0
        inside[i] = inside_box(theta, mesh.low, mesh.high)
        if not inside[i]:
            continue
        for k in range(len(mesh.local)):
            first, last = mesh.blocks[k], mesh.blocks[k + 1]
            phi_reference, sigma0, sigma1 = (
                theta[mesh.noise[k, 0]], theta[mesh.noise[k, 1]], theta[mesh.noise[k, 2]]
            )  # fmt: skip
            phi = per_sample(phi_reference, mesh.setting[k, 3])
            if not abs(phi) < 1.0:
                total = -np.inf
                break
            rest = 1.0 - phi * phi
            # any y0, beta serves as origin: the mesh's own reference keeps the numbers small
            y0, beta = 0.0, mesh.setting[k, 6]
            v0, v1 = variance_levels(sigma0, sigma1, mesh.setting[k, 2], mesh.setting[k, 7])
            if mesh.is_pulse:
                h, t0, tf = time_constants_of(theta, k, mesh, taus)
                separate, _ = node_responses(k, mesh, taus, t0, tf, h, c, room, table, stride)
                edge_responses(k, mesh, taus, t0, tf, c, separate, xe)
            else:
                chain_responses(theta, k, mesh, room, xe)
            change = gram_sums(
                first, last, mesh.moments, mesh.reference, mesh.reference_s2,
                room.x, room.xl, y0, beta, v0, v1, A, B,
            )  # fmt: skip
            logs = mesh.totals[k, 2] + change + mesh.totals[k, 0] * log(2.0 * pi)
            logs += mesh.totals[k, 1] * log(rest)
            for a in range(3):
                for j in range(a, 3):
                    Q[a, j] = ((1.0 + phi * phi) * A[a, j] - 2.0 * phi * B[a, j]) / rest
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
                    across = across_gap(phi, phi_reference, mesh.setting[k, 3], mesh.distance[run])
                    logs += log(1.0 - across * across)
                for a in range(3):
                    first_a = basis[run, 0, a]
                    for j in range(a, 3):
                        Q[a, j] += (
                            phi
                            * phi
                            / rest
                            * (first_a * basis[run, 0, j] - basis[run, 1, a] * basis[run, 1, j])
                        )
                        if run == mesh.runs[k]:
                            Q[a, j] += first_a * basis[run, 0, j]
                        else:
                            u = first_a - across * basis[run - 1, 1, a]
                            v = basis[run, 0, j] - across * basis[run - 1, 1, j]
                            Q[a, j] += u * v / (1.0 - across * across)
            l11 = sqrt(Q[1, 1])
            l21 = Q[1, 2] / l11
            l22 = sqrt(Q[2, 2] - l21 * l21)
            u1 = Q[0, 1] / l11
            u2 = (Q[0, 2] - l21 * u1) / l22
            best[i, k, 1] = u2 / l22
            best[i, k, 0] = (u1 - l21 * best[i, k, 1]) / l11
            best[i, k, 0] += mesh.setting[k, 5]
            best[i, k, 1] += beta
            factor[i, k, 0], factor[i, k, 1], factor[i, k, 2] = l11, l21, l22
            total += (
                -0.5 * (logs + Q[0, 0] - u1 * u1 - u2 * u2) - log(l11) - log(l22) + log(2.0 * pi)
            )
        values[i] = total
