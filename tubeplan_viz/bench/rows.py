"""One line of a benchmark: ours beside a reference, against a target."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Row:
    """One figure of one case.

    Attributes
    ----------
    case, figure : str
        What was measured on what; `figure` carries its unit.
    ours : float
    reference : float or None
        The published or measured value beside it, from `source`.
    source : str
        Where the reference comes from; empty without one.
    target : str
        What must hold, in words; empty for a figure that is shown only.
    holds : bool or None
        None without a target.
    """

    case: str
    figure: str
    ours: float
    reference: float | None = None
    source: str = ""
    target: str = ""
    holds: bool | None = None

    @property
    def ratio(self) -> float | None:
        """Ours over reference."""
        return None if not self.reference else self.ours / self.reference

    def as_dict(self) -> dict[str, Any]:
        """The row for JSON."""
        return {**asdict(self), "ratio": self.ratio}

    def cells(self) -> tuple[str, ...]:
        """The row for a table."""
        ratio = "" if self.ratio is None else f"{self.ratio:.2f}"
        reference = "" if self.reference is None else f"{self.reference:.4g}"
        holds = {True: "yes", False: "NO", None: ""}[self.holds]
        return (self.case, self.figure, f"{self.ours:.4g}", reference, self.source, ratio, self.target, holds)


def under(case: str, figure: str, value: float, limit: float, reference: float | None = None, source: str = "") -> Row:
    """A row whose target is an upper limit."""
    held = bool(value < limit)
    return Row(case=case, figure=figure, ours=value, reference=reference, source=source, target=f"under {limit:g}", holds=held)
