"""Numbers, p-values and lists as the report writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import floor, log10

from bayes_sensor.display import time_unit
from bayes_sensor.figures.labels import raised


def number(value: float | None, digits: int = 3) -> str:
    """A number with ``digits`` significant digits, never in powers of ten unless it must be.

    >>> number(0.0481234), number(None), number(1234567.0), number(0.0)
    ('0.0481', '–', '1234567', '0')
    """
    if value is None:
        return "–"
    if value == 0:
        return "0"
    exponent = floor(log10(abs(value)))
    if exponent < -4 or exponent > 9:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def powers(value: float | None, digits: int = 3) -> str:
    """A number as a power of ten.

    >>> powers(1.71e-10), powers(None)
    ('1.71 × 10⁻¹⁰', '–')
    """
    if value is None:
        return "–"
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa} × 10{raised(int(exponent))}"


def with_spread(value: float | None, spread: float | None) -> str:
    """A number rounded to two digits of its spread.

    >>> with_spread(58.1747, 0.5337)
    '58.17'
    """
    if value is None:
        return "–"
    if not spread:
        return number(value, 4)
    decimals = max(0, 1 - floor(log10(spread)))
    return f"{value:.{min(decimals, 9)}f}"


def interval(low: float, high: float) -> str:
    """Both ends, rounded to two digits of their difference.

    >>> interval(30.96, 52.04)
    '[31, 52]'
    """
    return f"[{with_spread(low, high - low)}, {with_spread(high, high - low)}]"


LAG_WORDS = {"faster": "shorter", "between": "middle", "slower": "longer"}
"""which of the lags the sensor's is, by ``sensor_is``"""


def time_words(seconds: float) -> str:
    """A time in the unit that suits it.

    >>> time_words(0.0481), time_words(20.07)
    ('48.1 ms', '20.1 s')
    """
    factor, unit = time_unit(seconds)
    return f"{number(factor * seconds)} {unit}"


def p_words(p: float | None) -> str:
    """A p-value in words, without false precision.

    >>> p_words(1e-30), p_words(0.0312)
    ('below 0.001', '0.031')
    """
    if p is None:
        return "–"
    return "below 0.001" if p < 0.001 else f"{p:.2g}"


def p_equals(p: float | None) -> str:
    """``= 0.03``, ``below 0.001`` or ``not computed``."""
    if p is None:
        return "not computed"
    words = p_words(p)
    return words if words.startswith("below") else f"= {words}"


def list_words(items: Sequence[str], most: int = 6) -> str:
    """Items joined as in a sentence.

    >>> list_words(["a", "b", "c"])
    'a, b and c'
    """
    items = list(items)
    if len(items) > most:
        items = [*items[: most - 1], f"{len(items) - most + 1} more"]
    return " and ".join(filter(None, [", ".join(items[:-1]), *items[-1:]]))


_SYMBOLS = {
    "tau_v": "τᵥ", "tau_v_s": "τᵥ", "tau": "τ", "tau_s": "τ", "V_mL": "V", "t0": "t₀", "t0_s": "t₀",
    "tf": "t_f", "tf_s": "t_f", "y0": "y₀", "y0_V": "y₀", "beta": "β", "beta_V": "β", "phi": "φ",
    "sigma0_V": "σ₀", "sigma1_V": "σ₁",
    "lag_fast_s": "shorter lag", "lag_between_s": "middle lag", "lag_slow_s": "longer lag",
}  # fmt: skip


def typeset(text: str) -> str:
    """A sentence of the numerical rooms with symbols in place of plain ASCII; not in quotes.

    >>> typeset("tau^2 is known to +-0.5 ms^2, mixed with t0_s[6]")
    'τ² is known to ± 0.5 ms², mixed with t₀[6]'
    """
    text = re.sub(r"(?<![\w.'\"])([a-zA-Z]\w*)", lambda m: _SYMBOLS.get(m[1], m[1]), text)
    return re.sub(r"\+-\s?", "± ", text.replace("^2", "²"))


def sentence(text: str) -> str:
    """A text with a capital and a full stop; symbols and names of parameters keep their case.

    >>> sentence("the fit ended"), sentence("t_f[2] is open"), sentence("model right?")
    ('The fit ended.', 't_f[2] is open.', 'Model right?')
    """
    text = text.strip()
    if re.match(r"[a-z][a-zA-Z'-]*(?=[\s,.:;?!]|$)", text):
        text = text[:1].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else text + "."


def scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


def ms(seconds: float | None) -> float | None:
    return scaled(seconds, 1e3)
