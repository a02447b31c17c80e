"""The coverage study from the command line: simulate, bound, count, resume."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bayes_sensor import figures
from bayes_sensor.bounds import METHODS
from bayes_sensor.checks.coverage import BoundsStudy, chosen_settings, run_coverage
from bayes_sensor.cli.logged_notes import noted
from bayes_sensor.cli.put_figure import put_figure
from bayes_sensor.cli.terminal import lined_up, progress_bar, say
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import Results

if TYPE_CHECKING:
    import pandas as pd

    from bayes_sensor.cli.command_options import CoverageStudy

CHUNKS = "coverage-parts"
"""folder of finished parts; kept, so that --resume may also add campaigns"""


def study_coverage(wanted: CoverageStudy) -> None:
    """Write coverage.csv, coverage.json and the figure.

    Methods that are given replace those of the settings; without either, all are used.
    """
    from bayes_sensor.analysis.overrides import read_overrides

    clock = CommandClock()
    chosen = chosen_settings(wanted.setting or ())
    asked = read_overrides(wanted.config).bounds
    names = tuple(wanted.method or ()) or tuple(asked.methods or ()) or tuple(METHODS)
    BoundsStudy(next(iter(chosen.values())), methods=names)  # refuses unknown methods
    resamples = asked.resamples if "resamples" in asked.model_fields_set else None
    results = Results(wanted.out)
    parts = results.own_folder(CHUNKS)
    with results.locked(steps=["coverage"]):
        if not wanted.resume:
            results.clear(CHUNKS)
        with progress_bar("coverage", wanted.quiet) as tell:
            table = run_coverage(
                parts, chosen, wanted.campaigns, names, wanted.seed, wanted.jobs, wanted.scheduler,
                lambda done, n: tell(done / n, f"{done} of {n} campaigns"),
                n_resamples=resamples,
            )  # fmt: skip
        rows = table.to_dict("records")
        with results.writing() as stage:
            stage.text("coverage.csv", table.to_csv(index=False, lineterminator="\n"))
            stage.json(
                "coverage.json",
                {
                    "campaigns_per_setting": wanted.campaigns,
                    "settings": {name: setting.words for name, setting in chosen.items()},
                    "methods": list(names),
                    "coverage": rows,
                },
            )
            put_figure(stage, "coverage", figures.coverage(rows))
            put_run(
                stage, "coverage", clock, seed=wanted.seed, warnings=noted(),
                settings={
                    "campaigns": wanted.campaigns, "settings": list(chosen),
                    "methods": list(names),
                },
            )  # fmt: skip
    say(summary(table), wanted.quiet)
    say(f"results: {results.path('coverage.csv')}", wanted.quiet)


def summary(table: pd.DataFrame, parameter: str = "tau_s") -> str:
    """Coverage of the 95 % interval of one parameter, a row a method, a column a setting."""
    some = table[(table["level"] == "95") & (table["parameter"] == parameter)]
    methods, settings = list(dict.fromkeys(some["method"])), list(dict.fromkeys(some["setting"]))
    values = some.set_index(["method", "setting"])["coverage"]
    rows = [[f"95 % of {parameter.rpartition('_')[0]}", *settings]]
    rows += [[method, *(f"{values[method, s]:.3f}" for s in settings)] for method in methods]
    return "\n".join(lined_up(rows, left=1))
