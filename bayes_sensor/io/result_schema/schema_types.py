"""Types of which the schemas are made: finite numbers, texts, lists of one length."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, StringConstraints
from pydantic_core import PydanticCustomError

Num = Annotated[float, Field(strict=True, ge=-1e100, le=1e100)]
"""a number whose square is one, too"""
Positive = Annotated[float, Field(strict=True, gt=0.0, le=1e100)]
NotNegative = Annotated[float, Field(strict=True, ge=0.0, le=1e100)]
Share = Annotated[float, Field(strict=True, ge=-1e-9, le=1.0 + 1e-9)]
"""a probability, with rounding"""
Int = Annotated[int, Field(strict=True, ge=0, le=10**15)]
Seed = Annotated[int, Field(strict=True, ge=-(2**128), le=2**128)]
Text = Annotated[str, StringConstraints(strict=True, max_length=100_000)]
Name = Annotated[str, StringConstraints(strict=True, min_length=1, max_length=1000)]
FileName = Annotated[
    str, StringConstraints(strict=True, max_length=250, pattern=r"^[^/\\\x00.][^/\\\x00]*$")
]
"""a name that leads to no other folder"""
Unit = Annotated[str, StringConstraints(strict=True, max_length=100)]
Hash = Annotated[str, StringConstraints(strict=True, pattern="^[0-9a-f]{64}$")]
MaybeNum = Num | None
Texts = list[Text]
Numbers = list[Num]
MaybeNumbers = list[MaybeNum]
Phase = Literal["baseline", "onset", "rise", "plateau", "fall", "tail"]
SensorIs = Literal["faster", "slower", "between"]


def fail(text: str) -> PydanticCustomError:
    """The error of a validator, in the words of its message."""
    return PydanticCustomError("content", "{text}", {"text": text})


def same_length(*keys: str) -> AfterValidator:
    """The lists of these keys have one length, if they are there."""

    def check(found: Mapping[str, Any]) -> Mapping[str, Any]:
        lengths = {key: len(found[key]) for key in keys if found.get(key) is not None}
        if len({*lengths.values()}) > 1:
            told = ", ".join(f"{key} {n}" for key, n in lengths.items())
            raise fail(f"lists of one length were expected, but they have {told}")
        return found

    return AfterValidator(check)
