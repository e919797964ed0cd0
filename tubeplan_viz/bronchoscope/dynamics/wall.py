"""The patient's wall as the planes that touch the robot now.

Each ball of the robot meets the wall first at the point of the mesh that is nearest to its centre; that point is exact,
whatever the mesh's shape and size. The plane through it across the line to the centre stands for the wall until the
ball has moved a little; then the mesh is asked again. A ball in a narrow lumen or at a carina touches in several
directions: further planes come from samples of the wall that lie in other directions.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.mesh import Surface
from tubeplan_viz.geometry import WallDistance

# Planes per ball.
SIDES = 3
# A ball's plane is renewed when its centre has moved by this much, mm: in a tube of radius R the plane
# then errs by 0.2^2 / 2 / (R - r), 0.03 mm where 0.7 mm of play are left.
RENEWAL = 0.2
# Planes are laid for wall nearer to the ball than this, mm; the way between renewals and the motion of a step are less.
RANGE = 0.45
# Wall within 50 degrees (cosine) of a plane's direction needs no plane of its own.
SAME_SIDE = 0.64
# Edge of the cells that hold one sample of the wall each, mm: a ball of 1.75 mm sinks 0.02 mm between samples.
SAMPLE_CELL = 0.4
# Where a ball was that was never asked for, mm.
NEVER = 1e9
# Samples looked at for each ball.
SAMPLES = 72


class PatientWall:
    """One lumen's wall: exact distances, and samples that list what lies around a place.

    Parameters
    ----------
    surface : Surface
    """

    def __init__(self, surface: Surface) -> None:
        self.exact = WallDistance(surface)
        self.samples = cKDTree(_samples(surface))
        self.outward = surface.face_normals


class WallPlanes:
    """Nearest wall planes of moving balls.

    Parameters
    ----------
    wall : PatientWall
    radii : (n,) float array, mm
    """

    def __init__(self, wall: PatientWall, radii: FloatArray) -> None:
        self._wall = wall
        self._radii = radii
        self._asked = np.full((len(radii), 3), NEVER)
        self.distance = np.zeros(len(radii))
        self.points = np.zeros((len(radii), SIDES, 3))
        self.normals = np.zeros((len(radii), SIDES, 3))
        self.used = np.zeros((len(radii), SIDES), dtype=bool)

    def renew(self, centers: FloatArray, inside: BoolArray) -> BoolArray:
        """Ask the mesh again for the balls that need it; whose planes are new, per ball (n,).

        The distance to the wall changes by no more than the ball moves, so a ball far from the wall is not asked.

        Parameters
        ----------
        centers : (n, 3) float array, mm
        inside : (n,) bool array
            Balls beyond the entrance; those in the sheath touch nothing.
        """
        ways = centers - self._asked
        moved = np.sqrt(np.einsum("ij,ij->i", ways, ways))
        near = inside & (self.distance - moved < self._radii + RANGE)
        changed = self.used[:, 0] & ~near
        self.used[changed] = False
        if not (near & (moved > RENEWAL)).any():
            return changed
        asked = np.flatnonzero(near & (moved > 0.5 * RENEWAL))
        self._ask(asked, centers[asked])
        changed[asked] = True
        return changed

    def _ask(self, balls: IntArray, centers: FloatArray) -> None:
        """Lay the planes of some balls."""
        radii = self._radii[balls]
        distance, faces, feet = self._wall.exact.nearest(centers)
        ways = centers - feet
        # A centre that has passed the wall is pushed back through it, not on. The nearest face only raises the suspicion: at
        # edges of the wall and at its open rim it may look away from a centre that is inside.
        beyond = (distance < radii) & (np.einsum("ij,ij->i", ways, self._wall.outward[faces]) > 0.0)
        if beyond.any():
            beyond[beyond] = ~self._wall.exact.inside(centers[beyond])
        normals = np.where(beyond, -1.0, 1.0)[:, None] * ways / np.maximum(distance, 1e-9)[:, None]
        distance = np.where(beyond, -distance, distance)
        self._asked[balls], self.distance[balls] = centers, distance
        touching = distance - radii < RANGE
        self.points[balls, 0], self.normals[balls, 0], self.used[balls, 0] = feet, normals, touching
        self.used[balls, 1:] = False
        rows = np.flatnonzero(touching & ~beyond)
        if not len(rows):
            return
        reach = float(self._radii.max()) + RANGE
        found, index = self._wall.samples.query(centers[rows], k=SAMPLES, distance_upper_bound=reach)
        far = found > radii[rows, None] + RANGE
        points = self._wall.samples.data[np.where(far, 0, index)]  # (k, SAMPLES, 3)
        towards = (centers[rows, None] - points) / np.maximum(found, 1e-9)[..., None]
        gap = np.where(far, np.inf, found)
        last = normals[rows]
        for side in range(1, SIDES):
            gap = np.where(np.einsum("ksi,ki->ks", towards, last) > SAME_SIDE, np.inf, gap)
            best = np.argmin(gap, axis=1)
            each = np.arange(len(rows))
            last = towards[each, best]
            chosen = np.isfinite(gap[each, best])
            ball = balls[rows[chosen]]
            self.points[ball, side], self.normals[ball, side] = points[each, best][chosen], last[chosen]
            self.used[ball, side] = True


def _samples(surface: Surface) -> FloatArray:
    """Points of the wall, one for each cell that the wall's finer lattice visits, (n, 3) mm."""
    corners = surface.vertices[surface.wall_faces]
    longest = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=2).max(axis=1)
    count = np.clip(np.ceil(longest / SAMPLE_CELL), 1, None).astype(int)
    made = [surface.vertices[np.unique(surface.wall_faces)]]
    for n in np.unique(count):
        own = corners[count == n]
        i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        i, j = (axis[i + j < n] for axis in (i, j))
        s, t = (i + 1.0 / 3.0) / n, (j + 1.0 / 3.0) / n
        lattice = (1.0 - s - t)[:, None] * own[:, None, 0] + s[:, None] * own[:, None, 1] + t[:, None] * own[:, None, 2]
        made.append(lattice.reshape(-1, 3))
    points = np.concatenate(made)
    cells = np.floor((points - points.min(axis=0)) / SAMPLE_CELL).astype(np.int64)
    size = cells.max(axis=0) + 1
    _, first = np.unique((cells[:, 0] * size[1] + cells[:, 1]) * size[2] + cells[:, 2], return_index=True)
    return np.asarray(points[first])
