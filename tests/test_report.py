"""The report: self-contained, escaped, in order, honest about what failed, alive in a browser."""

import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from bayes_sensor import figures
from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import _guarded
from bayes_sensor.report import (
    MOST_OVERLAYS,
    MOST_PIXELS,
    Table,
    alerts,
    build_report,
    headline,
    inline_svg,
    number,
    p_words,
    read_results,
    with_spread,
)

HOSTILE = "<script>document.title='taken'</script> $x^2$ \"&'"
DESIGN = """title = "</title><script>document.title='taken'</script>"
"""


def run(*arguments: str | Path) -> int:
    return _guarded([str(a) for a in arguments])


@pytest.fixture(scope="module")
def analysed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder of ``analyze``; one experiment has a hostile name, one no step down."""
    folder = tmp_path_factory.mktemp("analysed")
    name = json.dumps(HOSTILE)
    flows = (("4.0", "0.5"), ("8.0", "1.0"), ("5.0", "1.0"), ("3.0", "0.5"))
    text = DESIGN
    for k, (carrier, test) in enumerate(flows):
        text += (
            f"[[experiment]]\nname = {name if k == 0 else chr(34) + str(k) + chr(34)}\n"
            f'carrier_flow = "{carrier} L/min"\ntest_gas_flow = "{test} L/min"\n'
            'commanded_on = "3 s"\ninterval = "10 ms"\nduration = "18 s"\n'
        )
        text += 'commanded_off = "11 s"\n' if k != 2 else ""
    (folder / "design.toml").write_text(text)
    noise = ["--tau", "150 ms", "--sigma0", "5 mV", "--sigma1", "3 mV", "--quiet"]
    data = folder / "data"
    assert run("simulate", "--design", folder / "design.toml", "--out", data, *noise) == 0
    (folder / "over.toml").write_text("[bounds]\nresamples = 40\n")
    options = ["--sampler", "independence", "--config", folder / "over.toml", "--quiet"]
    code = run("analyze", data / "campaign.toml", "--out", folder / "out", *options)
    assert code in (0, 3)
    return folder / "out"


# --- words


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0481, "0.0481"), (58.2345, "58.2"), (None, "–"), (-1.5e-7, "-1.50e-07"), (0.0, "0"),
     (123456.7, "123457")],
)  # fmt: skip
def test_numbers_as_text(value: float | None, text: str) -> None:
    assert number(value) == text


def test_rounding_follows_the_spread() -> None:
    assert with_spread(48.1234, 12.0) == "48"
    assert with_spread(0.85767, 0.0021) == "0.8577"
    assert with_spread(3.0, None) == "3.000"
    assert p_words(0.0) == "below 0.001" and p_words(0.25) == "0.25"


def test_headline_of_a_limit_and_of_an_interval() -> None:
    row = {"q2.5": 0.001, "q50": 0.022, "q97.5": 0.064}
    priors = [{"prior": "half_normal", "upper95_s": 0.057}]
    naive = {"naive": {"crlb_iid": {"tau_s": 0.0214}, "crlb_iid_one_percent_step": None}}
    found = headline({"parameters": {"tau_s": row}, "tau_under_priors": priors}, naive)
    assert found is not None and found.is_limit and found.limit == "57 ms"
    assert str(found) == (
        "tau = 22 ms, 95 % interval [1, 64] ms (posterior, AR(1) noise); "
        "the iid Cramer-Rao bound alone would have said ± 42 ms"
    )
    row = {"q2.5": 0.040, "q50": 0.048, "q97.5": 0.056}
    white = {"noise": {"autocorrelation": "white"}}
    found = headline({"parameters": {"tau_s": row}}, None, white)
    assert found is not None and not found.is_limit and "white noise" in str(found)
    assert headline(None, None) is None


def test_a_drawing_that_could_run_something_is_refused() -> None:
    for bad in ("<svg><script>1</script></svg>", '<svg onload="x"/>', "<svg><a href='x'/></svg>"):
        with pytest.raises(ValueError, match="must not hold"):
            inline_svg(bad, "k", "label")


def test_table_cells_are_rounded_but_sort_by_the_full_value() -> None:
    cell = Table("k", "c", ["x"], [[0.123456789]]).cells([0.123456789])[0]
    assert cell == {"text": "0.1235", "full": "0.123456789", "num": True}
    assert Table("k", "c", ["x"], []).cells([None, True, "a"])[0]["text"] == "–"


# --- the page


class Page(HTMLParser):
    """Tags, ids and links of a page, with a check that what is opened is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "img", "br", "input"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_page_is_whole_self_contained_and_in_order(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    assert len(text) < 15e6
    page = Page(text)
    assert page.open == []
    for tag, attributes in page.tags:
        for key in ("src", "href", "xlink:href"):
            target = attributes.get(key) or "#"
            assert target.startswith(("#", "data:")), f"<{tag} {key}={target}>"
    assert not re.search(r"url\((?!#)", text), "a style refers to something outside"
    ids = [a["id"] for _, a in page.tags if "id" in a]
    assert len(ids) == len(set(ids))
    anchors = {a["href"] for t, a in page.tags if t == "a"}
    assert anchors <= {f"#{i}" for i in ids}
    titles = re.findall(r"<h2 id=.*?</span> (.*?)</h2>", text)
    assert titles == [
        "What was measured", "How well does the model fit",
        "What is the sensor&#39;s time constant", "Is the noise model adequate",
        "How do the delays depend on flow", "How it was computed",
    ]  # fmt: skip
    pictures = [a for t, a in page.tags if t == "figure" and a.get("class") == "picture"]
    assert len(pictures) == 4 + 9  # one overlay per experiment, and the rest
    assert all(a.get("aria-label") for t, a in page.tags if t == "svg")


def test_hostile_names_stay_text(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert sum(tag == "script" for tag, _ in page.tags) == 1
    assert "document.title='taken'</script>" not in text
    assert "&lt;script&gt;document.title=" in text
    for name, kind in (("report", ".svg"), ("report", ".png")):
        assert not any("script" in p.name for p in (analysed / "figures").glob(f"*{kind}")), name


def test_figures_are_saved_and_not_blank(analysed: Path) -> None:
    names = {p.name for p in (analysed / "figures").iterdir()}
    for stem in ("overlay_1", "overlay_4", "histogram", "autocorrelation", "spread", "delays",
                 "corner", "traces", "intervals", "step_study", "rms"):  # fmt: skip
        assert {f"{stem}.svg", f"{stem}.png"} <= names
        pixels = imread(analysed / "figures" / f"{stem}.png")[..., :3]
        assert pixels.std() > 0.02, stem


def test_numbers_of_the_page_are_those_of_the_files(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    posterior = json.loads((analysed / "posterior.json").read_text())
    tau = posterior["parameters"]["tau_s"]
    fit = json.loads((analysed / "fit.json").read_text())
    assert f'data-v="{1e3 * tau["mean"]!r}"' in text
    assert f'data-v="{fit["parameters"]["V_mL"]!r}"' in text
    assert f"RMS residual of {number(1e3 * fit['rms_V'])} mV" in text
    lo, hi = (1e3 * tau[k] for k in ("q2.5", "q97.5"))
    assert f"[{with_spread(lo, hi - lo)}, {with_spread(hi, hi - lo)}] ms" in text
    run_file = json.loads((analysed / "run.json").read_text())["commands"]["analyze"]
    for name, value in run_file["files_sha256"].items():
        assert name in text and value in text


def test_report_is_rebuilt_from_saved_results_alone(
    analysed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(analysed, copy)
    before = (copy / "report.html").read_text(encoding="utf-8")
    (copy / "report.html").unlink()
    shutil.rmtree(copy / "figures")
    assert run("report", copy) == 0
    assert (copy / "report.html").read_text(encoding="utf-8") == before
    assert len(list((copy / "figures").iterdir())) == 26
    assert "report.html" in capsys.readouterr().out
    (copy / "posterior.nc").write_bytes(b"\x89HDF\r\n\x1a\n cut off")
    assert run("report", copy) == 2
    assert "posterior.nc: expected the draws" in capsys.readouterr().err
    assert (copy / "report.html").read_text(encoding="utf-8") == before


def test_parts_that_were_not_computed_are_left_out(analysed: Path, tmp_path: Path) -> None:
    for name in ("campaign.json", "run.json", "fit.json", "traces.npz"):
        shutil.copy(analysed / name, tmp_path / name)
    text = build_report(tmp_path)
    assert "How well does the model fit" in text
    assert "time constant</h2>" not in text and 'id="delays"' not in text


def test_what_failed_stands_at_the_top(analysed: Path, tmp_path: Path) -> None:
    for name in ("campaign.json", "run.json", "fit.json", "traces.npz", "posterior.json"):
        shutil.copy(analysed / name, tmp_path / name)
    for name, change in (
        ("fit.json", {"converged": False, "status": "The refinement stopped."}),
        ("posterior.json", {"converged": False, "status": "largest R-hat 1.2 (tau_s)"}),
    ):
        content = json.loads((tmp_path / name).read_text())
        (tmp_path / name).write_text(json.dumps({**content, **change}))
    record = json.loads((tmp_path / "run.json").read_text())
    record["commands"]["fit"] = {**record["commands"]["analyze"], "basis_sha256": "other"}
    (tmp_path / "run.json").write_text(json.dumps(record))
    found = [text for kind, text in alerts(read_results(tmp_path)) if kind == "bad"]
    assert len(found) == 3
    assert "did not converge" in found[0] and "must not be quoted" in found[1]
    assert "fit rest on other data" in found[2]
    page = build_report(tmp_path)
    assert page.index("must not be quoted") < page.index('aria-label="Contents"')


@pytest.mark.parametrize("missing", ["campaign.json", "run.json"])
def test_a_folder_without_results_is_refused(analysed: Path, tmp_path: Path, missing: str) -> None:
    for name in {"campaign.json", "run.json"} - {missing}:
        shutil.copy(analysed / name, tmp_path / name)
    with pytest.raises(CampaignError, match="expected a results folder"):
        read_results(tmp_path)


def test_many_overlays_become_pixels_before_the_page_grows_too_large(
    analysed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("campaign.json", "run.json", "fit.json", "traces.npz"):
        shutil.copy(analysed / name, tmp_path / name)
    monkeypatch.setattr("bayes_sensor.report.MOST_OVERLAYS", 100_000)
    text = build_report(tmp_path)
    assert text.count("data:image/png;base64,") >= 3
    assert MOST_OVERLAYS + MOST_PIXELS < 12e6  # the rest of the page stays below 3 MB
    monkeypatch.setattr("bayes_sensor.report.MOST_PIXELS", 100_000)
    text = build_report(tmp_path, tmp_path)
    assert "Drawn in figures/overlay_4.svg" in text and (tmp_path / "overlay_4.svg").is_file()


# --- in a browser

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome", "chrome")
     if (path := shutil.which(name))),
    None,
)  # fmt: skip
PROBE = """
<script>
window.addEventListener("load", function () {
  var table = document.getElementById("table-experiments");
  var button = Array.prototype.find.call(table.querySelectorAll("button.sort"), function (b) {
    return b.textContent.indexOf("flow") === 0; });
  button.click(); button.click();
  var flows = Array.prototype.map.call(table.tBodies[0].rows, function (r) {
    return r.cells[4].getAttribute("data-v"); });
  var drawings = document.querySelectorAll(".drawing > *"), empty = 0;
  drawings.forEach(function (d) {
    var box = d.getBoundingClientRect();
    if (box.width < 100 || box.height < 50) { empty += 1; } });
  var wide = document.documentElement.scrollWidth > window.innerWidth + 1;
  var out = document.createElement("pre");
  out.id = "probe";
  out.textContent = JSON.stringify({ flows: flows, n: drawings.length, empty: empty, wide: wide,
    ready: document.documentElement.dataset.ready, title: document.title,
    sorted: button.closest("th").getAttribute("aria-sort") });
  document.body.appendChild(out);
});
</script></body>"""


def browse(profile: Path, page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    assert BROWSER is not None
    return subprocess.run(
        [
            BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
            "--no-first-run", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", "--disable-dev-shm-usage", "--hide-scrollbars",
            "--host-resolver-rules=MAP * ~NOTFOUND", "--enable-logging=stderr",
            f"--user-data-dir={profile}", *options, page.as_uri(),
        ],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip


@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed: the page is not opened")
@pytest.mark.parametrize("width", [420, 1200])
def test_page_lives_in_a_browser(analysed: Path, tmp_path: Path, width: int) -> None:
    page = tmp_path / "page.html"
    text = (analysed / "report.html").read_text(encoding="utf-8")
    page.write_text(text.replace("</body>", PROBE), encoding="utf-8")
    done = browse(tmp_path / "p1", page, "--dump-dom", f"--window-size={width},2000")
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert console == []
    found = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout)
    assert found is not None, done.stderr[-2000:]
    probe = json.loads(found[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    assert probe["ready"] == "yes" and probe["title"] != "taken"
    assert probe["n"] == 13 and probe["empty"] == 0 and not probe["wide"]
    flows = [float(v) for v in probe["flows"]]
    assert flows == sorted(flows, reverse=True) and probe["sorted"] == "descending"


@pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed: the page is not opened")
def test_page_is_seen_and_printed(analysed: Path, tmp_path: Path) -> None:
    page = analysed / "report.html"
    shot, paper = tmp_path / "page.png", tmp_path / "page.pdf"
    browse(tmp_path / "p1", page, f"--screenshot={shot}", "--window-size=1000,3000")
    pixels = imread(shot)[..., :3]
    bands = [band.std() for band in np.array_split(pixels, 10)]
    assert min(bands) > 0.01, "a tenth of the page is blank"
    browse(tmp_path / "p2", page, "--no-pdf-header-footer", f"--print-to-pdf={paper}")
    content = paper.read_bytes()
    assert content.startswith(b"%PDF") and 3 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 30


def test_every_colour_has_its_counterpart_in_the_dark(analysed: Path) -> None:
    text = (analysed / "report.html").read_text(encoding="utf-8")
    for colour in figures.COLOURS:
        assert f"--f-{colour[1:]}:" in text
