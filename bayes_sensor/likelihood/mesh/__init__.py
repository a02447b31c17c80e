"""The data of a campaign reduced once to mesh nodes, so that a likelihood costs microseconds.

Between the switch times the mean and the variance are smooth, so sums over samples such as
``sum w(t_i) d_i d_(i-1)`` may be taken with ``w`` interpolated from a few nodes: each node keeps
the Lagrange-weighted sums of 1, d_i, d_(i-1), d_i^2 and d_i d_(i-1), where d = y - m_ref.  Blocks
are narrow where a switch time may fall and grow as the exponentials die away (error of polynomial
interpolation at Chebyshev nodes: Trefethen, Approximation Theory and Approximation Practice,
2013, ch. 8).  The first and last sample of every stretch of consecutive samples are kept exactly,
and with them the pairs across gaps.

Outside the region for which the mesh was built the likelihood is computed from all samples.
"""

from bayes_sensor.likelihood.mesh.blocks import Region, build, lagrange
from bayes_sensor.likelihood.mesh.compressed import Compressed, Nodes
from bayes_sensor.likelihood.mesh.mean_derivatives import mean_derivatives, sizes
from bayes_sensor.likelihood.mesh.mesh_arrays import Arrays, K
from bayes_sensor.likelihood.mesh.mesh_region import NO_NOISE, default_region
from bayes_sensor.likelihood.mesh.reduce_campaign import (
    above_zero,
    compress,
    expected_information,
    fastest_beside_tau,
    log_likelihood,
)

__all__ = [
    "NO_NOISE",
    "Arrays",
    "Compressed",
    "K",
    "Nodes",
    "Region",
    "above_zero",
    "build",
    "compress",
    "default_region",
    "expected_information",
    "fastest_beside_tau",
    "lagrange",
    "log_likelihood",
    "mean_derivatives",
    "sizes",
]
