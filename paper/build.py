"""The manuscript as PDF: ``python paper/build.py [--out manuscript.pdf]``.

Reads manuscript.typ, references.bib, tables/ and figures/; every number of the text comes from the
tables, which ``make study`` writes.  A section whose tables do not exist yet is left out.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import matplotlib
import typst

PAPER = Path(__file__).resolve().parent
OUT = PAPER.parent / "build" / "manuscript.pdf"
NEEDED = (
    "published_bounds", "bound_against_step", "predictive", "sbc", "coverage_posterior",
    "coverage_tau", "benchmark",
)  # fmt: skip
"""tables without which there is no manuscript"""


def build(out: Path) -> None:
    """Typeset the manuscript.

    Raises FileNotFoundError, naming the tables, if one that it needs is missing.
    """
    tables = sorted(path.stem for path in (PAPER / "tables").glob("*.csv"))
    missing = [name for name in NEEDED if name not in tables]
    if missing:
        raise FileNotFoundError(
            f"paper/tables: {', '.join(missing)} missing; expected the outputs of the studies: "
            "run make study"
        )
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    content = typst.compile(
        PAPER / "manuscript.typ",
        root=PAPER,
        font_paths=[fonts],
        sys_inputs={"tables": ",".join(tables)},
    )
    assert isinstance(content, bytes)
    out.parent.mkdir(parents=True, exist_ok=True)
    part = out.with_suffix(".part")
    part.write_bytes(content)
    os.replace(part, out)


def main() -> int:
    """Parse, build, tell; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=OUT, help="where the PDF goes")
    arguments = parser.parse_args()
    try:
        build(arguments.out)
    except FileNotFoundError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"manuscript: {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
