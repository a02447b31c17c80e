"""Print what was understood of a campaign."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.analysis.read_input import check_methods, read_input
from bayes_sensor.campaign import CampaignError, FloatArray, counted
from bayes_sensor.cli.terminal import lined_up
from bayes_sensor.io.disk import write_bytes
from bayes_sensor.io.untrusted import LARGEST_FILE, read_bytes
from bayes_sensor.rig.ties import tie_texts

FIGURE = "check.png"
WIDEST = 40
"""characters of a cell: a longer name is cut off"""
MOST_TIMES = 12
"""of the commands of one experiment"""


def _check_free(place: Path) -> None:
    """Raise CampaignError where a picture stands that this command has not drawn."""
    from bayes_sensor.figures.style import SOFTWARE

    if os.path.lexists(place):
        content = read_bytes(place, LARGEST_FILE, "a picture that check drew")
        if f"Software\0{SOFTWARE}".encode() not in content[:1000]:
            raise CampaignError(
                f"{place}: expected a picture that check drew, but it is another; move it away, so "
                "that it is not replaced"
            )


def print_check(path: Path, quiet: bool, config: Path | None = None, plot: bool = False) -> None:
    """Print what was understood of a campaign; settings are checked against it.

    ``plot``: draw it, too, into a file beside the campaign's.
    """
    from bayes_sensor.analysis.overrides import fit_bounds, make_problem, read_overrides

    overrides = read_overrides(config)
    label = config.name if config is not None else "--config"
    check_methods(overrides.bounds.methods, label)
    campaign, table, remarks = read_input(path)
    fit_bounds(make_problem(campaign, overrides, label), overrides, label)
    if plot:
        from bayes_sensor.figures import png, understood

        _check_free(path.parent / FIGURE)
        write_bytes(path.parent / FIGURE, png(understood(campaign), dpi=130))
    if quiet:
        return
    kind = "a design without data" if campaign.is_design else f"{campaign.n_samples} samples in use"
    print(f"{campaign.title}: {counted(len(campaign), 'experiment')}, {kind}")
    unit = campaign.signal_unit
    columns = [
        ("experiment", "experiment", "{}"),
        ("samples", "samples", "{}"),
        ("used", "used", "{}"),
        ("interval", "interval_s", "{:.4g} s"),
        ("Q (L/min)", "total_flow_L_min", "{:.4g}"),
        ("test gas (%)", "concentration_percent", "{:.3g}"),
        ("on (s)", "commanded_on_s", "{:.4f}"),
        ("off (s)", "commanded_off_s", "{:.4f}"),
        (f"baseline ({unit})", "baseline_V", "{:.4g}"),
        (f"step ({unit})", "step_V", "{:.4g}"),
        (f"noise ({unit})", "noise_V", "{:.3g}"),
    ]
    rows = [[title for title, _, _ in columns]]
    for row in table:
        rows.append([_cell(row[key], pattern) for _, key, pattern in columns])
    print("\n".join(lined_up(rows, left=1)))
    for e in campaign:
        if e.commands is not None and not e.commands.recorded:
            print(f"commands of {e.name} (s): {_listed(e.commands.times)}")
    print(f"rig: {', '.join(campaign.stages)}; which lag is the sensor: {campaign.sensor_is}")
    for name, to in tie_texts(campaign.ties).items():
        print(f"tied: {name} = {to}")
    for name, info in campaign.side_information.items():
        print(f"known beforehand: {name} = {info.mean:g} +- {info.sd:g}")
    for remark in remarks:
        print(f"remark: {remark}")
    if plot:
        print(f"drawn: {path.parent / FIGURE}")


def _listed(times: FloatArray) -> str:
    """Times with the digits that tell them apart, the middle ones left out where there are many."""
    shown = [f"{t:.10g}" for t in times]
    if len(shown) > MOST_TIMES:
        half = MOST_TIMES // 2
        shown = [*shown[:half], f"... {len(shown) - 2 * half} more ...", *shown[-half:]]
    return ", ".join(shown)


def _cell(value: Any, pattern: str) -> str:
    if isinstance(value, float) and np.isnan(value):
        return "-"
    shown = pattern.format(value)
    return shown if len(shown) <= WIDEST else f"{shown[: WIDEST - 3]}..."
