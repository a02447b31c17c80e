"""A signal that is no voltage: every JSON file names its unit, and its ``_V`` keys are in it."""

import json
from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.cli import exit_code

SCALE = 1000.0


def run(*arguments: str | Path) -> int:
    """The exit code of a command, in this process."""
    return exit_code([str(a) for a in arguments])


@pytest.fixture(scope="module")
def volts_and_ppm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Campaign files of the same samples, once in V and once, a thousandfold, in ppm."""
    folder = tmp_path_factory.mktemp("units")
    volts, ppm = folder / "volts", folder / "ppm"
    assert run("simulate", "--out", volts, "--experiments", "1,4,6", "--duration", "15 s",
               "--interval", "10 ms", "--tau", "150 ms", "--sigma0", "5 mV", "--sigma1", "3 mV",
               "--format", "npz", "--quiet") == 0  # fmt: skip
    ppm.mkdir()
    for path in volts.glob("*.npz"):
        with np.load(path) as recorded:
            content = dict(recorded)
        np.savez(ppm / path.name, **{**content, "y": SCALE * content["y"]})
    text = (volts / "campaign.toml").read_text(encoding="utf-8")
    assert "signal_unit" not in text
    text = text.replace("test_gas_flow", 'signal_unit = "ppm"\ntest_gas_flow')
    (ppm / "campaign.toml").write_text(text, encoding="utf-8")
    return volts / "campaign.toml", ppm / "campaign.toml"


@pytest.mark.slow
def test_every_json_file_names_the_unit(volts_and_ppm: tuple[Path, Path], tmp_path: Path) -> None:
    found = {}
    for unit, campaign in zip(("V", "ppm"), volts_and_ppm, strict=True):
        out = tmp_path / unit
        for command in (["fit"], ["posterior", "--sampler", "independence"], ["delays"]):
            assert run(*command, campaign, "--out", out, "--quiet") == 0
        files = {p.name: json.loads(p.read_text(encoding="utf-8")) for p in out.glob("*.json")}
        assert {"fit.json", "residuals.json", "posterior.json", "predictive.json", "coating.json",
                "delays.json", "campaign.json", "run.json"} <= set(files)  # fmt: skip
        said = {name: content.get("signal_unit") for name, content in files.items()}
        assert said == dict.fromkeys(files, unit)
        found[unit] = files
    volts, ppm = found["V"]["fit.json"], found["ppm"]["fit.json"]
    assert ppm["rms_V"] == pytest.approx(SCALE * volts["rms_V"], rel=1e-6)
    for name, own in ppm["parameters"]["experiments"].items():
        expected = volts["parameters"]["experiments"][name]
        assert own["beta_V"] == pytest.approx(SCALE * expected["beta_V"], rel=1e-4)
        assert own["t0_s"] == pytest.approx(expected["t0_s"], abs=2e-3)


def test_the_truth_of_a_simulation_names_the_unit(
    volts_and_ppm: tuple[Path, Path], tmp_path: Path
) -> None:
    _, campaign = volts_and_ppm
    out = tmp_path / "again"
    options = ["--sigma0", "5 ppm", "--quiet", "--format", "npz"]
    assert run("simulate", campaign, "--out", out, *options) == 0
    truth = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    assert truth["signal_unit"] == "ppm" and truth["sigma0_V"] == 5.0
    assert all(own["beta_V"] > 500.0 for own in truth["experiments"].values())
    # and it is taken again as the truth of the next
    assert run("simulate", campaign, "--out", tmp_path / "more", "--truth", out / "truth.json",
               *options) == 0  # fmt: skip
