"""The arrays of the mesh, and scratch space for one evaluation."""

# mypy: allow-untyped-defs, allow-untyped-calls
# The kernels are typed by numba when they are compiled; annotations would not be read.

from __future__ import annotations

from math import pi
from typing import NamedTuple

import numpy as np

K = 8
"""nodes per block"""
CHEBYSHEV = 0.5 - 0.5 * np.cos((2 * np.arange(K) + 1) * pi / (2 * K))


class Arrays(NamedTuple):
    """The mesh of a whole campaign; blocks, edge samples and runs of all experiments in a row."""

    local: np.ndarray  # (n_exp, 4) positions of y0, beta, t0, tf in theta
    noise: np.ndarray  # (n_exp, 3) positions of phi, sigma0, sigma1
    blocks: np.ndarray  # (n_exp + 1,) first block of each experiment
    runs: np.ndarray  # (n_exp + 1,) first run of each experiment
    setting: np.ndarray  # (n_exp, 11) interval, total flow, variance weight, interval/reference,
    # least tau that is no delay, the reference's y0 and beta, share of sigma0^2 that fades; y0 is
    # the level that means and edge samples below count from, so that a signal far from zero keeps
    # its digits; input before all switches, number of the first switch and of the next record's
    totals: np.ndarray  # (n_exp, 3) samples, pairs of neighbouring samples, sum of the reference
    # log s^2 over the blocks' samples
    base: np.ndarray  # (n_blocks,) s, half a sample before the block's first sample
    kind: np.ndarray  # (n_blocks,) 0: pointwise; k: 8 2^k samples
    follows: np.ndarray  # (n_blocks,) whether the block starts where the previous one ends
    time: np.ndarray  # (n_nodes,) s; the nodes of all blocks in a row, K each
    moments: np.ndarray  # (5, n_nodes) of 1, d, d_lag, d^2, d d_lag
    reference: np.ndarray  # (2, n_nodes) reference mean at the node and one sample before
    reference_s2: np.ndarray  # (n_nodes,)
    edge_t: np.ndarray  # (n_runs, 2) s, first and last sample of each run
    edge_y: np.ndarray  # (n_runs, 2)
    distance: np.ndarray  # (n_runs,) samples since the previous run's last sample
    low: np.ndarray  # (n_theta,) region of the mesh
    high: np.ndarray  # (n_theta,)
    n_kinds: int
    is_pulse: bool  # three lags and one pulse a record: what the quick responses are for
    # two arrays for six quantities: handing over an array costs a hundredth of an evaluation
    lags: np.ndarray  # (n_exp, n_lags, 2) position in theta of what a lag comes from, and what that
    # is divided by: the total flow of a volume, or 1
    switches: np.ndarray  # (n_switches, 3) position in theta of what moves it, s added, height


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
