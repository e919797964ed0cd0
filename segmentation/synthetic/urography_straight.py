"""Collecting systems made of straight pieces, whose clinical measures follow from the construction.

Strategy: the pelvis is a round cone (a ball where both its ends are one) whose axis goes on straight as the upper
ureter, every infundibulum is a cylinder that starts on that axis, and every calyx is a round cone or a cylinder with a
round end. So the infundibulopelvic angle is the angle between two lines of the construction, the width twice a
cylinder's radius, and the length a distance between a line's way out of the pelvis and the far side of a ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.synthetic.abdomen import paint_abdomen
from segmentation.synthetic.collecting_system import Branch, CollectingSystem
from segmentation.synthetic.shapes import round_cone_distance, smooth_curve
from segmentation.synthetic.urography import SEED, UrographySettings, empty_canvas, lower_border, scanned
from segmentation.volume import Volume


@dataclass(frozen=True, kw_only=True)
class StraightCalyx:
    """One calyx: a neck from the infundibulum's end that widens to a ball, with or without a papilla in it.

    Attributes
    ----------
    turn_deg, azimuth_deg : float
        Of its axis against the infundibulum's, and around it.
    length : float, mm
        From the infundibulum's end to the ball's centre.
    neck, ball : float, mm
        Radii where it begins and where it ends.
    papilla : float or None, mm
        Radius of the ball that dents it so far that its bottom is at the ball's centre; None for a blunted calyx.
    """

    turn_deg: float
    azimuth_deg: float
    length: float
    neck: float
    ball: float
    papilla: float | None = None


@dataclass(frozen=True, kw_only=True)
class StraightInfundibulum:
    """One infundibulum: a cylinder from the pelvis's axis at a known angle to the ureter.

    Attributes
    ----------
    name : str
    angle_deg, azimuth_deg : float
        Between its axis and the direction down the ureter (the infundibulopelvic angle), and around that direction.
    foot : float
        Where it leaves the axis of the pelvis: 0 at the lower ball's centre, 1 at the upper's.
    length, radius : float, mm
        From the axis of the pelvis to its end, and of the lumen.
    calyces : tuple of StraightCalyx
    """

    name: str
    angle_deg: float
    azimuth_deg: float
    foot: float
    length: float
    radius: float
    calyces: tuple[StraightCalyx, ...]


@dataclass(frozen=True, kw_only=True)
class StraightPlan:
    """What a straight collecting system is built from.

    Attributes
    ----------
    pelvis : (3,) float tuple, mm, LPS
        Centre of its lower ball.
    down : (3,) float tuple
        Direction from the pelvis along the upper ureter.
    pelvis_radii : (lower, upper), mm
    pelvis_length : float, mm
        Between the centres of its two balls; 0 for one ball.
    ureter_radius : float, mm
    ureter_straight : float, mm
        Length of the ureter's straight part; below it runs to `ureter_end`.
    ureter_end : (3,) float tuple, mm
    infundibula : tuple of StraightInfundibulum
    """

    pelvis: tuple[float, float, float]
    down: tuple[float, float, float]
    pelvis_radii: tuple[float, float]
    pelvis_length: float
    ureter_radius: float
    ureter_straight: float
    ureter_end: tuple[float, float, float]
    infundibula: tuple[StraightInfundibulum, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class CalyxTruth:
    """One calyx: the end of its axis, and its distance from the infundibulum's lip, mm."""

    name: str
    bottom: FloatArray
    length: float


@dataclass(frozen=True, eq=False, kw_only=True)
class InfundibulumTruth:
    """Angle in space and from the front in degrees, width in mm, and the lip (where its axis leaves the pelvis)."""

    name: str
    angle_deg: float
    coronal_deg: float
    width: float
    lip: FloatArray
    calyces: tuple[CalyxTruth, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class StraightSystem:
    """A straight collecting system with its measures."""

    lumen: CollectingSystem
    infundibula: tuple[InfundibulumTruth, ...]
    ureter_diameter: float
    pelvis_diameter: float


# A ball for a pelvis, three round calyces in one kidney: what the definitions say can be checked with a pencil.
PLAIN = StraightPlan(
    pelvis=(44.0, 20.0, -3.0),
    down=(-0.30, -0.20, -0.93),
    pelvis_radii=(7.5, 7.5),
    pelvis_length=0.0,
    ureter_radius=2.0,
    ureter_straight=70.0,
    ureter_end=(22.0, 2.0, -92.0),
    infundibula=(
        StraightInfundibulum(
            name="upper",
            angle_deg=150.0,
            azimuth_deg=10.0,
            foot=0.0,
            length=24.0,
            radius=2.5,
            calyces=(StraightCalyx(turn_deg=0.0, azimuth_deg=0.0, length=8.0, neck=2.5, ball=5.0),),
        ),
        StraightInfundibulum(
            name="middle",
            angle_deg=95.0,
            azimuth_deg=-10.0,
            foot=0.0,
            length=18.0,
            radius=2.0,
            calyces=(StraightCalyx(turn_deg=0.0, azimuth_deg=0.0, length=6.0, neck=2.0, ball=4.0),),
        ),
        StraightInfundibulum(
            name="lower",
            angle_deg=50.0,
            azimuth_deg=5.0,
            foot=0.0,
            length=26.0,
            radius=1.7,
            calyces=(StraightCalyx(turn_deg=0.0, azimuth_deg=0.0, length=7.0, neck=1.7, ball=4.5),),
        ),
    ),
)

# Another anatomy than the curved one's: a long pelvis, four infundibula, necks and cups of many sizes, blunted calyces too.
SECOND = StraightPlan(
    pelvis=(42.0, 19.0, -8.0),
    down=(-0.36, -0.20, -0.91),
    pelvis_radii=(6.0, 6.0),
    pelvis_length=11.0,
    ureter_radius=1.8,
    ureter_straight=50.0,
    ureter_end=(20.0, 3.0, -92.0),
    infundibula=(
        StraightInfundibulum(
            name="upper",
            angle_deg=158.0,
            azimuth_deg=-10.0,
            foot=1.0,
            length=23.0,
            radius=1.6,
            calyces=(
                StraightCalyx(turn_deg=38.0, azimuth_deg=80.0, length=12.0, neck=1.6, ball=3.6, papilla=3.0),
                StraightCalyx(turn_deg=40.0, azimuth_deg=-100.0, length=12.0, neck=1.6, ball=3.2),
            ),
        ),
        StraightInfundibulum(
            name="second",
            angle_deg=112.0,
            azimuth_deg=-35.0,
            foot=1.0,
            length=17.0,
            radius=2.1,
            calyces=(StraightCalyx(turn_deg=0.0, azimuth_deg=0.0, length=8.0, neck=2.1, ball=3.9, papilla=3.4),),
        ),
        StraightInfundibulum(
            name="third",
            angle_deg=84.0,
            azimuth_deg=15.0,
            foot=0.4,
            length=20.0,
            radius=2.6,
            calyces=(StraightCalyx(turn_deg=0.0, azimuth_deg=0.0, length=7.0, neck=2.6, ball=4.4),),
        ),
        StraightInfundibulum(
            name="lower",
            angle_deg=46.0,
            azimuth_deg=-20.0,
            foot=0.0,
            length=20.0,
            radius=2.0,
            calyces=(
                StraightCalyx(turn_deg=42.0, azimuth_deg=10.0, length=13.0, neck=1.8, ball=3.8, papilla=3.3),
                StraightCalyx(turn_deg=46.0, azimuth_deg=-120.0, length=12.0, neck=1.7, ball=3.3),
                StraightCalyx(turn_deg=44.0, azimuth_deg=130.0, length=14.0, neck=1.9, ball=4.0, papilla=3.6),
            ),
        ),
    ),
)


def straight_system(plan: StraightPlan, *, lower_border: float) -> StraightSystem:
    """Build the lumen and its measures.

    Parameters
    ----------
    plan : StraightPlan
    lower_border : float, mm
        z of the image's lower face; the start lies 4 mm above it on the ureter's axis.
    """
    down = unit(plan.down)
    low = np.array(plan.pelvis)
    high = low - plan.pelvis_length * down
    trunk = trunk_of(plan, low, high, down)
    start_index = int(np.argmin(np.abs(trunk.points[:, 2] - (lower_border + 4.0))))
    branches, calyces, papillae, directions, goals, routes, truths = [trunk], [], [], [], [], [], []
    for piece in plan.infundibula:
        axis = tilted(down, piece.angle_deg, piece.azimuth_deg)
        foot = low + piece.foot * (high - low)
        end = foot + piece.length * axis
        branches.append(
            Branch(name=piece.name, points=stations(foot, end), radii=np.full(len(stations(foot, end)), piece.radius))
        )
        lip = foot + leaves_cone(foot, axis, low, high, plan.pelvis_radii) * axis
        ends = []
        for number, calyx in enumerate(piece.calyces, start=1):
            heading = tilted(axis, calyx.turn_deg, calyx.azimuth_deg)
            center = end + calyx.length * heading
            points = stations(end, center)
            name = f"{piece.name} {number}"
            calyces.append(Branch(name=name, points=points, radii=np.linspace(calyx.neck, calyx.ball, len(points))))
            ends.append(calyx_truth(name, calyx, end, heading, lip))
            directions.append(heading)
            if calyx.papilla is not None:
                papillae.append([*(center + calyx.papilla * heading), calyx.papilla])
            goals.append((name, frozen_array(center - 1.5 * heading, (3,), "goal")))
            way = np.concatenate([trunk.points[start_index:], stations(foot, end), points])
            routes.append((name, frozen_array(way, (None, 3), "route")))
        flat = np.array([1.0, 0.0, 1.0])
        truths.append(
            InfundibulumTruth(
                name=piece.name,
                angle_deg=piece.angle_deg,
                coronal_deg=degrees_between(down * flat, axis * flat),
                width=2.0 * piece.radius,
                lip=lip,
                calyces=tuple(ends),
            )
        )
    dented = [direction for direction, calyx in zip(directions, every_calyx(plan), strict=True) if calyx.papilla is not None]
    lumen = CollectingSystem(
        branches=(*branches, *calyces),
        papillae=frozen_array(np.array(papillae).reshape(-1, 4), (None, 4), "papillae"),
        papilla_axes=frozen_array(np.array(dented).reshape(-1, 3), (None, 3), "papilla_axes"),
        start=frozen_array(trunk.points[start_index], (3,), "start"),
        goals=tuple(goals),
        routes=tuple(routes),
    )
    return StraightSystem(
        lumen=lumen,
        infundibula=tuple(truths),
        ureter_diameter=2.0 * plan.ureter_radius,
        pelvis_diameter=2.0 * max(plan.pelvis_radii),
    )


def every_calyx(plan: StraightPlan) -> list[StraightCalyx]:
    """All calyces in the order of the infundibula."""
    return [calyx for piece in plan.infundibula for calyx in piece.calyces]


def trunk_of(plan: StraightPlan, low: FloatArray, high: FloatArray, down: FloatArray) -> Branch:
    """Ureter from below and pelvis; straight from the pelvis down to the end of the straight part."""
    bend = low + plan.ureter_straight * down
    below = smooth_curve(np.array([bend, 0.5 * (bend + plan.ureter_end) + 3.0 * down, plan.ureter_end]), start_tangent=down)[::-1]
    straight = stations(bend, low)
    pelvis = stations(low, high) if plan.pelvis_length > 0.0 else low[None]
    # The lower ball stands where the cylinder ends: two points there, one of each radius.
    points = np.concatenate([below[:-1], straight, pelvis + 1e-9 * down])
    radii = np.concatenate(
        [np.full(len(below) - 1 + len(straight), plan.ureter_radius), np.linspace(*plan.pelvis_radii, len(pelvis))]
    )
    return Branch(name="ureter and pelvis", points=points, radii=radii)


def calyx_truth(name: str, calyx: StraightCalyx, begin: FloatArray, heading: FloatArray, lip: FloatArray) -> CalyxTruth:
    """Where a calyx's axis ends: at the far side of its ball, or at the papilla's tip, which stands at the ball's centre."""
    bottom = begin + (calyx.length + (calyx.ball if calyx.papilla is None else 0.0)) * heading
    return CalyxTruth(name=name, bottom=frozen_array(bottom, (3,), "bottom"), length=float(np.linalg.norm(bottom - lip)))


def leaves_cone(foot: FloatArray, axis: FloatArray, low: FloatArray, high: FloatArray, radii: tuple[float, float]) -> float:
    """Distance from a point on a pelvis's axis to where a line leaves the pelvis, mm: by bisection of its level."""
    near, far = 0.0, 60.0
    for _ in range(60):
        middle = 0.5 * (near + far)
        level = float(round_cone_distance((foot + middle * axis)[None], low, high, *radii)[0])
        near, far = (middle, far) if level < 0.0 else (near, middle)
    return near


def stations(begin: FloatArray, end: FloatArray, step: float = 1.0) -> FloatArray:
    """Places about every `step` mm from one point to another, both included, (n, 3) mm."""
    count = max(int(np.ceil(np.linalg.norm(end - begin) / step)), 1) + 1
    return np.asarray(begin + np.linspace(0.0, 1.0, count)[:, None] * (end - begin))


def tilted(axis: FloatArray, angle_deg: float, azimuth_deg: float) -> FloatArray:
    """Unit direction at an angle to an axis; azimuth 0 is towards the patient's left, 90 is around the axis, (3,)."""
    left = np.array([1.0, 0.0, 0.0])
    first = unit(left - (left @ axis) * axis)
    second = np.cross(axis, first)
    angle, azimuth = np.radians([angle_deg, azimuth_deg])
    return np.asarray(np.cos(angle) * axis + np.sin(angle) * (np.cos(azimuth) * first + np.sin(azimuth) * second))


def unit(vector: Sequence[float] | FloatArray) -> FloatArray:
    """A direction of length one, (3,)."""
    given = np.asarray(vector, dtype=float)
    return np.asarray(given / np.linalg.norm(given))


def degrees_between(one: FloatArray, other: FloatArray) -> float:
    """Angle between two vectors, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def straight_urography(
    plan: StraightPlan, *, seed: int = SEED, right: bool = False, settings: UrographySettings | None = None
) -> tuple[Volume, StraightSystem]:
    """A CT urography of a straight collecting system in the generated abdomen, and its measures.

    Parameters
    ----------
    plan : StraightPlan
        Of a left kidney.
    seed : int
        Of textures and noise.
    right : bool
        The mirror image of the scan: a right kidney.
    settings : UrographySettings, optional
    """
    settings = settings or UrographySettings()
    system = straight_system(plan, lower_border=lower_border(settings))
    canvas = empty_canvas(settings)
    anatomy, quality = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    paint_abdomen(canvas, system.lumen, rng=anatomy)
    volume = scanned(canvas, settings, rng=quality)
    return (mirrored(volume), mirrored_system(system)) if right else (volume, system)


MIRROR = np.array([-1.0, 1.0, 1.0])


def mirrored(volume: Volume) -> Volume:
    """The scan of the mirror image of a patient: left and right change places."""
    index_to_lps = np.array(volume.index_to_lps)
    last = volume.to_lps([0, 0, volume.voxels.shape[2] - 1])
    index_to_lps[:3, 3] = last * MIRROR
    return Volume(np.ascontiguousarray(volume.voxels[:, :, ::-1]), index_to_lps)


def mirrored_system(system: StraightSystem) -> StraightSystem:
    """The measures of the mirror image; angles, lengths and widths stay."""
    lumen = system.lumen
    return StraightSystem(
        lumen=CollectingSystem(
            branches=tuple(Branch(name=one.name, points=one.points * MIRROR, radii=one.radii) for one in lumen.branches),
            papillae=lumen.papillae * np.append(MIRROR, 1.0),
            papilla_axes=lumen.papilla_axes * MIRROR,
            start=lumen.start * MIRROR,
            goals=tuple((name, point * MIRROR) for name, point in lumen.goals),
            routes=tuple((name, points * MIRROR) for name, points in lumen.routes),
        ),
        infundibula=tuple(
            replace(
                one,
                lip=one.lip * MIRROR,
                calyces=tuple(replace(calyx, bottom=calyx.bottom * MIRROR) for calyx in one.calyces),
            )
            for one in system.infundibula
        ),
        ureter_diameter=system.ureter_diameter,
        pelvis_diameter=system.pelvis_diameter,
    )
