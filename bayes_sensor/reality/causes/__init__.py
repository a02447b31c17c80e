"""What can go wrong on the simulated rig: one entry a cause, each turned on by one strength.

A cause turns the knobs of every experiment.  What it has to choose besides its strength (signs,
times, variants) it draws from a generator that depends on the case's seed and the cause's name
only, so that the same case with another strength differs in the strength alone.

``listed_as`` holds the names in the catalogue of effects that are a right answer, most fitting
first; it is empty for a cause outside the catalogue.
"""

from bayes_sensor.reality.causes import electronics, flows, manifold, noise, readout, sensor, valve
from bayes_sensor.reality.causes.cause import Cause, Rig
from bayes_sensor.reality.causes.noise import converter_step, tail_mixture

CAUSES: dict[str, Cause] = {
    **valve.CAUSES,
    **flows.CAUSES,
    **manifold.CAUSES,
    **sensor.CAUSES,
    **readout.CAUSES,
    **electronics.CAUSES,
    **noise.CAUSES,
}
"""by name; which campaigns a seed draws depends on their order"""

__all__ = ["CAUSES", "Cause", "Rig", "converter_step", "tail_mixture"]
