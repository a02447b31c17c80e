"""The command line: exit codes, one message per mistake, nothing half-written, same numbers."""

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import bayes_sensor
import bayes_sensor.posterior as posterior
from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.overrides import make_problem, read_overrides
from bayes_sensor.analysis.posterior_step import saved_spreads, watching
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.cli.summary_lines import fit_words
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.io.results import Results
from bayes_sensor.likelihood.prior_text import read_prior
from bayes_sensor.posterior.checkpoints import Checkpoint
from bayes_sensor.rig.layout import Layout

ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


def run(*arguments: str | Path) -> int:
    """The exit code of a command, in this process."""
    return exit_code([str(a) for a in arguments])


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    """A command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "bayes_sensor", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
    )  # fmt: skip


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small simulated campaign's file."""
    folder = tmp_path_factory.mktemp("campaign")
    options = ["--experiments", "1,4,6", "--duration", "15 s", "--interval", "10 ms"]
    noise = ["--tau", "150 ms", "--sigma0", "5 mV", "--sigma1", "3 mV"]
    assert run("simulate", "--out", folder, *options, *noise, "--quiet") == 0
    return folder / "campaign.toml"


# --- start


def test_the_help_answers_quickly_and_names_the_commands() -> None:
    def spent() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    before = spent()
    with start("--help") as process:
        text, _ = process.communicate()
    assert process.returncode == 0
    assert spent() - before < 1.5  # s of the processor, whatever else runs; it takes .4 s
    for command in ("analyze", "fit", "posterior", "bounds", "delays", "simulate", "report",
                    "check", "diffusion", "design", "coverage"):  # fmt: skip
        assert re.search(rf"^  {command} ", text, re.MULTILINE)


def test_numerics_are_not_loaded_for_the_help() -> None:
    code = (
        "import sys; from bayes_sensor.cli import exit_code; exit_code(['--help'])\n"
        "heavy = {'numpy', 'scipy', 'numba', 'pandas', 'matplotlib', 'arviz', 'pydantic'}\n"
        "loaded = heavy & set(sys.modules)\n"
        "sys.exit(f'loaded: {loaded}' if loaded - {'numpy'} else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version") == 0
    assert capsys.readouterr().out == f"bayes-sensor {bayes_sensor.__version__}\n"


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "bayes_sensor", "--version"],
        capture_output=True, text=True, env=ENVIRONMENT,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, f"bayes-sensor {bayes_sensor.__version__}\n")


# --- mistakes: exit 2, one line on stderr, nothing written


def refused(capsys: pytest.CaptureFixture[str], out: Path, *arguments: str | Path) -> str:
    """The one line that a refused command says."""
    assert run(*arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("error: ") and said.err.count("\n") == 1
    assert "Traceback" not in said.err
    assert not out.exists()
    return said.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["fit"], r"Missing argument 'CAMPAIGN.toml'.*fit --help"),
        (["fit", "c.toml"], r"Missing option '--out'"),
        (["fit", "c.toml", "--out", "OUT", "--sede", "1"], r"No such option.*--seed"),
        (["fit", "c.toml", "--out", "OUT", "--seed", "x"], r"--seed.*valid int"),
        (["fit", "c.toml", "--out", "OUT", "--jobs", "0"], r"--jobs"),
        (["frobnicate"], r"No such command 'frobnicate'"),
        (["fit", "none.toml", "--out", "OUT"], r"none\.toml: there is no such file"),
        (["simulate", "--out", "OUT", "--tau", "20"], r"--tau: expected a time with its unit"),
        (["simulate", "--out", "OUT", "--tau", "20 mL"], r"--tau: expected a time, but '20 mL'"),
        (["simulate", "--out", "OUT", "--tau=-20 ms"], r"--tau: expected a positive value"),
        (
            ["simulate", "--out", "OUT", "--interval", "0 ms"],
            r"--interval: expected a positive value, but got '0 ms'; write for example \"1 ms\"",
        ),
        (["simulate", "--out", "OUT", "--phi", "1.5"], r"--phi: expected a number between"),
        (["simulate", "--out", "OUT", "--experiments", "1,9"], r"no experiment '9'"),
        (["simulate", "--out", "OUT", "--format", "xls"], r"--format: expected one of csv"),
        (["simulate", "--out", "OUT", "--interval", "1 year"], r"samples"),
        (["diffusion", "--out", "OUT", "--outer-radius", "9"], r"--outer-radius.*with its unit"),
        (["diffusion", "--out", "OUT", "--tolerance", "5"], r"--tolerance"),
        (
            ["diffusion", "--out", "OUT", "--thickness-zif8", "-1 um"],
            r"^error: --thickness-zif8: expected a positive length, got '-1 um'; write for example "
            r"\"1\.5 um\"$",
        ),
        (
            ["diffusion", "--out", "OUT", "--d-pdms", "0 m^2/s"],
            r"--d-pdms: expected a positive diffusivity, got '0 m\^2/s'; .*\"4\.2e-9 m\^2/s\"",
        ),
        (
            ["diffusion", "--out", "OUT", "--probe-height", "20 um"],
            r"^error: --probe-height: expected less than --thickness-zif8 \+ --thickness-pdms = "
            r"8\.5 um, got 20 um, .*; write for example \"0\.221 um\", or a larger thickness$",
        ),
        (
            ["diffusion", "--out", "OUT", "--outer-radius", "8 um"],
            r"--outer-radius: expected more than --ring-radius = 10 um, got 8 um, ",
        ),
        (["report", "OUT"], r"there is no such folder"),
    ],
)
def test_bad_usage_is_one_message(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "OUT"
    assert re.search(message, refused(capsys, out, *arguments))


def test_no_command_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 2
    assert "Usage: bayes-sensor" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[noise\n", r"over\.toml: expected TOML"),
        ("[noise]\nvarience = 'signal'", r"\[noise\] unknown key 'varience'.*\"variance\""),
        ("[nose]\n", r"over\.toml: unknown key 'nose'.*\"noise\""),
        ("[noise]\nvariance = 'loud'", r"variance: expected 'concentration'.*'loud'"),
        ("[fit]\nswarms = 0", r"swarms.*but got 0"),
        ("[fit]\nswarms = '3'", r"swarms.*but got '3'"),
        ("[fit]\nbounds = {tau = ['1 s', '1 ms']}", r"bounds tau: expected low < high"),
        ("[fit]\nbounds = {tau = ['1', '2']}", r"bounds tau: expected a time with its unit"),
        ("[priors]\ntua = 'flat'", r"unknown parameter 'tua'.*\"tau\""),
        ("[priors]\ntau = 'half-normal(200)'", r"tau: expected a time with its unit"),
        ("[priors]\ntau = 'gamma(1, 2)'", r"tau: expected a prior such as"),
        ("[priors]\ntau = 'normal(1 s)'", r"normal takes 2 numbers, but got 1"),
        ("[priors]\ntau = 'uniform(2 s, 1 s)'", r"expected low < high"),
        ("[priors]\n't0[9]' = 'flat'", r"unknown parameter 't0\[9\]'"),
        ("[posterior]\nsampler = 'gibbs'", r"sampler: expected 'emcee'"),
        ("[posterior]\nn_chains = 1", r"n_chains"),
        ("[bounds]\nmethods = ['crlb']", r"unknown method 'crlb'"),
    ],
)
def test_bad_settings_are_one_message(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    config = tmp_path / "over.toml"
    config.write_text(text)
    out = tmp_path / "out"
    said = refused(capsys, out, "fit", campaign, "--out", out, "--config", config)
    assert re.search(message, said), said


def test_bad_campaign_is_one_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "c.toml"
    path.write_text('[[experiment]]\nname = "1"\nfile = "no.csv"\ncarrier_flow = 4\n')
    out = tmp_path / "out"
    assert "carrier_flow" in refused(capsys, out, "analyze", path, "--out", out)
    path.write_text(
        '[[experiment]]\nname = "1"\ncarrier_flow = "4 L/min"\ntest_gas_flow = "1 L/min"\n'
        'commanded_on = "1 s"\ninterval = "1 ms"\nduration = "5 s"\n'
    )
    assert "design without data" in refused(capsys, out, "fit", path, "--out", out)


def test_out_that_is_a_file_is_refused(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "file"
    out.write_text("keep me")
    assert run("fit", campaign, "--out", out) == 2
    assert "cannot be written" in capsys.readouterr().err
    assert out.read_text() == "keep me"


# --- settings


def test_priors_and_noise_reach_the_problem(campaign: Path, tmp_path: Path) -> None:
    config = tmp_path / "over.toml"
    config.write_text(
        "[noise]\nvariance = 'signal'\n[priors]\n"
        "tau = 'log-uniform(1 ms, 1 s)'\nV = 'normal(60 mL, 2000 mm^3)'\n"
        "'t0[4]' = 'uniform(3 s, 5 s)'\nt0 = 'uniform(1 s, 9 s)'\nsigma0 = 'half-normal(50 mV)'\n"
        "phi = 'uniform(0, 1)'\n"
    )
    overrides = read_overrides(config, {"max_steps": 50})
    problem = make_problem(read_campaign(campaign), overrides, "over.toml")
    assert problem.noise.variance == "signal"
    priors = {name: str(problem.priors[name]) for name in problem.layout.names}
    assert priors["tau_s"] == "log-uniform(0.001, 1)"
    assert priors["V_mL"] == "normal(60, 2)"
    assert priors["t0_s[4]"] == "uniform(3, 5)" and priors["t0_s[1]"] == "uniform(1, 9)"
    assert priors["sigma0_V"] == "half-normal(0.05)" and priors["phi"] == "uniform(0, 1)"
    assert overrides.sampler_settings().max_steps == 50


@pytest.mark.parametrize(
    "text",
    ["", "flat(1 s)", "half-normal", "half-normal(-1 s)", "normal(,)", "log-normal(48 ms, nan)"],
)
def test_a_prior_that_makes_no_sense_is_refused(text: str) -> None:
    with pytest.raises(CampaignError, match=r"tau: "):
        read_prior(text, "tau_s", "V", "tau")


@pytest.mark.parametrize("text", ["normal(nan, 0.1)", "normal(0, inf)", "uniform(-inf, inf)"])
def test_a_prior_without_finite_numbers_is_refused(text: str) -> None:
    with pytest.raises(CampaignError, match="phi: expected a number.*, but got '.*(nan|inf)'"):
        read_prior(text, "phi", "V", "phi")


# --- commands


def test_simulate_writes_what_can_be_read_again(campaign: Path) -> None:
    truth = json.loads((campaign.parent / "truth.json").read_text())
    assert truth["tau_s"] == 0.15 and truth["sigma0_V"] == 0.005
    assert set(truth["experiments"]) == {"1", "4", "6"}
    read = read_campaign(campaign)
    assert read.names_of_experiments == ["1", "4", "6"]
    for e in read:
        assert len(e.t) == 1500 and e.interval == pytest.approx(0.01)
        own = truth["experiments"][e.name]
        assert e.commanded_on is not None and e.commanded_on < own["t0_s"] < own["tf_s"] < 15.0
        # noise of 5 to 6 mV around the model: before the step the signal is y0
        assert np.mean(e.values[:200]) == pytest.approx(own["y0_V"], abs=0.003)


def test_simulate_takes_design_truth_and_seed(campaign: Path, tmp_path: Path) -> None:
    truth = campaign.parent / "truth.json"
    for name, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        options = ["--truth", truth, "--seed", seed, "--format", "npz", "--quiet"]
        assert run("simulate", "--design", campaign, "--out", tmp_path / name, *options) == 0
    a, b, c = (read_campaign(tmp_path / n / "campaign.toml")["4"].values for n in "abc")
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.001


def test_check_prints_what_was_understood(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", campaign) == 0
    text = capsys.readouterr().out
    assert "3 experiments, 4500 samples in use" in text
    row = next(line for line in text.splitlines() if line.startswith("4 "))
    assert "0.01 s" in row and " 9 " in row and " 11.1 " in row
    assert run("check", campaign, "--quiet") == 0
    assert capsys.readouterr().out == ""


def numbers(folder: Path) -> dict[str, Any]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "run.json"}


@pytest.mark.slow
def test_fit_is_replaced_as_a_whole_and_repeats_itself(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    out = tmp_path / "out"
    assert run("fit", campaign, "--out", out, "--seed", "3") == 0
    said = capsys.readouterr()
    assert "RMS residual" in said.out and said.err == ""
    fit = json.loads((out / "fit.json").read_text())
    assert {"rms_V", "n_samples", "parameters", "at_bound", "converged", "warnings"} <= set(fit)
    assert fit["parameters"]["tau_s"] == pytest.approx(0.15, abs=0.05)
    first = numbers(out)
    assert set(first) == {
        "fit.json",
        "residuals.json",
        "campaign.json",
        "traces.npz",
        "samples.npz",
        *("campaign_record.npz", "fit_record.npz", "residuals_record.npz"),
    }
    record = json.loads((out / "run.json").read_text())["commands"]["fit"]
    assert record["seed"] == 3 and record["exit_code"] == 0
    assert set(record["files_sha256"]) == {"campaign.toml", "exp1.csv", "exp4.csv", "exp6.csv"}
    # a failure while the results are written leaves the old ones alone
    import bayes_sensor.residuals

    def broken(*arguments: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(bayes_sensor.residuals.Residuals, "to_json", broken)
        assert run("fit", campaign, "--out", out, "--seed", "4") == 2
    assert "No space left" in capsys.readouterr().err
    assert numbers(out) == first
    assert run("fit", campaign, "--out", out, "--seed", "3", "--jobs", "2", "--quiet") == 0
    assert capsys.readouterr().out == ""
    assert numbers(out) == first


def test_delays_are_saved(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run("delays", campaign, "--out", out) == 0
    assert "end delay = " in capsys.readouterr().out
    found = json.loads((out / "delays.json").read_text())
    assert set(found) == {"start", "end", "signal_unit"}
    assert found["start"]["n"] == found["end"]["n"] == 3


def test_files_of_one_name_in_two_folders_are_both_recorded(campaign: Path, tmp_path: Path) -> None:
    text = campaign.read_text()
    for i in "14":
        (tmp_path / i).mkdir()
        (tmp_path / i / "exp.csv").write_bytes((campaign.parent / f"exp{i}.csv").read_bytes())
        text = text.replace(f'"exp{i}.csv"', f'"{i}/exp.csv"')
    (tmp_path / "exp6.csv").write_bytes((campaign.parent / "exp6.csv").read_bytes())
    (tmp_path / "campaign.toml").write_text(text)
    out = tmp_path / "out"
    assert run("fit", tmp_path / "campaign.toml", "--out", out, "--quiet") == 0
    files = json.loads((out / "run.json").read_text())["commands"]["fit"]["files_sha256"]
    assert set(files) == {"campaign.toml", "1/exp.csv", "4/exp.csv", "exp6.csv"}


def test_bounds_without_the_posterior(campaign: Path, tmp_path: Path) -> None:
    config = tmp_path / "over.toml"
    config.write_text("[bounds]\nmethods = ['crlb_iid', 'crlb_ar1']\nstep_study = false\n")
    out = tmp_path / "out"
    assert run("bounds", campaign, "--out", out, "--config", config, "--quiet") == 0
    bounds = json.loads((out / "bounds.json").read_text())
    assert set(bounds["methods"]) == {"crlb_iid", "crlb_ar1"}
    assert bounds["naive"]["crlb_iid"]["tau_s"] > 0
    header = (out / "bounds.csv").read_text().splitlines()[0]
    assert header.startswith("parameter,method,estimate,sd,lo68,hi68")


def test_bounds_take_the_posterior_from_the_fastest_sampler(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    sample = posterior.sample_posterior

    def noted(*args: Any, sampler: str, **options: Any) -> Any:
        asked.append(sampler)
        return sample(*args, sampler="independence", **options)

    monkeypatch.setattr(posterior, "sample_posterior", noted)
    config = tmp_path / "over.toml"
    config.write_text("[bounds]\nmethods = ['posterior']\nstep_study = false\n")
    options = ("--config", config, "--quiet")
    assert run("bounds", campaign, "--out", tmp_path / "out", *options) == 0
    assert run("bounds", campaign, "--out", tmp_path / "2", "--sampler", "emcee", *options) == 0
    assert asked == ["independence", "emcee"]


@pytest.mark.slow
def test_closed_streams_are_no_obstacle(campaign: Path, tmp_path: Path) -> None:
    # as services and the like start a program
    for work, closed in (("fit", "2>&-"), ("posterior", "--sampler independence <&- >&- 2>&-")):
        out = tmp_path / work
        command = f'"{sys.executable}" -m bayes_sensor {work} "$0" --out "$1" {closed}'
        words = [command, str(campaign), str(out)]
        assert subprocess.run(["sh", "-c", *words], env=ENVIRONMENT).returncode == 0
        assert (out / f"{work}.json").is_file()


def test_a_terminal_that_cannot_show_a_letter_shows_its_number() -> None:
    pty = pytest.importorskip("pty", reason="terminals are opened as on Unix")
    code = (
        "from bayes_sensor.cli.terminal import progress_bar\n"
        "with progress_bar('fit', False) as tell: tell(0.5, chr(0x3c4))"
    )
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "TERM": "xterm",
             "COLUMNS": "80"}  # fmt: skip
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [sys.executable, "-c", code], env=ENVIRONMENT | plain, stderr=theirs
    ) as process:
        os.close(theirs)
        shown = b""
        while part := _read(ours):
            shown += part
    os.close(ours)
    assert process.returncode == 0
    assert b"fit" in shown and b"\\u03c4" in shown


def _read(descriptor: int) -> bytes:
    """What a terminal's program wrote; nothing at its end, which Linux calls an error."""
    try:
        return os.read(descriptor, 4096)
    except OSError:
        return b""


@pytest.mark.slow
def test_delays_take_their_weights_from_the_newest_posterior_only(
    campaign: Path, tmp_path: Path
) -> None:
    def weights(config: Path) -> object:
        assert run("delays", campaign, "--out", tmp_path, "--quiet", "--config", config) == 0
        job = Job("delays", None, None, "", 1, 1, True, False, Results(tmp_path), basis())
        return saved_spreads(job)

    def basis() -> str:
        commands = json.loads((tmp_path / "run.json").read_text())["commands"]
        return str(commands["delays"]["basis_sha256"])

    configs = [tmp_path / "ar1.toml", tmp_path / "white.toml"]
    common = ["--out", tmp_path, "--sampler", "independence", "--quiet", "--config"]
    for config, law in zip(configs, ("ar1", "white"), strict=True):
        config.write_text(f"[noise]\nautocorrelation = '{law}'\n")
        assert run("posterior", campaign, *common, config) == 0
    assert weights(configs[0]) is None
    assert weights(configs[1]) is not None
    # an older analyze with the first settings has not written posterior.json
    record = json.loads((tmp_path / "run.json").read_text())
    earlier = record["commands"]["posterior"] | {"finished": "2000-01-01T00:00:00Z"}
    assert run("delays", campaign, "--out", tmp_path, "--quiet", "--config", configs[0]) == 0
    record = json.loads((tmp_path / "run.json").read_text())
    record["commands"]["analyze"] = earlier | {"basis_sha256": basis()}
    (tmp_path / "run.json").write_text(json.dumps(record))
    assert weights(configs[0]) is None


@pytest.mark.slow
def test_a_posterior_that_does_not_converge_says_so(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    options = ["--walkers", "32", "--steps", "110", "--chains", "2", "--sampler", "emcee"]
    assert run("posterior", campaign, "--out", out, *options) == 3
    said = capsys.readouterr()
    assert said.err.startswith("not converged: ") and said.err.count("\n") == 1
    posterior = json.loads((out / "posterior.json").read_text())
    assert posterior["converged"] is False and posterior["parameters"]["tau_s"]["r_hat"] > 0
    assert (out / "posterior.nc").is_file()
    assert json.loads((out / "run.json").read_text())["commands"]["posterior"]["exit_code"] == 3


def test_a_fit_that_sees_no_step_is_one_sentence(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    from bayes_sensor.fit import least_squares

    monkeypatch.setattr(least_squares, "step_is_seen", lambda *_: False)
    assert run("fit", campaign, "--out", tmp_path, "--quiet") == 3
    said = capsys.readouterr().err
    assert said.startswith("not converged: No step is seen")
    assert "mean nothing; the results are marked so" in said


def test_a_file_is_no_results_folder(campaign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("report", campaign) == 2
    assert "this is a file; expected a results folder" in capsys.readouterr().err


def test_lags_are_told_in_order() -> None:
    values = {"lag_slow_s": 0.0489, "lag_fast_s": 0.0128, "lag_between_s": 0.02}
    fit = SimpleNamespace(
        estimates=lambda: dict(values), order="unknown", rms=0.01, signal_unit="V"
    )
    assert fit_words(fit).startswith("lags of 12.8 ms, 20.0 ms and 48.9 ms;")


def test_a_checkpoint_of_other_settings_is_said_not_to_be_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for resume, digest, n in ((True, "mine", 0), (True, "other", 1), (False, "third", 0)):
        Checkpoint(tmp_path, "mine", resume=False)
        (tmp_path / "ensemble-0-00000.npz").write_bytes(b"")
        caplog.clear()
        told: list[float] = []
        tell = watching(
            SimpleNamespace(resume=resume, checkpoint=tmp_path),  # type: ignore[arg-type]
            lambda share, _, told=told: told.append(share),
        )
        tell(0.0, "approximation")
        Checkpoint(tmp_path, digest, resume)
        tell(0.5, "sampling")
        tell(1.0, "done")
        assert told == [0.0, 0.5, 1.0]
        said = [r.getMessage() for r in caplog.records]
        assert len(said) == n and all("is of other data or settings" in text for text in said)


def test_quantities_of_a_coating_are_taken_together(tmp_path: Path) -> None:
    # neither is possible with the other's default
    radii = ["--outer-radius", "8 um", "--ring-radius", "5 um"]
    assert run("diffusion", "--out", tmp_path, *radii, "--tolerance", "0.05", "--quiet") in (0, 3)


def test_the_noise_law_does_not_act_on_the_gap_and_this_is_said(
    campaign: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    import bayes_sensor.diagnosis as room

    given: list[Any] = []

    def stop(_campaign: Any, fit: Any, **_options: Any) -> None:
        given.append(fit)
        raise CampaignError("gap: far enough")

    monkeypatch.setattr(room, "diagnose_gap", stop)
    said = []
    for config in ("[noise]\nper_experiment = true\n", "[fit]\nswarms = 2\n"):
        caplog.clear()
        (tmp_path / "over.toml").write_text(config)
        options = ["--config", tmp_path / "over.toml", "--quiet"]
        assert run("gap", campaign, "--out", tmp_path / "out", *options) == 2
        said.append([r.getMessage() for r in caplog.records if "[noise]" in r.getMessage()])
    assert said[0][0].startswith("over.toml: [noise] does not act on gap") and said[1] == []
    # both are given whole, and have the same mean, which is all that the diagnosis takes
    names = Layout.of(read_campaign(campaign)).mean_names
    assert [fit.names[: len(names)] for fit in given] == [names, names]
    assert [len(fit.theta_hat) for fit in given] == [len(fit.names) for fit in given]
    assert len(given[0].names) > len(given[1].names) == len(names) + 3


def test_diffusion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run("diffusion", "--out", out, "--d-zif8", "2.6e-11 m^2/s", "--tolerance", "0.01") == 0
    record = json.loads((out / "diffusion.json").read_text())
    assert record["tau63_ms"] == pytest.approx(48.9, rel=0.03)  # the paper: comparable to 48 ms
    assert "63.2 % after" in capsys.readouterr().out
    assert (out / "diffusion.svg").read_text().startswith("<svg")


def run_code(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=25,
        env=ENVIRONMENT | variables,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [("ascii", "\\u03c4 \\xb1 \\u6c17"), ("cp1252:strict", "\\u03c4 \xb1 \\u6c17")],
)
def test_a_console_that_lacks_a_letter_shows_its_number(encoding: str, shown: str) -> None:
    code = (
        "from bayes_sensor import cli\n"
        "from bayes_sensor.campaign import CampaignError\n"
        "def app(**_):\n    print(chr(0x3c4), chr(0xb1), chr(0x6c17))\n"
        "    raise CampaignError(chr(0x3c4) + chr(27) + '[2J')\n"
        "cli.app = app\n"
        "cli.main(['check', 'campaign.toml'])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, timeout=25,
        env=ENVIRONMENT | {"PYTHONIOENCODING": encoding},
    )  # fmt: skip
    assert done.returncode == 2 and done.stdout.decode("cp1252") == shown + "\n"
    assert done.stderr == b"error: \\u03c4\\ufffd[2J\n"  # no code reaches the terminal


def test_a_working_directory_that_is_gone_is_named(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    code = (
        "import os\n"
        "from bayes_sensor import cli\n"
        f"os.chdir({str(tmp_path / 'gone')!r})\n"
        f"os.rmdir({str(tmp_path / 'gone')!r})\n"
        "def app(**_):\n    os.path.abspath('campaign.toml')\n"
        "cli.app = app\n"
        "cli.main(['check', 'campaign.toml'])\n"
    )
    done = run_code(code)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("error: the working directory: it has been removed")


@pytest.mark.parametrize(
    ("name", "code", "word"), [("SIGTERM", 143, "terminated"), ("SIGHUP", 129, "hung up")]
)
def test_other_signals_stop_a_run_as_ctrl_c_does(name: str, code: int, word: str) -> None:
    begin = (
        "import os, signal, sys, time\n"
        f"signal.signal(signal.{name}, signal.SIG_DFL)\n"  # the tests may run under nohup
        "from bayes_sensor import cli\n"
        f"def app(**_):\n    os.kill(os.getpid(), signal.{name})\n    time.sleep(%s)\n"
        "cli.app = app\n"
    )
    end = "cli.main(['posterior', 'campaign.toml', '--out', 'results'])\n"
    done = run_code(begin % 10 + end)
    assert done.returncode == code and done.stdout == ""
    expected = "bayes-sensor posterior campaign.toml --out results --resume"
    assert done.stderr == f"stopped: {word}; continue with: {expected}\n"
    # nohup
    done = run_code(begin % 0.1 + f"signal.signal(signal.{name}, signal.SIG_IGN)\n" + end)
    assert done.returncode == 0 and done.stderr == ""


@pytest.mark.parametrize("module", ["typer", "numpy"])
def test_an_interruption_while_the_command_is_loaded_is_one_line(
    tmp_path: Path, module: str
) -> None:
    # found first, it presses Ctrl-C in the midst of an import
    (tmp_path / f"{module}.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(10.0)\n"
    )
    path = os.pathsep.join([str(tmp_path), ENVIRONMENT.get("PYTHONPATH", "")])
    environment = {**ENVIRONMENT, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-m", "bayes_sensor", "check", "campaign.toml"],
        capture_output=True, text=True, env=environment, timeout=25,
    )  # fmt: skip
    assert done.returncode == 130 and done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("stopped: interrupted before anything was begun; ")


def test_an_interruption_of_a_compiler_waits_until_it_has_finished() -> None:
    # it would turn it into errors of its own; its callbacks drop it with a message
    code = (
        "import ctypes, os, signal, time\n"
        "from bayes_sensor import cli\n"
        "press = 'os.kill(os.getpid(), signal.SIGINT)'\n"
        "room = {'__name__': 'numba.core', 'os': os, 'signal': signal, 'time': time}\n"
        "exec(f'def build():\\n {press}\\n time.sleep(0.1)\\n print(7)', room)\n"
        "called = ctypes.CFUNCTYPE(None)(lambda: eval(press))\n"
        "def app(**_):\n"
        "    room['build']()\n"
        "    called()\n"
        "    time.sleep(30.0)\n"
        "cli.app = app\n"
        "cli.main(['fit', 'campaign.toml', '--out', 'results'])\n"
    )
    done = run_code(code)
    lines = [line for line in done.stderr.splitlines() if line]
    assert done.returncode == 130 and len(lines) == 1, done.stderr
    assert lines[0].startswith("stopped: interrupted; ") and done.stdout == "7\n"


def test_a_compiler_that_takes_long_is_left_with_one_line_even_where_all_is_muted() -> None:
    # as inside emcee: what is at work then must not swallow how to go on
    code = (
        "import os, signal, time\n"
        "from bayes_sensor import cli\n"
        "from bayes_sensor.cli.terminal import muted\n"
        "room = {'__name__': 'numba.core', 'os': os, 'signal': signal, 'time': time}\n"
        "press = 'os.kill(os.getpid(), signal.SIGINT)'\n"
        "exec(f'def build():\\n {press}\\n while True: time.sleep(0.01)', room)\n"
        "def app(**_):\n"
        "    with muted():\n"
        "        room['build']()\n"
        "cli.app = app\n"
        "cli.main(['posterior', 'campaign.toml', '--out', 'results'])\n"
    )
    done = run_code(code)
    assert done.returncode == 130 and done.stdout == ""
    expected = "bayes-sensor posterior campaign.toml --out results --resume"
    assert done.stderr == f"stopped: interrupted; continue with: {expected}\n"


@pytest.mark.parametrize("ending", ["return 0", "raise KeyboardInterrupt"])
def test_ctrl_c_at_the_very_end_changes_nothing(ending: str) -> None:
    # pressed when the results are in place, or again when the first one has been answered
    code = (
        "import atexit, os, signal\n"
        "from bayes_sensor import cli\n"
        "deaf = lambda: signal.getsignal(signal.SIGINT) == signal.SIG_IGN\n"
        "atexit.register(lambda: print('deaf' if deaf() else 'open', flush=True))\n"
        "atexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
        f"def app(**_):\n    {ending}\n"
        "cli.app = app\n"
        "cli.main(['fit', 'campaign.toml', '--out', 'results'])\n"
    )
    done = run_code(code)
    assert done.returncode == (0 if ending == "return 0" else 130)
    assert done.stdout == "deaf\n"  # what is registered for the end runs in any case
    assert len(done.stderr.splitlines()) == (0 if ending == "return 0" else 1), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_interruption_is_one_line_and_tells_how_to_go_on(
    campaign: Path, tmp_path: Path, jobs: str
) -> None:
    out = tmp_path / "out"
    config = tmp_path / "long.toml"
    config.write_text("[posterior]\nsampler = 'emcee'\ntarget_ess = 1e9\nmax_steps = 100000\n")
    options = ["--out", out, "--config", config, "--jobs", jobs]
    process = subprocess.Popen(
        [sys.executable, "-m", "bayes_sensor", "posterior", campaign, *options],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT,
        start_new_session=True,  # so that the signal reaches its workers too, as from a keyboard
    )  # fmt: skip
    with process:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and process.poll() is None:
            if len(list((out / "checkpoint").glob("*.npz"))) >= 4:
                break
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)
        try:
            said, err = process.communicate(timeout=60)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 130, err
    lines = [line for line in err.splitlines() if line]
    assert len(lines) == 1, err
    assert lines[0].startswith("stopped: interrupted; continue with: ") and said == ""
    assert lines[0].endswith("--resume") and str(out) in lines[0]
    assert not (out / "posterior.json").exists() and not list(out.glob(".stage-*"))
    assert list((out / "checkpoint").glob("*.npz"))
