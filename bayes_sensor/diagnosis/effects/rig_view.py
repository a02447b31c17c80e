"""The rig of one experiment, as an effect's own function of the mean sees it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.rig.experiment_kernel import ExperimentKernel
from bayes_sensor.rig.imperfections import BETA, FIRST, INDEX, SETTINGS, Y0
from bayes_sensor.rig.perturbed import rig_mean, rig_response


def check_settings(effect: str, settings: Mapping[str, float]) -> None:
    """Raise CampaignError where an effect names a setting that the rig does not have."""
    for name in settings:
        if name not in SETTINGS:
            import difflib

            close = difflib.get_close_matches(name, SETTINGS, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(SETTINGS)}"
            raise CampaignError(f"effect {effect}: the rig has no setting '{name}'; {hint}")


@lru_cache(maxsize=1)
def coating_modes() -> tuple[FloatArray, FloatArray]:
    """Shares (6,) and time constants (6,) over the time to 63.2 % of the published coating."""
    from bayes_sensor.coating import Coating, reduced

    modes = reduced(Coating()).with_tau63(1.0)
    return np.array(modes.amplitude), 1.0 / np.array(modes.rate)


class RigView:
    """The rig of one experiment as a user's own effect sees it."""

    def __init__(
        self, setting: Setting, parameters: FloatArray, kernel: ExperimentKernel | None = None
    ) -> None:
        """``parameters``: of the ``kernel``, or of that of a pulse on the published rig,
        :func:`bayes_sensor.rig.perturbed.rig_mean`."""
        self.setting, self._parameters, self._kernel = setting, parameters, kernel
        self.y0, self.beta = float(parameters[Y0]), float(parameters[BETA])
        self.experiment = setting.experiment
        self.t0, self.tf = setting.t0, setting.tf

    def mean(self, t: FloatArray, **settings: float) -> FloatArray:
        """V (n_t,), the mean of the rig with these settings changed."""
        changed, modes = self._changed(settings), coating_modes()
        if self._kernel is not None:
            return self._kernel.mean(t, changed, modes)
        return np.asarray(rig_mean(t, changed, *modes))

    def response(self, t: FloatArray, **settings: float) -> FloatArray:
        """x3 (n_t,), 0 to 1, of the rig with these settings changed."""
        changed, modes = self._changed(settings), coating_modes()
        if self._kernel is not None:
            return self._kernel.response(t, changed, modes)
        return np.asarray(rig_response(t, changed, *modes))

    def _changed(self, settings: Mapping[str, float]) -> FloatArray:
        check_settings("user's own", settings)
        changed = self._parameters.copy()
        for name, value in settings.items():
            changed[FIRST + INDEX[name]] = value
        return changed
