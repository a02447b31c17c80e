"""Flows as they are set: two flows, a total flow and a concentration, standard units."""

from pathlib import Path

import numpy as np
import pytest
from scipy.constants import R, atm, zero_Celsius

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.io.readers import read_campaign

ENTRY = """
[[experiment]]
name = "1"
commanded_on = "24 s"
interval = "10 ms"
duration = "60 s"
"""


def read(tmp_path: Path, flows: str, above: str = "") -> Campaign:
    """A design with these flows."""
    path = tmp_path / "campaign.toml"
    path.write_text(above + ENTRY + flows + "\n", encoding="utf-8")
    return read_campaign(path)


def refused(tmp_path: Path, flows: str, above: str = "") -> str:
    """The message of a campaign that is refused."""
    with pytest.raises(CampaignError) as error:
        read(tmp_path, flows, above)
    return str(error.value)


@pytest.mark.parametrize(
    ("concentration", "share"), [("11.1 %", 0.111), ("400 ppm", 400e-6), ("2 ppb", 2e-9)]
)
def test_total_flow_and_concentration_make_the_two_flows(
    concentration: str, share: float, tmp_path: Path
) -> None:
    (e,) = read(tmp_path, f'total_flow = "4.5 L/min"\nconcentration = "{concentration}"')
    assert e.total_flow == pytest.approx(75.0, rel=1e-12)
    assert e.concentration == pytest.approx(share, rel=1e-12)


def test_both_ways_may_stand_where_they_agree_to_the_digits_written(tmp_path: Path) -> None:
    flows = 'carrier_flow = "4.0 L/min"\ntest_gas_flow = "0.5 L/min"\n'
    both = flows + 'total_flow = "4.5 L/min"\nconcentration = "11.1 %"'
    (e,) = read(tmp_path, both)
    assert e.concentration == pytest.approx(0.5 / 4.5, rel=1e-12)  # the flows count
    said = refused(tmp_path, flows + 'concentration = "11.3 %"')
    assert "concentration = '11.3 %', but carrier_flow and test_gas_flow make 11.11 %" in said
    said = refused(tmp_path, flows + 'total_flow = "4.6 L/min"')
    assert "total_flow = '4.6 L/min', but carrier_flow and test_gas_flow make 4.5 L/min" in said


@pytest.mark.parametrize(
    ("flows", "message"),
    [
        ('total_flow = "4.5 L/min"', 'add concentration = "11.1 %"'),
        ('concentration = "5 %"', 'add total_flow = "4.5 L/min"'),
        ('concentration = "5 %"\ncarrier_flow = "4 L/min"', "and remove carrier_flow"),
        ('total_flow = "4 L/min"\nconcentration = "5 %"\ntest_gas_flow = "1 L/min"',
         "remove test_gas_flow"),
        ('total_flow = "4 L/min"\nconcentration = 0.111', 'write concentration = "11.1 %"'),
        ('total_flow = "4 L/min"\nconcentration = "5"', 'write concentration = "5 %"'),
        ('total_flow = "4 L/min"\nconcentration = "100 %"', "between 0 and 100 %"),
        ('total_flow = "4 L/min"\nconcentration = "5 L/min"', "expected a concentration"),
        ('total_flow = 4.5\nconcentration = "5 %"', 'write total_flow = "4.5 L/min"'),
        ('totl_flow = "4 L/min"\nconcentration = "5 %"', "add total_flow"),
        ('total_flo = "4 L/min"', 'write "total_flow"'),
    ],
)  # fmt: skip
def test_a_mixture_that_cannot_be_used(flows: str, message: str, tmp_path: Path) -> None:
    said = refused(tmp_path, flows)
    assert message in said and "experiment '1'" in said


@pytest.mark.parametrize(
    ("text", "litres_a_minute"),
    [("500 sccm", 0.5), ("0.5 slm", 0.5), ("0.5 SLPM", 0.5), ("8 sccs", 0.48), ("500 nml/min", 0.5),
     ("0.5 nL/min", 0.5), ("500 mln/min", 0.5), ("5e2 sccm", 0.5)],
)  # fmt: skip
def test_standard_units_are_moles_a_time(text: str, litres_a_minute: float, tmp_path: Path) -> None:
    """Through the amount of substance: n = p V / (R T) at 0 degC and 1 atm, V again in the rig."""
    conditions = '[conditions]\ntemperature = "294.15 K"\npressure = "95 kPa"\n'
    (e,) = read(tmp_path, f'carrier_flow = "{text}"\ntest_gas_flow = "1 mL/s"', conditions)
    moles = atm * litres_a_minute * 1e-3 / 60 / (R * zero_Celsius)  # mol/s
    volume = moles * R * 294.15 / 95e3  # m^3/s
    np.testing.assert_allclose(e.carrier_flow, volume * 1e6, rtol=1e-9)
    assert e.test_gas_flow == 1.0


def test_what_standard_units_stand_for_is_said_unless_the_campaign_says_it(tmp_path: Path) -> None:
    conditions = '[conditions]\ntemperature = "20 degC"\npressure = "1.01325 bar"\n'
    flows = 'total_flow = "500 sccm"\nconcentration = "10 %"'
    assumed = read(tmp_path, flows, conditions)
    (remark,) = assumed.warnings
    assert "taken at 0 degC and 1.01325 bar" in remark and "write standard_temperature" in remark
    told = read(tmp_path, flows, conditions + 'standard_temperature = "68 degF"\n')
    assert told.warnings == ()
    assert told["1"].total_flow == pytest.approx(500 / 60, rel=1e-9)
    assert assumed["1"].total_flow == pytest.approx(500 / 60 * 293.15 / 273.15, rel=1e-9)


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ("", 'add [conditions] with temperature = "21 degC" and pressure = "1.0 bar"'),
        ('[conditions]\ntemperature = "21 degC"\n', "which need the pressure of the gas"),
        ('[conditions]\ntemperature = "21"\npressure = "1 bar"\n', "a temperature with its unit"),
        ('[conditions]\ntemperature = "21 K"\npressure = "1 bar"\n', "'21 K' is -252.1 degC"),
        ('[conditions]\ntemperature = "21 degC"\npressure = "0 bar"\n', "absolute pressure above"),
        ('[conditions]\ntemperature = "21 degC"\npressure = "1 m"\n', "an absolute pressure"),
        ('[conditions]\ntemprature = "21 degC"\n', "unknown key 'temprature'"),
    ],
)
def test_standard_units_need_the_conditions_in_the_rig(
    conditions: str, message: str, tmp_path: Path
) -> None:
    flows = 'carrier_flow = "500 sccm"\ntest_gas_flow = "20 sccm"'
    assert message in refused(tmp_path, flows, conditions)


def test_everything_that_is_left_open_is_named_at_once(tmp_path: Path) -> None:
    flows = 'carrier_flow = "? L/min"\ntest_gas_flow = "?"'
    said = refused(tmp_path, flows, '[conditions]\npressure = "? bar"\n')
    assert "pressure; carrier_flow, test_gas_flow of experiment '1' are still missing" in said
