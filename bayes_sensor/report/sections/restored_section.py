"""What the gas did: the restored input of a record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_sensor.report.parts import Part, Picture, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import number, p_equals, time_words

MOMENTS = {"lowest": "lowest input", "highest": "highest input", "least_known": "widest band"}


def restored(saved: Saved) -> Section | None:
    """The input with its bands, the resolution, and whether the record behaves as assumed."""
    found = saved.restored
    if found is None:
        return None
    unit = found["signal_unit"]
    of_unit = f" {unit}" if unit else ""
    resolution = found["resolution_s"]
    width = number(found["bands"]["median_half_width95"])
    answer = (
        "Nothing is resolved: the noise is larger than the signal at every period"
        if resolution is None
        else f"What lasts longer than {time_words(resolution)} is restored, what is shorter is not"
    )
    answer += f"; the 95 % band is ± {width}{of_unit} in the median{see('restored', 'bands')}."
    lag, noise = found["lag_s"], found["noise"]
    paragraphs = [
        f"The longest lag is {time_words(lag['q50'])} (95 % interval {time_words(lag['q2.5'])} to "
        f"{time_words(lag['q97.5'])}), from {found['lag_source']}. The band holds its "
        "uncertainty, that of the noise and that of how rough the input is.",
        f"The noise is {number(noise['sigma']['q50'])}{of_unit}, its correlation "
        f"{number(noise['phi']['q50'], 2)} after {time_words(noise['phi_interval_s'])}.",
        _innovations(found["innovations"]),
        *(f"Remark: {text}." for text in found["remarks"]),
    ]
    columns = ["where", "time (s)", *(f"{head}{of_unit and f' ({unit})'}" for head in _HEADS)]
    table = Table(
        "bands",
        "The restored input where it is lowest and highest, and where the record tells least.",
        columns,
        [
            [words, *(found["bands"][key][name] for name in ("time_s", *_HEADS.values()))]
            for key, words in MOMENTS.items()
        ],
    )
    picture = Picture(
        "restored",
        None,
        "Above, the record; below, the input with its 68 and 95 % bands. The bar is the "
        "resolution: what is shorter is smoothed away.",
        drawing=saved.restored_figure,
    )
    content: list[Part] = [*([picture] if saved.restored_figure else []), table]
    return Section("restored", "What was the input", answer, paragraphs, content)


_HEADS = {
    "input": "value", "68 % low": "lo68", "68 % high": "hi68", "95 % low": "lo95",
    "95 % high": "hi95",
}  # fmt: skip


def _innovations(test: Mapping[str, Any]) -> str:
    """Whether the errors of the filter's predictions pass their tests."""
    from bayes_sensor.restoration.innovations import DOUBTFUL  # slow to import

    passed = min(test["p_value"], test["largest_p_value"]) >= DOUBTFUL
    return (
        f"The filter's prediction errors (innovations) {'pass' if passed else 'do not pass'} their "
        f"tests: Ljung-Box p {p_equals(test['p_value'])}; the largest of {test['n']} is "
        f"{number(abs(test['largest']), 2)} standard deviations, p "
        f"{p_equals(test['largest_p_value'])}."
    )
