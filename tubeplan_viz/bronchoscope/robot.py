"""The robot's parameters: two active sections, a passive one (Guo et al. 2022, section 1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from segmentation.errors import CaseError


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A continuum robot of two bending sections on a passive shaft.

    Attributes
    ----------
    name : str
    diameter : float
        Outer diameter, mm.
    proximal_length, distal_length : float
        Arc length of the active sections, mm; the distal one carries the tip. The text calls its parameters virtual; the
        only lengths it states are L2 = L3 = 1 with n = 12 (its figure 2), read as mm: ``L1 = n L2 + L3 = 13``.
    bend_max : float
        Largest bend of each active section, radian (90 degrees in the text); the passive section bends as sharply.
    links : int
        Rigid links per active section in the chain model.
    push_speed : float
        mm/s (0.015 m/s in the text).
    passive_length : float
        Length of the passive section, mm.
    """

    name: str = "two-section"
    diameter: float = 3.5
    proximal_length: float = 13.0
    distal_length: float = 13.0
    bend_max: float = math.pi / 2
    links: int = 12
    push_speed: float = 15.0
    passive_length: float = 400.0

    def __post_init__(self) -> None:
        for key in ("diameter", "proximal_length", "distal_length", "bend_max", "push_speed", "passive_length"):
            if not getattr(self, key) > 0.0:
                raise CaseError(f"robot {self.name}: {key} is {getattr(self, key):g}, expected more than 0")
        if self.links < 2:
            raise CaseError(f"robot {self.name}: links is {self.links}, expected at least 2")

    @property
    def radius(self) -> float:
        """Outer radius, mm."""
        return self.diameter / 2.0

    @property
    def curvature_max(self) -> float:
        """Largest curvature of any section, 1/mm."""
        return self.bend_max / min(self.proximal_length, self.distal_length)

    @property
    def active_length(self) -> float:
        """Length of both active sections, mm."""
        return self.proximal_length + self.distal_length
