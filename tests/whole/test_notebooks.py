"""Every notebook runs from top to bottom, and one number of each is checked; so does the script."""

import json
import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from bayes_sensor.cli import main

ROOT = Path(__file__).resolve().parents[2]

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

pytestmark = [
    pytest.mark.filterwarnings("ignore"),  # the Jupyter client's own warnings, not ours
    pytest.mark.slow,
]


def run(name: str, expressions: dict[str, str]) -> dict[str, float]:
    """Execute a notebook from the repository's root; values of ``expressions`` at its end."""
    notebook = nbformat.read(ROOT / "notebooks" / name, as_version=4)
    probe = ", ".join(f"{key!r}: {code}" for key, code in expressions.items())
    notebook.cells.append(nbformat.v4.new_code_cell(f"import json; print(json.dumps({{{probe}}}))"))
    nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(ROOT)}}
    ).execute()
    shown = [
        output["data"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output["output_type"] in ("execute_result", "display_data")
    ]
    for data in shown:  # a figure that is only handed back is shown as its name
        assert not data.get("text/plain", "").startswith("<Figure") or "image/png" in data, name
    return json.loads(notebook.cells[-1]["outputs"][0]["text"])


def test_stored_notebooks_hold_no_outputs() -> None:
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        for cell in json.loads(path.read_text())["cells"]:
            assert not cell.get("outputs"), f"{path.name}: strip its outputs"


def test_main_job() -> None:
    values = run(
        "main_job.ipynb",
        {
            "lo": "lo",
            "hi": "hi",
            "truth": "truth['tau_s']",
            "rms": "fit.rms",
            "converged": "posterior.converged",
            "outliers": "start['outliers']",
            "iid": "bounds.to_json()['methods']['crlb_iid']['parameters']['V_mL']['sd']",
            "ar1": "bounds.to_json()['methods']['crlb_ar1']['parameters']['V_mL']['sd']",
        },
    )
    assert values["converged"]
    assert values["lo"] < values["truth"] < values["hi"]
    assert values["rms"] == pytest.approx(0.0653, abs=3e-4)
    assert values["outliers"] == ["4"]
    # coloured noise widens the bound by about sqrt((1 + phi)/(1 - phi)) = 3
    assert 2.5 < values["ar1"] / values["iid"] < 3.5


def test_quickstart() -> None:
    values = run("quickstart.ipynb", {"lo": "lo", "hi": "hi", "n": "len(campaign)"})
    assert values["n"] == 3
    assert 0 < values["lo"] < 0.060 < values["hi"]


def test_noise() -> None:
    values = run(
        "noise.ipynb",
        {"phi": "residuals.ar1['phi']", "right": "checks['ar1'].failed",
         "wrong": "checks['white'].failed"},
    )  # fmt: skip
    assert values["phi"] == pytest.approx(0.8, abs=0.02)
    assert values["right"] == [] and "autocorrelation" in values["wrong"]


def test_restore() -> None:
    values = run(
        "restore.ipynb",
        {"share": "share(found)", "known": "share(known)", "resolution": "found.resolution_s",
         "low": "float(found.quantile(0.025).min())"},
    )  # fmt: skip
    assert values["share"] > 0.9 and values["share"] >= values["known"]
    assert 60.0 < values["resolution"] < 2400.0  # between a sample and the lag
    assert values["low"] >= 0.0


def test_own_rig() -> None:
    values = run(
        "own_rig.ipynb",
        {"probe": "alone.posterior.quantiles('tau_s', [0.025, 0.975]).tolist()",
         "stairs": "[float(low), float(high)]"},
    )  # fmt: skip
    for name, truth in (("probe", 8.0), ("stairs", 5.0)):
        low, high = values[name]
        assert low < truth < high


def test_a_fast_sensor_narrows_the_interval_of_a_slow_one() -> None:
    values = run(
        "several_sensors.ipynb",
        {"factor": "float(factor)", "beside": "interval(beside).tolist()", "tau": "TAU['B']"},
    )
    low, high = values["beside"]
    assert values["factor"] > 1.5 and low < values["tau"] < high


def test_design() -> None:
    values = run(
        "design.ipynb",
        {"before": "proposal.before.half_width95", "after": "proposal.after.half_width95",
         "target": "target", "reached": "proposal.reached"},
    )  # fmt: skip
    assert values["reached"]
    assert values["after"] <= values["target"] < values["before"]


def test_bound_methods() -> None:
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
    t = np.arange(0.0, 20.0, 0.05)  # and of a sensor alone
    y = 1.0 - np.expm1(-np.maximum(t - 5.3, 0.0) / 2.0)
    y += 0.01 * np.random.default_rng(1).standard_normal(len(t))
    np.savetxt(tmp_path / "a.csv", np.c_[t, y], delimiter=",", header="t_s,y_V", comments="")
    path = tmp_path / "alone.toml"
    path.write_text(
        '[rig]\nstages = ["sensor"]\n[[experiment]]\nname = "1"\nfile = "a.csv"\n'
        'commanded_on = "5 s"\n'
    )
    monkeypatch.setattr(sys, "argv", [str(script), str(path), str(picture)])
    runpy.run_path(str(script))
    assert re.search(r"^tau_s +crlb_iid ", capsys.readouterr().out, re.MULTILINE)


@pytest.mark.slow
def test_coating() -> None:
    values = run(
        "coating.ipynb",
        {
            "literature": "literature.tau63",
            "lowered": "lowered.tau63",
            "reduced": "short.tau63",
            "converged": "posterior.converged",
            "published": "published.tail_probability",
            "honest": "honest.tail_probability",
            "rows": "len(table)",
        },
    )
    assert values["literature"] == pytest.approx(12.9e-3, rel=0.01)
    assert 48e-3 < values["lowered"] < 49.5e-3
    assert values["reduced"] == pytest.approx(values["literature"], rel=2e-3)
    assert values["converged"]
    assert values["published"] < 1e-3 < values["honest"]
    assert values["rows"] == 7  # the sensor and six different flows


def test_the_sealed_cause_is_found() -> None:
    values = run(
        "gap.ipynb",
        {
            "kind": "gap.verdict.kind",
            "likeliest": "gap.verdict.effects[0]",
            "probability": "gap.probabilities.effects[sealed]",
            "sealed": "sealed",
            "true": "next(iter(strength[sealed].values()))",
            "estimated": "next(iter(row.strength.values()))",
            "low": "shrink.tau_after_low_s",
            "high": "shrink.tau_after_high_s",
            "tau": "theta['tau_s']",
            "closed": "shrink.closure.fraction",
            "rival": "shrink.rival_fraction_closed",
        },
    )
    assert values["kind"] in ("effect", "family") and values["likeliest"] == values["sealed"]
    assert values["probability"] > 0.8
    assert values["estimated"] == pytest.approx(values["true"], rel=0.15)
    assert values["low"] < values["tau"] < values["high"]
    assert values["closed"] > max(0.95, values["rival"])


def test_an_effect_of_ones_own() -> None:
    values = run(
        "own_effect.ipynb",
        {
            "before": "before.verdict.kind",
            "named": "list(gap.verdict.effects)",
            "strength": "gap.which.set_index('effect').strength['crosstalk']",
            "p": "gap.verdict.probability",
        },
    )
    assert values["before"] == "unlisted"
    assert values["named"] == ["crosstalk"] and values["p"] > 0.9
    assert values["strength"]["pulse"] == pytest.approx(0.04, rel=0.15)
    assert values["strength"]["fading"] == pytest.approx(0.4, rel=0.3)
