"""What a check says, and what all of them say together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Check:
    """One claim of a run, tested.

    Attributes
    ----------
    name : str
        Short and stable, e.g. ``path: clearance``.
    ok : bool
    found, expected : str
        As printed to the reader, with units.
    text : str
        One sentence: what was compared and, if it fails, where and what that means.
    """

    name: str
    ok: bool
    found: str
    expected: str
    text: str

    @property
    def sentence(self) -> str:
        """What to show a reader: the text, and for a check that does not hold what was found and expected."""
        return self.text if self.ok else f"{self.text} Found {self.found}; expected {self.expected}."


@dataclass(frozen=True, kw_only=True)
class Verification:
    """All checks of one run, in the order in which they were made."""

    run: str
    checks: tuple[Check, ...]

    @property
    def holds(self) -> bool:
        """Whether every check holds."""
        return all(check.ok for check in self.checks)

    @property
    def faults(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.ok)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``--json``."""
        rows = [
            {"name": check.name, "ok": check.ok, "found": check.found, "expected": check.expected, "text": check.text}
            for check in self.checks
        ]
        return {"run": self.run, "holds": self.holds, "checks": rows}
