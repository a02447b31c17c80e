"""Undo the lag: what the gas did, from what a slow sensor said.

A record is the input after a chain of lags, plus noise.  :func:`restore` gives the input with bands
that hold the lags' uncertainty, the roughness of the input and the noise.
"""

from bayes_sensor.restoration.restore_record import restore
from bayes_sensor.restoration.restored import Restored

__all__ = ["Restored", "restore"]
