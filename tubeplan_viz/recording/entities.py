"""Names and colours that writer, blueprint and reader share: entity paths under ``/case``, timelines, palette."""

from __future__ import annotations

from typing import Final

from tubeplan_viz.plan import FeatureKind, FlagKind

ITERATION: Final = "iteration"
"""Sequence timeline: the iteration's index."""
ARC_LENGTH: Final = "arc_length"
"""Sequence timeline for walking along the planned path, in tenths of a millimetre: #123 is 12.3 mm."""
TICKS_PER_MM: Final = 10

NOTICE: Final = "Research use, not for clinical decisions."

CASE: Final = "/case"
WALL: Final = "/case/anatomy/wall"
CAPS: Final = "/case/anatomy/caps"
CENTERLINE: Final = "/case/centerline"
INSCRIBED: Final = "/case/centerline/inscribed"
CT: Final = "/case/ct"
VOLUME: Final = "/case/ct/volume"
MASK: Final = "/case/ct/mask"
GROWTH: Final = "/case/growth"
CURVE: Final = "/case/path/curve"
SPLINE: Final = "/case/path/spline"
FLAGGED: Final = "/case/path/flagged"
FEATURES: Final = "/case/features"
FACTS: Final = "/case/iteration"
PROFILE: Final = "/case/profile"
CONVERGENCE: Final = "/case/convergence"
COUNTS: Final = "/case/counts"
DECISIONS: Final = "/case/decisions"
SUMMARY: Final = "/case/summary"
WALK: Final = "/case/walk"
WALK_CAMERA: Final = "/case/walk/camera"
REFORMATION: Final = "/case/ct/reformation"
FILM: Final = "/case/film"

Color = tuple[int, int, int]

PLANES: Final = ("axial", "coronal", "sagittal")

OK: Final[Color] = (84, 178, 128)
FLAG_COLORS: Final[dict[FlagKind, Color]] = {FlagKind.CURVATURE: (226, 58, 52), FlagKind.CLEARANCE: (245, 150, 35)}
LEAK: Final[Color] = (226, 58, 52)
LIMIT: Final = (150, 156, 180, 70)
PATH: Final[Color] = (255, 226, 120)
CENTERLINE_COLOR: Final[Color] = (96, 165, 255)
WALL_COLOR: Final[Color] = (205, 172, 158)
CAP_COLOR: Final[Color] = (120, 140, 205)
LUMEN: Final[Color] = (80, 205, 220)
HERE: Final[Color] = (255, 255, 255)
FEATURE_COLORS: Final[dict[FeatureKind, Color]] = {
    FeatureKind.START: (130, 225, 130),
    FeatureKind.GOAL: (240, 120, 220),
    FeatureKind.EXTREMUM: (255, 205, 70),
    FeatureKind.SEGMENT: (150, 200, 255),
    FeatureKind.INFLECTION: (195, 160, 255),
    FeatureKind.NODE: (215, 215, 215),
    FeatureKind.CLEARANCE: (255, 150, 90),
}


def flagged_path(kind: FlagKind) -> str:
    """Entity of the stretches that break one limit."""
    return f"{FLAGGED}/{kind.value}"


def feature_path(kind: FeatureKind) -> str:
    """Entity of the features of one kind."""
    return f"{FEATURES}/{kind.value}"


def profile_path(kind: FlagKind, part: str) -> str:
    """Entity of one bar series of a plot over arc length; `part` is ``limit``, ``ok``, ``flagged`` or ``here``."""
    # The viewer draws in the order of the paths: the digit keeps the limit behind the bars and the cursor in front.
    order = {"limit": "0_limit", "ok": "1_ok", "flagged": "2_flagged", "here": "3_here"}[part]
    return f"{PROFILE}/{kind.value}/{order}"


def plane_path(plane: str, part: str) -> str:
    """Entity of one layer of a CT plane."""
    order = {"image": "0_image", "lumen": "1_lumen", "path": "2_path", "here": "3_here"}[part]
    return f"{CT}/{plane}/{order}"
