"""The results of this version on some sixty campaigns: computed, kept in results.json, compared.

    python tests/record/make.py                   computes all and writes results.json
    python tests/record/make.py --check           computes all and prints every difference
    python tests/record/make.py --cases FOLDER    with the campaigns FOLDER/*/campaign.toml
    python tests/record/make.py --only NAME       those whose names begin so; repeatable

The package is used by its public names, its command ``simulate`` and the keys of its JSON results
alone, so that files inside it may move without a change here.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import bayes_sensor as bs

# one thread, as in the suite; read when numpy is loaded, which the line above does not do
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

ROOT = Path(__file__).resolve().parent.parent.parent
RECORD = Path(__file__).with_name("results.json")
SEED = 1
DIGITS = 10
"""significant digits of a recorded number"""
LEAST = 0.01
"""probabilities and shares up to this one are not listed by name"""

# --------------------------------------------------------------------------- the campaigns


@dataclass(frozen=True)
class Simulated:
    """A campaign made by ``bayes-sensor simulate``: three records of 35 s at 100 Hz."""

    effects: tuple[str, ...]
    experiments: str
    """of the seven published ones, for their flows"""
    sensor_is: str

    def make(self, folder: Path) -> bs.Campaign:
        """Simulate into a new folder and read what was written."""
        command = [
            sys.executable, "-m", "bayes_sensor", "simulate", "--out", str(folder), "--quiet",
            "--seed", str(SEED), "--experiments", self.experiments, "--duration", "35 s",
            "--interval", "10 ms", "--sigma0", "6 mV", "--sigma1", "4 mV", "--phi", "0.6",
        ]  # fmt: skip
        if self.sensor_is == "slower":
            command += ["--tau", "1.1 s", "--tau-v", "0.25 s"]
        for effect in self.effects:
            command += ["--effect", effect]
        # the package that is tested here, wherever it was found
        found = str(Path(bs.__file__).parent.parent)
        path = os.pathsep.join([found, os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
        environment = {**os.environ, "PYTHONPATH": path}
        subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
        campaign = bs.read_campaign(folder / "campaign.toml")
        unknown = self.sensor_is == "unknown"
        return replace(campaign, sensor_is="unknown") if unknown else campaign


_FLOWS = ("1,3,4", "2,5,6", "3,4,7")
_ORDERS = ("faster", "unknown", "faster", "slower")
_EFFECTS = (
    "flow_switching", "valve_asymmetry", "valve_second_order", "two_rate_valve", "finite_stroke",
    "dead_volume", "axial_dispersion", "flow_settling", "flow_error", "sensor_diffusion",
    "sorption_asymmetry", "slow_sorption", "optical_nonlinearity", "baseline_drift",
    "baseline_step", "gain_drift", "carry_over", "mains_pickup", "daq_filter", "heavy_tails",
    "quantisation",
)  # fmt: skip
SIMULATED = {
    "none": Simulated((), _FLOWS[0], "faster"),
    **{
        name: Simulated((name,), _FLOWS[k % len(_FLOWS)], _ORDERS[k % len(_ORDERS)])
        for k, name in enumerate(_EFFECTS)
    },
    "valve_asymmetry+baseline_drift": Simulated(
        ("valve_asymmetry", "baseline_drift"), _FLOWS[1], "faster"
    ),
}
BUNDLED = ("reference", "withheld")

Maker = Callable[[Path], bs.Campaign]


def campaigns(cases: Path | None = None) -> dict[str, Maker]:
    """By name, what makes or reads each campaign; it is given an empty folder."""

    def reading(path: Path) -> Maker:
        return lambda _: bs.read_campaign(path)

    found: dict[str, Maker] = {
        f"data/{name}": reading(ROOT / "data" / name / "campaign.toml") for name in BUNDLED
    }
    found |= {f"simulated/{name}": one.make for name, one in SIMULATED.items()}
    if cases is not None:
        paths = sorted(cases.glob("*/campaign.toml"))
        if not paths:
            raise SystemExit(f"--cases {cases}: expected folders with a campaign.toml; none there")
        found |= {f"cases/{path.parent.name}": reading(path) for path in paths}
    return found


# --------------------------------------------------------------------------- what is recorded


def rounded(value: Any) -> Any:
    """The value with its numbers at :data:`DIGITS` significant digits, without keys of nothing.

    >>> rounded({"a": (1 / 3, None), "n": 3, "b": True, "c": None})
    {'a': [0.3333333333, None], 'n': 3, 'b': True}
    """
    if isinstance(value, Mapping):
        return {str(key): rounded(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, list | tuple):
        return [rounded(entry) for entry in value]
    if isinstance(value, bool | int | str) or value is None:
        return value
    return float(f"{float(value):.{DIGITS - 1}e}")


def words(sentences: Iterable[str]) -> list[str]:
    """A short hash of each sentence, whatever its numbers: those are recorded by themselves.

    >>> words(["tau is 3.1 ms"]) == words(["tau is 4 ms"]) != words(["tau is 3.1 s"])
    True
    """
    plain = [re.sub(r"\d+(\.\d+)?(e[-+]?\d+)?", "#", sentence) for sentence in sentences]
    return [hashlib.sha256(sentence.encode()).hexdigest()[:8] for sentence in plain]


def numbers_in(content: Any) -> Iterator[float]:
    """Every finite number of a JSON result."""
    if isinstance(content, Mapping):
        content = list(content.values())
    if isinstance(content, list | tuple):
        for entry in content:
            yield from numbers_in(entry)
    elif isinstance(content, int | float) and not isinstance(content, bool):
        if math.isfinite(content):
            yield float(content)


WHOLE = ("parameters", "budget", "shrink", "ar1")
"""keys of results that are recorded by themselves"""


def all_numbers(content: Mapping[str, Any]) -> dict[str, float]:
    """By top key of a JSON result, the mean of the cube roots of the sizes of all its numbers.

    It notices a change, or a loss, of what is not recorded by itself.  A cube root, so that neither
    the great nor the small ones count alone.
    """
    found = {}
    for key, entry in content.items():
        roots = [math.cbrt(abs(value)) for value in numbers_in(entry)]
        if len(roots) > 1 and key not in WHOLE:
            found[key] = math.fsum(roots) / len(roots)
    return found


def of_fit(said: Mapping[str, Any]) -> dict[str, Any]:
    """What is recorded of fit.json."""
    keys = ("order", "noise_V", "misfit", "rms_V", "cost_V2", "parameters", "unseen", "at_bound",
            "converged", "lags_s")  # fmt: skip
    texts = {key: words(said[key]) for key in ("caveats", "warnings")}
    return {key: said[key] for key in keys} | texts


def of_posterior(said: Mapping[str, Any]) -> dict[str, Any]:
    """What is recorded of posterior.json: percentiles of what all experiments share."""
    ends = ("q2.5", "q50", "q97.5")
    return {
        "parameters": {
            name: [row[q] for q in ends]
            for name, row in said["parameters"].items()
            if row is not None and "[" not in name
        },
        "lags_s": [[lag[q] for q in ends] for lag in said["lags_s"]],
        "assignments": [
            [a["sensor_is"], a["lag"], a["probability"], a["tau_s"]["q50"]]
            for a in said["assignments"]
        ],
        "chain": {
            name: [times["t63_s"]["q50"], times["t90_s"]["q50"]]
            for name, times in said["chain"].items()
        },
        "warnings": words(said["warnings"]),
        **{key: said[key] for key in ("order", "converged", "sampler", "n_draws")},
    }


def of_bounds(said: Mapping[str, Any]) -> dict[str, Any]:
    """What is recorded of bounds.json: sd and 95 % interval of lags and V by every method."""
    found: dict[str, Any] = {}
    for method, bound in said["methods"].items():
        if method == "posterior":
            continue  # recorded as such
        rows = bound["parameters"]
        shared = [name for name in rows if name.startswith(("tau", "lag_", "V_")) and rows[name]]
        numbers = {name: [rows[name][key] for key in ("sd", "lo95", "hi95")] for name in shared}
        found[method] = {"status": words([bound["status"]]), **numbers}
    return found


def of_delays(said: Mapping[str, Any]) -> dict[str, Any]:
    """What is recorded of delays.json."""
    keys = ("intercept_s", "slope_L", "n", "outliers")
    lines = {end: said[end] for end in ("start", "end")}
    return {end: line and {key: line[key] for key in keys} for end, line in lines.items()}


def of_residuals(said: Mapping[str, Any]) -> dict[str, Any]:
    """What is recorded of residuals.json."""
    verdict = words([said["verdict"]])
    return {"adequate": said["adequate"], "verdict": verdict, "ar1": said["ar1"]}


def of_gap(said: Mapping[str, Any]) -> dict[str, Any]:
    """What is recorded of gap.json."""
    return {
        "budget": said["budget"],
        "where": {
            f"{cell['experiment']} {cell['phase']}": cell["share"]
            for cell in said["where"]
            if cell["share"] > LEAST
        },
        "which": {
            row["effect"]: [row["probability"], row["tau_s"], row["fraction_closed"]]
            for row in said["which"]
            if row["probability"] > LEAST
        },
        "verdict": said["verdict"],
        "shrink": said["shrink"],
        "hidden": {k: v for k, v in said["hidden"].items() if k not in ("effects", "lag")},
        "notes": words(said["notes"]),
    }


SELECTED: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
    "fit": of_fit,
    "posterior": of_posterior,
    "bounds": of_bounds,
    "delays": of_delays,
    "residuals": of_residuals,
    "gap": of_gap,
}


def results_of(make: Maker) -> dict[str, Any]:
    """Everything that is recorded of one campaign; of what cannot be told, the message."""
    found: dict[str, Any] = {}
    said: dict[str, Any] = {}

    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")

        def plain(error: Exception) -> str:
            text = str(error)
            if not isinstance(error, bs.CampaignError):
                text = f"{type(error).__name__}: {text}"
            for where in (folder, str(Path(campaign.source).parent) if campaign else ""):
                text = text.replace(where, "FOLDER") if where else text
            return text

        def add(key: str, compute: Callable[[], Any]) -> Any:
            try:
                record = compute()
            except Exception as error:  # whatever this version does is recorded
                found[key] = {"error": plain(error)}
                return None
            said[key] = record.to_json()
            found[key] = {**SELECTED[key](said[key]), "all": all_numbers(said[key])}
            return record

        campaign: bs.Campaign | None = None
        try:
            campaign = make(Path(folder))
        except Exception as error:
            # the message names the file; where that lies is this machine's own
            found["read"] = {"error": re.sub(r"(?<!\S)/\S*/", "", plain(error))}
            return rounded_record(found)
        found["read"] = {
            "n_samples": campaign.n_samples,
            "warnings": words(campaign.warnings),
            "experiments": {
                e.name: [e.total_flow, e.interval, float(e.values.mean()), float(e.values.std())]
                for e in campaign
            },
        }
        fit = add("fit", lambda: bs.fit_least_squares(campaign, seed=SEED))
        if fit is None:
            return rounded_record(found)
        # where nothing but the ensembles is left, they stop early, converged or not
        settings = bs.Settings(n_walkers=32, max_steps=200)
        if said["fit"]["hidden_by_sampling_s"] is not None:
            # no fast form of the likelihood there, and minutes of full ones
            settings = replace(settings, n_draws=10, burn_in=10, chunk=10, max_steps=20)
        posterior = add(
            "posterior",
            lambda: bs.sample_posterior(
                campaign, fit, seed=SEED, sampler="independence", settings=settings
            ),
        )
        add("bounds", lambda: bs.compare_bounds(campaign, fit, posterior, seed=SEED))
        add("delays", lambda: bs.regress_delays(campaign, fit, posterior))
        add("residuals", lambda: bs.diagnose_residuals(campaign, fit))
        add("gap", lambda: bs.diagnose_gap(campaign, fit, seed=SEED))
    return rounded_record(found)


def rounded_record(found: Mapping[str, Any]) -> dict[str, Any]:
    """A campaign's record as JSON will give it back."""
    as_json: dict[str, Any] = rounded(found)
    return as_json


# --------------------------------------------------------------------------- the comparison

RELATIVE = 1e-6
"""of two numbers that are the same but for rounding: computed with other instructions of the
processor (no AVX2, no FMA) none but the distances below were further apart"""
NO_UNIT = 1e-9
"""absolute, of probabilities, shares and p-values, which may be as small as 1e-200"""
_WITHOUT_UNIT = re.compile(r"p_value|probability|/which/|/where/|fraction")
DISTANCE = 2e-3
"""absolute, of the distance left in units of the noise: the root of a small difference of sums of
squares, in which rounding was seen to make 4e-4"""
_DISTANCES = re.compile(r"/shrink/d_(before|after)$")


def differences(recorded: Any, found: Any, place: str = "") -> Iterator[str]:
    """A sentence for whatever is not the same but for rounding, with its name.

    >>> list(differences({"rms": 1.0}, {"rms": 1.0 + 1e-9}))
    []
    >>> list(differences({"rms": [1.0, 2]}, {"rms": [1.0, 3]}))
    ['/rms/1: recorded 2, now 3 (relative 0.33)']
    """
    if isinstance(recorded, Mapping) and isinstance(found, Mapping):
        for key in [*recorded, *(key for key in found if key not in recorded)]:
            where = f"{place}/{key}"
            if key not in found:
                yield f"{where}: recorded {_short(recorded[key])}, now missing"
            elif key not in recorded:
                yield f"{where}: not recorded, now {_short(found[key])}"
            else:
                yield from differences(recorded[key], found[key], where)
    elif isinstance(recorded, list) and isinstance(found, list) and len(recorded) == len(found):
        for i, (before, now) in enumerate(zip(recorded, found)):
            yield from differences(before, now, f"{place}/{i}")
    elif _is_number(recorded) and _is_number(found):
        apart, size = abs(found - recorded), max(abs(found), abs(recorded))
        allowed = RELATIVE * size + (NO_UNIT if _WITHOUT_UNIT.search(place) else 0.0)
        allowed += DISTANCE if _DISTANCES.search(place) else 0.0
        if not apart <= allowed:
            share = f"relative {apart / size:.2g}"
            yield f"{place}: recorded {recorded!r}, now {found!r} ({share})"
    elif type(recorded) is not type(found) or recorded != found:
        yield f"{place}: recorded {_short(recorded)}, now {_short(found)}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 300 else f"{text[:290]} .."


# --------------------------------------------------------------------------- the file


def provenance() -> dict[str, str]:
    """Versions of whatever the numbers depend on."""
    names = ("numpy", "scipy", "numba", "emcee", "arviz")
    return {
        "python": platform.python_version(),
        "bayes-sensor": bs.__version__,
        **{name: metadata.version(name) for name in names},
        "platform": f"{platform.system()} {platform.machine()}",
    }


def read_record() -> dict[str, Any]:
    """The content of results.json: ``made_with`` and ``campaigns``."""
    content: dict[str, Any] = json.loads(RECORD.read_text(encoding="utf-8"))
    return content


def text_of(content: Mapping[str, Any]) -> str:
    """Compact JSON with one line for each result of each campaign, in the order of names."""

    def line(value: Any) -> str:
        return json.dumps(value, sort_keys=True, ensure_ascii=False, separators=(",", ":"))

    parts = []
    for name, results in sorted(content["campaigns"].items()):
        rows = [f"  {line(key)}: {line(results[key])}" for key in sorted(results)]
        parts.append(f" {line(name)}: {{\n" + ",\n".join(rows) + "\n }")
    head = f'{{"made_with": {line(content["made_with"])},\n"campaigns": {{\n'
    return head + ",\n".join(parts) + "\n}}\n"


def main(arguments: list[str] | None = None) -> int:
    """Compute, then write or compare; 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--check", action="store_true", help="compare, write nothing")
    parser.add_argument("--cases", type=Path, help="folder with further campaigns")
    parser.add_argument("--only", action="append", default=[], help="names that begin so")
    given = parser.parse_args(arguments)
    before = read_record() if RECORD.exists() else {"made_with": {}, "campaigns": {}}
    chosen = {
        name: make
        for name, make in campaigns(given.cases).items()
        if not given.only or name.startswith(tuple(given.only))
    }
    now: dict[str, Any] = {}
    different = 0
    begin, of_all = time.perf_counter(), time.process_time()
    for name, make in chosen.items():
        start = time.process_time()
        now[name] = results_of(make)
        said = list(differences(before["campaigns"].get(name, {}), now[name], name))
        different += len(said)
        print(f"{time.process_time() - start:6.1f} s  {name}", flush=True)
        if given.check:
            for sentence in said:
                print(f"    {sentence}")
    busy, passed = time.process_time() - of_all, time.perf_counter() - begin
    print(f"{busy:6.1f} s  of one core, {passed:.0f} s in all: {len(now)} campaigns")
    left = [name for name in before["campaigns"] if name not in now]
    if left:
        print(f"not computed, their record stays: {len(left)} ({', '.join(left[:3])}, ..)")
    if given.check:
        if before["made_with"] != provenance():
            print(f"recorded with {before['made_with']}\nnow {provenance()}")
        print(f"{different} differences" if different else "no difference")
        return 1 if different else 0
    kept = {name: before["campaigns"][name] for name in left}
    content = {"made_with": provenance(), "campaigns": kept | now}
    RECORD.write_text(text_of(content), encoding="utf-8")
    print(f"written: {RECORD} ({RECORD.stat().st_size / 1000:.0f} kB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
