"""How fast CO2 reaches the ring: diffusion through the ZIF-8/PDMS coating.

The coating is a disc (or, in the planar geometry, a strip) of ZIF-8 on the chip under PDMS.
With mu the concentration as a fraction of its final value and s the storage capacity of a layer
relative to PDMS (the partition coefficient in ZIF-8, 1 in PDMS), Fick's law reads

    s dmu/dt = div(s D grad mu),   mu = 1 on top and on the outer side,   no flux below,

and both mu and the flux s D dmu/dn are continuous at the interface, so that the concentration
s mu jumps there by the partition coefficient (paper Sec. III-D and eq. 19, where it is 1).
The probe sits 220 nm above the chip at the radius of the ring.

Two independent routes lead to the response at the probe. :func:`solve` is the finite element
method on scikit-fem: biquadratic elements on a graded mesh and TR-BDF2 steps under error control;
it makes no use of the simple shape of the domain.  :func:`modal` separates the variables (Bessel
functions or cosines across, spectral elements upwards), takes milliseconds and returns the
response as a sum of exponentials, which :func:`reduced` shortens to a few of them for the
``sensor_diffusion`` effect.  :func:`infer_d_zif8` reads the diffusivity off a posterior of tau.

The lateral extent of the coating is not published; :func:`find_outer_radius` finds the radius
that reproduces the published 12.9 ms.
"""

from bayes_sensor.coating.exponentials import ReducedResponse, modal, reduced
from bayes_sensor.coating.finite_elements import (
    March,
    Response,
    System,
    assemble,
    fit_single_lag,
    march,
    solve,
)
from bayes_sensor.coating.inverse import (
    DEFAULT_TOLERANCES,
    DiffusivityPosterior,
    TauMap,
    find_outer_radius,
    infer_d_zif8,
    tau_map,
)
from bayes_sensor.coating.layers import LEVEL_63, Coating

__all__ = [
    "DEFAULT_TOLERANCES",
    "LEVEL_63",
    "Coating",
    "DiffusivityPosterior",
    "March",
    "ReducedResponse",
    "Response",
    "System",
    "TauMap",
    "assemble",
    "find_outer_radius",
    "fit_single_lag",
    "infer_d_zif8",
    "march",
    "modal",
    "reduced",
    "solve",
    "tau_map",
]
