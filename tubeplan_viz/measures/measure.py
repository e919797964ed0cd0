"""One measured value, or why there is none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from segmentation.arrays import FloatArray
from tubeplan_viz.measures.definitions import DEFINITIONS


@dataclass(frozen=True, eq=False, kw_only=True)
class Measure:
    """A value of one kind for one part of the anatomy.

    Attributes
    ----------
    key : str
        Of its definition.
    of : str
        Which part, in words; empty for the whole.
    value : float or None
        In the definition's unit; None where it could not be computed.
    reason : str
        Why not; empty where it could.
    """

    key: str
    of: str = ""
    value: float | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        if self.key not in DEFINITIONS:
            raise ValueError(f"there is no measure {self.key!r}")
        if (self.value is None) == (not self.reason):
            raise ValueError(f"measure {self.key} needs either a value or a reason, not both and not neither")

    def details(self) -> dict[str, Any]:
        """The measure for result.json."""
        definition = DEFINITIONS[self.key]
        return {
            "key": self.key,
            "group": definition.group,
            "of": self.of,
            "name": definition.name,
            "value": self.value,
            "unit": definition.unit,
            "reason": self.reason or None,
        }


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawing:
    """Lines and points of the anatomy by which a measure can be drawn, LPS or mesh mm.

    Attributes
    ----------
    lines : mapping of str to (n, 3) float array
    points : mapping of str to (3,) float array
    """

    lines: Mapping[str, FloatArray]
    points: Mapping[str, FloatArray]

    def details(self) -> dict[str, Any]:
        """The drawing for result.json, rounded to a hundredth of a millimetre."""
        return {
            "lines": {name: line.round(2).tolist() for name, line in self.lines.items()},
            "points": {name: point.round(2).tolist() for name, point in self.points.items()},
        }


def lacking(reason: str, *keys: str, of: str = "") -> list[Measure]:
    """Measures that cannot be computed, all for one reason."""
    return [Measure(key=key, of=of, reason=reason) for key in keys]
