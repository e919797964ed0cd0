"""How near the instrument comes to voxels, by points in its own coordinates: where each lies along the axis and from it.

# Strategy: a voxel's box is filled with points, `GRID` to a side. Which voxels can hold the nearest point is told by their
# middles: a box reaches no farther from its middle than half its diagonal. On a straight push the instrument only shifts along
# its axis, so that points keep their distance from the axis, and for places of the tip beside each other the same few voxels
# matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.volume import Volume

GRID = 5  # points of a voxel to a side, its faces included
TURN_STEP = np.radians(0.5)
BLOCK = 8  # places of the tip that share their voxels
ROUNDING_MM = 5e-3  # of the distances along the chosen path
WRITTEN_MM = 1e-4  # goals and nodes of candidates have four decimals
RANKED_MM = 0.02  # of those that paths are ranked by


@dataclass(frozen=True, eq=False)
class Boxes:
    """The outer voxels of one structure.

    Attributes
    ----------
    middles : (n, 3) float array, LPS mm
    corners : (k, 3) float array, mm
        From a voxel's middle to the points on its faces.
    half : float, mm
        Half the diagonal of a voxel.
    unseen : float, mm
        No point of a face is farther than this from one that is looked at.
    """

    middles: FloatArray
    corners: FloatArray
    half: float
    unseen: float

    @classmethod
    def of(cls, mask: BoolArray, volume: Volume) -> Boxes:
        """Of a mask on a volume's voxels; inner voxels are no nearer than their neighbours."""
        padded = np.pad(mask, 1)
        inner = mask.copy()
        for axis in range(3):
            for way in (-1, 1):
                inner &= np.roll(padded, way, axis=axis)[1:-1, 1:-1, 1:-1]
        share = np.linspace(-0.5, 0.5, GRID)
        grid = np.stack(np.meshgrid(share, share, share, indexing="ij"), axis=-1).reshape(-1, 3)
        outer = grid[(np.abs(grid) == 0.5).any(axis=1)]
        linear = volume.index_to_lps[:3, :3]
        sides = np.sort(volume.spacing)
        return cls(
            volume.to_lps(np.argwhere(mask & ~inner)),
            outer @ linear.T,
            0.5 * float(np.linalg.norm(sides)),
            0.5 * float(np.linalg.norm(sides[1:])) / (GRID - 1),
        )

    def slack(self, distance: float) -> float:
        """How far the distance to the points may be above that to the boxes, mm."""
        return float(np.sqrt(distance**2 + self.unseen**2) - distance + ROUNDING_MM) if np.isfinite(distance) else 0.0


@dataclass(frozen=True)
class Pose:
    """The instrument with its tip at a place, drawn out backwards by `run` mm; what it was made of stands in `tool`."""

    tip: FloatArray
    way: FloatArray
    roll: float
    tool: Mapping[str, Any]
    run: float = 0.0

    @property
    def up(self) -> FloatArray:
        """Where the endoscope lies, seen from the shaver's axis: upwards where that goes, turned by the roll."""
        level = np.array([0.0, 0.0, 1.0]) - self.way[2] * self.way
        level /= np.linalg.norm(level)
        return np.asarray(np.cos(self.roll) * level + np.sin(self.roll) * np.cross(self.way, level))

    def local(self, points: FloatArray) -> FloatArray:
        """Points along the axis, above it and beside it, (n, 3) mm from the tip."""
        up = self.up
        return np.asarray((points - self.tip) @ np.column_stack([self.way, up, np.cross(self.way, up)]))


def apart(local: FloatArray, tool: Mapping[str, Any], run: float) -> FloatArray:
    """Distance of points, in the instrument's coordinates, to shaver and endoscope: the lesser of both, (n,) mm."""
    along, rise, aside = local.T
    r_s, r_e = 0.5 * tool["shaver_diameter_mm"], 0.5 * tool["scope_diameter_mm"]
    # Shaver: a cylinder up to the centre of its ball, and the ball.
    radial = np.hypot(rise, aside)
    back = -(tool["shaver_length_mm"] + run)
    beyond = np.maximum(np.maximum(back - along, along + r_s), 0.0)
    cylinder = np.hypot(np.maximum(radial - r_s, 0.0), beyond)
    ball = np.maximum(np.hypot(radial, along + r_s) - r_s, 0.0)
    # Endoscope: a cylinder with flat ends.
    radial = np.hypot(rise - tool["offset_mm"], aside)
    front, back = -tool["setback_mm"], -(tool["setback_mm"] + tool["scope_length_mm"] + run)
    beyond = np.maximum(np.maximum(back - along, along - front), 0.0)
    scope = np.hypot(np.maximum(radial - r_e, 0.0), beyond)
    return np.asarray(np.minimum(np.minimum(cylinder, ball), scope))


def gap_to(boxes: Boxes, pose: Pose) -> float:
    """Least distance of the instrument to the points of a structure's voxels, mm; infinite where there are none."""
    if not len(boxes.middles):
        return float("inf")
    rough = apart(pose.local(boxes.middles), pose.tool, pose.run)
    near = boxes.middles[rough <= rough.min() + boxes.half + 1e-9]
    return float(apart(pose.local(points_of(boxes, near)), pose.tool, pose.run).min())


def points_of(boxes: Boxes, middles: FloatArray) -> FloatArray:
    """All points of some voxels, (n, 3) LPS mm."""
    return np.asarray((middles[:, None] + boxes.corners[None]).reshape(-1, 3))


def swept_gap(boxes: Boxes, nodes: FloatArray, roll: float, tool: Mapping[str, Any]) -> float:
    """Least distance while the tip goes from node to node, the turns between left out, mm."""
    least = float("inf")
    for a, b in pairwise(nodes):
        way, run = _way(a, b)
        least = min(least, gap_to(boxes, Pose(b, way, roll, tool, run)))
    return least


def turned_gap(boxes: Boxes, nodes: FloatArray, roll: float, tool: Mapping[str, Any]) -> float:
    """Least distance while the instrument turns at the nodes, mm; infinite without bends."""
    least = float("inf")
    for a, b, c in zip(nodes[:-2], nodes[1:-1], nodes[2:], strict=True):
        (first, _), (second, _) = _way(a, b), _way(b, c)
        angle = float(np.arccos(np.clip(first @ second, -1.0, 1.0)))
        for part in np.linspace(0.0, 1.0, max(int(np.ceil(angle / TURN_STEP)), 1) + 1):
            way = np.sin((1.0 - part) * angle) * first + np.sin(part * angle) * second
            least = min(least, gap_to(boxes, Pose(b, way / np.linalg.norm(way), roll, tool)))
    return least


def _way(a: FloatArray, b: FloatArray) -> tuple[FloatArray, float]:
    """Direction from one place to another, and how far it is."""
    run = float(np.linalg.norm(b - a))
    return (b - a) / run, run


def gaps_along(boxes: Boxes, tips: FloatArray, ways: FloatArray, roll: float, tool: Mapping[str, Any]) -> FloatArray:
    """Distance with the tip at each of n places, (n,) mm.

    Parameters
    ----------
    boxes : Boxes
    tips : (n, 3) float array, LPS mm
    ways : (n, 3) float array
        Direction in which the instrument stands there; the same as long as the push goes on.
    roll : float, radian
    tool : mapping
    """
    out = np.full(len(tips), np.inf)
    if not len(boxes.middles):
        return out
    cuts = np.flatnonzero(np.linalg.norm(np.diff(ways, axis=0), axis=1) > 1e-9) + 1
    for rows in np.split(np.arange(len(tips)), cuts):
        for block in np.array_split(rows, max(1, len(rows) // BLOCK)):
            _block(boxes, tips, Pose(tips[block[0]], ways[block[0]], roll, tool), block, out)
    return out


def _block(boxes: Boxes, tips: FloatArray, pose: Pose, block: IntArray, out: FloatArray) -> None:
    """Fill in the distances at places of the tip one after the other on a straight push."""
    shift = np.linalg.norm(tips[block] - pose.tip, axis=1)
    local = pose.local(boxes.middles)
    rough = apart(local, pose.tool, 0.0)
    # By as much as the tip moves, a voxel may come nearer and another go away.
    near = boxes.middles[rough <= rough.min() + boxes.half + 2.0 * float(shift[-1]) + 1e-9]
    local = pose.local(near)
    corners = boxes.corners @ np.column_stack([pose.way, pose.up, np.cross(pose.way, pose.up)])
    for k, by in zip(block.tolist(), shift.tolist(), strict=True):
        moved = local - np.array([by, 0.0, 0.0])
        some = apart(moved, pose.tool, 0.0)
        kept = moved[some <= some.min() + boxes.half + 1e-9]
        out[k] = apart((kept[:, None] + corners[None]).reshape(-1, 3), pose.tool, 0.0).min()
