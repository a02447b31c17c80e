"""Rigs, programmes of switches, recorded inputs and several sensors in a campaign file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.io.writers import write_campaign, write_csv
from bayes_sensor.rig.layout import Layout
from tests.support.other_rigs import CASES

T = np.arange(0.0, 100.0, 0.1)
RIG = '[rig]\nstages = ["sensor"]\n'
ONE = '[[experiment]]\nname = "1"\nfile = "a.csv"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A record with two signals, a drive of four edges that starts low, and an input."""
    rng = np.random.default_rng(1)
    y = np.where((T > 20) & (T < 60), 1.0, 0.0) + 0.01 * rng.standard_normal(len(T))
    drive = np.where(((T >= 10) & (T < 30)) | ((T >= 50) & (T < 70)), 5.0, 0.0)
    ramp = np.interp(T, [0, 20, 40, 100], [2.0, 2.0, 6.0, 6.0])
    columns = {"time_s": T, "a_V": y, "b_V": y[::-1], "drive": drive, "input": ramp}
    write_csv(tmp_path / "a.csv", columns)
    return tmp_path


def read(folder: Path, text: str) -> Campaign:
    path = folder / "campaign.toml"
    path.write_text(text)
    return read_campaign(path)


def test_a_rig_without_volumes_needs_no_flow(folder: Path) -> None:
    campaign = read(folder, RIG + ONE + 'signal = "a_V"\ncommanded_on = "20 s"\n')
    assert campaign.stages == ("sensor",) and not campaign["1"].flow_known
    assert Layout.of(campaign).shared_names == ("tau_s",)
    assert np.isnan(campaign["1"].total_flow)


def test_without_flows_and_rig_no_volume_is_assumed(folder: Path) -> None:
    campaign = read(folder, ONE + 'signal = "a_V"\ncommanded_on = "20 s"\n')
    assert Layout.of(campaign).shared_names == ("tau_s", "tau_v_s")
    assert any("without a volume" in text for text in campaign.warnings)


def test_a_volume_without_a_flow_is_refused(folder: Path) -> None:
    with pytest.raises(CampaignError, match="stage 'cell' depends on the total flow, but none"):
        read(folder, '[rig]\nstages = ["cell", "sensor"]\n' + ONE + 'commanded_on = "20 s"\n')


@pytest.mark.parametrize(
    ("stages", "said"),
    [
        ('["valv", "sensor"]', "did you mean 'valve'"),
        ('["valve"]', "exactly one called 'sensor'"),
        ('["probe: lak", "sensor"]', "did you mean 'lag'"),
        ('"sensor"', "expected a list"),
        ("[" + ", ".join(f'"p{i}: lag"' for i in range(6)) + ', "sensor"]', "one to 6"),
    ],
)
def test_stages_are_checked(folder: Path, stages: str, said: str) -> None:
    with pytest.raises(CampaignError, match=said):
        read(folder, f"[rig]\nstages = {stages}\n" + ONE + 'commanded_on = "20 s"\n')


def test_side_information_goes_by_the_rigs_parameters(folder: Path) -> None:
    rig = '[rig]\nstages = ["probe: lag", "sensor"]\n[side_information]\n'
    rest = ONE + 'signal = "a_V"\ncommanded_on = "20 s"\n'
    campaign = read(folder, rig + 'tau_probe = "2 +- 0.1 s"\n' + rest)
    assert campaign.side_information["tau_probe_s"].mean == 2.0
    with pytest.raises(CampaignError, match="unknown key 'V'; expected one that is known"):
        read(folder, rig + 'V = "60 +- 2 mL"\n' + rest)


def test_a_pulse_train_is_two_lists(folder: Path) -> None:
    lists = 'commanded_on = ["10 s", "50 s"]\ncommanded_off = ["30 s", "70 s"]\n'
    e = read(folder, RIG + ONE + 'signal = "a_V"\n' + lists)["1"]
    assert e.commands is not None and e.commands.delays == "free"
    assert e.commands.times.tolist() == [10.0, 30.0, 50.0, 70.0]
    assert e.commands.levels.tolist() == [1.0, 0.0, 1.0, 0.0]
    assert e.commanded_on == 10.0
    shared = read(folder, RIG + ONE + 'signal = "a_V"\ndelays = "shared"\n' + lists)
    assert Layout.of(shared).names[3:5] == ["delay_on_s[1]", "delay_off_s[1]"]
    # a drive with the same edges says the same
    driven = read(folder, RIG + ONE + 'signal = "a_V"\ndrive = "drive"\n')["1"].commands
    assert driven is not None
    assert driven.times == pytest.approx(e.commands.times, abs=0.1)
    assert driven.levels.tolist() == e.commands.levels.tolist()


def test_one_pulse_in_lists_is_a_pulse(folder: Path) -> None:
    lists = 'commanded_on = ["20 s"]\ncommanded_off = ["60 s"]\n'
    e = read(folder, RIG + ONE + 'signal = "a_V"\n' + lists)["1"]
    assert (e.commands, e.commanded_on, e.commanded_off) == (None, 20.0, 60.0)


def test_a_staircase_counts_from_its_highest_concentration(folder: Path) -> None:
    steps = 'steps = [{at = "10 s", to = "5 %"}, {at = "50 s", to = "10 %"}, {at = "80 s", to = 0}]'
    e = read(folder, RIG + ONE + f'signal = "a_V"\n{steps}\n')["1"]
    assert e.commands is not None
    assert e.commands.levels.tolist() == [0.5, 1.0, 0.0]
    shares = steps.replace('"5 %"', "0.2").replace('"10 %"', '"0.4"')
    e = read(folder, RIG + ONE + f'signal = "a_V"\n{shares}\n')["1"]
    assert e.commands is not None
    assert e.commands.levels.tolist() == [0.2, 0.4, 0.0]


def test_a_recorded_channel_may_be_the_input(folder: Path) -> None:
    e = read(folder, RIG + ONE + 'signal = "a_V"\ninput = "input"\n')["1"]
    assert e.commands is not None and e.commands.recorded and e.drive is None
    assert e.commands.levels.min() == 0.0 and e.commands.levels.max() == 1.0
    assert e.commanded_on is None


def test_several_sensors_share_their_records_switches(folder: Path) -> None:
    sensors = 'signals = {A = "a_V", B = "b_V"}\ncommanded_on = "20 s"\n'
    campaign = read(folder, '[rig]\nstages = ["valve", "sensor"]\n' + ONE + sensors)
    assert campaign.names_of_experiments == ["1,A", "1,B"]
    assert Layout.of(campaign).names == [
        "tau_s[A]", "tau_s[B]", "tau_v_s", "y0_V[1,A]", "beta_V[1,A]", "t0_s[1]", "y0_V[1,B]",
        "beta_V[1,B]", "phi[A]", "sigma0_V[A]", "sigma1_V[A]", "phi[B]", "sigma0_V[B]",
        "sigma1_V[B]",
    ]  # fmt: skip
    np.testing.assert_allclose(campaign["1,B"].values, campaign["1,A"].values[::-1])


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('steps = [{at = "1 s", to = 1}]\ncommanded_on = "2 s"', "both steps and commanded_on"),
        ('input = "input"\ndrive = "drive"', "both input and drive"),
        ('commanded_on = ["1 s", "2 s", "3 s"]\ncommanded_off = "2.5 s"', "one off after each on"),
        ('commanded_on = ["5 s", "3 s"]\ncommanded_off = ["6 s", "7 s"]', "times must rise"),
        ('commanded_on = "1 s"\ndelays = "shared"', "delays is for several switches"),
        ('commanded_on = ["1 s", "9 s"]\ncommanded_off = ["2 s"]\ndelays = "one"', '"free"'),
        ('steps = [{at = "1 s"}]', "each step as"),
        ('steps = [{at = "1 s", to = "5 %"}, {at = "2 s", to = 0.3}]', "all steps in %"),
        ('steps = [{at = "1 s", to = 1.5}]', "between 0 and 100 %"),
        ('steps = [{at = "1 s", to = 0.5}, {at = "2 s", to = 0.5}]', "leave it out"),
        ('signals = {A = "a_V"}\nsignal = "a_V"\ncommanded_on = "1 s"', "both signal and signals"),
        ('signals = {"A,B" = "a_V"}\ncommanded_on = "1 s"', "without brackets and commas"),
        ('steps = [{at = "200 s", to = 1}]', "the record runs from 0 s"),
        ('input = "nothing"', "nothing"),
    ],
)
def test_what_contradicts_itself_is_one_message(folder: Path, keys: str, said: str) -> None:
    signal = "" if "signal" in keys else 'signal = "a_V"\n'
    with pytest.raises(CampaignError, match=said) as error:
        read(folder, RIG + ONE + signal + keys + "\n")
    assert "experiment '1" in str(error.value)


@pytest.mark.parametrize("name", CASES)
def test_what_is_written_is_read_again(name: str, tmp_path: Path) -> None:
    data = CASES[name]().simulated()
    path = write_campaign(data, tmp_path)
    found = read_campaign(path)
    assert Layout.of(found).names == Layout.of(data).names
    assert (found.stages, found.sensor_is) == (data.stages, data.sensor_is)
    for a, b in zip(data, found, strict=True):
        np.testing.assert_allclose(b.values, a.values, atol=1e-7)
        if a.commands is None or a.commands.recorded:
            assert (a.commanded_on, a.commanded_off) == (b.commanded_on, b.commanded_off)
            continue
        assert b.commands is not None
        np.testing.assert_allclose(b.commands.times, a.commands.times)
        np.testing.assert_allclose(b.commands.levels, a.commands.levels)
        assert b.commands.delays == a.commands.delays
