"""One file for one thing: what is added from outside, and where names of inside things stand."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import bayes_sensor
from bayes_sensor.bounds import METHODS
from bayes_sensor.cli import exit_code
from bayes_sensor.io.readers import FORMATS
from bayes_sensor.posterior import SAMPLERS
from bayes_sensor.report.sections import SECTIONS, add_section

PACKAGE = Path(bayes_sensor.__file__).parent


# --- names stand in their own file and the registry


REGISTRIES = ("bounds/methods/__init__.py", "posterior/samplers/__init__.py")
HOME = {
    name: Path(sys.modules[record.__module__].__file__ or "").relative_to(PACKAGE).as_posix()
    for name, record in [
        *((m.name, m.compute) for m in METHODS.values()),
        *((s.name, s.run) for s in SAMPLERS.values()),
    ]
}
A_RESULT = "the posterior as a result, a command, a file or a module, not the bound method"
NAMESAKES = {
    ("__init__.py", "posterior"): A_RESULT,
    **{
        (f"{file}.py", "posterior"): A_RESULT
        for file in (
            "analysis/job",
            "analysis/overrides",
            "analysis/resume",
            "analysis/plots",
            "analysis/posterior_step",
            "analysis/run_steps",
            "analysis/saved_records",
            "analysis/summary_text",
            "cli/analysis_commands",
            "cli/interruption",
            "cli/pipeline",
            "cli/plan_experiments",
            "cli/stage_lines",
            "cli/summary_lines",
            "io/record_archive",
            "io/results",
        )
    },
    ("fleet/outcome.py", "posterior"): A_RESULT,
    ("report/saved.py", "posterior"): A_RESULT,
    ("restoration/lag_draws.py", "posterior"): A_RESULT,
    ("restoration/restore_record.py", "posterior"): A_RESULT,
    ("posterior/save_draws.py", "posterior"): "a group of ArviZ's InferenceData",
    ("posterior/to_arviz.py", "posterior"): "a group of ArviZ's InferenceData",
    ("bounds/hardness.py", "profile"): "a curve in bounds.json's what_makes_tau_hard",
    ("figures/plot_tau.py", "profile"): "the same curve, drawn",
    ("io/run_record.py", "emcee"): "the package whose version is recorded",
}
"""other things that are called as a method or a sampler is, with what they are"""


def strings(source: str) -> Iterator[str]:
    """Every string of Python code that is no docstring."""
    tree = ast.parse(source)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            if id(node) not in docstrings:
                yield node.value


def found_in(source: str) -> set[str]:
    """Names in the strings of code: whole strings, or words where no other thing is called so."""
    found = set()
    for text in strings(source):
        for name in HOME:
            if text == name or ("_" in name and re.search(rf"\b{name}\b", text)):
                found.add(name)
    return found


def test_names_of_methods_and_samplers_stand_in_their_own_file_and_the_registry() -> None:
    seen = {
        (place, name)
        for file in sorted(PACKAGE.rglob("*.py"))
        for place in [file.relative_to(PACKAGE).as_posix()]
        for name in found_in(file.read_text(encoding="utf-8"))
        if place not in (HOME[name], *REGISTRIES)
    }
    others = {key for key in NAMESAKES if (PACKAGE / key[0]).is_file()}
    assert seen <= others, f"ask the registry's record for a trait: {sorted(seen - others)}"


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("if method == 'crlb_iid': pass", {"crlb_iid"}),
        ("raise ValueError('ask sandwich_ar1 instead')", {"sandwich_ar1"}),
        ("f'{name} of the profile'", set()),
        ("def f():\n    'profile'\n    return 'hmc'", {"hmc"}),
        ("'crlb_iid_tau_sd_s'", set()),
    ],
)
def test_a_name_in_code_is_seen(source: str, names: set[str]) -> None:
    assert found_in(source) == names


@pytest.mark.parametrize("name", METHODS)
def test_a_method_says_all_of_itself(name: str) -> None:
    method = METHODS[name]
    assert method.name == name and method.label and method.assumes and method.reference


@pytest.mark.parametrize("name", SAMPLERS)
def test_a_sampler_says_all_of_itself(name: str) -> None:
    assert SAMPLERS[name].name == name


# --- one file each adds a reader, a bound, a sampler, a section and an effect


TOYS = {
    "toy_reader": """
import json

import numpy as np

from bayes_sensor.io.readers import FORMATS
from bayes_sensor.io.readers.recording import Recording


def read_toy(file, selection):
    content = json.loads(file.content)
    return Recording(
        t=np.array(content["t"]), y=np.array(content["y"]), signal="y",
        place=lambda i: f"entry {i + 1}", unit="V",
    )


FORMATS[".toy"] = read_toy
""",
    "toy_bound": """
from dataclasses import replace

from bayes_sensor.bounds import METHODS, BoundMethod


def doubled(evidence):
    bound = METHODS["crlb_iid"].compute(evidence)
    centre = bound.estimate[:, None]
    low, high = centre - 2 * (centre - bound.low), centre + 2 * (bound.high - centre)
    return replace(bound, sd=2 * bound.sd, low=low, high=high)


METHOD = BoundMethod(
    name="toy_bound", label="toy: iid, doubled", assumes="that twice is enough",
    compute=doubled, reference="none", noise="white",
)
METHODS[METHOD.name] = METHOD
""",
    "toy_sampler": """
import numpy as np

from bayes_sensor.posterior import SAMPLERS, Run, Sampler
from bayes_sensor.posterior.laplace import log_posteriors_and_likelihoods


def resample(target):
    chains = []
    for stream in target.streams.spawn(target.settings.n_chains):
        rng = np.random.default_rng(stream)
        thetas, log_q = target.laplace.draw(4 * target.settings.n_draws, rng)
        log_p, _ = log_posteriors_and_likelihoods(
            target.compressed, target.laplace.coordinates, thetas, roots=True
        )
        weights = np.exp(log_p - log_q - np.max(log_p - log_q))
        weights /= weights.sum()
        chains.append(thetas[rng.choice(len(thetas), target.settings.n_draws, p=weights)])
    return Run(np.stack(chains), True, "Toy: importance resampling", 1.0)


SAMPLER = Sampler("toy_sampler", resample)
SAMPLERS[SAMPLER.name] = SAMPLER
""",
    "toy_section": """
from bayes_sensor.report import Section, Table
from bayes_sensor.report.sections import add_section


def twice(saved):
    found = (saved.bounds or {}).get("methods", {}).get("toy_bound")
    if found is None:
        return None
    rows = [[name, row["sd"]] for name, row in found["parameters"].items() if row]
    table = Table("toy-table", "The doubled bound.", ["parameter", "sd"], rows)
    return Section("toy", "Is twice enough", "It is a toy.", [], [table])


add_section("toy", twice, after="tau")
""",
    "toy_effect": """
import bayes_sensor as bs
from bayes_sensor.diagnosis import Strength

EFFECT = bs.own_effect(
    "toy_leak",
    [Strength("leak", "V", "normal", 0.0, 0.02)],
    lambda t, strength, rig: rig.mean(t) + strength["leak"] * (1.0 - rig.response(t)),
    plausible={"leak": 0.02},
)
""",
}
QUICK = """
[fit]
swarms = 1
particles = 8
euler = false

[posterior]
n_draws = 2000

[bounds]
methods = ["crlb_iid", "toy_bound", "posterior"]
step_study = false
explain = false
"""


def run(*arguments: str | Path) -> int:
    """The exit code of a command, in this process."""
    return exit_code([str(a) for a in arguments])


def load(path: Path) -> ModuleType:
    """A Python file as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A small campaign in the toy's format, with every toy in its file and all but the effect
    loaded; what they registered is taken back at the end."""
    place = tmp_path_factory.mktemp("toys")
    rig = ["--experiments", "1,6", "--duration", "12 s", "--interval", "10 ms"]
    noise = ["--tau", "150 ms", "--sigma0", "5 mV", "--sigma1", "3 mV"]
    assert run("simulate", "--out", place / "data", *rig, *noise, "--quiet") == 0
    campaign = place / "data" / "campaign.toml"
    for file in (place / "data").glob("*.csv"):
        t, y = np.loadtxt(file, delimiter=",", skiprows=1, unpack=True)[:2]
        file.with_suffix(".toy").write_text(json.dumps({"t": t.tolist(), "y": y.tolist()}))
        file.unlink()
    campaign.write_text(campaign.read_text().replace(".csv", ".toy"))
    (place / "quick.toml").write_text(QUICK)
    registries: list[dict[str, Any]] = [FORMATS, METHODS, SAMPLERS, SECTIONS]
    before = [dict(registry) for registry in registries]
    for name, code in TOYS.items():
        (place / f"{name}.py").write_text(code)
        if name != "toy_effect":
            load(place / f"{name}.py")
    yield place
    for registry, entries in zip(registries, before, strict=True):
        registry.clear()
        registry.update(entries)


@pytest.fixture(scope="module")
def results(folder: Path) -> Path:
    """The main job with the toys, then the diagnosis with the toy effect, and the report again."""
    campaign, out = folder / "data" / "campaign.toml", folder / "out"
    common = ["--out", out, "--quiet", "--config", folder / "quick.toml"]
    assert run("analyze", campaign, *common, "--sampler", "toy_sampler") == 0
    assert run("gap", campaign, *common, "--own-effects", folder / "toy_effect.py") == 0
    assert run("report", out, "--quiet") == 0
    return out


def test_a_reader_is_one_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(list((folder / "data").glob("*.toy"))) == 2
    assert run("check", folder / "data" / "campaign.toml") == 0
    assert "2 experiments, 2400 samples in use" in capsys.readouterr().out


def test_a_bound_is_one_file(results: Path) -> None:
    methods = json.loads((results / "bounds.json").read_text())["methods"]
    assert list(methods) == ["crlb_iid", "toy_bound", "posterior"]
    assert methods["toy_bound"]["assumes"] == "that twice is enough"
    one, two = (methods[m]["parameters"]["V_mL"]["sd"] for m in ("crlb_iid", "toy_bound"))
    assert two == pytest.approx(2.0 * one, rel=1e-12)
    page = (results / "report.html").read_text()
    # in the table of intervals, that of assumptions, and the figure
    assert page.count("toy: iid, doubled") >= 3
    assert "toy: iid, doubled" in (results / "figures" / "intervals.svg").read_text()


def test_a_sampler_is_one_file(results: Path) -> None:
    posterior = json.loads((results / "posterior.json").read_text())
    assert posterior["sampler"] == "toy_sampler" and posterior["converged"]
    assert "Toy: importance resampling" in (results / "report.html").read_text()


def test_a_section_is_one_file(results: Path) -> None:
    page = (results / "report.html").read_text()
    keys = re.findall(r'<details class="section" id="([\w-]+)"', page)
    assert keys[keys.index("tau") + 1] == "toy" and "Is twice enough" in page
    assert [key for key in SECTIONS if key in keys] == keys


def test_an_effect_is_one_file(results: Path) -> None:
    gap = json.loads((results / "gap.json").read_text())
    assert "toy_leak" in [row["effect"] for row in gap["which"]]
    assert "toy leak" in (results / "report.html").read_text()


def test_a_section_follows_one_that_is_there() -> None:
    with pytest.raises(KeyError, match="no section 'nowhere' in the report"):
        add_section("toy", lambda saved: None, after="nowhere")


STAGE = '''
"""Tanks in series: three equal lags that share one residence time."""

from bayes_sensor.rig.stages.stage import Passage, StageKind

KIND = StageKind(
    name="tanks",
    symbol="residence",
    unit="s",
    depends_on_flow=False,
    passage=lambda time, flow: Passage((time / 3.0,) * 3),
    slope=lambda time, flow: Passage((1.0 / 3.0,) * 3),
)
'''


def test_a_stage_kind_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    from bayes_sensor.fit import fit_least_squares
    from bayes_sensor.likelihood.density import log_likelihood, simulate
    from bayes_sensor.likelihood.mesh import compress
    from bayes_sensor.likelihood.problem import Problem
    from bayes_sensor.rig.stages import KINDS
    from tests.support.other_rigs import CASES

    path = tmp_path / "tanks.py"
    path.write_text(STAGE)
    spec = importlib.util.spec_from_file_location("tanks", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setitem(KINDS, "tanks", module.KIND)
    plain = CASES["sensor"]()
    design = replace(plain.design, stages=("mixer: tanks", "sensor"))
    case = replace(plain, design=design, shared={"tau_s": 8.0, "residence_mixer_s": 3.0})
    problem = Problem(design)
    assert problem.layout.shared_names == ("tau_s", "residence_mixer_s")
    data = simulate(design, case.theta, seed=2)
    mesh = compress(data, case.theta)
    assert mesh.log_likelihood(case.theta) == pytest.approx(
        log_likelihood(data, case.theta), abs=1e-3
    )
    fit = fit_least_squares(data, seed=1, swarms=1)
    assert fit.order == "given"  # only one lag is alone
    assert fit.parameters["tau_s"] == pytest.approx(8.0, rel=0.1)
    assert fit.parameters["residence_mixer_s"] == pytest.approx(3.0, rel=0.3)
