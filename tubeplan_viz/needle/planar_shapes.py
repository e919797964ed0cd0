"""The task of the planar planner: forms and bend sides of paths, what is asked of them, from where to where past what.

Source of the forms: Zhao et al. (2013), China Mechanical Engineering 24(1), table 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.needle.obstacles import Scene

FORMS = {
    1: ("L", "R"),
    2: ("LR", "RL", "RR"),
    3: ("LRR", "RLR", "RRL", "LRL", "RRR"),
    4: ("LRLR", "LRRL", "LRRR", "RLRL", "RLRR", "RRLR", "RRRL", "RRRR"),
}

WEIGHT_MAX = 1e6  # beyond, sums with lengths lose their digits


@dataclass(frozen=True, kw_only=True)
class PlanarSettings:
    """What is asked of planar paths.

    Attributes
    ----------
    radius : float, mm
        Of the arcs; 50 mm in the source.
    safety : float, mm
        Least distance to any obstacle: a hard limit.
    degree_max : int
        Most pieces, 1 to 4.
    weight_length, weight_danger, weight_degree : float
        a1 (per mm), a2 and a4 (per piece) of F = a1 L + a2 D + a3 H + a4 N. The source does not print them; the two
        values of F in its table 2 differ by what a4 near 10 gives. a3 is not needed: nothing that hits is allowed.
    angle_max : float, radian
        Largest insertion angle to either side.
    piece_min : float, mm
        Least length of a piece: a shorter one would be another form.
    turn_max : float, radian
        Largest angle of one arc.
    """

    radius: float = 50.0
    safety: float = 0.0
    degree_max: int = 4
    weight_length: float = 1.0
    weight_danger: float = 0.0
    weight_degree: float = 10.0
    angle_max: float = np.pi / 2
    piece_min: float = 1.0
    turn_max: float = np.pi

    def __post_init__(self) -> None:
        if not 0.1 <= self.radius <= 1e4:
            raise CaseError(f"radius_mm is {self.radius:g}, expected 0.1 to 10000 (kappa is its reciprocal)")
        if not 0.0 <= self.safety <= 100.0:
            raise CaseError(f"safety_mm is {self.safety:g}, expected 0 to 100")
        if self.degree_max not in FORMS:
            raise CaseError(f"degree_max is {self.degree_max}, expected 1 to 4")
        weights = (self.weight_length, self.weight_danger, self.weight_degree)
        if min(weights) < 0 or max(weights) > WEIGHT_MAX or self.weight_length == 0:
            raise CaseError(
                f"the weights of length, danger and degree are {', '.join(f'{w:g}' for w in weights)}, "
                f"expected 0 to {WEIGHT_MAX:g}, that of the length more than 0"
            )
        if not 0.0 < self.angle_max <= np.pi:
            raise CaseError(f"angle_max is {np.degrees(self.angle_max):g} degrees, expected more than 0 and at most 180")
        if not 0.0 < self.turn_max <= 2.0 * np.pi:
            raise CaseError(f"turn_max is {np.degrees(self.turn_max):g} degrees, expected more than 0 and at most 360")
        if not 1e-6 <= self.piece_min <= 100.0:
            raise CaseError(f"piece_min is {self.piece_min:g} mm, expected 0.000001 to 100")
        if self.turn_max * self.radius < self.piece_min:
            raise CaseError(
                f"turn_max is {np.degrees(self.turn_max):g} degrees, which at radius_mm {self.radius:g} is shorter than "
                f"piece_min, {self.piece_min:g} mm; no arc is possible, expected {np.degrees(self.piece_min / self.radius):.3g} "
                "degrees or more"
            )


@dataclass(frozen=True, eq=False)
class PlanarProblem:
    """From where, to where, past what; `entry` and `target` are (y, z) in mm."""

    entry: FloatArray
    target: FloatArray
    scene: Scene
    settings: PlanarSettings

    def __post_init__(self) -> None:
        if self.distance < 1e-3:
            raise CaseError("the needle's target is its entry; expected two places apart")
        for name, place in (("entry", self.entry), ("target", self.target)):
            gaps = [float(body.distance(np.array([[0.0, *place]]))[0]) for body in self.scene.obstacles]
            for k, gap in enumerate(gaps):
                if gap < self.settings.safety:
                    raise CaseError(
                        f"the {name} ({place[0]:g}, {place[1]:g}) mm is {gap:.2f} mm from obstacle {k + 1} "
                        f"({self.scene.obstacles[k].kind}), expected at least safety_mm = {self.settings.safety:g}"
                    )

    @property
    def distance(self) -> float:
        """From entry to target, mm."""
        return float(np.linalg.norm(np.subtract(self.target, self.entry)))

    @property
    def bearing(self) -> float:
        """Insertion angle of the straight line to the target, radian."""
        y, z = np.subtract(self.target, self.entry)
        return float(np.arctan2(-y, z))


def sides_of(form: str) -> list[tuple[int, ...]]:
    """Bend sides of a form's pieces: neighbouring arcs alternate, every run of arcs starts on either side."""
    runs = [k for k, piece in enumerate(form) if piece == "R" and (k == 0 or form[k - 1] == "L")]
    made = []
    for firsts in product((1, -1), repeat=len(runs)):
        first = dict(zip(runs, firsts, strict=True))
        sides: list[int] = []
        for k, piece in enumerate(form):
            sides.append(0 if piece == "L" else first.get(k, -sides[-1] if sides else 1))
        made.append(tuple(sides))
    return made


def turns_of(sides: FloatArray) -> FloatArray:
    """Turn of the bevel before each piece, radian, (..., n): pi where an arc bends to the other side than the last (first: 1)."""
    turns = np.zeros(sides.shape)
    now = np.ones(sides.shape[:-1])
    for k in range(sides.shape[-1]):
        here = np.where(sides[..., k] == 0, now, sides[..., k])
        turns[..., k] = np.where(here != now, np.pi, 0.0)
        now = here
    return turns
