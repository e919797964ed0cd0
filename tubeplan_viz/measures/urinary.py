"""Measures of a collecting system: infundibulopelvic angle, infundibular length and width, diameters."""

# Strategy: the parts are those of `collecting_system`. Every measure is a length, a direction or a cross-section along the
# ways through them.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.measures.collecting_system import Infundibulum, collecting_system, urinary_parts
from tubeplan_viz.measures.ends import calyx_bottoms
from tubeplan_viz.measures.lines import Lumen, angle_between, fitted_direction, place
from tubeplan_viz.measures.measure import Drawing, Measure, lacking
from tubeplan_viz.measures.outward import OutwardWall
from tubeplan_viz.measures.parts import Part

AXIS_LEAST_MM = 8.0  # a shorter stretch of middle line gives no sure direction
NARROW_RUN = 5  # sections, 2 mm: the narrowest place is that of their running median, not the noise of one section
URETER_SKIP_MM = 2.0  # beside the ureter's cut end a cross-section may meet the cap
CORONAL = np.array([1.0, 0.0, 1.0])  # seen from the front: left and up remain


@dataclass(frozen=True, kw_only=True)
class UrinarySettings:
    """What the lumen does not show.

    Attributes
    ----------
    ureter_level : float, mm
        Distance from the centre of the pelvis to the place of the ureter that stands for the level
        of the kidney's lower pole. An adult kidney is about 110 mm long [1]_; the default is our
        choice within the half of that, so that a zoomed scan still shows the place.

    References
    ----------
    .. [1] Emamian, S. A. et al. (1993). Kidney dimensions at sonography. AJR 160(1), 83-86.
    """

    ureter_level: float = 40.0

    def __post_init__(self) -> None:
        if not 10.0 <= self.ureter_level <= 150.0:
            raise CaseError(f"ureter_level_mm is {self.ureter_level:g}, expected 10 to 150")


@dataclass(frozen=True, eq=False, kw_only=True)
class UrinaryMeasures:
    """All measures of a collecting system, and what scores and drawings take from it."""

    measures: tuple[Measure, ...]
    infundibula: tuple[Infundibulum, ...]
    drawing: Drawing
    parts: tuple[Part, ...]


def urinary_measures(lumen: Lumen, settings: UrinarySettings) -> UrinaryMeasures:
    """Measure a collecting system whose tree begins at the ureter's end."""
    wall = OutwardWall(lumen.wall.surface)
    system = collecting_system(lumen, wall)
    ways, infundibula, trunk, center = system.ways, system.infundibula, system.trunk, system.pelvis.center
    measures = [Measure(key="pelvis_diameter_mm", value=2.0 * system.radius)]
    measures += ureter_measures(lumen, trunk, system.junction)
    level = ureter_place(trunk, center, settings.ureter_level)
    drawn_lines = {f"way to {lumen.labels[target]}": line.points for target, line in ways.items()}
    drawn_points = {"pelvis": center}
    if level is not None:
        drawn_points["ureter level"] = level
    lips = {target: place(ways[target], one.lip) for one in infundibula for target in one.targets}
    bottoms = calyx_bottoms(lumen, ways, lips, wall, system.blur)
    for infundibulum in infundibula:
        of = f"{infundibulum.name} infundibulum"
        way = ways[longest_way(infundibulum, ways)]
        axis, points = infundibular_axis(way, infundibulum)
        middle = points.mean(axis=0)
        reach = 0.5 * float(np.linalg.norm(points[-1] - points[0]))
        drawn_lines[f"axis of {of}"] = np.array([middle - reach * axis, middle + reach * axis])
        drawn_points[f"lip of {of}"] = place(way, infundibulum.lip)
        measures += angle_measures(lumen.frame, center, level, axis, settings, of)
        measures += width_measures(lumen, way, infundibulum, of)
        for target in infundibulum.targets:
            measures += calyx_measures(lumen, target, ways[target], infundibulum, bottoms)
            if target in bottoms:
                drawn_points[f"bottom of {lumen.labels[target]}"] = bottoms[target]
    return UrinaryMeasures(
        measures=tuple(measures),
        infundibula=infundibula,
        drawing=Drawing(lines=drawn_lines, points=drawn_points),
        parts=urinary_parts(lumen, system),
    )


def longest_way(infundibulum: Infundibulum, ways: dict[int, Centerline]) -> int:
    """Target of the infundibulum that is farthest along its way."""
    return max(infundibulum.targets, key=lambda target: float(ways[target].arc_length[-1]))


def infundibular_axis(way: Centerline, infundibulum: Infundibulum) -> tuple[FloatArray, FloatArray]:
    """Unit direction from the pelvis to the calyx, and the middle points that it was fitted to, (k, 3) mm."""
    last = min(max(infundibulum.end, infundibulum.lip + AXIS_LEAST_MM), float(way.arc_length[-1]))
    places = np.linspace(infundibulum.lip, last, 41)
    points = np.array([place(way, s) for s in places])
    return fitted_direction(points), points


def ureter_place(trunk: Centerline | None, center: FloatArray, level: float) -> FloatArray | None:
    """The ureter's centre at a distance from the centre of the pelvis, the nearest on the way down; None above its end."""
    if trunk is None:
        return None
    away = np.linalg.norm(trunk.points - center, axis=1)
    outside = np.flatnonzero(away >= level)
    if not len(outside):
        return None
    k = int(outside[-1])
    share = (level - away[k + 1]) / (away[k] - away[k + 1])
    return np.asarray(trunk.points[k + 1] + share * (trunk.points[k] - trunk.points[k + 1]))


def angle_measures(
    frame: str, center: FloatArray, level: FloatArray | None, axis: FloatArray, settings: UrinarySettings, of: str
) -> list[Measure]:
    """The infundibulopelvic angle in space and seen from the front."""
    keys = ("infundibulopelvic_angle_deg", "infundibulopelvic_angle_coronal_deg")
    if level is None:
        reason = f"the ureter in the image ends less than {settings.ureter_level:g} mm from the centre of the pelvis"
        return lacking(reason, *keys, of=of)
    down = level - center
    made = [Measure(key=keys[0], of=of, value=angle_between(down, axis))]
    if frame != "LPS":
        return made + lacking("the axes of a mesh file do not say where the front is", keys[1], of=of)
    return [*made, Measure(key=keys[1], of=of, value=angle_between(down * CORONAL, axis * CORONAL))]


def width_measures(lumen: Lumen, way: Centerline, infundibulum: Infundibulum, of: str) -> list[Measure]:
    """The infundibulum's narrowest cross-section."""
    diameters = lumen.diameters(way, infundibulum.lip, infundibulum.end)
    if not len(diameters):
        return lacking(
            "no cross-section of the infundibulum has a closed outline in the mesh and a wall in the CT",
            "infundibular_width_mm",
            of=of,
        )
    return [Measure(key="infundibular_width_mm", of=of, value=narrowest(diameters))]


def narrowest(diameters: FloatArray) -> float:
    """Least running median of diameters along a lumen, mm."""
    run = min(NARROW_RUN, len(diameters))
    return float(np.median(np.lib.stride_tricks.sliding_window_view(diameters, run), axis=1).min())


def calyx_measures(
    lumen: Lumen, target: int, way: Centerline, infundibulum: Infundibulum, farthest: dict[int, FloatArray]
) -> list[Measure]:
    """Infundibular length to one calyx, whose farthest point is known, and its diameter."""
    of = f"calyx {lumen.labels[target]}, {infundibulum.name}"
    whole = float(way.arc_length[-1])
    if target in farthest:
        length = float(np.linalg.norm(farthest[target] - place(way, infundibulum.lip)))
        made = [Measure(key="infundibular_length_mm", of=of, value=length)]
    else:
        made = lacking("the calyx has no part of its own beyond the last branching", "infundibular_length_mm", of=of)
    last = lumen.tree.branches[int(lumen.tree.last_branch[target])]
    # The calyx is the far half of what lies beyond the last branching, or beyond the lip where there is none.
    begin = whole - 0.5 * (last.length if len(infundibulum.targets) > 1 else whole - infundibulum.lip)
    widths = lumen.widths(way, begin, whole)
    if not len(widths):
        return made + lacking(
            "no cross-section of the calyx has a closed outline in the mesh and a wall in the CT", "calyx_diameter_mm", of=of
        )
    return [*made, Measure(key="calyx_diameter_mm", of=of, value=float(widths.max()))]


def ureter_measures(lumen: Lumen, trunk: Centerline | None, junction: float | None) -> list[Measure]:
    """Mean and least diameter from the ureter's end to the ureteropelvic junction."""
    keys = ("ureter_diameter_mean_mm", "ureter_diameter_min_mm")
    if trunk is None or junction is None:
        return lacking("the image shows no ureter below the pelvis", *keys)
    diameters = lumen.diameters(trunk, URETER_SKIP_MM, junction)
    if not len(diameters):
        return lacking("no cross-section of the ureter has a closed outline in the mesh and a wall in the CT", *keys)
    return [Measure(key=keys[0], value=float(diameters.mean())), Measure(key=keys[1], value=narrowest(diameters))]
