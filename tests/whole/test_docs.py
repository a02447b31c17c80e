"""The pages of docs/: every name, file, column and command in them exists, the examples run."""

import csv
import json
import re
import runpy
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

import bayes_sensor as bs
from bayes_sensor.bounds import METHODS
from bayes_sensor.checks.coverage import SETTINGS
from bayes_sensor.cli import app
from bayes_sensor.diagnosis import CATALOGUE
from bayes_sensor.io.readers import FORMATS
from bayes_sensor.io.readers.campaign_file import ExperimentTable
from bayes_sensor.posterior import SAMPLERS
from bayes_sensor.report import Saved
from tests.support.campaigns import small_problem

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
FILES = r"`((?:bayes_sensor|tests|paper|notebooks|data|docs)/[\w./-]*)`"
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}

pytestmark = pytest.mark.prose


def resolve(dotted: str) -> Any:
    """The object of a dotted name; AttributeError or ModuleNotFoundError where there is none."""
    parts = dotted.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(dotted)


def test_a_name_that_does_not_exist_is_seen() -> None:
    assert resolve("bayes_sensor.bounds.bound.Bound").__name__ == "Bound"
    with pytest.raises(AttributeError):
        resolve("bayes_sensor.bounds.bound.Bounding")


def test_the_reference_holds_every_public_name_once() -> None:
    listed = re.findall(r"^\.\. auto\w+:: ([\w.]+)$", TEXT["api.md"], flags=re.MULTILINE)
    public = [name for name in listed if "." not in name]
    assert sorted(public) == sorted(set(bs.__all__) - {"__version__"})
    for name in listed:
        found = resolve(name if "." in name else f"bayes_sensor.{name}")
        assert found.__doc__, name


@pytest.mark.parametrize("page", TEXT)
def test_names_files_and_links_exist(page: str) -> None:
    text = TEXT[page]
    for dotted in re.findall(r"\{py:\w+\}`~?([\w.]+)`", text):
        resolve(dotted)
    for name in re.findall(r"\bbs\.(\w+)", text):
        assert name in bs.__all__, name
    for dotted in re.findall(r"`(bayes_sensor(?:\.\w+)+)`", text):
        resolve(dotted)
    for module, names in re.findall(r"^from (bayes_sensor[\w.]*) import ([^(\n]+)$", text, re.M):
        for name in names.split(","):
            resolve(f"{module}.{name.strip()}")
    for path in re.findall(FILES, text):
        assert (ROOT / path).exists(), path
    for path in re.findall(r"`(\w+\.ipynb)`", text):
        assert (ROOT / "notebooks" / path).exists(), path
    for path in re.findall(r"\]\(([^)#]+)\)", text):
        assert (DOCS / path).exists(), path
    for path in re.findall(r"^(\w+)$", "\n".join(re.findall(r"\{toctree\}(.*?)```", text, re.S)),
                           re.M):  # fmt: skip
        assert (DOCS / f"{path}.md").exists(), path


def test_every_page_ends_with_what_to_read_next() -> None:
    # the first page leads to all, the reference is where one ends
    ends = {page: text.split("```{toctree}")[0].rstrip() for page, text in TEXT.items()}
    last = {page: text.rpartition("\n\n")[2] for page, text in ends.items()}
    without = {page for page, text in last.items() if not text.startswith("What to read next: [")}
    assert without == {"index.md", "api.md"}


def test_the_gallery_shows_every_notebook() -> None:
    listed = re.findall(r"^notebooks/(\w+)$", TEXT["gallery.md"], re.MULTILINE)
    assert sorted(listed) == sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("page", TEXT)
def test_commands_and_their_options_exist(page: str) -> None:
    root: Any = typer.main.get_command(app)
    for name, rest in re.findall(r"bayes-sensor ([a-z][a-z-]*)([^`\n#]*)", TEXT[page]):
        assert name in root.commands, name
        known = {flag for parameter in root.commands[name].params for flag in parameter.opts}
        for flag in re.findall(r"(?<!\S)--[a-z-]+", rest):
            assert flag in known, f"{name} {flag}"
    for target in re.findall(r"`make ([\w-]+)`|^make ([\w-]+)$", TEXT[page], flags=re.MULTILINE):
        assert re.search(rf"^{''.join(target)}:", (ROOT / "Makefile").read_text(), re.MULTILINE)


def directives() -> list[tuple[str, str, str]]:
    """(page, table, body) of every study-table."""
    return [
        (page, name, body)
        for page, text in TEXT.items()
        for name, body in re.findall(r"```\{study-table\} (\w+)\n(.*?)```", text, flags=re.DOTALL)
    ]


@pytest.mark.tables
def test_tables_have_the_columns_and_rows_that_are_asked_for() -> None:
    found = directives()
    assert len(found) > 10
    for page, name, body in found:
        path = ROOT / "paper" / "tables" / f"{name}.csv"
        if not path.exists():  # the page then says that make study writes it
            assert name in "".join(p.read_text() for p in (ROOT / "paper/studies").glob("*.py"))
            continue
        with path.open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        options = dict(re.findall(r"^:(\w+): (.*)$", body, flags=re.MULTILINE))
        named = [part.split("=")[0].strip() for part in options.get("columns", "").split(",")]
        named += [part.strip() for part in options.get("pivot", "").split("=")]
        wanted = dict(
            part.strip().split("=") for part in options.get("where", "").split(",") if part
        )
        for column in [*filter(None, named), *wanted]:
            assert column in rows[0], f"{page}: {name}.csv has no column {column}"
        assert any(all(row[k] == v for k, v in wanted.items()) for row in rows), f"{page}: {name}"


def test_no_result_of_a_study_is_typed_into_a_page() -> None:
    # a table whose cells are decimals would be one
    for page, text in TEXT.items():
        assert not re.search(r"^\|.*\d\.\d+.*\|.*\d\.\d+.*\|$", text, flags=re.MULTILINE), page


def test_what_can_be_chosen_is_told() -> None:
    formats, bounds, gap = (
        TEXT[f"{page}.md"] for page in ("file_formats", "choose_a_bound", "read_a_gap_report")
    )
    assert [suffix for suffix in FORMATS if f"`{suffix}`" not in formats] == []
    assert [
        key for key in ExperimentTable.model_fields if not re.search(rf"\b{key}\b", formats)
    ] == []
    assert [method for method in METHODS if f"\n`{method}`\n:" not in bounds] == []
    assert [name for name in SAMPLERS if f'"{name}"' not in formats] == []
    assert [
        kind for kind in ("none", "effect", "family", "unlisted") if f"**{kind}**" not in gap
    ] == []
    blocks = re.findall(r"```toml\n(.*?)```", formats, flags=re.DOTALL)
    assert len(blocks) == 2  # a campaign and settings, both read below


def test_the_settings_and_the_campaign_of_the_page_are_accepted(tmp_path: Path) -> None:
    from bayes_sensor.analysis.overrides import read_overrides

    campaign, settings = re.findall(r"```toml\n(.*?)```", TEXT["file_formats.md"], flags=re.DOTALL)
    (tmp_path / "overrides.toml").write_text(settings)
    assert read_overrides(tmp_path / "overrides.toml").bounds.methods == [
        "crlb_iid", "profile", "posterior",
    ]  # fmt: skip
    t = np.arange(12_000) * 0.01
    rows = [f"{a:.2f},{b:.4f},{c:.1f}" for a, b, c in zip(t, _step(t), _drive(t))]
    (tmp_path / "exp1.csv").write_text("\n".join(["time_s,A,B", *rows]))
    (tmp_path / "campaign.toml").write_text(campaign)
    read = bs.read_campaign(tmp_path / "campaign.toml")
    assert read["1"].commanded_off == 83.6
    assert read["1"].n_samples < len(read["1"].t)  # the mask
    assert read.side_information["V_mL"].mean == 60.0


def _drive(t: np.ndarray) -> np.ndarray:
    return np.where((t >= 24.0) & (t < 83.6), 5.0, 0.0)


def _step(t: np.ndarray) -> np.ndarray:
    noise = 0.01 * np.random.default_rng(1).standard_normal(len(t))
    return 0.3 + 1.5 * (1 - np.exp(-np.maximum(t - 24.5, 0))) * (t < 84.1) + noise


@pytest.fixture
def examples(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the code blocks of extend.md define, run from top to bottom."""
    monkeypatch.setattr("bayes_sensor.io.readers.FORMATS", dict(FORMATS))
    made: dict[str, Any] = {}
    blocks = re.findall(r"```python\n(.*?)```", TEXT["extend.md"], flags=re.DOTALL)
    assert len(blocks) == 9
    exec(compile("\n".join(blocks), "extend.md", "exec"), made)
    return made


def test_the_reader_of_the_page_reads(examples: dict[str, Any], tmp_path: Path) -> None:
    t = np.arange(6000) * 0.02
    content = {"time_s": t.tolist(), "voltage_mV": (1e3 * _step(t)).tolist()}
    (tmp_path / "exp1.json").write_text(json.dumps(content))
    (tmp_path / "campaign.toml").write_text(
        '[[experiment]]\nname = "1"\nfile = "exp1.json"\ncarrier_flow = "4 L/min"\n'
        'test_gas_flow = "0.5 L/min"\ncommanded_on = "24 s"\ncommanded_off = "83.6 s"\n'
    )
    assert ".json" in examples["FORMATS"] and ".json" not in FORMATS
    read = bs.read_campaign(tmp_path / "campaign.toml")
    assert read.signal_unit == "V"
    np.testing.assert_allclose(read["1"].values, _step(t), rtol=1e-12)
    (tmp_path / "exp1.json").write_text('{"time_s": [0, 1')
    with pytest.raises(bs.CampaignError, match=r"experiment '1' \(exp1.json\): expected a JSON"):
        bs.read_campaign(tmp_path / "campaign.toml")


def test_the_effect_of_the_page_is_one(examples: dict[str, Any]) -> None:
    assert examples["EFFECT"].name == "leak" and "leak" not in CATALOGUE
    assert len(examples["BUMP"].forms[0].starts) == 4


def test_the_bound_of_the_page_is_wider_by_its_factor(examples: dict[str, Any]) -> None:
    campaign = small_problem(phi=0.5)[0].campaign
    fit = bs.fit_least_squares(campaign, seed=1, euler=False)
    bounds = bs.compare_bounds(campaign, fit, methods=examples["mine"])
    phi = fit.parameters["phi"]
    assert 0.4 < phi < 0.6
    narrow, wide = (np.ptp(bounds[m].interval("tau_v_s")) for m in examples["mine"])
    assert wide / narrow == pytest.approx(np.sqrt((1 + phi) / (1 - phi)))


def test_the_sampler_of_the_page_converges(
    examples: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SAMPLERS, "resample", examples["RESAMPLE"])
    problem, theta = small_problem(n=2, interval=0.05)
    posterior = bs.sample_posterior(problem, theta, seed=1, sampler="resample")
    assert posterior.sampler == "resample" and posterior.reasons == ("importance resampling",)
    assert posterior.converged


def test_the_section_of_the_page_answers(examples: dict[str, Any]) -> None:
    saved = Saved({}, {}, bounds={
        "methods": {name: {"parameters": {"V_mL": {"lo95": 0.0, "hi95": width}}}
                    for name, width in (("narrow", 1.0), ("wide", 2.0))}
    })  # fmt: skip
    section = examples["widest"](saved)
    assert section.answer == "wide." and section.content[0].rows == [["narrow", 1.0], ["wide", 2.0]]
    assert examples["widest"](Saved({}, {})) is None


def readme() -> str:
    return (ROOT / "README.md").read_text(encoding="utf-8")


def rows(name: str) -> list[dict[str, str]]:
    with (ROOT / "paper" / "tables" / f"{name}.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_readme_is_short_and_in_the_order_of_the_house() -> None:
    assert len(readme()) < 6000
    assert re.findall(r"^## (.+)$", readme(), re.MULTILINE) == [
        "Two commands", "Your own data", "What you get", "Assumptions and limits",
        "How often the diagnosis is right", "Links",
    ]  # fmt: skip


def test_files_that_the_readme_names_exist() -> None:
    named = re.findall(FILES, readme())
    linked = re.findall(r"\]\(([^)#:]+)\)", readme())
    assert len(named) > 4 and len(linked) > 8
    assert [path for path in (*named, *linked) if not (ROOT / path).exists()] == []
    picture = ROOT / "docs" / "static" / "report_first_page.png"
    assert picture.stat().st_size < 250_000


def numbers(pattern: str, text: str) -> list[float]:
    """The numbers in the first match of a pattern whose blanks may be line breaks."""
    found = re.search(pattern.replace(" ", r"\s+"), text)
    assert found is not None, pattern
    return [float(number) for number in found.groups()]


@pytest.mark.tables
def test_the_readme_says_what_the_tables_say() -> None:
    text = readme()
    speed = {row["what"]: float(row["median"]) for row in rows("benchmark_commands")}
    took = numbers(
        r"`fit` takes (\d+) s of [a-z ]+, `analyze --quick` (\d+) s and `analyze` (\d+) s", text
    )
    commands = ("fit", "analyze --quick", "analyze")
    assert took == [round(speed[f"{command}, bundled"]) for command in commands]

    cover = {
        (row["setting"], row["parameter"]): float(row["coverage"])
        for row in rows("coverage_bounds")
        if row["method"] == "posterior" and row["level"] == "95"
    }

    def shares(*settings: str) -> list[float]:
        found = [cover[setting, name] for setting in settings
                 for name in ("tau_s", "tau_v_s", "V_mL")]  # fmt: skip
        return [round(100 * value) for value in (min(found), max(found))]

    assert numbers(r"with such noise, (\d+) to (\d+) %", text) == shares(
        "iid", "ar1_0.5", "ar1_0.9"
    )
    assert numbers(r"half AR\(1\) it is (\d+) to (\d+) %", text) == shares("arma")
    closing = SETTINGS["slow_closing"].closing
    assert numbers(r"closes (\d+) % more slowly than it opens reduces the coverage of the valve's "
                   r"time constant to (\d+) %", text) == [
        round(100 * (closing - 1)), round(100 * cover["slow_closing", "tau_v_s"]),
    ]  # fmt: skip


@pytest.mark.tables
def test_the_page_on_bounds_says_where_intervals_hold() -> None:
    text = TEXT["choose_a_bound.md"]
    found = [row for row in rows("coverage_bounds") if row["level"] == "95"]

    def shares(methods: set[str], settings: set[str], parameters: set[str]) -> list[float]:
        some = [
            float(row["coverage"])
            for row in found
            if row["method"] in methods
            and row["setting"] in settings
            and row["parameter"] in parameters
        ]
        return [round(100 * value) for value in (min(some), max(some))]

    likely = {"posterior", "profile", "crlb_ar1"}
    three = {"tau_s", "tau_v_s", "V_mL"}
    assert numbers(r"AR\(1\) noise, (\d+) to (\d+) % of", text) == shares(
        likely, {"iid", "ar1_0.5", "ar1_0.9"}, three
    )
    assert numbers(r"hold tau_v and V in (\d+) to (\d+) %", text) == shares(
        likely, {"arma"}, three - {"tau_s"}
    )
    assert numbers(r"methods hold tau_v in (\d+) to (\d+) %", text) == shares(
        set(METHODS), {"slow_closing"}, {"tau_v_s"}
    )
    published, recipe = rows("published_bounds")[:2]
    assert recipe["how"] == "forward Euler, forward difference, +1 % of every parameter"
    worst = max(
        abs(float(recipe[key]) / float(published[key]) - 1) for key in published if key != "how"
    )
    assert numbers(r"is reproduced, within ([\d.]+) %, by", text) == [round(100 * worst, 1)]


@pytest.mark.tables
def test_the_readme_says_how_often_the_diagnosis_is_right() -> None:
    part = readme().partition("## How often the diagnosis is right")[2].partition("##")[0]
    together = {row["what"]: row for row in rows("blind_check_together")}
    nulls = together["null hypotheses named"]
    unknown = together["unknown causes found"]
    assert numbers(r"In (\d+) blind checks", part) == [float(nulls["runs"])]
    assert numbers(r"Of (\d+) campaigns without a fault ([\d.]+) % were", part) == [
        float(nulls["of"]), round(100 * float(nulls["share"]), 1),
    ]  # fmt: skip
    assert numbers(r"right family was found in (\d+) %", part) == [
        round(100 * float(together["right family"]["share"]))
    ]
    assert numbers(r"catalogue were found in (\d+) %", part) == [
        round(100 * float(unknown["share"]))
    ]
    reached = [round(100 * float(unknown[key])) for key in ("at_d8", "at_d16")]
    goals = numbers(r"catalogue, (\d+) % at 8 and (\d+) % at 16, were missed", part)
    assert goals == [60, 85] and all(is_low < goal for is_low, goal in zip(reached, goals))
    assert numbers(r"missed with (\d+) and (\d+) %", part) == reached


@pytest.mark.tables
def test_the_page_on_the_gap_says_what_became_of_real_measurements() -> None:
    text = TEXT["gap_catalogue.md"]
    steps, matrix = rows("real_pid")
    assert {steps["verdict"], steps["verdict_with"]} == {"unlisted"}
    assert {matrix["verdict"], matrix["verdict_with"]} == {"unlisted"}
    assert numbers(
        r"closed (\d+) % of the squared excess in the dilution steps and (\d+) % in", text
    ) == [round(100 * float(row["held_closed"])) for row in (steps, matrix)]


@pytest.mark.tables
def test_the_page_on_other_rigs_says_what_real_records_show() -> None:
    assert "wherever it could be given, it holds the independent fit" in " ".join(
        TEXT["other_rigs.md"].split()
    )
    simulated = [row for row in rows("other_rigs") if row["method"] == "posterior"]
    assert {row["campaigns"] for row in simulated} == {"200"}  # "Two hundred campaigns"
    of_chain = "short pulse of a chain", "tau_s"
    (chain,) = [r for r in simulated if (r["rig"], r["parameter"]) == of_chain]
    assert numbers(r"chain only (\d+) % of the intervals hold tau", TEXT["other_rigs.md"]) == [
        round(100 * float(chain["share95"]))
    ]
    assert int(chain["too_low"]) > 2 * int(chain["too_high"])  # "most of the others lie below it"
    (plain,) = [
        r
        for r in rows("other_rigs")
        if (r["rig"], r["parameter"]) == of_chain and r["method"] == "sandwich"
    ]
    assert numbers(r"no prior, holds it in (\d+) % and", TEXT["other_rigs.md"]) == [
        round(100 * float(plain["share95"]))
    ]
    assert int(plain["too_high"]) == 0 < int(plain["too_low"])  # "on that side only"
    assert all(
        float(r["share95"]) >= 0.92
        for r in simulated
        if r is not chain and r["parameter"][:3] != "phi"
    )
    given = [row for row in rows("recorders") if row["discrepancy_lo95_s"]]
    assert len(given) > 5 and all(row["discrepancy_holds_scipy"] == "1" for row in given)


@pytest.mark.tables
def test_the_page_on_speed_says_what_was_measured() -> None:
    text = TEXT["speed.md"]
    speed = {row["what"]: float(row["median"]) for row in rows("benchmark")}
    euler, closed = (f"PINTS AR1LogLikelihood, numba {x} over " for x in ("Euler", "closed form"))
    for pattern, what in (
        (r"takes ([\d.]+) times as long as our compiled full pass", f"{euler}own full pass"),
        (r"as its model it takes ([\d.]+) times as long", f"{closed}own full pass"),
        (r"PINTS takes (\d+) times as long for a value with the Euler model", f"{euler}value"),
        (r"model, and (\d+) times with the closed form\. - Through", f"{closed}value"),
        (r"then takes (\d+) times as long with", f"{euler}value, parameters by name"),
        (r"model, and (\d+) times with the closed form\. The",
         f"{closed}value, parameters by name"),
        (r"set-up takes ([\d.]+) s", "set-up of the compressed form"),
    ):  # fmt: skip
        assert numbers(pattern, text) == [pytest.approx(speed[what], rel=0.05)], what
    value = "compressed value"
    each = (value, f"{value} and gradient", f"{value}, parameters by name")
    assert numbers(
        r"from an array takes (\d+) µs .* gradient (\d+) µs .* by names (\d+) µs", text
    ) == [round(speed[what]) for what in each]
    posterior = speed["arrays and a fit to posterior, independence"]
    assert numbers(r"independence posterior takes ([\d.]+) s", text) == [round(posterior, 1)]
    gap = [float(row["median_s"]) for row in rows("blind_check_seconds")]
    assert numbers(r"takes about (\d+) s at the sizes", text) == [round(max(gap))]


@pytest.mark.tables
def test_the_page_on_robustness_says_how_the_large_fleet_went() -> None:
    (row,) = [r for r in rows("benchmark_commands") if "Dask" in r["what"]]
    told = numbers(
        r"fleet of (\d+) small .* lost none\. A worker took at most (\d+) MB", TEXT["robustness.md"]
    )
    done, asked, peak = numbers(r"(\d+) of (\d+) done; at most (\d+) MB", row["note"])
    assert told == [done, peak] and done == asked


@pytest.mark.tables
def test_the_page_on_speed_says_by_how_much_goals_are_missed() -> None:
    text = TEXT["speed.md"]
    measured = {row["what"]: row for row in rows("benchmark_commands")}
    told = {
        "analyze, bundled": r"size takes (\d+) s in place of (\d+), and",
        "analyze --jobs 2, bundled, wall": r"(\d+) s of wall time on two cores in place of (\d+)",
        "analyze, 3 experiments of 35 s at 100 Hz": r"campaign takes (\d+) s in place of (\d+)",
        "analyze, bundled, first interval of tau, wall": r"after ([\d.]+) s in place of (\d+)",
        "fit, bundled": r"`fit` takes (\d+) s in place of (\d+)",
        "posterior by emcee, bundled": r"`posterior` with (\d+) s .* in place of (\d+) each",
        "bounds, bundled": r"`bounds` with (\d+) s in place of (\d+) each",
        "gap, bundled, nothing missing": r"takes (\d+) s without a cause .*, in place of (\d+) and",
        "gap, withheld, a cause": r"and (\d+) s with one, in place of \d+ and (\d+)\.",
        "compiling on a fresh machine": r"Compiling takes (\d+) s in place of (\d+)",
        "peak memory, largest of all": r"and (\d+) MB for fifty experiments in place of (\d+)",
    }
    for what, pattern in told.items():
        median, goal = numbers(pattern, text)
        row = measured.pop(what)
        digits = 1 if "first interval" in what else 0
        assert median == pytest.approx(round(float(row["median"]), digits)), what
        assert goal == float(row["goal"].removeprefix("<= ")), what
    left = [what for what, row in measured.items()
            if "missed" in row["verdict"] and "before" not in what]  # fmt: skip
    assert left == ["analyze --quick, bundled, first interval of tau, wall"]  # as of analyze
    no_goal = ("analyze --quick, 50 experiments", "analyze --quick, 200 pulses in one record")
    assert numbers(r"`--quick` takes (\d+) s .* and (\d+) s for 200", text) == [
        round(float(measured[what]["median"])) for what in no_goal
    ]


def test_cells_of_a_study_table_read_as_words() -> None:
    pytest.importorskip("sphinx")
    shown = runpy.run_path(str(DOCS / "study_table.py"))["shown"]
    assert [shown(cell, 3) for cell in ("8.674e-19", "0.04512", "<= 0.02", "")] == [
        "0", "0.0451", "≤ 0.02", "–",
    ]  # fmt: skip
    assert shown("a_name+another", 3).replace("\u200b", "") == "a_name+another"
