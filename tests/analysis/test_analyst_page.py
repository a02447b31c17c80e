"""The analyst's page of the documentation: its code runs from top to bottom."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import bayes_sensor as bs
from bayes_sensor.cli import exit_code

PAGE = Path(__file__).resolve().parents[2] / "docs" / "analyst.md"
SETTINGS = """
[fit]
swarms = 1
euler = false
[posterior]
sampler = "independence"
[bounds]
methods = ["crlb_ar1", "posterior"]
step_study = false
explain = false
"""

pytestmark = [pytest.mark.prose, pytest.mark.arviz, pytest.mark.slow]


def test_the_code_of_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = ["--experiments", "1,4,6", "--duration", "15 s", "--interval", "20 ms"]
    noise = ["--tau", "150 ms", "--sigma0", "5 mV", "--sigma1", "3 mV", "--quiet"]
    assert exit_code(["simulate", "--out", str(tmp_path), *options, *noise]) == 0
    (tmp_path / "quick.toml").write_text(SETTINGS)
    monkeypatch.chdir(tmp_path)
    analyze = bs.analyze
    monkeypatch.setattr(bs, "analyze", lambda *a, **k: analyze(*a, **k, config="quick.toml"))
    names: dict[str, object] = {}
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) >= 6
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    plt.close("all")
    campaign, posterior = names["campaign"], names["posterior"]
    assert isinstance(campaign, bs.Campaign) and isinstance(posterior, bs.Posterior)
    assert campaign.names_of_experiments == ["1", "4", "6"]
    low, high = posterior.quantiles("tau_s", [0.001, 0.999])
    assert low < 0.15 < high
    assert np.ptp(posterior.of("tau_v_s")) == 0.0
    assert (tmp_path / "results" / "report.html").is_file()
    limited = names["limited"].parameters
    assert limited["tau_v_s"] == pytest.approx(6.0 * limited["tau_s"], rel=1e-12)
    assert names["again"] is not None and names["told"][0]
    assert names["simulated"].n_samples == campaign.n_samples
