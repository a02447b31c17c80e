"""Every layout of :mod:`recorder_layouts` loads unchanged, with its times and values exact."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorder_layouts import LAYOUTS, NOON, OTHER, POLLED, ON, N, T, Y, Layout, lines, samples, stamps

from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.io.check import campaign_remarks
from bayes_sensor.io.readers import read_campaign


def read(folder: Path, content: str | bytes, file: str = "a.csv", **keys: str) -> Campaign:
    """The campaign of one file; ``keys`` are TOML."""
    raw = content.encode() if isinstance(content, str) else content
    (folder / file).write_bytes(raw)
    table = {
        "name": '"1"', "file": f'"{file}"', "carrier_flow": '"4 L/min"',
        "test_gas_flow": '"0.5 L/min"', "commanded_on": '"2 s"',
    } | keys  # fmt: skip
    toml = "\n".join(["[[experiment]]", *(f"{key} = {value}" for key, value in table.items())])
    (folder / "campaign.toml").write_text(toml, encoding="utf-8")
    return read_campaign(folder / "campaign.toml")


@pytest.mark.parametrize("name", LAYOUTS)
def test_layout(name: str, tmp_path: Path) -> None:
    layout: Layout = LAYOUTS[name]
    found = read(tmp_path, layout.text, layout.file, **layout.keys)
    (e,) = found
    np.testing.assert_allclose(e.t, layout.t, rtol=0, atol=2e-9)
    np.testing.assert_allclose(e.values, layout.y, rtol=1e-12, atol=1e-12)
    assert e.used.all() and found.signal_unit == layout.unit
    assert e.commanded_on == pytest.approx(0.0 if layout.t[0] == -2.0 else ON, abs=1e-9)
    if layout.remark:
        assert len(found.warnings) == 1 and layout.remark in found.warnings[0]
    else:
        assert found.warnings == ()
