"""Tables as CSV whose texts no spreadsheet takes for formulas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

_FORMULA = ("=", "+", "-", "@")


def csv_text(table: pd.DataFrame) -> str:
    """The rows and the header; a text that would be a formula begins with an apostrophe.

    A text that is a number stays as it is.

    >>> import pandas as pd
    >>> print(csv_text(pd.DataFrame({"name": ["=A1", "-5", "a"], "x": [-1.0, 2.0, 3.0]})), end="")
    name,x
    '=A1,-1.0
    -5,2.0
    a,3.0
    """
    text: str = table.map(_harmless).to_csv(index=False, lineterminator="\n")
    return text


def _harmless(cell: Any) -> Any:
    if not isinstance(cell, str) or not cell.startswith(_FORMULA):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell
