"""A mesh that follows the draws."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.mesh import Compressed, Region


def covered(compressed: Compressed, thetas: FloatArray) -> Compressed:
    """The mesh itself if it covers ``thetas`` (n, n_theta), else a wider one that does.

    The range of a parameter that has left it is extended by the spread of the draws.  A switch time
    whose spread exceeds a twentieth of its uniform prior gets the whole prior, because the data
    hardly determine it.
    """
    problem, region = compressed.problem, compressed.region
    layout = problem.layout
    low, high = region.low.copy(), region.high.copy()
    least, most = thetas.min(axis=0), thetas.max(axis=0)
    if (least >= low).all() and (most <= high).all():
        return compressed
    moved = np.ones(len(low), dtype=bool)
    moved[layout.noise] = False  # its region holds all that exists
    room = most - least
    low[moved] = np.minimum(low, least - room)[moved]
    high[moved] = np.maximum(high, most + room)[moved]
    for i, name in enumerate(layout.extra, len(layout) - len(layout.extra)):
        support = problem.priors[name].support
        low[i], high[i] = max(low[i], support[0]), min(high[i], support[1])
    for i in layout.all_switches:
        prior = problem.priors[layout.names[i]]
        if prior.kind == "uniform" and room[i] > 0.05 * (prior.b - prior.a):
            low[i], high[i] = prior.a - 1e-9, prior.b + 1e-9
    rest = slice(int(layout.one_sensor), layout.n_shared)
    if layout.one_sensor:
        low[layout.tau] = 0.0
    low[rest] = np.maximum(low[rest], 0.5 * least[rest])
    return Compressed(problem, compressed.reference, Region(low, high, region.fineness))
