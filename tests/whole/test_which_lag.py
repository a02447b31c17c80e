"""Which lag is the sensor's, wherever tau is used: bounds, plans, simulations, reports, fleets."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from posterior_calibration import CoverageStudy

from bayes_sensor import figures
from bayes_sensor.bounds import Bound, cramer_rao, explain_tau, step_study
from bayes_sensor.bounds.compare import with_words
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.checks.coverage import SETTINGS, BoundsStudy, coverage_of_methods, small_design
from bayes_sensor.cli import exit_code
from bayes_sensor.design import design_experiments, what_if
from bayes_sensor.fleet import comparison, row_of
from bayes_sensor.fleet.comparison import sentences
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.io.results import Results
from bayes_sensor.likelihood.density import log_likelihood, mean_on_grid, simulate
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import SHARED

NOISE = {"phi": 0.7, "sigma0_V": 0.01, "sigma1_V": 0.016}


def rig(order: str, tau: float, tau_v: float) -> tuple[Campaign, dict[str, Any]]:
    """Three flows, and the truth by name."""
    design, theta = small_design()
    design = replace(design, sensor_is=order)
    nested = Problem(design).layout.nested(theta)
    return design, {**nested, **NOISE, "tau_s": tau, "tau_v_s": tau_v}


# --- bounds at a theta given by name


@pytest.mark.parametrize(("tau", "tau_v"), [(0.15, 2.0), (2.0, 0.15), (2.0, 1e-3)])
def test_the_bound_is_that_of_what_theta_calls_tau(tau: float, tau_v: float) -> None:
    design, theta = rig("unknown", tau, tau_v)
    problem = Problem(design)
    bound = cramer_rao(design, theta, sigma=0.05)
    vector = problem.flat(theta)
    columns = []
    for i in range(problem.layout.n_mean):
        # relative to the shortest lag, in which the response is curved most
        h = 1e-5 * max(abs(vector[i]), 1e-2) if i > 1 else 1e-4 * vector[i]
        up, down = vector.copy(), vector.copy()
        up[i] += h
        down[i] -= h
        columns.append(
            np.concatenate(
                [mean_on_grid(problem, up, k) - mean_on_grid(problem, down, k) for k in range(3)]
            )
            / (2.0 * h)
        )
    J = np.array(columns)
    # second-order differences: 1e-6 in the columns, 1e-5 after inversion
    assert bound.information == pytest.approx(J @ J.T / 0.05**2, rel=1e-4, abs=1e-3)
    assert bound.names[:3] == ["tau_s", "tau_v_s", "V_mL"]
    swapped = cramer_rao(design, {**theta, "tau_s": tau_v, "tau_v_s": tau}, sigma=0.05)
    assert bound.sd[:3] == pytest.approx(swapped.sd[[1, 0, 2]], rel=1e-6)


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ("faster", "tau's estimate, tau_s and tau_v_s"),
        ("slower", "tau_v's estimate, tau_v_s and tau_s"),
        ("unknown", "the shorter lag's estimate, lag_fast_s and lag_slow_s"),
    ],
)
def test_a_status_calls_lags_as_the_columns_do(order: str, said: str) -> None:
    design, _ = rig(order, 0.15, 2.0)
    problem = Problem(design)
    empty = np.zeros((3, 3))
    place = "tau's estimate, tau_s and tau_v_s"
    bound = Bound(list(SHARED), empty[0], empty[0], empty, empty, place)
    assert with_words(bound, problem.naming()).status == said


def test_the_step_study_follows_the_names() -> None:
    design, theta = rig("slower", 2.0, 0.15)
    other = {**theta, "tau_s": 0.15, "tau_v_s": 2.0}
    rows = step_study(design, theta, steps=[1e-3])
    swapped = step_study(design, other, steps=[1e-3])
    for a, b in (("tau_s", "tau_v_s"), ("tau_v_s", "tau_s"), ("V_mL", "V_mL")):
        assert rows[a].to_numpy() == pytest.approx(swapped[b].to_numpy(), rel=1e-6)


@pytest.mark.parametrize("tau_v", [0.15, 1e-3])
def test_a_mesh_serves_lags_in_any_order(tau_v: float) -> None:
    design, theta = rig("unknown", 2.0, tau_v)
    data = simulate(design, theta, seed=3)
    compressed = compress(data, theta)
    vector = Problem(data).flat(theta)
    moved = vector.copy()
    moved[:3] *= 1.004, 0.99, 1.003
    for at in (vector, moved):
        assert compressed.log_likelihood(at) == pytest.approx(log_likelihood(data, at), abs=1e-4)


def test_what_makes_a_slow_sensor_hard_is_told_of_its_own_lag() -> None:
    design, theta = rig("slower", 2.0, 0.15)
    data = simulate(design, theta, seed=4)
    told = explain_tau(data, theta, n_curve=9)
    bound = cramer_rao(design, theta, noise="ar1")
    assert told.known["nothing"] == pytest.approx(bound["tau_s"], rel=1e-6)
    timed = cramer_rao(design, theta, noise="ar1", fixed=("t0_s", "tf_s"))
    assert told.known["t0, tf"] == pytest.approx(timed["tau_s"], rel=1e-6)
    curve = told.curve
    best = float(curve["tau_s"][curve["drop"].idxmin()])
    # the profile is about the longer lag: its lowest point within two sd, 3.5 sd of tau^2 wide
    assert abs(best - 2.0) < 3 * bound["tau_s"]
    assert curve["tau_s"].min() == pytest.approx(
        best - 3.5 * bound["tau_s"], abs=1.5 * bound["tau_s"]
    )
    assert curve["drop"].iloc[0] == pytest.approx(0.5 * 3.5**2, rel=0.3)


# --- plans


def test_the_plan_is_for_the_sensors_lag() -> None:
    design, theta = rig("slower", 2.0, 0.15)
    problem = Problem(design)
    table = what_if(design, theta)
    slow = cramer_rao(design, theta, noise="ar1")
    assert table["sd_tau_s"][0] == pytest.approx(slow["tau_s"], rel=0.02)
    by_size = problem.flat({**theta, "tau_s": 0.15, "tau_v_s": 2.0})  # as a fit has it
    assert what_if(design, by_size)["half_width95_s"].tolist() == pytest.approx(
        table["half_width95_s"].tolist()
    )
    unknown = replace(design, sensor_is="unknown")
    same = what_if(unknown, theta)["half_width95_s"]  # a mapping says it
    assert same.tolist() == pytest.approx(table["half_width95_s"].tolist())
    with pytest.raises(CampaignError, match="which lag is the sensor's"):
        what_if(unknown, by_size)


def test_a_proposal_keeps_what_theta_says_of_the_lags() -> None:
    design, theta = rig("unknown", 2.0, 0.15)
    limits = ((50.0, 150.0), (0.1, 0.2), (27.0, 60.0))
    found = design_experiments(design, theta, 0.01, *limits, k=1, n_grid=(2, 2, 2))
    assert found.campaign.sensor_is == "slower"
    assert found.truth_for(found.campaign)["tau_s"] == 2.0
    assert found.after.half_width95 < found.before.half_width95 < 0.1
    assert found.prior == Problem(design).priors["tau_v_s"]


def test_what_is_known_by_name_is_the_prior_of_the_plan() -> None:
    design, theta = rig("slower", 2.0, 0.15)
    law = Prior("normal", 2.0, 1e-3)
    problem = Problem(design, given_priors={"tau_s": law})
    assert problem.prior_of_tau(problem.flat(theta)) == law
    assert what_if(problem, theta)["half_width95_s"][0] == pytest.approx(1.96e-3, rel=0.02)


def test_at_one_flow_the_prior_of_the_middle_lag_is_one_of_time() -> None:
    design, theta = rig("unknown", 0.5, 2.0)
    first = design.experiments[0]
    one = replace(design, experiments=(first,))
    problem = Problem(one)
    vector = problem.flat({**theta, "V_mL": 0.1 * first.total_flow})
    found, wanted = problem.prior_of_tau(vector), problem.priors["tau_s"]  # all have one law
    assert found.kind == wanted.kind
    assert (found.a, found.b) == pytest.approx((wanted.a, wanted.b), rel=1e-12)


# --- studies


def test_a_coverage_study_counts_lags_by_size_under_their_names() -> None:
    design, theta = rig("slower", 2.0, 0.15)
    flat = Problem(design).flat(theta)[: Problem(design).layout.n_mean]
    study = BoundsStudy(SETTINGS["ar1_0.5"], design, flat, methods=("crlb_iid",))
    assert study.names[:3] == ["tau_v_s", "tau_s", "V_mL"]
    assert study.truth[:3].tolist() == [0.15, 2.0, flat[2]]
    table = coverage_of_methods("x", study, {k: v[None] for k, v in study(0).items()})
    width = table[table["level"] == "95"].set_index("parameter")["median_width"]
    assert width["tau_s"] < 0.2 < width["V_mL"]
    unknown = replace(design, sensor_is="unknown")
    names = BoundsStudy(SETTINGS["iid"], unknown, flat).names
    assert names[:3] == ["lag_fast_s", "lag_slow_s", "V_mL"]
    with pytest.raises(CampaignError, match="which lag is the sensor's"):
        CoverageStudy(Problem(unknown), Problem(unknown).flat(theta))
    assert CoverageStudy(Problem(design), Problem(design).flat(theta)).theta[0] == 0.15


# --- the command line


def run(*arguments: str | Path) -> int:
    return exit_code([str(a) for a in arguments])


QUICK = """
[fit]
swarms = 1
particles = 10
euler = true
[posterior]
sampler = "independence"
n_chains = 2
target_ess = 200
[bounds]
methods = ["crlb_iid", "crlb_ar1", "posterior"]
"""


def plan(folder: Path, order: str | None, flows: tuple[str, ...] = ("2", "5")) -> Path:
    """A design file whose rig is said to be so, or not at all."""
    lines = ['title = "two steps"']
    lines += ["[rig]", f'sensor_is = "{order}"'] if order else []
    for i, flow in enumerate(flows):
        lines += [
            "[[experiment]]", f'name = "{i}"', f'carrier_flow = "{flow} L/min"',
            'test_gas_flow = "0.5 L/min"', 'commanded_on = "3 s"', 'commanded_off = "15 s"',
            'interval = "20 ms"', 'duration = "30 s"',
        ]  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "design.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def simulated(folder: Path, order: str | None, **more: Any) -> Path:
    """A slow sensor behind a fast valve."""
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV", "--phi", "0.5"]
    lags = ["--tau", "2 s", "--tau-v", "150 ms", "--V", "40 mL"]
    design = plan(folder / "plan", order, **more)
    out = folder / "data"
    assert run("simulate", "--design", design, "--out", out, *noise, *lags, "--quiet") == 0
    return out / "campaign.toml"


@pytest.fixture(scope="module")
def undecided(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder of a campaign that does not say which lag is the sensor's."""
    return results(tmp_path_factory.mktemp("undecided"), None)


@pytest.fixture(scope="module")
def slower(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same data, with the sensor said to be the slower one."""
    return results(tmp_path_factory.mktemp("slower"), "slower")


def results(folder: Path, order: str | None) -> Path:
    campaign = simulated(folder, order)
    (folder / "quick.toml").write_text(QUICK)
    for command in ("fit", "bounds", "posterior"):
        options = ["--out", folder / "out", "--config", folder / "quick.toml", "--quiet"]
        assert run(command, campaign, *options) == 0
    assert run("report", folder / "out", "--quiet") == 0
    return folder / "out"


def saved(out: Path, name: str) -> Any:
    return json.loads((out / name).read_text())


def test_a_simulated_campaign_keeps_what_its_design_says(tmp_path: Path) -> None:
    assert read_campaign(simulated(tmp_path / "a", None)).sensor_is == "unknown"
    assert read_campaign(simulated(tmp_path / "b", "slower")).sensor_is == "slower"
    assert read_campaign(simulated(tmp_path / "c", "faster")).sensor_is == "slower"  # the truth
    out = tmp_path / "d"
    small = ["--experiments", "1", "--duration", "12 s", "--interval", "10 ms", "--quiet"]
    assert run("simulate", "--out", out, *small) == 0
    assert read_campaign(out / "campaign.toml").sensor_is == "faster"
    design = plan(tmp_path / "e", "slower")
    assert run("simulate", "--design", design, "--out", tmp_path / "f", "--quiet") == 0
    assert saved(tmp_path / "f", "truth.json")["tau_s"] == 0.8577
    assert read_campaign(tmp_path / "f" / "campaign.toml").sensor_is == "slower"


def test_the_check_prints_what_is_said_of_the_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", plan(tmp_path, None)) == 0
    assert (
        "rig: valve, manifold, sensor; which lag is the sensor: unknown" in capsys.readouterr().out
    )


def test_undecided_results_name_no_tau(undecided: Path) -> None:
    bounds = saved(undecided, "bounds.json")
    assert bounds["what_makes_tau_hard"] is None and bounds["what_would_help"] is None
    assert "which lag is the sensor's" in bounds["not_explained"]
    assert {"tau_s", "tau_v_s"}.isdisjoint(bounds["naive"]["at"])
    assert bounds["naive"]["at"].keys() >= {"lag_fast_s", "lag_slow_s", "V_mL"}
    assert bounds["step_study"] is None  # of the published sensor alone
    assert saved(undecided, "campaign.json")["sensor_is"] == "unknown"
    fit = saved(undecided, "fit.json")
    assert list(fit["estimates"]) == ["lag_fast_s", "lag_slow_s", "V_mL"]
    assert abs(fit["estimates"]["lag_slow_s"] - 2.0) < 0.1
    assert {"lag_fast_s", "lag_slow_s"} < fit["euler"]["difference"].keys()


def test_the_study_of_steps_names_no_tau_either(undecided: Path, tmp_path: Path) -> None:
    data = shutil.copytree(undecided.parent / "data", tmp_path / "data")
    text = (data / "campaign.toml").read_text()
    (data / "campaign.toml").write_text('coating = "zif8"\n' + text)
    (tmp_path / "quick.toml").write_text(
        QUICK.replace('["crlb_iid", "crlb_ar1", "posterior"]', '["crlb_iid"]')
    )
    options = ["--out", tmp_path / "out", "--config", tmp_path / "quick.toml", "--quiet"]
    assert run("bounds", data / "campaign.toml", *options) == 0
    study = saved(tmp_path / "out", "bounds.json")["step_study"]
    assert {"tau_s", "tau_v_s"}.isdisjoint(study[0])
    assert study[0].keys() >= {"lag_fast_s", "lag_slow_s", "V_mL"}


def test_an_undecided_report_shows_lags_by_size(undecided: Path) -> None:
    text = (undecided / "report.html").read_text()
    for words in ("shorter lag", "longer lag", "does not say which of those"):
        assert words in text
    for words in (
        "sensor τ",
        "valve τᵥ",
        "A slower sensor and a later switch",
        "Literature",
        "ZIF-8",
    ):
        assert words not in text
    coating = saved(undecided, "coating.json")
    rows = [row for row in coating["response_times"] if row["system"] == "sensor"]
    assert [row["sensor_is"] for row in rows] == ["faster", "slower"]
    assert sum(row["probability"] for row in rows) == pytest.approx(1.0)
    posterior = saved(undecided, "posterior.json")
    for row, lag in zip(rows, posterior["lags_s"], strict=True):
        assert row["t63_s"] == pytest.approx(lag["q50"], rel=1e-3)
        assert row["t90_s"] == pytest.approx(np.log(10.0) * row["t63_s"])
    assert coating["d_zif8"] is None  # no campaign but one with that coating asks for it
    assert "d_zif8_left_out" not in coating


def test_the_report_of_a_slow_sensor_speaks_of_its_lag(slower: Path) -> None:
    bounds = saved(slower, "bounds.json")
    hard = bounds["what_makes_tau_hard"]
    assert abs(hard["tau_s"] - 2.0) < 0.1
    sd = bounds["naive"]["crlb_ar1"]["tau_s"]
    assert hard["sd_tau_if_known_s"]["nothing"] == pytest.approx(sd, rel=1e-3)
    now = bounds["what_would_help"][0]
    assert now["lo95_s"] > 1.5 and now["hi95_s"] < 2.5
    (sensor,) = [
        row for row in saved(slower, "coating.json")["response_times"] if row["system"] == "sensor"
    ]
    assert abs(sensor["t63_s"] - 2.0) < 0.1
    text = (slower / "report.html").read_text()
    assert "shorter lag" not in text and "the longest of the lags" in text


def test_a_design_refuses_what_is_undecided(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    campaign = simulated(tmp_path, None)
    out = tmp_path / "design"
    assert run("design", campaign, "--target-tau", "5 ms", "--out", out) == 2
    said = capsys.readouterr().err
    assert "sensor_is" in said and "which lag is the sensor's" in said and not out.exists()


# --- fleets


def test_an_undecided_campaign_has_no_tau_in_a_fleet(undecided: Path, slower: Path) -> None:
    rows = [
        row_of(Results(folder), name, "f", "r", "")
        for name, folder in (("u", undecided), ("s", slower))
    ]
    first, second = rows
    assert first["order"] == "undecided" and second["order"] == "given"
    assert all(first[name] is None for name in first if name.startswith(("tau_", "tau_v_")))
    assert abs(first["V_mL"] - 40.0) < 5.0
    assert first["lag_fast_s"] < 0.3 and abs(first["lag_slow_s"] - 2.0) < 0.1
    assert abs(second["tau_s"] - 2.0) < 0.1 and not second["tau_is_limit"]
    found = comparison([first, second])
    assert found["undecided"] == 1 and found["n_compared"] == 1
    assert found["median_tau_s"] == second["tau_s"]
    assert any("do not say which lag" in text for text in sentences(found))
    for some in ([first, second], [first]):
        drawing = figures.svg(figures.forest(some, comparison(some)["median_tau_s"]))
        assert "which lag is the sensor's is not known" in drawing
