"""Every study behind the paper: ``python paper/studies/run_all.py --jobs N``.

Unfinished studies go on where they stopped (chunks in build/studies); the numbers depend neither
on --jobs nor on --scheduler (the address of a Dask scheduler, ``tcp://host:port``).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import study_blind_check
import study_bounds
import study_calibration
import study_coating
import study_coverage
import study_determinism
import study_extremes
import study_faults
import study_fleet
import study_folders
import study_gap
import study_gap_rigs
import study_hostile
import study_misfit
import study_order
import study_other_rigs
import study_predictive
import study_published_bounds
import study_real
import study_recorders
import study_reproduction
import study_restoration
import study_sbc
import study_unlisted
import study_where

STUDIES = {
    "published-bounds": study_published_bounds.run,
    "reproduction": study_reproduction.run,
    "predictive": study_predictive.run,
    "sbc": study_sbc.run,
    "sbc-short": study_sbc.run_short,
    "coverage": study_coverage.run,
    "bounds": study_bounds.run,
    "other-rigs": study_other_rigs.run,
    "coating": study_coating.run,
    "gap": study_gap.run,
    "gap-rigs": study_gap_rigs.run,
    "unlisted": study_unlisted.run,
    "where": study_where.run,
    "calibration": study_calibration.run,
    "blind-check": study_blind_check.run,
    "order": study_order.run,
    "extremes": study_extremes.run,
    "folders": study_folders.run,
    "hostile": study_hostile.run,
    "misfit": study_misfit.run,
    "real": study_real.run,
    "recorders": study_recorders.run,
    "restoration": study_restoration.run,
    "faults": study_faults.run,
    "determinism": study_determinism.run,
    "fleet": study_fleet.run,
}
ROOT = Path(__file__).resolve().parent.parent.parent


def main() -> None:
    """Parse, run, tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=1, help="processes on this machine")
    parser.add_argument("--scheduler", help="address of a Dask scheduler, tcp://host:port")
    parser.add_argument("--only", choices=STUDIES, action="append", help="run only this study")
    arguments = parser.parse_args()
    folder = ROOT / "build" / "studies"
    (ROOT / "paper" / "tables").mkdir(parents=True, exist_ok=True)
    for name in arguments.only or STUDIES:
        begin = time.perf_counter()

        def tell(done: int, n: int, name: str = name, begin: float = begin) -> None:
            print(f"{name}: {done} of {n}, {time.perf_counter() - begin:.0f} s", flush=True)

        STUDIES[name](folder, arguments.jobs, arguments.scheduler, tell)
        print(f"{name}: done in {time.perf_counter() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
