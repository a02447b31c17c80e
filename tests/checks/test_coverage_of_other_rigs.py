"""The coverage study on a rig other than the published one."""

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks.coverage import SETTINGS, BoundsStudy, coverage_of_methods
from tests.support.other_rigs import CASES


def test_intervals_of_another_rig_are_counted() -> None:
    case = CASES["cell and sensor"]()
    n_mean = len(case.theta) - 3
    study = BoundsStudy(
        SETTINGS["ar1_0.5"], case.design, case.theta[:n_mean], ("crlb_iid", "crlb_ar1")
    )
    found = [study(i) for i in range(2)]
    results = {key: np.stack([one[key] for one in found]) for key in ("low", "high")}
    table = coverage_of_methods("ar1_0.5", study, results)
    assert {"tau_s", "V_cell_mL", "beta_V"} <= set(table["parameter"])
    rows = table[(table["parameter"] == "V_cell_mL") & (table["method"] == "crlb_ar1")]
    assert (rows["failures"] == 0).all() and (rows["median_width"] > 0).all()
    # 99.7 % of either campaign
    assert rows[rows["level"] == "997"]["covered"].iloc[0] == 2


def test_a_valve_of_two_rates_needs_a_valve() -> None:
    case = CASES["sensor"]()
    with pytest.raises(CampaignError, match="closes more slowly"):
        BoundsStudy(SETTINGS["slow_closing"], case.design, case.theta[:-3])
