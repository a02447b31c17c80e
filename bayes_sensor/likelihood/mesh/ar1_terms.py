"""What AR(1) noise makes of the sums over the nodes: runs, gaps and edges, compiled."""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from math import log, pi

import numpy as np

from bayes_sensor.compiled import compiled


@compiled(inside=True)
def across_gap(phi, phi_reference, steps, distance):
    return phi**distance if phi_reference < 0 else phi_reference ** (steps * distance)


@compiled(inside=True)
def per_sample(phi_reference, steps):
    whole = np.rint(steps)
    if abs(steps - whole) < 1e-9 * max(1.0, steps):
        return phi_reference ** int(whole)
    return phi_reference**steps


@compiled(inside=True, forceinline=True)
def variance_levels(sigma0, sigma1, weight, fading):
    # v0, v1 of s^2 = v0 + v1 x3, as noise.scale_squared has it between 0 and the highest level
    v0 = sigma0 * sigma0
    return v0, (sigma1 * sigma1 - fading * v0) * weight


@compiled(inside=True, forceinline=True)
def combined(k, mesh, phi, phi_reference, A, B, re, log_s2):
    # log L of one experiment from block sums and standardised residuals of the edge samples
    rest = 1.0 - phi * phi
    squares = (1.0 + phi * phi) * A - 2.0 * phi * B
    total = mesh.totals[k, 1] * log(rest) + log_s2 + mesh.totals[k, 0] * log(2.0 * pi)
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        a, b = re[run, 0], re[run, 1]
        squares += phi * phi * (a * a - b * b)
        if run == mesh.runs[k]:
            total += a * a
        else:
            across = across_gap(phi, phi_reference, mesh.setting[k, 3], mesh.distance[run])
            e = a - across * re[run - 1, 1]
            total += e * e / (1.0 - across * across) + log(1.0 - across * across)
    return -0.5 * (total + squares / rest)


@compiled(inside=True, forceinline=True)
def edge_log(k, mesh, s2e):
    # log s^2 of the first sample of every run; the last one is in the blocks
    total = 0.0
    for run in range(mesh.runs[k], mesh.runs[k + 1]):
        total += log(s2e[run, 0])
    return total


@compiled(inside=True, forceinline=True)
def slopes_of_edges(k, mesh, phi, phi_reference, A, B, re, gre):
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
            across = across_gap(phi, phi_reference, steps, distance)
            left = 1.0 - across * across
            e = a - across * re[run - 1, 1]
            gre[run, 0] -= e / left
            gre[run - 1, 1] += across * e / left
            d_log = e * re[run - 1, 1] / left - across * e * e / left**2 + across / left
            if phi_reference > 0:
                g_across += d_log * steps * distance * across / phi_reference
            elif phi_reference < 0:
                slope = distance * phi ** (distance - 1)
                g_across += d_log * slope * phi_slope(phi, phi_reference, steps)
    g_phi = -0.5 * (d_squares / rest + 2.0 * phi * squares / rest**2)
    g_phi += mesh.totals[k, 1] * phi / rest
    return g_phi * phi_slope(phi, phi_reference, steps) + g_across


@compiled(inside=True)
def phi_slope(phi, phi_reference, steps):
    # derivative of phi_reference ** steps
    if steps == 1.0:
        return 1.0
    if phi_reference == 0.0:
        return 0.0
    return steps * phi / phi_reference
