"""Response of any chain of lags to any programme of switches at the nodes of the mesh, compiled.

Where the lags are apart, the response is level - sum_j c_j A_j with A_j the sum over all switches
before of their heights times exp(-s/tau_j), which advance from node to node: the cost does not grow
with the switches.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from math import exp

import numpy as np

from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.mesh.mesh_arrays import K
from bayes_sensor.rig.partial_fractions import partial_fractions
from bayes_sensor.rig.propagation import at_any_times
from bayes_sensor.rig.sorting import rising_rates

LARGEST = 1e5
"""coefficient of an exponential, below which eleven digits are left when they cancel"""
GONE = 1e-17
"""what is left of a switch that no longer counts"""


@compiled(inside=True)
def _advance(times, shift, taus, c, switch_time, switch_height, rest, out):
    # out (n,) at times (n,) less shift, mostly rising; where they fall the sums begin anew
    n, n_switches = len(taus), len(switch_time)
    A = np.zeros(n)
    e, level, before = 0, rest, -np.inf
    for i in range(len(times)):
        t = times[i] - shift
        if t < before:
            A[:] = 0.0
            e, level = 0, rest
        elif e > 0:
            for j in range(n):
                if A[j] != 0.0:
                    A[j] *= exp((before - t) / taus[j])
                    if abs(A[j]) < GONE:
                        A[j] = 0.0
        while e < n_switches and switch_time[e] < t:
            for j in range(n):
                A[j] += switch_height[e] * exp((switch_time[e] - t) / taus[j])
            level += switch_height[e]
            e += 1
        x = level
        for j in range(n):
            x -= c[j] * A[j]
        out[i] = x
        before = t


@compiled()
def chain_responses(theta, k, mesh, room, xe):
    # Response of experiment k at the nodes (room.x), one sample before (room.xl) and at the first
    # and last sample of every run (xe)
    n = mesh.lags.shape[1]
    taus, c = np.empty(n), np.empty(n)
    for j in range(n):
        taus[j] = theta[int(mesh.lags[k, j, 0])] / mesh.lags[k, j, 1]
    rest, begin, end = mesh.setting[k, 8], int(mesh.setting[k, 9]), int(mesh.setting[k, 10])
    switch_time, switch_height = np.empty(end - begin), np.empty(end - begin)
    for e in range(end - begin):  # sorted: free switches may cross
        time = theta[int(mesh.switches[begin + e, 0])] + mesh.switches[begin + e, 1]
        place = e
        while place > 0 and switch_time[place - 1] > time:
            switch_time[place] = switch_time[place - 1]
            switch_height[place] = switch_height[place - 1]
            place -= 1
        switch_time[place] = time
        switch_height[place] = mesh.switches[begin + e, 2]
    nodes = slice(mesh.blocks[k] * K, mesh.blocks[k + 1] * K)
    times, h = mesh.time[nodes], mesh.setting[k, 0]
    n_runs = mesh.runs[k + 1] - mesh.runs[k]
    edge_times, edges = np.empty(2 * n_runs), np.empty(2 * n_runs)
    for i in range(2 * n_runs):
        edge_times[i] = mesh.edge_t[mesh.runs[k] + i // 2, i % 2]
    partial_fractions(taus, c)
    apart = True
    for j in range(n):
        if not abs(c[j]) < LARGEST:
            apart = False
    if apart:
        _advance(times, 0.0, taus, c, switch_time, switch_height, rest, room.x[nodes])
        _advance(times, h, taus, c, switch_time, switch_height, rest, room.xl[nodes])
        _advance(edge_times, 0.0, taus, c, switch_time, switch_height, rest, edges)
    else:
        rates = rising_rates(taus)
        kicks, slope = np.zeros(end - begin), np.zeros(end - begin)
        level, now = np.empty(end - begin), 0.0
        for e in range(end - begin):
            now += switch_height[e]
            level[e] = now
        at_any_times(times, rates, switch_time, kicks, level, slope, room.x[nodes])
        before = np.empty(len(times))
        for i in range(len(times)):
            before[i] = times[i] - h
        at_any_times(before, rates, switch_time, kicks, level, slope, room.xl[nodes])
        at_any_times(edge_times, rates, switch_time, kicks, level, slope, edges)
        for i in range(mesh.blocks[k] * K, mesh.blocks[k + 1] * K):
            room.x[i] += rest
            room.xl[i] += rest
    for i in range(2 * n_runs):
        xe[mesh.runs[k] + i // 2, i % 2] = edges[i] if apart else edges[i] + rest
