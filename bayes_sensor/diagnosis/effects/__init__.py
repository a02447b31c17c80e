"""The catalogue: every cause of misfit that the diagnosis knows, one file each."""

from collections.abc import Iterable
from importlib import import_module
from types import MappingProxyType

from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis.effects.effect import Effect

NAMES = (
    "flow_switching", "valve_asymmetry", "valve_second_order", "two_rate_valve", "finite_stroke",
    "dead_volume", "axial_dispersion", "flow_settling", "flow_error", "sensor_diffusion",
    "sorption_asymmetry", "slow_sorption", "optical_nonlinearity", "baseline_drift",
    "baseline_step", "gain_drift", "carry_over", "mains_pickup", "daq_filter", "heavy_tails",
    "quantisation",
)  # fmt: skip

CATALOGUE: MappingProxyType[str, Effect] = MappingProxyType(
    {name: import_module(f"bayes_sensor.diagnosis.effects.{name}").EFFECT for name in NAMES}
)
"""name -> effect, in the order in which they are tried"""


def check_names(names: Iterable[str], where: str) -> None:
    """Raise CampaignError, with the nearest known name, for one that is not in the catalogue."""
    for name in names:
        if name not in CATALOGUE:
            import difflib

            close = difflib.get_close_matches(name, NAMES, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(NAMES)}"
            raise CampaignError(f"{where}: no effect '{name[:80]}' in the catalogue; {hint}")
