"""The truth of the generated urography: ureter, pelvis, infundibula and calyces as round cones.

The lumen is the union of balls whose centres run along smooth axes and whose radii
change linearly between them, less the balls of the papillae that dent the calyces
into cups. Positions are mm in LPS around a left kidney.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from segmentation.arrays import FloatArray, frozen_array
from segmentation.synthetic.shapes import round_cone_distance, smooth_curve

# Ureter to renal pelvis: x (left), y (posterior), z (superior), radius; mm. Lumen radii of a distended,
# contrast-filled ureter are 1.5 to 2.5 mm, narrowest at the ureteropelvic junction. Partial volume takes 0.3 to 0.5 mm
# from what a segmentation finds, and a ureteroscope of 1.2 mm radius is still to pass.
TRUNK = np.array(
    [
        [27.0, 3.0, -92.0, 2.2],
        [29.5, 3.5, -72.0, 2.1],
        [27.5, 5.0, -55.0, 2.4],
        [28.5, 8.0, -40.0, 2.2],
        [31.5, 11.5, -28.0, 2.1],
        [34.5, 14.0, -20.5, 1.9],
        [38.5, 17.0, -13.0, 3.8],
        [43.0, 19.5, -7.0, 6.4],
        [47.0, 21.5, -2.5, 6.8],
    ]
)
# Each leaves the trunk at its first waypoint along the trunk's tangent.
INFUNDIBULA = {
    "upper": np.array([[40.0, 17.9, -10.8, 4.6], [47.3, 22.8, 2.5, 4.2], [51.5, 25.5, 15.0, 2.6], [55.0, 27.3, 27.0, 2.7]]),
    "middle": np.array([[40.0, 17.9, -10.8, 4.6], [47.0, 21.4, -3.6, 5.0], [55.0, 23.8, 0.3, 2.8], [62.5, 24.8, 1.5, 2.9]]),
    "lower": np.array([[43.0, 19.5, -7.0, 6.0], [49.0, 21.8, -7.5, 4.2], [54.0, 22.8, -15.5, 2.3], [58.5, 23.4, -25.0, 2.4]]),
}
# Tip (middle of the cup) of each minor calyx; it leaves its infundibulum's end along the tangent there.
MINOR_CALYCES = {
    "upper": np.array([[53.5, 29.5, 39.5], [62.0, 31.5, 36.5], [61.0, 21.0, 34.0]]),
    "middle": np.array([[73.0, 30.0, 4.5], [73.0, 19.5, -1.0]]),
    "lower": np.array([[62.5, 30.0, -34.0], [67.5, 19.0, -31.0], [57.0, 22.0, -37.5]]),
}
NECK_RADIUS, CUP_RADIUS = 2.0, 3.7
PAPILLA_RADIUS, PAPILLA_AHEAD = 3.3, 3.4
# In front of the papilla, where the tip of an endoscope looks at it.
GOAL_BEFORE_TIP = 2.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Branch:
    """One tube of the tree, from proximal to distal: points (n, 3) mm and radii (n,) mm."""

    name: str
    points: FloatArray
    radii: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points, (None, 3), "points"))
        object.__setattr__(self, "radii", frozen_array(self.radii, (len(self.points),), "radii"))


@dataclass(frozen=True, eq=False, kw_only=True)
class CollectingSystem:
    """The known lumen.

    Attributes
    ----------
    branches : tuple of Branch
        Ureter and pelvis first, then infundibula, then minor calyces ("upper 1", ...).
    papillae : (k, 4) float array, mm
        Centre and radius of the balls that dent the calyces.
    papilla_axes : (k, 3) float array
        Unit direction from each calyx into its papilla.
    start : (3,) float array, mm
        On the axis of the lower ureter.
    goals : mapping-like tuple of (name, (3,) float array)
        One for each minor calyx, in the middle of its cup in front of the papilla.
    routes : tuple of (name, (n, 3) float array)
        Axis from the start to each goal.
    """

    branches: tuple[Branch, ...]
    papillae: FloatArray
    papilla_axes: FloatArray
    start: FloatArray
    goals: tuple[tuple[str, FloatArray], ...]
    routes: tuple[tuple[str, FloatArray], ...]

    def goal(self, name: str) -> FloatArray:
        """Goal point of a calyx, e.g. "middle 1", (3,) mm."""
        return dict(self.goals)[name]

    def clearance(self, points: ArrayLike) -> FloatArray:
        """Signed distance in mm to the lumen's wall, positive inside, at (n, 3) LPS points.

        Exact on the wall, outside the tubes, and inside wherever one tube's wall is the
        nearest; where tubes overlap a lower bound (the wall of a tube inside another
        is no wall).
        """
        sites = np.asarray(points, dtype=float).reshape(-1, 3)
        level = np.full(len(sites), np.inf)
        for branch in self.branches:
            for i in range(len(branch.points) - 1):
                a, b, ra, rb = branch.points[i], branch.points[i + 1], float(branch.radii[i]), float(branch.radii[i + 1])
                np.minimum(level, round_cone_distance(sites, a, b, ra, rb), out=level)
        for x, y, z, radius in self.papillae:
            np.maximum(level, radius - np.linalg.norm(sites - (x, y, z), axis=1), out=level)
        return -level


def collecting_system(lower_border: float) -> CollectingSystem:
    """Build the tree; the ureter goes on below the image.

    Parameters
    ----------
    lower_border : float, mm
        z of the image's lower face; the start lies 4 mm above it on the ureter's axis.
    """
    trunk = _branch("ureter and pelvis", TRUNK, None)
    branches, papillae, directions = [trunk], [], []
    goals, routes = [], []
    start_index = int(np.argmin(np.abs(trunk.points[:, 2] - (lower_border + 4.0))))
    calyces: list[Branch] = []
    for name, rows in INFUNDIBULA.items():
        # The split lies on the trunk itself, so that the axes meet.
        split = int(np.argmin(np.linalg.norm(trunk.points - rows[0, :3], axis=1)))
        here, tangent = trunk.points[split], trunk.points[split] - trunk.points[split - 1]
        infundibulum = _branch(name, np.concatenate([[[*here, min(rows[0, 3], trunk.radii[split])]], rows[1:]]), tangent)
        branches.append(infundibulum)
        for number, tip in enumerate(MINOR_CALYCES[name]):
            end, tangent = infundibulum.points[-1], infundibulum.points[-1] - infundibulum.points[-2]
            length = float(np.linalg.norm(tip - end))
            middle = end + 0.45 * (tip - end) + 0.12 * length * tangent / np.linalg.norm(tangent)
            neck = [[*end, infundibulum.radii[-1]], [*middle, NECK_RADIUS], [*tip, CUP_RADIUS]]
            calyx = _branch(f"{name} {number + 1}", np.array(neck), tangent)
            calyces.append(calyx)
            direction = calyx.points[-1] - calyx.points[-3]
            direction /= np.linalg.norm(direction)
            directions.append(direction)
            papillae.append([*(calyx.points[-1] + PAPILLA_AHEAD * direction), PAPILLA_RADIUS])
            before_tip = np.linalg.norm(calyx.points - calyx.points[-1], axis=1)
            stop = int(np.flatnonzero(before_tip >= GOAL_BEFORE_TIP)[-1])
            goals.append((calyx.name, frozen_array(calyx.points[stop], (3,), "goal")))
            axis = np.concatenate([trunk.points[start_index:split], infundibulum.points[:-1], calyx.points[: stop + 1]])
            routes.append((calyx.name, frozen_array(axis, (None, 3), "route")))
    return CollectingSystem(
        branches=(*branches, *calyces),
        papillae=frozen_array(np.array(papillae), (None, 4), "papillae"),
        papilla_axes=frozen_array(np.array(directions), (None, 3), "papilla_axes"),
        start=frozen_array(trunk.points[start_index], (3,), "start"),
        goals=tuple(goals),
        routes=tuple(routes),
    )


def _branch(name: str, rows: FloatArray, start_tangent: FloatArray | None) -> Branch:
    """A smooth axis through (k, 4) waypoints with radii that change without overshoot."""
    points = smooth_curve(rows[:, :3], start_tangent=start_tangent)
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1))])
    radii = PchipInterpolator(chord, rows[:, 3])(np.linspace(0.0, chord[-1], len(points)))
    return Branch(name=name, points=points, radii=radii)
