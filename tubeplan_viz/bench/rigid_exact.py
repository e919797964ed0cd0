"""Whether a path is free, by octrees instead of the planner's envelope and kd-tree.

# Strategy: all voxels with an open face are put into cubes of 2, 4, 8, 16 and 32 voxels to a side. A body whose distance to
# a cube's centre is more than half the cube's diagonal cannot meet it; what is left is looked at in the next smaller cubes,
# and voxels are halved further until a centre lies inside the body (it touches) or all parts are out of reach (it is free).
# What stays open at `SMALLEST_MM` counts as touching. Pushes are tested as a whole; turns in poses so near to each other that
# no point of the instrument moves more than `TURN_MM` in between.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from segmentation.arrays import BoolArray, IntArray
from tubeplan_viz.rigid import Bodies, Problem, RigidPath, posed, swept
from tubeplan_viz.rigid.collision import to_frame
from tubeplan_viz.rigid.instrument import unit

LEVELS = 5
SMALLEST_MM = 0.01
TURN_MM = 0.25
PATHS = 8  # looked at together
CORNERS = np.stack(np.meshgrid(*3 * [(-1.0, 1.0)], indexing="ij"), axis=-1).reshape(-1, 3)


def free_paths(problem: Problem, paths: Sequence[RigidPath]) -> BoolArray:
    """Which paths keep the swept instrument away from every structure and the border of the entry region, (n,)."""
    tree = _Octree(problem)
    free = np.ones(len(paths), dtype=bool)
    for low in range(0, len(paths), PATHS):
        some = [_bodies(problem, path) for path in paths[low : low + PATHS]]
        owner = np.repeat(np.arange(len(some)), [len(bodies) for bodies in some])
        parts = zip(*((b.tail, b.front, b.radius, b.round_front) for b in some), strict=True)
        bodies = to_frame(Bodies(*(np.concatenate(part) for part in parts)), problem.obstacles.frame)
        free[low + owner[tree.touched(bodies)]] = False
    return free


def _bodies(problem: Problem, path: RigidPath) -> Bodies:
    """All pushes of a path and poses of its turns, LPS mm."""
    made = [swept(problem.instrument, path.nodes[:-1], path.nodes[1:], path.roll)]
    ways = unit(np.diff(path.nodes, axis=0))
    for node, (before, after) in zip(path.nodes[1:-1], pairwise(ways), strict=True):
        angle = float(np.arccos(np.clip(before @ after, -1.0, 1.0)))
        depth = float(np.linalg.norm(problem.starts - node, axis=1).max()) + problem.instrument.reach
        count = int(np.ceil(angle * depth / TURN_MM)) + 1
        share = np.linspace(0.0, 1.0, count)[:, None]
        # Great circle: the sine rule of spherical interpolation.
        way = before + share * (after - before)
        if angle > 1e-6:
            way = (np.sin((1.0 - share) * angle) * before + np.sin(share * angle) * after) / np.sin(angle)
        tips = np.broadcast_to(node, way.shape)
        pose = posed(problem.instrument, tips, unit(way), path.roll)
        made.append(pose.cut(np.repeat(tips, 2, axis=0), np.full(2 * count, depth)))
    return Bodies(*(np.concatenate([getattr(b, name) for b in made]) for name in ("tail", "front", "radius", "round_front")))


class _Octree:
    """Cubes of voxels with an open face, from large to small."""

    def __init__(self, problem: Problem) -> None:
        self.spacing = problem.obstacles.frame.spacing
        union = np.pad(np.any(problem.obstacles.masks, axis=0), 1)
        inner = union.copy()
        for axis in range(3):
            inner &= np.roll(union, 1, axis) & np.roll(union, -1, axis)
        voxels = np.argwhere((union & ~inner)[1:-1, 1:-1, 1:-1])
        self.cubes: list[IntArray] = []
        self.children: list[list[IntArray]] = []
        for level in range(LEVELS + 1):
            cube, which = np.unique(voxels >> level, axis=0, return_inverse=True)
            self.cubes.append(cube)
            if level:
                below = self.cubes[level - 1]
                _, parent = np.unique(np.vstack([cube, below >> 1]), axis=0, return_inverse=True)
                order = np.argsort(parent.reshape(-1)[len(cube) :], kind="stable")
                counts = np.bincount(parent.reshape(-1)[len(cube) :], minlength=len(cube))
                self.children.append(np.split(order, np.cumsum(counts)[:-1]))
            del which

    def touched(self, bodies: Bodies) -> BoolArray:
        """Which bodies, in the image frame, touch a voxel, (n,)."""
        hit = np.zeros(len(bodies), dtype=bool)
        top = np.arange(len(self.cubes[LEVELS]))
        body, cube = (a.reshape(-1) for a in np.meshgrid(np.arange(len(bodies)), top, indexing="ij"))
        for level in range(LEVELS, -1, -1):
            side = 2**level
            centre = (self.cubes[level][cube] * side + 0.5 * (side - 1)) * self.spacing
            near = bodies.take(body).gap(centre) <= 0.5 * side * float(np.linalg.norm(self.spacing))
            body, cube, centre = body[near], cube[near], centre[near]
            if level:
                kids = [self.children[level - 1][k] for k in cube]
                body = np.repeat(body, [len(k) for k in kids])
                cube = np.concatenate(kids) if kids else np.empty(0, dtype=np.int64)
        half = 0.5 * self.spacing
        while len(body):
            gap = bodies.take(body).gap(centre)
            hit[body[gap <= 0.0]] = True
            reach = float(np.linalg.norm(half))
            open_ = (gap <= reach) & ~hit[body]
            body, centre = body[open_], centre[open_]
            if reach < SMALLEST_MM:
                hit[body] = True
                break
            half = 0.5 * half
            centre = (centre[:, None] + CORNERS[None] * half).reshape(-1, 3)
            body = np.repeat(body, len(CORNERS))
        return hit


__all__ = ["free_paths"]
