"""Signal: the converter's step is not small beside the noise, the samples lie on a coarse lattice.

Tested on the sample values themselves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_sensor.campaign import Campaign
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch, detrended, innovations
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal
from bayes_sensor.residuals.converter_step import lattice_step

COARSE = 0.02
"""share of the sample-to-sample variance from which the converter's steps are called coarse"""
COARSE_OF_ALL = 0.001
"""share of the noise's whole variance below which the steps do not matter, fine as they may look"""


def look_for_steps(campaign: Campaign, stretches: Sequence[Stretch]) -> Finding:
    """Coarse steps: a lattice whose rounding makes up a share of the sample-to-sample variance."""
    steps = [lattice_step(e.values[e.used]) for e in campaign]
    known = [s for s in steps if s > 0]
    if not known or not stretches:
        return Finding(SIGNAL, -5.0, {"adc_step": 0.0}, None)
    step = float(np.median(known))
    variances = [float(np.var(innovations(detrended(s.samples), 4))) for s in stretches]
    share = step**2 / 12.0 / max(float(np.median(variances)), 1e-300)
    whole = float(np.median([np.var(s.samples) for s in stretches]))
    of_all = step**2 / 12.0 / max(whole, 1e-300)
    # the lattice itself is certain; what is judged is whether it matters
    value = 8.0 * np.log(min(share / COARSE, of_all / COARSE_OF_ALL))
    value = float(np.clip(value, -30.0, 30.0))
    return Finding(SIGNAL, value, {"adc_step": step}, None)


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    step = found.strength["adc_step"]
    if step <= 0.0:
        return "The samples lie on no lattice."
    return f"The samples lie on a lattice of steps of {1e3 * step:.3g} m{unit}."


def _look(samples: Samples) -> list[Finding]:
    return [look_for_steps(samples.campaign, samples.stretches)]


SIGNAL = Signal(
    "quantisation", 0.03, {"adc_step": "V"}, _words, _look, listed=True, despite_rounding=True
)
