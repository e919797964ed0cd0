"""All obstacles of a needle's case asked together: exactly how far a path stays from them.

Spheres, circles and polygons have closed formulas against arcs and lines. Everything else is a signed
distance at points; since a distance changes by no more than the way walked, samples along a path
bound it between the samples too (`least_distance`).
"""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.needle.arc_distance import arc_distance
from tubeplan_viz.needle.bodies import Obstacle, Polygon, Sphere, body_distance, exact_distance
from tubeplan_viz.needle.kinematics import Arcs, chord


class Scene:
    """All obstacles of a case, asked together.

    Parameters
    ----------
    obstacles : sequence of Obstacle
    spacing : float, mm
        Of the samples along a path where there is no closed formula.
    """

    def __init__(self, obstacles: tuple[Obstacle, ...], *, spacing: float = 1.0) -> None:
        self.obstacles = tuple(obstacles)
        self.spacing = spacing
        self._round = [k for k, body in enumerate(self.obstacles) if isinstance(body, Sphere)]
        self._flat = {k: body for k, body in enumerate(self.obstacles) if isinstance(body, Polygon)}
        self._other = [k for k, body in enumerate(self.obstacles) if not isinstance(body, Sphere | Polygon)]
        balls = [body for body in self.obstacles if isinstance(body, Sphere)]
        self._centers = np.array([ball.center for ball in balls]).reshape(-1, 3)
        self._radii = np.array([ball.radius for ball in balls])

    def __len__(self) -> int:
        return len(self.obstacles)

    @property
    def exact(self) -> bool:
        """Whether all obstacles have a closed formula."""
        return not self._other

    def piece_distances(self, arcs: Arcs) -> FloatArray:
        """Least distance, mm, of each piece to each obstacle, (..., n, m): at samples for those without a formula."""
        found = np.empty((*arcs.lengths.shape, len(self)))
        if self._round:
            found[..., self._round] = arc_distance(arcs, self._centers) - self._radii
        for k, body in self._flat.items():
            found[..., k] = body.arc_gaps(arcs)
        if self._other:
            longest = float(arcs.lengths.max(initial=0.0))
            count = int(np.ceil(longest / self.spacing)) + 1
            points = arcs.points(arcs.lengths[..., None] * np.linspace(0.0, 1.0, max(count, 2)))
            for k in self._other:
                found[..., k] = self.obstacles[k].distance(points).min(axis=-1)
        return found

    def distances(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, of (k, 3) points to the nearest obstacle, (k,); infinite without obstacles."""
        if not self.obstacles:
            return np.full(points.shape[:-1], np.inf)
        return np.asarray(np.min([exact_distance(body, points) for body in self.obstacles], axis=0))

    def body_distances(self, points: FloatArray) -> FloatArray:
        """As `distances`, for drawing: without what a label volume's distance keeps back for its error bound."""
        if not self.obstacles:
            return np.full(points.shape[:-1], np.inf)
        return np.asarray(np.min([body_distance(body, points) for body in self.obstacles], axis=0))

    def least_distance(self, arcs: Arcs, *, tolerance: float = 1e-3) -> FloatArray:
        """Lower bound, mm, on the distance of one path, pieces (n,), to each obstacle, (m,), over every point of it.

        Spheres and polygons exactly. Others by bisection: between samples a and b that are h apart along the path the distance is
        at least (d_a + d_b - h) / 2, since it changes by no more than the way walked.
        """
        found = self.piece_distances(arcs).min(axis=0) if len(self) else np.empty(0)
        for k in self._other:
            found[k] = self._bisected(arcs, self.obstacles[k], tolerance)
        return np.asarray(found)

    def _bisected(self, arcs: Arcs, body: Obstacle, tolerance: float) -> float:
        piece: IntArray = np.arange(len(arcs.lengths))
        low: FloatArray = np.zeros(len(piece))
        high: FloatArray = np.array(arcs.lengths)
        d_low, d_high = self._at(arcs, body, piece, low), self._at(arcs, body, piece, high)
        best = float(min(d_low.min(), d_high.min()))
        while len(piece):
            bound = 0.5 * (d_low + d_high - (high - low))
            keep = bound < best - tolerance
            if not keep.any():
                break
            piece = piece[keep]
            low, high, d_low, d_high = (v[keep] for v in (low, high, d_low, d_high))
            middle = 0.5 * (low + high)
            d_middle = self._at(arcs, body, piece, middle)
            best = min(best, float(d_middle.min()))
            piece = np.concatenate([piece, piece])
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
            d_low, d_high = np.concatenate([d_low, d_middle]), np.concatenate([d_middle, d_high])
        return best - tolerance

    @staticmethod
    def _at(arcs: Arcs, body: Obstacle, piece: IntArray, place: FloatArray) -> FloatArray:
        forward, aside = (np.asarray(v)[:, None] for v in chord(place, arcs.curvatures[piece]))
        return exact_distance(body, arcs.starts[piece] + forward * arcs.tangents[piece] + aside * arcs.normals[piece])


def danger(distances: FloatArray, safety: float, *, factor: float = 1.0) -> FloatArray:
    """Sum over obstacles of factor * safety / distance, infinite where one is nearer than `safety` (Huo 2015, eq. 11).

    Parameters
    ----------
    distances : (..., m) array, mm
    safety : float, mm

    Returns
    -------
    (...) array, no unit
    """
    near = distances < safety
    safe = np.where(distances > 0.0, distances, np.inf)
    return np.asarray(np.where(near.any(axis=-1), np.inf, (factor * safety / safe).sum(axis=-1)))
