"""Names of parameters, units and numbers as figures write them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

SHARED_LABELS = {
    "tau_s": ("sensor τ", "ms", 1e3),
    "tau_v_s": ("valve τᵥ", "ms", 1e3),
    "lag_fast_s": ("shorter lag", "s", 1.0),
    "lag_between_s": ("middle lag", "s", 1.0),
    "lag_slow_s": ("longer lag", "s", 1.0),
    "V_mL": ("volume V", "mL", 1.0),
}
"""flat name to words, unit shown and the factor to it; lags by size are those that cannot be
assigned"""


def shared_labels(names: Iterable[str]) -> dict[str, tuple[str, str, float]]:
    """Words, unit shown and factor of the shared parameters among ``names``: those of
    :data:`SHARED_LABELS`, then lags and volumes of other stages and sensors.

    >>> shared_labels(["V_mL", "tau_s[A]", "tau_filter_s", "phi"])["tau_filter_s"]
    ('filter τ', 's', 1.0)
    """
    names = list(dict.fromkeys(names))
    found = {name: words for name, words in SHARED_LABELS.items() if name in names}
    for name in names:
        words = _stage_label(name)
        if name not in found and words is not None:
            found[name] = words
    return found


def _stage_label(name: str) -> tuple[str, str, float] | None:
    """The same of a stage of another rig or of one of several sensors; None for anything else."""
    kind, bracket, rest = name.partition("[")
    if kind == "tau_s" and bracket:
        return f"sensor {rest.removesuffix(']')} τ", "s", 1.0
    if bracket:
        return None
    if kind.startswith("lag_") and kind.endswith("_s"):
        return kind.removesuffix("_s").replace("_", " "), "s", 1.0
    if kind.startswith("tau_") and kind.endswith("_s"):
        return f"{kind[4:-2].replace('_', ' ')} τ", "s", 1.0
    if kind.startswith("V_") and kind.endswith("_mL"):
        return f"{kind[2:-3].replace('_', ' ')} V", "mL", 1.0
    return None


def told_apart(names: Iterable[str]) -> list[str]:
    """``names`` of a posterior, shared ones first, without tau and tau_v if they cannot be
    assigned.

    >>> told_apart(["tau_s", "tau_v_s", "V_mL", "lag_fast_s", "lag_slow_s", "phi"])
    ['lag_fast_s', 'lag_slow_s', 'V_mL', 'phi']
    """
    names = list(names)
    unknown = set()
    if any(name.startswith("lag_") for name in names):
        unknown = {"tau_s", "tau_v_s"}
    if "lag_between_s" in names:  # at one flow that may be V/Q
        unknown.add("V_mL")
    shared = list(shared_labels(names))
    rest = [name for name in names if name not in shared]
    return [name for name in [*shared, *rest] if name not in unknown]


def labels_of_bounds(bounds: Mapping[str, Any]) -> dict[str, tuple[str, str, float]]:
    """:func:`shared_labels` of the content of ``bounds.json``."""
    rows = [row for entry in bounds["methods"].values() for row in entry["parameters"].items()]
    if not any(name.startswith("lag_") for name, _ in rows):
        return shared_labels(name for name, _ in rows)
    return shared_labels(name for name, row in rows if row)


def plain(value: float) -> str:
    """A number as a reader writes it: small ones as powers of ten.

    >>> plain(0.01), plain(1e-6), plain(2e-11), plain(2000.0)
    ('0.01', '10⁻⁶', '2 × 10⁻¹¹', '2000')
    """
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:g}"
    mantissa, exponent = f"{value:e}".split("e")
    front = f"{float(mantissa):g}"
    return ("" if front == "1" else f"{front} × ") + "10" + raised(int(exponent))


def raised(exponent: int) -> str:
    """An exponent in small raised digits."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def thousands(count: float) -> str:
    """A count in groups of three digits, which no line breaks.

    >>> thousands(840000) == "840\\u00a0000", thousands(4500)
    (True, '4500')
    """
    return f"{count:,.0f}".replace(",", "\u00a0") if count > 9999 else f"{count:.0f}"


def volts(unit: str, size: float) -> tuple[str, float]:
    """Unit and factor that make values near ``size`` readable."""
    return ("mV", 1e3) if unit == "V" and size < 0.5 else (unit, 1.0)


def shortened(text: str, most: int = 18) -> str:
    """A text of at most ``most`` characters; the tables have all of it.

    >>> shortened("the same gas, once more", 9)
    'the same…'
    """
    return text if len(text) <= most else text[: most - 1] + "…"


def parameter_words(name: str, unit: str = "V") -> tuple[str, str, float]:
    """Symbol, unit shown and factor to it, of a flat parameter name.

    >>> parameter_words("t0_s[4]")
    ('t₀[4]', 's', 1.0)
    >>> parameter_words("drift_V_per_s")
    ('drift', 'V/s', 1.0)
    """
    shared = shared_labels([name])
    if shared:
        return shared[name]
    kind, bracket, rest = name.partition("[")
    symbols = {
        "phi": "φ", "sigma0_V": "σ₀", "sigma1_V": "σ₁",
        "y0_V": "y₀", "beta_V": "β", "t0_s": "t₀", "tf_s": "t_f",
    }  # fmt: skip
    if kind not in symbols:  # a parameter of an effect
        from bayes_sensor.rig.named_values import UNITS, unit_of

        own = unit_of(kind, unit)
        words = kind.split("_")
        while own != "1" and (words[-1] in UNITS or words[-1] == "per") and len(words) > 1:
            words.pop()
        return " ".join(words) + bracket + rest, "" if own == "1" else own, 1.0
    shown, factor = ("", 1.0) if kind == "phi" else ("s", 1.0) if kind.endswith("_s") else (unit, 1)
    if kind.startswith("sigma") and unit == "V":
        shown, factor = "mV", 1e3
    return symbols.get(kind, kind) + bracket + rest, shown, factor


def axis_label(words: tuple[str, str, float]) -> str:
    return f"{words[0]} ({words[1]})" if words[1] else words[0]
