"""A generated airway of five generations below the trachea, with diameters after Weibel, as a closed mesh with its exact tree.

Positions are mm with the axes of LPS: the trachea runs down along -z, the patient's right is -x, front is -y.
"""

# Strategy: a branch leaves its parent's end along the parent's tangent, turns by a circular arc into its own direction and
# goes on straight. The lumen is the union of balls along all axes, so its signed distance is that of round cones;
# marching cubes of it give the wall. The trachea is cut flat, tips are round and closed, as a grown CT region ends.

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from skimage.measure import marching_cubes

from segmentation.arrays import FloatArray, IntArray, frozen_array
from segmentation.errors import CaseError
from segmentation.isosurface import outward
from segmentation.mesh import Cap, Surface
from segmentation.synthetic.shapes import round_cone_distance

# Diameters of generations 0 to 5, mm: Weibel, E. R. (1963). Morphometry of the Human Lung, model A.
WEIBEL_DIAMETERS = (18.0, 12.2, 8.3, 5.6, 4.5, 3.5)
# A branch turns into its direction along an arc of this many of its own diameters: curved, and in the segments sharper than
# a section of 13 mm that bends by 90 degrees (8.3 mm), which must use the lumen's width there.
ARC_DIAMETERS = 1.25
ARC_STEP = 0.5
# Lengths of generations 0 to 5, mm. Model A's 120, 47.6, 19.0, 7.6, 12.7 and 10.7 make all main bronchi alike
# and the segments shorter than their turns, so these are anatomical (right and left main: see the table below).
LENGTHS = (100.0, 0.0, 19.0, 17.0, 14.0, 10.0)


@dataclass(frozen=True, kw_only=True)
class Offshoot:
    """A named branch of generations 1 to 3: its parent, turn from the parent's direction, and the plane of the turn.

    Attributes
    ----------
    turn : float, degrees
    roll : float, degrees
        Of the turn's plane about the parent's direction; 0 goes on turning in the frontal plane the way the parent turned (the
        trachea's to the right), 180 the other way, 90 to the front, -90 to the back.
    length : float, mm, or None for the generation's own
    """

    name: str
    parent: str
    turn: float
    roll: float
    length: float | None = None


# Turns of the route to the right apical segment: 30, 60 and 90 degrees, all in the frontal plane and the same way, 180
# together (the published route). The others spread the tree in space.
OFFSHOOTS = (
    Offshoot(name="right main bronchus", parent="trachea", turn=30.0, roll=0.0, length=25.0),
    Offshoot(name="left main bronchus", parent="trachea", turn=45.0, roll=180.0, length=48.0),
    Offshoot(name="right upper lobe", parent="right main bronchus", turn=60.0, roll=0.0),
    Offshoot(name="bronchus intermedius", parent="right main bronchus", turn=20.0, roll=180.0, length=24.0),
    Offshoot(name="left upper lobe", parent="left main bronchus", turn=40.0, roll=0.0),
    Offshoot(name="left lower lobe", parent="left main bronchus", turn=40.0, roll=180.0),
    Offshoot(name="right apical segment", parent="right upper lobe", turn=90.0, roll=0.0),
    Offshoot(name="right anterior segment", parent="right upper lobe", turn=50.0, roll=90.0),
    Offshoot(name="right middle lobe", parent="bronchus intermedius", turn=55.0, roll=90.0),
    Offshoot(name="right lower lobe", parent="bronchus intermedius", turn=15.0, roll=-90.0),
    Offshoot(name="left upper division", parent="left upper lobe", turn=80.0, roll=0.0),
    Offshoot(name="lingula", parent="left upper lobe", turn=45.0, roll=90.0),
    Offshoot(name="left superior segment", parent="left lower lobe", turn=70.0, roll=-90.0),
    Offshoot(name="left basal trunk", parent="left lower lobe", turn=20.0, roll=90.0),
)
DIVISION = 36.0  # degrees on each side, of the generations without names
APICAL = "right apical segment"


@dataclass(frozen=True, eq=False, kw_only=True)
class AirwayBranch:
    """One tube of the generated tree.

    Attributes
    ----------
    name : str
    generation : int
        0 for the trachea.
    parent : int
        Number of the branch that it leaves; -1 for the trachea.
    points : (n, 3) float array, mm
        Its axis from the parent's end.
    radius : float, mm
    turn : float, rad
        By which its axis turns away from its parent's end.
    """

    name: str
    generation: int
    parent: int
    points: FloatArray
    radius: float
    turn: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points, (None, 3), "points"))

    @cached_property
    def direction(self) -> FloatArray:
        """Unit direction at its end, (3,)."""
        step = self.points[-1] - self.points[-2]
        return np.asarray(step / np.linalg.norm(step))


@dataclass(frozen=True, eq=False, kw_only=True)
class Airway:
    """The generated airway: its wall and the truth about it.

    Attributes
    ----------
    surface : Surface
        Closed; the only cap is the trachea's flat upper end.
    branches : tuple of AirwayBranch
        Parents before children; the first is the trachea.
    """

    surface: Surface
    branches: tuple[AirwayBranch, ...]

    @property
    def entrance(self) -> FloatArray:
        """Middle of the trachea's upper end, (3,) mm."""
        return np.asarray(self.branches[0].points[0])

    def number(self, name: str) -> int:
        """Number of a branch.

        Raises
        ------
        CaseError
            If there is none of that name.
        """
        for number, branch in enumerate(self.branches):
            if branch.name == name:
                return number
        raise CaseError(f"the generated airway has no branch {name!r}; it has {', '.join(b.name for b in self.branches)}")

    def route(self, name: str = APICAL) -> tuple[int, ...]:
        """Numbers of the branches from the trachea to a branch."""
        chain = [self.number(name)]
        while self.branches[chain[-1]].parent >= 0:
            chain.append(self.branches[chain[-1]].parent)
        return tuple(chain[::-1])

    def axis(self, name: str = APICAL) -> FloatArray:
        """The axis from the entrance to the end of a branch, (n, 3) mm."""
        parts = [self.branches[number].points for number in self.route(name)]
        return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])

    def clearance(self, points: FloatArray) -> FloatArray:
        """Signed distance in mm to the wall, positive inside, at (n, 3) points.

        Exact on the wall, outside, and inside one tube; where tubes overlap a lower bound. The cap is left out.
        """
        level = np.full(len(points), np.inf)
        for branch in self.branches:
            for a, b in _pieces(branch):
                np.minimum(level, round_cone_distance(points, a, b, branch.radius, branch.radius), out=level)
        return -level


def weibel_airway(*, generations: int = 5, voxel: float = 0.6) -> Airway:
    """The generated airway.

    Parameters
    ----------
    generations : int
        Below the trachea, 1 to 5; generation 5 is as wide as the robot of 3.5 mm, which therefore stays out.
    voxel : float, mm
        Of the grid for marching cubes, 0.2 to 1.

    Returns
    -------
    Airway

    Raises
    ------
    CaseError
        If a parameter is out of its range.
    """
    if not 1 <= generations <= 5:
        raise CaseError(f"the generated airway has {generations} generations below the trachea, expected 1 to 5")
    if not 0.2 <= voxel <= 1.0:
        raise CaseError(f"the generated airway's voxel is {voxel:g} mm, expected 0.2 to 1")
    branches = _tree(generations)
    return Airway(surface=_wall(branches, voxel), branches=tuple(branches))


def _tree(generations: int) -> list[AirwayBranch]:
    trachea = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -LENGTHS[0]]])
    branches = [AirwayBranch(name="trachea", generation=0, parent=-1, points=trachea, radius=0.5 * WEIBEL_DIAMETERS[0], turn=0.0)]
    sides = [np.array([-1.0, 0.0, 0.0])]  # direction of roll 0 of each branch's children
    for made in OFFSHOOTS:
        parent = next((number for number, branch in enumerate(branches) if branch.name == made.parent), None)
        if parent is not None and branches[parent].generation < generations:
            generation = branches[parent].generation + 1
            length = LENGTHS[generation] if made.length is None else made.length
            _add(branches, sides, made.name, parent, np.radians(made.turn), np.radians(made.roll), length)
    for generation in range(4, generations + 1):
        for parent in [number for number, branch in enumerate(branches) if branch.generation == generation - 1]:
            for letter, roll in (("a", 90.0), ("b", -90.0)):
                name = f"{branches[parent].name} {letter}" if generation == 4 else f"{branches[parent].name}{letter}"
                _add(branches, sides, name, parent, np.radians(DIVISION), np.radians(roll), LENGTHS[generation])
    return branches


def _add(
    branches: list[AirwayBranch],
    sides: list[FloatArray],
    name: str,
    parent: int,
    turn: float,
    roll: float,
    length: float,
) -> None:
    """Append one branch: an arc out of the parent's direction, then a line."""
    stem = branches[parent]
    ahead, side = stem.direction, sides[parent]
    front = np.cross(ahead, side)
    front *= -1.0 if front[1] > 0.0 else 1.0
    towards = np.cos(roll) * side + np.sin(roll) * front
    diameter = WEIBEL_DIAMETERS[stem.generation + 1]
    bend = ARC_DIAMETERS * diameter
    angle = np.linspace(0.0, turn, max(int(np.ceil(turn * bend / ARC_STEP)), 2) + 1)[:, None]
    arc = stem.points[-1] + bend * (np.sin(angle) * ahead + (1.0 - np.cos(angle)) * towards)
    new = np.cos(turn) * ahead + np.sin(turn) * towards
    end = arc[-1] + max(length - turn * bend, 0.5 * diameter) * new
    branches.append(
        AirwayBranch(
            name=name,
            generation=stem.generation + 1,
            parent=parent,
            points=np.vstack([arc, end]),
            radius=0.5 * diameter,
            turn=float(turn),
        )
    )
    sides.append(np.cos(turn) * towards - np.sin(turn) * ahead)


def _pieces(branch: AirwayBranch) -> list[tuple[FloatArray, FloatArray]]:
    return list(zip(branch.points[:-1], branch.points[1:], strict=True))


def _wall(branches: list[AirwayBranch], voxel: float) -> Surface:
    """Marching cubes of the union of round cones, the trachea cut by a plane."""
    margin = 2.5 * voxel
    cloud = np.concatenate([branch.points for branch in branches])
    # No round share of a voxel, so that no grid point lies on the surface, where facets would degenerate.
    lower = cloud.min(axis=0) - 0.5 * WEIBEL_DIAMETERS[0] - margin - voxel * np.array([0.131, 0.237, 0.353])
    count = np.ceil((cloud.max(axis=0) + 0.5 * WEIBEL_DIAMETERS[0] + margin - lower) / voxel).astype(int) + 1
    level = np.full(tuple(count), margin, dtype=np.float32)
    for branch in branches:
        for a, b in _pieces(branch):
            low = np.maximum(np.floor((np.minimum(a, b) - branch.radius - margin - lower) / voxel).astype(int), 0)
            high = np.minimum(np.ceil((np.maximum(a, b) + branch.radius + margin - lower) / voxel).astype(int) + 1, count)
            box = tuple(slice(int(i), int(j)) for i, j in zip(low, high, strict=True))
            axes = [lower[k] + voxel * np.arange(low[k], high[k]) for k in range(3)]
            grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
            part = level[box]
            np.minimum(part, round_cone_distance(grid, a, b, branch.radius, branch.radius).astype(np.float32), out=part)
    height = (lower[2] + voxel * np.arange(count[2])).astype(np.float32)
    np.maximum(level, height, out=level)  # the plane z = 0 through the trachea's upper end
    vertices, faces, _, _ = marching_cubes(level, 0.0)
    points = lower + voxel * vertices.astype(np.float64)
    return _with_cap(points, outward(points, faces.astype(np.int64)), voxel)


def _with_cap(points: FloatArray, faces: IntArray, voxel: float) -> Surface:
    """The mesh with the flat upper end of the trachea as its cap; its rim's chamfer of one voxel is made part of it."""
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    # Facets that look up, not to the side, within a voxel of the plane.
    cap = (corners[:, :, 2].min(axis=1) > -1.05 * voxel) & (normals[:, 2] > 0.6 * size)
    flat = points.copy()
    flat[np.unique(faces[cap]), 2] = 0.0  # the chamfer is pressed flat: the cap lies in its plane and meets the wall in a rim
    corners = flat[faces[cap]]
    area = 0.5 * float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum())
    found = Cap("C1", "flat end", np.zeros(3), np.array([0.0, 0.0, 1.0]), area)
    return Surface(flat, faces, np.where(cap, 0, -1), (found,), "mesh")
