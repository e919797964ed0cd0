"""Model trees of tubes with known axes: a renal collecting system and an airway, meshed by marching cubes."""

# Strategy: every branch is a circular arc, a pair of arcs or a line with one radius, so its axis is exact. Two
# children leave in a plane that turns by a right angle from one generation to the next, which
# keeps the branches of a binary tree apart.

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.mesh import Surface
from tubeplan_viz.bench.axes import Axis
from tubeplan_viz.bench.meshing import constant_radius, marching_surface

AXIS_STEP = 0.1


@dataclass(frozen=True, eq=False)
class TreeBranch:
    """One tube of a tree.

    Attributes
    ----------
    axis : Axis
        From the junction at its proximal end.
    radius : float, mm
    parent : int
        Number of the branch that it leaves; -1 for the root.
    generation : int
        0 for the root.
    """

    axis: Axis
    radius: float
    parent: int
    generation: int

    @cached_property
    def points(self) -> FloatArray:
        """Dense points on the axis, (n, 3) mm."""
        count = int(np.ceil(self.axis.length / AXIS_STEP)) + 1
        return frozen_array(self.axis.at(np.linspace(0.0, self.axis.length, count))[0], (None, 3), "axis points")


@dataclass(frozen=True, eq=False)
class TreeModel:
    """A tree's mesh with the truth about it.

    Attributes
    ----------
    name : str
    surface : Surface
        With a flat cap at the root and at every tip.
    branches : tuple of TreeBranch
        Parents before children; the first is the root.
    """

    name: str
    surface: Surface
    branches: tuple[TreeBranch, ...]

    @property
    def root(self) -> FloatArray:
        """Middle of the root's cap, (3,) mm."""
        return np.asarray(self.branches[0].points[0])

    @cached_property
    def leaves(self) -> tuple[int, ...]:
        """Numbers of the branches that end in a tip."""
        parents = {branch.parent for branch in self.branches}
        return tuple(number for number in range(len(self.branches)) if number not in parents)

    @property
    def targets(self) -> FloatArray:
        """Middles of the tips' caps, (k, 3) mm."""
        return np.array([self.branches[number].points[-1] for number in self.leaves])

    def off_axis(self, points: FloatArray, *, end_length: float, junction_radii: float) -> FloatArray:
        """Distance to the nearest axis, mm, of those points whose foot is away from ends and junctions, (k,).

        Parameters
        ----------
        points : (n, 3) float array, mm
        end_length : float, mm
            Left out at the root's and the tips' caps.
        junction_radii : float
            Left out on both sides of a junction, in radii of the branch that enters it.
        """
        gap, counts = np.full(len(points), np.inf), np.zeros(len(points), dtype=bool)
        for number, branch in enumerate(self.branches):
            entering = branch.radius if branch.parent < 0 else self.branches[branch.parent].radius
            low = end_length if branch.parent < 0 else junction_radii * entering
            high = branch.axis.length - (end_length if number in self.leaves else junction_radii * branch.radius)
            found, arc = branch.axis.nearest(points, branch.radius)
            nearer = found < gap
            gap[nearer] = found[nearer]
            counts[nearer] = ((arc > low) & (arc < high))[nearer]
        return gap[counts]


def renal_tree(*, voxel: float = 0.471) -> TreeModel:
    """A ureter with a double bend, a pelvis and three calyces; 52,000 faces as it is."""
    ureter = Axis(((70.0, 1.0 / 60.0, 0.0), (70.0, -1.0 / 60.0, 0.0)), np.zeros(3), _frame([0.0, 0.2, 1.0], [1.0, 0.0, 0.0]))
    pelvis_start, frame = _end(ureter)
    pelvis = Axis(((22.0, 1.0 / 40.0, 0.0),), pelvis_start, frame)
    branches = [TreeBranch(ureter, 2.4, -1, 0), TreeBranch(pelvis, 4.5, 0, 1)]
    point, frame = _end(pelvis)
    for angle, roll in ((0.9, 0.0), (0.0, 0.0), (0.9, np.pi)):
        turned = _turned(frame, angle, roll)
        branches.append(TreeBranch(Axis(((24.0, 1.0 / 50.0, 0.0),), point, turned), 2.6, 1, 2))
    return _meshed("renal tree", branches, voxel)


def calyceal_tree(*, minor: tuple[int, ...] = (3, 4, 3), voxel: float = 0.471) -> TreeModel:
    """A ureter, a pelvis, three infundibula and on each of them some minor calyces, ten in all."""
    model = "ten calyces"
    ureter = Axis(((60.0, 1.0 / 60.0, 0.0), (60.0, -1.0 / 60.0, 0.0)), np.zeros(3), _frame([0.0, 0.2, 1.0], [1.0, 0.0, 0.0]))
    point, frame = _end(ureter)
    pelvis = Axis(((22.0, 1.0 / 40.0, 0.0),), point, frame)
    branches = [TreeBranch(ureter, 2.4, -1, 0), TreeBranch(pelvis, 4.5, 0, 1)]
    point, frame = _end(pelvis)
    for count, (angle, roll) in zip(minor, ((0.9, 0.0), (0.0, 0.0), (0.9, np.pi)), strict=True):
        infundibulum = Axis(((22.0, 1.0 / 50.0, 0.0),), point, _turned(frame, angle, roll))
        branches.append(TreeBranch(infundibulum, 2.9, 1, 2))
        parent = len(branches) - 1
        tip, tip_frame = _end(infundibulum)
        for k in range(count):
            # Each neck a little narrower and each turn a little sharper than the one before: cells differ.
            turned = _turned(tip_frame, 0.6 + 0.12 * k, 2.0 * np.pi * k / count)
            branches.append(TreeBranch(Axis(((13.0, 1.0 / 30.0, 0.0),), tip, turned), 2.1 - 0.25 * k, parent, 3))
    return _meshed(model, branches, voxel)


def airway_tree(*, generations: int = 5, voxel: float = 0.642) -> TreeModel:
    """A binary tree, trachea of 9 mm radius; 235,000 faces and 32 tips with 5 generations below the trachea.

    Radii fall by 2^(-1/3) and a little more from one generation to the next (Murray's law has 2^(-1/3)).
    """
    lengths = [90.0, 56.0, 46.0, 32.0, 25.0, 19.0]
    radii = [9.0, 6.8, 4.7, 3.4, 2.5, 1.9]
    branches = [
        TreeBranch(
            Axis(((lengths[0], 1.0 / 400.0, 0.0),), np.zeros(3), _frame([0.0, 0.0, -1.0], [0.0, 1.0, 0.0])), radii[0], -1, 0
        )
    ]
    last = [0]
    for generation in range(1, generations + 1):
        bend = 1.0 / (3.0 * lengths[generation])
        for parent in last:
            point, frame = _end(branches[parent].axis)
            for roll in (0.5 * np.pi, 1.5 * np.pi):
                # The normal of the child's frame lies in the plane of the division, that of its own children across it.
                turned = _turned(frame, 0.62, roll)
                pieces = ((lengths[generation], bend, 0.0),)
                branches.append(TreeBranch(Axis(pieces, point, turned), radii[generation], parent, generation))
        last = [number for number, branch in enumerate(branches) if branch.generation == generation]
    return _meshed("airway tree", branches, voxel)


def _meshed(name: str, branches: list[TreeBranch], voxel: float) -> TreeModel:
    parents = {branch.parent for branch in branches}
    tubes = [
        (branch.axis, constant_radius(branch.radius), (branch.parent < 0, number not in parents))
        for number, branch in enumerate(branches)
    ]
    return TreeModel(name, marching_surface(tubes, voxel=voxel), tuple(branches))


def _frame(tangent: list[float], normal: list[float]) -> FloatArray:
    """Orthonormal columns tangent, normal, binormal."""
    t = np.asarray(tangent) / np.linalg.norm(tangent)
    n = np.asarray(normal) - (np.asarray(normal) @ t) * t
    n /= np.linalg.norm(n)
    return np.column_stack([t, n, np.cross(t, n)])


def _end(axis: Axis) -> tuple[FloatArray, FloatArray]:
    points, frames = axis.at(np.array([axis.length]))
    return points[0], frames[0]


def _turned(frame: FloatArray, angle: float, roll: float) -> FloatArray:
    """The frame rolled about its tangent, then its tangent tilted by `angle` towards its new normal."""
    c, s = np.cos(roll), np.sin(roll)
    rolled = frame @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(rolled @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
