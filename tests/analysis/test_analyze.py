"""One record of all results: the same by command and by call, as text, figures, files and back."""

import json
import re
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

import bayes_sensor as bs
from bayes_sensor.analysis.analysis import Analysis
from bayes_sensor.cli import exit_code
from bayes_sensor.io.record_archive import load_record, save_record
from tests.support.campaigns import small_problem

PARTS = ("fit", "residuals", "posterior", "predictive", "bounds", "delays", "gap")
SETTINGS = """
[fit]
swarms = 1
euler = false
[posterior]
sampler = "independence"
[bounds]
methods = ["crlb_iid", "crlb_ar1", "posterior"]
step_study = false
explain = false
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign's file, with the settings beside it; the last record has no step down."""
    folder = tmp_path_factory.mktemp("campaign")
    problem, _ = small_problem(n=3, interval=0.02, fall=[True, True, False])
    text = 'title = "small"\n[rig]\nsensor_is = "faster"\n'
    for e in problem.campaign:
        table = np.stack([e.t, e.values], axis=1)
        np.savetxt(folder / f"{e.name}.csv", table, "%.9g", ",", header="time_s,A_V", comments="")
        text += f'[[experiment]]\nname = "{e.name}"\nfile = "{e.name}.csv"\n'
        text += (
            f'carrier_flow = "{e.carrier_flow} mL/s"\ntest_gas_flow = "{e.test_gas_flow} mL/s"\n'
        )
        text += f'commanded_on = "{e.commanded_on} s"\n'
        if e.commanded_off is not None:
            text += f'commanded_off = "{e.commanded_off} s"\n'
    (folder / "campaign.toml").write_text(text)
    (folder / "settings.toml").write_text(SETTINGS)
    return folder


@pytest.fixture(scope="module")
def result(place: Path) -> Analysis:
    """What the call finds; it writes the folder "call", too."""
    return bs.analyze(
        place / "campaign.toml", seed=3, out=place / "call", config=place / "settings.toml"
    )


@pytest.fixture(scope="module")
def loaded(result: Analysis, place: Path) -> Analysis:
    """The same from the folder."""
    return bs.load(place / "call")


@pytest.mark.slow
def test_command_and_call_write_the_same(result: Analysis, place: Path) -> None:
    arguments = ["analyze", str(place / "campaign.toml"), "--out", str(place / "command")]
    arguments += ["--seed", "3", "--quiet", "--config", str(place / "settings.toml")]
    assert exit_code(arguments) == (0 if result.converged else 3)
    names = sorted(path.name for path in (place / "command").iterdir() if path.is_file())
    assert names == sorted(path.name for path in (place / "call").iterdir() if path.is_file())
    assert {f"{part}_record.npz" for part in PARTS} <= set(names)
    for name in names:
        if name not in ("run.json", "report.html"):  # these tell when and how
            same = (place / "command" / name).read_bytes() == (place / "call" / name).read_bytes()
            assert same, name


def test_a_folder_gives_the_same_record(result: Analysis, loaded: Analysis) -> None:
    assert loaded.summary() == result.summary()
    assert repr(loaded) == repr(result) and loaded._repr_html_() == result._repr_html_()
    for part in PARTS:
        ours, theirs = getattr(loaded, part), getattr(result, part)
        assert type(ours) is type(theirs)
        told, kept = theirs.to_json(), ours.to_json()
        told.pop("seconds", None), kept.pop("seconds", None)  # run.json has the times
        assert json.dumps(kept, default=float) == json.dumps(told, default=float), part
    np.testing.assert_array_equal(loaded.posterior.chains, result.posterior.chains)
    np.testing.assert_array_equal(loaded.fit.theta_hat, result.fit.theta_hat)
    assert loaded.bounds.table().equals(result.bounds.table())
    assert loaded.gap.where.equals(result.gap.where) and loaded.gap.which.equals(result.gap.which)
    for ours, theirs in zip(loaded.campaign, result.campaign, strict=True):
        np.testing.assert_array_equal(ours.t, theirs.t)
        np.testing.assert_array_equal(ours.values, theirs.values)
    theta = result.posterior.draws[7]
    assert bs.log_likelihood(loaded.problem, theta) == bs.log_likelihood(result.problem, theta)
    assert bs.log_prior(loaded.problem, theta) == bs.log_prior(result.problem, theta)


def test_nothing_is_computed_to_load(
    result: Analysis, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*arguments: object, **options: object) -> None:
        raise AssertionError("computed again")

    for name in ("fit.fit_least_squares", "posterior.sample_posterior", "bounds.compare_bounds",
                 "diagnosis.diagnose_gap", "fit.traces.make_traces", "checks.delays.regress_delays",
                 "analysis.findings.make_traces"):  # fmt: skip
        monkeypatch.setattr(f"bayes_sensor.{name}", never)
    again = bs.load(place / "call")
    assert again.summary() == result.summary()
    again.plot.fit("b")


def test_summary_tells_answer_parameters_and_gap(result: Analysis) -> None:
    text = result.summary()
    for title in ("Campaign", "Answer", "Fit statistics", "Parameters", "Correlations",
                  "Bounds of tau"):  # fmt: skip
        assert f"[[{title}]]" in text
    low, high = result.posterior.quantiles("tau_s", [0.025, 0.975])
    line = next(line for line in text.splitlines() if line.strip().startswith("tau:"))
    said = re.search(r"95 % \[(.*), (.*)\] s$", line)
    np.testing.assert_allclose([float(said[1]), float(said[2])], [low, high], rtol=1e-3)
    assert f"gap: {result.gap.verdict.sentence}" in text
    assert "tf[c]" not in text and "tf[b]" in text


def test_figures_stand_alone_and_on_axes(loaded: Analysis) -> None:
    names = ("fit", "residuals", "acf", "corner", "intervals", "delays", "gap")
    for name in names:
        figure = getattr(loaded.plot, name)()
        assert isinstance(figure, Figure) and figure.axes
    assert figure._repr_png_().startswith(b"\x89PNG")
    figure, axes = plt.subplots(2, 3)
    for ax, name in zip(axes.ravel(), [n for n in names if n != "corner"], strict=True):
        assert getattr(loaded.plot, name)(ax=ax) is ax
        assert ax.lines or ax.patches or ax.collections
    plt.close(figure)
    assert loaded.plot.intervals("V_mL").axes[0].get_xlabel() == "volume V (mL)"
    for call, message in (
        (lambda: loaded.plot.fit("9"), "there is no experiment '9'; expected one of a, b, c"),
        (
            lambda: loaded.plot.intervals("W"),
            "there are no intervals of 'W'; expected one of tau_s",
        ),
        (lambda: loaded.plot.delays("middle", ax=None), "expected side to be 'start' or 'end'"),
    ):
        with pytest.raises(bs.CampaignError, match=message):
            call()


def test_figures_of_what_is_missing_say_so(loaded: Analysis, place: Path) -> None:
    assert exit_code(
        ["fit", str(place / "campaign.toml"), "--out", str(place / "fit"), "--quiet",
         "--config", str(place / "settings.toml")]
    ) == 0  # fmt: skip
    part = bs.load(place / "fit")
    assert part.posterior is part.bounds is part.delays is part.gap is None
    (note,) = part.notes
    assert note.startswith("posterior, predictive, bounds, delays, gap: not computed by this run")
    assert part.fit.rms == pytest.approx(loaded.fit.rms, rel=1e-6)  # of another seed
    assert "[[Parameters]]" in part.summary() and "[[Bounds of tau]]" not in part.summary()
    for name in ("corner", "intervals", "delays", "gap"):
        (text,) = [t.get_text() for t in getattr(part.plot, name)().axes[0].texts]
        assert text.startswith("no ") and "run analyze" in text
    with pytest.raises(bs.CampaignError, match="these results have no posterior"):
        part.to_arviz()


def test_saving_writes_the_folder_again(loaded: Analysis, place: Path) -> None:
    loaded.save(place / "saved")
    again = bs.load(place / "saved")
    assert again.summary() == loaded.summary()
    for name in ("fit.json", "posterior.json", "bounds.json", "gap.json", "posterior.nc"):
        same = (place / "saved" / name).read_bytes() == (place / "call" / name).read_bytes()
        assert same, name


def test_records_show_themselves(result: Analysis) -> None:
    posterior, e = result.posterior, result.campaign["a"]
    records = [
        result, result.problem, result.campaign, e, result.fit, posterior, result.bounds,
        result.bounds["crlb_ar1"], result.delays, result.gap, result.residuals, result.predictive,
        result.problem.noise, posterior.layout, posterior.settings, bs.Prior("flat"),
        bs.SideInformation(1.0, 0.1), bs.Cascade(), bs.Coating(),
        bs.cramer_rao(result.campaign, posterior.draws[0], sigma=0.02),
    ]  # fmt: skip
    for record in records:
        html = record._repr_html_()
        assert html.startswith("<div>") and html.endswith("</div>"), type(record)
        assert html.count("<td") >= 1 and "array([" not in html


def test_a_broken_folder_is_refused(result: Analysis, place: Path, tmp_path: Path) -> None:
    def refused(message: str) -> None:
        with pytest.raises(bs.CampaignError, match=message):
            bs.load(tmp_path / "r")

    refused("there is no such folder")
    (tmp_path / "r").mkdir()
    refused("expected a results folder with campaign_record.npz")
    shutil.rmtree(tmp_path / "r")
    shutil.copytree(place / "call", tmp_path / "r")
    content = (tmp_path / "r" / "fit_record.npz").read_bytes()
    for broken in (content[: len(content) // 2], b"", b"PK nothing", content[:-30] + b"x" * 30):
        (tmp_path / "r" / "fit_record.npz").write_bytes(broken)
        refused("expected saved fit|expected a saved fit")
    (tmp_path / "r" / "fit_record.npz").write_bytes(content)
    (tmp_path / "r" / "run.json").write_text('{"last": "analyze", "commands": []}')
    refused(r"run.json: expected the content of run.json")
    (tmp_path / "r" / "run.json").write_bytes((place / "call" / "run.json").read_bytes())
    (tmp_path / "r" / "gap_record.npz").unlink()
    assert bs.load(tmp_path / "r").gap is None


def test_a_result_of_other_data_is_left_out(result: Analysis, place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "call", tmp_path / "r")
    known = {"experiments": result.campaign.experiments}
    path = tmp_path / "r" / "delays_record.npz"
    content = load_record(path, "delays", known)
    save_record(path, {**content, "data": "of another campaign"}, known)
    again = bs.load(tmp_path / "r")
    assert again.delays is None and again.fit is not None
    assert any("delays: that in" in note and "other data" in note for note in again.notes)


def test_held_parameters_leave_out_what_does_not_carry_them(place: Path) -> None:
    held = bs.analyze(
        place / "campaign.toml", config=place / "settings.toml", fix={"tau_v": "300 ms"},
        priors={"V": bs.Prior("normal", 14.0, 1.0)}, out=place / "held",
    )  # fmt: skip
    assert held.bounds is held.delays is held.gap is None
    assert len(held.notes) == 3 and "tau_v = 0.3 s" in held.notes[0]
    assert "(held)" in held.summary()
    (text,) = [t.get_text() for t in held.plot.gap().axes[0].texts]
    assert "not computed where parameters are held" in text
    assert bs.load(place / "held").notes == held.notes
    assert json.loads((place / "held" / "run.json").read_text())["commands"]["analyze"]["settings"][
        "fix"
    ] == {"tau_v": "300 ms"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"campaign": np.zeros(5)}, "expected the path of a campaign.toml or a Campaign, but got a "
                                    "ndarray; make one with bs.Campaign.from_frames"),
        ({"campaign": "none.toml"}, "none.toml: there is no such file"),
        ({"seed": -1}, "seed: expected a whole number"),
        ({"seed": "1"}, "seed: expected a whole number"),
        ({"priors": {"W": "flat"}}, r"\[priors\] W: unknown parameter 'W'"),
        ({"priors": {"V": 60}}, r"\[priors\] V: .*prior such as 'normal\(60, 2\) mL'"),
        ({"priors": ["V"]}, "priors: expected a mapping of settings, but got a list"),
        ({"fix": {"tau": "1 s"}}, "tau is what is measured, and cannot be held"),
        ({"fix": {"tau_v": None}}, r"\[fix\] tau_v: .*value such as '0.86 s'"),
        ({"noise": {"colour": "pink"}}, r"\[noise\] unknown key 'colour'"),
        ({"sampler": "gibbs"}, "sampler.*expected 'emcee'"),
    ],
)  # fmt: skip
def test_wrong_arguments(place: Path, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(bs.CampaignError, match=message):
        bs.analyze(**{"campaign": place / "campaign.toml", "out": place / "none", **arguments})
    assert not (place / "none").exists()


def test_the_summary_tells_the_ends_of_an_interval_apart() -> None:
    t = np.arange(0.0, 200.0, 0.1)
    y = 401.0 - 20.0 * np.expm1(-np.maximum(t - 100.3, 0.0) / 4.0)
    y += 0.02 * np.random.default_rng(1).standard_normal(len(t))
    made = bs.Campaign.from_frames({"1": (t, y)}, stages=["sensor"], commanded_on="100 s")
    text = bs.analyze(made, quick=True).summary()
    ends = re.findall(r"(\S+): .* 95 % \[(\S+), (\S+)\]", text)
    assert {"y0[1]", "t0[1]"} <= {name for name, _, _ in ends}
    assert all(low != high for _, low, high in ends)
