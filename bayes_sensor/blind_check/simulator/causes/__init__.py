"""What can go wrong on the simulated rig: one function per cause, one file per place.

A cause changes the rig of one experiment.  Its random choices do not depend on its strength: the
same case with another strength differs in the strength alone.
"""

from bayes_sensor.blind_check.simulator.causes import (
    electronics,
    flow,
    manifold,
    readout,
    sensor,
    valve,
)
from bayes_sensor.blind_check.simulator.causes.cause import Cause
from bayes_sensor.blind_check.simulator.causes.electronics import converter_step, tail_mixture

CAUSES: dict[str, Cause] = {
    **valve.CAUSES,
    **flow.CAUSES,
    **manifold.CAUSES,
    **sensor.CAUSES,
    **readout.CAUSES,
    **electronics.CAUSES,
}
"""by name, in the order in which gas and signal meet them; several act in this order"""

__all__ = ["CAUSES", "Cause", "converter_step", "tail_mixture"]
