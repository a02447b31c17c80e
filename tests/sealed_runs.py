"""What the sealed runs of the blind check found, for the tests of what rests on it."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

TABLES = Path(__file__).resolve().parent.parent / "paper" / "tables"


def sealed_cases() -> pd.DataFrame:
    """Every case of the sealed runs that are kept, the last one included, with its run's seed."""
    earlier, last = (  # "null" is a word here
        pd.read_csv(TABLES / f"blind_check_{name}", keep_default_na=False, na_values=[""])
        for name in ("earlier.csv.gz", "first.csv")
    )
    seeds = pd.read_csv(TABLES / "blind_check_runs.csv")["seed"]
    return pd.concat([earlier, last.assign(seed=seeds.max())], ignore_index=True)
