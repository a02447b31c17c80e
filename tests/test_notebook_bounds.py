"""The notebook on bound methods runs and its numbers are right; so does the short script."""

import runpy
import sys
from pathlib import Path

import pytest

pytest.importorskip("nbformat")
pytest.importorskip("nbclient")

from test_notebooks import ROOT, run

from bayes_sensor.cli import main


@pytest.mark.filterwarnings("ignore")  # the Jupyter client's own warnings, not ours
def test_bounds() -> None:
    values = run(
        "bounds.ipynb",
        {
            "recipe": "3e3 * recipe['tau_s']",
            "converged": "3e3 * converged['tau_s']",
            "known": "told.known['t0, tf'] / told.known['nothing']",
            "reached": "plan.reached",
            "methods": "len(bounds.methods)",
            "gain": "float(help_rows.set_index('change')['gain'].max())",
        },
    )
    # the truth is the published parameters: Table III and its converged counterpart at this RMS
    assert values["recipe"] == pytest.approx(5.61, rel=0.01)
    assert values["converged"] == pytest.approx(32.7, rel=0.01)
    assert values["known"] < 0.2 and values["gain"] > 3.0
    assert values["reached"] and values["methods"] == 9


def test_the_script_compares_in_under_twenty_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = ROOT / "notebooks" / "compare_bounds.py"
    lines = [line for line in script.read_text().splitlines() if line.strip()]
    assert len(lines) < 20
    with pytest.raises(SystemExit) as ended:
        main(["simulate", "--out", str(tmp_path), "--duration", "30 s", "--interval", "20 ms",
              "--experiments", "1,4,6", "-q"])  # fmt: skip
    assert ended.value.code == 0
    picture = tmp_path / "b.png"
    monkeypatch.setattr(sys, "argv", [str(script), str(tmp_path / "campaign.toml"), str(picture)])
    runpy.run_path(str(script))
    assert "jackknife_experiments: assumes" in capsys.readouterr().out
    assert picture.stat().st_size > 1000
