"""A fleet of campaigns: which they are, failures kept apart, resumed, compared."""

import json
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayes_sensor as bs
from bayes_sensor import figures
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.fleet import COLUMNS, FleetEntry, comparison, failed_row, read_list, table
from bayes_sensor.fleet.comparison import page
from bayes_sensor.fleet.outcome import fingerprint

QUICK = """
[fit]
swarms = 1
particles = 10
euler = false
[posterior]
sampler = "independence"
n_chains = 2
target_ess = 200
[bounds]
methods = ["crlb_iid", "crlb_ar1", "posterior"]
step_study = false
explain = false
"""


def run(*arguments: str | Path) -> int:
    return exit_code([str(a) for a in arguments])


# --- lists


def touch(*paths: Path) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("title = 'x'\n")


def test_every_kind_of_list_names_the_same_campaigns(tmp_path: Path) -> None:
    touch(tmp_path / "lab" / "a" / "campaign.toml", tmp_path / "lab" / "b" / "campaign.toml")
    touch(tmp_path / "lab" / ".hidden" / "campaign.toml")
    text = tmp_path / "list.txt"
    text.write_bytes("\ufeff# two\r\nlab/a\r\n\r\n lab/b/campaign.toml  # second\r\n".encode())
    pattern = tmp_path / "pattern.txt"
    pattern.write_text("lab/*/campaign.toml\n")
    toml = tmp_path / "list.toml"
    toml.write_text('[[campaign]]\nfile = "lab/a"\n[[campaign]]\nname = "b"\nfile = "lab/b"\n')
    lists = [text, pattern, toml, tmp_path / "lab", f"{tmp_path}/lab/*"]
    found = [[(e.name, os.path.abspath(e.file)) for e in read_list(each)] for each in lists]
    assert found[0] == [(n, str(tmp_path / "lab" / n / "campaign.toml")) for n in "ab"]
    assert all(each == found[0] for each in found)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_for_a_list_or_a_campaign_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(CampaignError, match="not a regular file"):
        read_list(tmp_path / "pipe.toml")
    with pytest.raises(CampaignError, match="not a regular file"):
        fingerprint(tmp_path / "pipe.toml")


def test_names_are_unlike_each_other_and_safe(tmp_path: Path) -> None:
    listing = tmp_path / "list.txt"
    listing.write_text(
        "x/s1/campaign.toml\ny/s1/campaign.toml\nz/other.toml\n../up:1/campaign.toml\n"
    )
    assert [e.name for e in read_list(listing)] == ["x-s1", "y-s1", "other", "up-1"]
    toml = tmp_path / "list.toml"
    toml.write_text('[[campaign]]\nname = "../../etc"\nfile = "a.toml"\n')
    assert [e.name for e in read_list(toml)] == ["-..-etc"]
    toml.write_text(
        '[[campaign]]\nname = "caf\u00e9"\nfile = "a.toml"\n'
        '[[campaign]]\nname = "cafe\u0301"\nfile = "b.toml"\n'
    )
    with pytest.raises(CampaignError, match="number 2: the name .* is taken by"):
        read_list(toml)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("l.txt", b"# none\n", r"without any campaign"),
        ("l.txt", b"", r"the file is empty"),
        ("l.txt", b"a.toml\nb.toml\n./a.toml\n", r"line 3: .*stands in the list twice.*line 1"),
        ("l.txt", b"\xff\xfea\x00", r"expected UTF-8"),
        ("l.txt", b"a\0b", r"binary data"),
        ("l.txt", b"no/*/where.toml", r"line 1: the pattern .* matches nothing"),
        ("l.toml", b"[[experiment]]\nname='1'", r"this is one campaign.*use analyze"),
        ("l.toml", b"[[campaign]]\nfil='a'", r"number 1: unknown key 'fil'"),
        ("l.toml", b"[[campaign]]\nname='a'", r"number 1: expected file"),
        ("l.toml", b"[[campaign]]\nfile=3", r"number 1: expected file"),
        ("l.toml", b"campaign = [[", r"expected TOML"),
        ("l.toml", b"campaigns = 1", r"the key 'campaigns'"),
        ("l.toml", b"campaign = 1", r"nothing but \[\[campaign\]\]"),
        ("l.toml", b"[[campaign]]\nname='A'\nfile='a'\n[[campaign]]\nname='a'\nfile='b'",
         r"the name 'a' is taken"),
    ],
)  # fmt: skip
def test_a_bad_list_is_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    out = tmp_path / "out"
    assert run("fleet", tmp_path / name, "--out", out) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ") and said.err.count("\n") == 1 and said.out == ""
    assert re.search(message, said.err), said.err
    assert not out.exists()


@pytest.mark.parametrize("where", ["none.txt", "empty", "no*thing"])
def test_a_list_that_is_not_there_is_refused(tmp_path: Path, where: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(CampaignError, match="check (LIST|the name)"):
        read_list(tmp_path / where)


# --- comparison


def row(name: str, tau_ms: float, sd_ms: float, **more: Any) -> dict[str, Any]:
    made: dict[str, Any] = dict.fromkeys(COLUMNS)
    made.update(
        campaign=name, file=f"{name}.toml", title=name, status="done", message="",
        experiments=3, samples=100, signal_unit="V", tau_s=1e-3 * tau_ms, tau_sd_s=1e-3 * sd_ms,
        tau_is_limit=False, report=f"campaigns/{name}/report.html", gap="none", gap_effects="",
        tau_upper95_s=1e-3 * (tau_ms + 1.64 * sd_ms),
    )  # fmt: skip
    for end, z in (("lo95", -1.96), ("hi95", 1.96), ("lo68", -1.0), ("hi68", 1.0)):
        made[f"tau_{end}_s"] = 1e-3 * (tau_ms + z * sd_ms)
    return made | more


def test_spread_between_sensors_is_that_of_a_dense_likelihood() -> None:
    rng = np.random.default_rng(3)
    sd = rng.uniform(2.0, 6.0, 400)
    tau = rng.normal(80.0, 5.0, 400) + sd * rng.standard_normal(400)
    found = comparison([row(f"s{i}", t, s) for i, (t, s) in enumerate(zip(tau, sd, strict=True))])
    assert found["p_value"] < 1e-6 and found["n_compared"] == 400
    # another route to the same two numbers: the likelihood on a grid
    mean, between = np.meshgrid(np.linspace(77, 83, 241), np.linspace(2, 8, 241), indexing="ij")
    variance = between[..., None] ** 2 + sd**2
    log_l = -0.5 * (np.log(variance) + (tau - mean[..., None]) ** 2 / variance).sum(axis=-1)
    i, j = np.unravel_index(np.argmax(log_l), log_l.shape)
    assert 1e3 * found["mean_tau_s"] == pytest.approx(mean[i, j], abs=0.15)
    # moments and maximum likelihood: both within the sd of some .3 ms of either
    assert 1e3 * found["between_sensors_sd_s"] == pytest.approx(between[i, j], abs=0.6)
    assert 1e3 * found["mean_tau_sd_s"] == pytest.approx(float(np.hypot(5, 4) / 20), rel=0.15)


def test_sensors_alike_are_found_alike_about_as_often_as_promised() -> None:
    rng = np.random.default_rng(5)
    p = [
        comparison([row(f"s{i}", 50 + 3 * rng.standard_normal(), 3.0) for i in range(12)])[
            "p_value"
        ]
        for _ in range(400)
    ]
    # 400 draws of a uniform: its 5 % point is met within 3.3 standard deviations
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.036)


def test_counts_and_what_is_left_out_of_the_mean() -> None:
    rows = [
        row("a", 50, 3), row("b", 52, 3), row("c", 900, 3, status="not converged"),
        row("d", 5, 9, tau_is_limit=True), failed_row("e", "e.toml", "no\nfile"), row("f", 48, 3),
    ]  # fmt: skip
    found = comparison(rows)
    counts = [found[k] for k in ("n", "done", "not_converged", "failed", "limits", "n_compared")]
    assert counts == [6, 4, 1, 1, 1, 3]
    assert found["mean_tau_s"] == pytest.approx(0.05) and found["between_sensors_sd_s"] == 0.0
    assert comparison(rows[:2])["p_value"] is None
    assert comparison([rows[4]])["median_tau_s"] is None
    frame = table(rows)
    assert list(frame.columns) == list(COLUMNS) and frame["experiments"].tolist()[:2] == [3, 3]
    assert frame["message"].tolist()[4] == "no file"


def test_a_sensor_with_a_cause_found_counts_with_that_cause_in_the_model() -> None:
    rows = [row(name, 50, 3) for name in "abc"]
    cause = {"tau_with_cause_s": 0.05, "tau_with_cause_lo95_s": 0.044,
             "tau_with_cause_hi95_s": 0.056, "gap": "family"}  # fmt: skip
    wrong = row("d", 90, 1)
    assert comparison([*rows, wrong])["p_value"] < 1e-6
    found = comparison([*rows, wrong | cause])
    assert found["mean_tau_s"] == pytest.approx(0.05) and found["p_value"] == pytest.approx(1.0)
    # its interval is as wide as the others': all weigh alike
    assert found["mean_tau_sd_s"] == pytest.approx(0.0015, rel=0.02)
    text = page([*rows, wrong | cause], found, None, "1")
    assert "with the cause in the model" in text and ">90<" not in text
    axes = figures.forest([*rows, wrong | cause]).axes[0]
    assert max(float(np.max(line.get_xdata())) for line in axes.lines) < 80.0


@pytest.mark.parametrize("n", [1, 7, 80])
def test_the_figure_holds_every_campaign(n: int) -> None:
    rows = [row(f"s{i}", 20 + i, 4) for i in range(n)]
    rows += [row("limit", 3, 4, tau_is_limit=True), failed_row("lost", "x", "y")]
    axes = figures.forest(rows, 0.03).axes[0]
    names = [label.get_text() for label in axes.get_yticklabels()]
    if n <= 7:
        assert names[-1] == "lost" and set(names) == {r["campaign"] for r in rows}
    medians = {round(float(np.atleast_1d(line.get_xdata())[0]), 6) for line in axes.lines}
    assert {round(1e3 * r["tau_s"], 6) for r in rows if r["tau_s"]} <= medians
    low, high = axes.get_xlim()
    assert low <= 0.0 and high > 20 + n
    assert figures.svg(figures.forest(rows, 0.03)) == figures.svg(figures.forest(rows, 0.03))


def test_the_page_escapes_names_and_links_reports() -> None:
    rows = [row("<b>&", 50, 3, report="campaigns/a b#1/report.html"),
            failed_row("gone", "x", "<script>alert(1)</script>")]  # fmt: skip
    text = page(rows, comparison(rows), None, "1")
    assert "&lt;b&gt;&amp;" in text and "<script>alert" not in text
    assert 'href="campaigns/a%20b%231/report.html"' in text
    assert text.count("<a href=") == 3  # one report, fleet.csv, fleet.json
    assert not re.search(r'(?:src|href)="https?:', text)


# --- the command


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two good campaigns, one whose data are broken, one that is not there."""
    lab = tmp_path_factory.mktemp("lab")
    small = ["--experiments", "1,6", "--duration", "12 s", "--interval", "10 ms", "--quiet"]
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV", "--tau", "150 ms"]
    for name, seed in (("good", 1), ("broken", 2)):
        assert run("simulate", "--out", lab / name, *small, *noise, "--seed", seed) == 0
    (lab / "broken" / "exp6.csv").write_text("time_s,voltage_V\n0,1\n0,2\n")
    (lab / "list.txt").write_text("good\nbroken\nmissing/campaign.toml\n")
    (lab / "quick.toml").write_text(QUICK)
    return lab


@pytest.mark.slow
def test_a_bad_campaign_is_a_row_and_the_rest_goes_on(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, options = tmp_path / "out", ["--config", str(lab / "quick.toml")]
    assert run("fleet", lab / "list.txt", "--out", out, *options) == 3
    said = capsys.readouterr()
    assert "3 campaigns: 1 done, 0 not converged, 2 failed" in said.out and said.err == ""
    first = pd.read_csv(out / "fleet.csv").set_index("campaign")
    assert first["status"].tolist() == ["done", "failed", "failed"]
    assert "experiment '6'" in first["message"]["broken"]
    assert "there is no such file" in first["message"]["missing"]
    assert abs(first["tau_s"]["good"] - 0.15) < 4 * first["tau_sd_s"]["good"]
    posterior = json.loads((out / "campaigns" / "good" / "posterior.json").read_text())
    assert first["tau_s"]["good"] == posterior["parameters"]["tau_s"]["q50"]
    assert 'href="campaigns/good/report.html"' in (out / "index.html").read_text()
    assert sorted(p.name for p in (out / "campaigns").iterdir()) == ["good"]
    record = json.loads((out / "run.json").read_text())
    assert record["commands"]["fleet"]["exit_code"] == 3
    assert record["cost"]["good"]["peak_memory_MB"] > 50

    # resumed: the good one is not analysed again, and the comparison is the same
    import bayes_sensor.cli.run_fleets as fleets

    analysed: list[str] = []
    analyse = fleets.run_command

    def counted(command: str, campaign: Path, *rest: Any, **more: Any) -> int:
        analysed.append(campaign.parent.name)
        return analyse(command, campaign, *rest, **more)

    monkeypatch.setattr(fleets, "run_command", counted)
    before = {p.name: p.read_bytes() for p in out.iterdir() if p.is_file() and p.name != "run.json"}
    frame = bs.run_fleet(lab / "list.txt", out, config=lab / "quick.toml", resume=True)
    assert analysed == ["broken", "missing"]
    assert frame["status"].tolist() == ["done", "failed", "failed"]
    for name, content in before.items():
        assert (out / name).read_bytes() == content, name

    # other settings, or a changed file: analysed again (here the settings are refused later on)
    analysed.clear()

    def fails(command: str, campaign: Path, *rest: Any, **more: Any) -> int:
        analysed.append(campaign.parent.name)
        raise RuntimeError("an accident")

    monkeypatch.setattr(fleets, "run_command", fails)
    again = bs.run_fleet(lab / "list.txt", out, seed=2, config=lab / "quick.toml", resume=True)
    assert analysed == ["good", "broken", "missing"] and set(again["status"]) == {"failed"}
    assert "unforeseen RuntimeError (an accident)" in again["message"][0]

    def full(*arguments: Any, **more: Any) -> int:
        raise OSError(28, "No space left on device", "x")

    monkeypatch.setattr(fleets, "run_command", full)
    assert run("fleet", lab / "list.txt", "--out", out, *options) == 2
    assert "No space left" in capsys.readouterr().err


def test_a_campaign_that_kills_its_worker_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bayes_sensor.cli import run_fleets as fleets
    from bayes_sensor.workers import WorkerDied

    def died(function: Any, items: Any, jobs: int, client: Any) -> Any:
        assert all(isinstance(item, FleetEntry) for item in items)
        yield 1, {"row": failed_row("b", "b", "bad"), "cost": {}}
        yield 0, WorkerDied("it ended 3 worker processes")

    monkeypatch.setattr(fleets, "completed", died)
    (tmp_path / "l.txt").write_text("a/x.toml\nb/x.toml\n")
    frame = bs.run_fleet(tmp_path / "l.txt", tmp_path / "out", jobs=2)
    assert frame["message"].tolist() == ["it ended 3 worker processes", "bad"]
    assert not (tmp_path / "out" / "fleet.png").exists()
