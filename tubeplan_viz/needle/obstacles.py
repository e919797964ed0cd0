"""What a needle must keep away from, and exactly how far it stays from it.

Spheres, circles and polygons have closed formulas against arcs and lines. Everything else is a signed
distance at points; since a distance changes by no more than the way walked, samples along a path
bound it between the samples too (`least_distance`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray, IntArray, frozen_array
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from segmentation.volume import Volume
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.needle.kinematics import Arcs, chord, cross

STRAIGHT = 1e-12  # 1/mm; an arc of this curvature leaves its tangent by less than rounding


class Obstacle(Protocol):
    """A body to keep away from."""

    @property
    def kind(self) -> str:
        """As in the case file."""

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, of (..., 3) points, negative inside; never more than the true one."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """A ball, or a circle where the path stays in the plane x = 0. `center` (3,) and `radius` in mm."""

    center: FloatArray
    radius: float
    kind: str = "sphere"

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", frozen_array(self.center, (3,), "center"))
        check_radius(self.kind, self.radius)

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm."""
        return np.asarray(np.linalg.norm(points - self.center, axis=-1) - self.radius)


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` of a polyline: a vessel, a rib. `points` (n, 3) in mm, n >= 2."""

    points: FloatArray
    radius: float
    kind: str = "capsule"

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points, (None, 3), "points"))
        if len(self.points) < 2:
            raise CaseError(f"a capsule has {len(self.points)} point, expected two or more; one point is a sphere")
        check_radius(self.kind, self.radius)

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm."""
        return segment_distance(points, self.points[:-1], self.points[1:]).min(axis=-1) - self.radius


@dataclass(frozen=True, eq=False)
class Polygon:
    """An area of the plane x = 0, or the prism along x over it. `corners` (n, 2): y, z in mm, in order, not crossing."""

    corners: FloatArray
    kind: str = "polygon"

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", frozen_array(self.corners, (None, 2), "points"))
        if len(self.corners) < 3:
            raise CaseError(f"a polygon has {len(self.corners)} corners, expected three or more")
        if abs(self.area) < 1e-9:
            raise CaseError("a polygon has no area; expected corners in order around it")

    @property
    def area(self) -> float:
        """Signed area, mm2."""
        y, z = self.corners.T
        return float(0.5 * (y * np.roll(z, -1) - np.roll(y, -1) * z).sum())

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, in the plane."""
        flat = points[..., 1:]
        first, second = self.corners, np.roll(self.corners, -1, axis=0)
        gap = segment_distance(flat, first, second).min(axis=-1)
        y, z = flat[..., None, 0], flat[..., None, 1]
        crosses = (first[:, 1] > z) != (second[:, 1] > z)
        rise = np.where(second[:, 1] == first[:, 1], 1.0, second[:, 1] - first[:, 1])
        at = first[:, 0] + (z - first[:, 1]) * (second[:, 0] - first[:, 0]) / rise
        inside = np.count_nonzero(crosses & (y < at), axis=-1) % 2 == 1
        return np.where(inside, -gap, gap)

    def arc_gaps(self, arcs: Arcs) -> FloatArray:
        """Exact distance, mm, of pieces in the plane x = 0, (..., n); 0 or less where one meets the polygon.

        # Strategy: an arc and an edge are nearest at a corner, at an end of the arc, or where the circle's radius meets the
        # edge at a right angle; or they cross.
        """
        corners = np.column_stack([np.zeros(len(self.corners)), self.corners])
        edge = np.roll(corners, -1, axis=0) - corners
        size = np.linalg.norm(edge, axis=1)
        along = edge / size[:, None]
        across = np.cross(along, [1.0, 0.0, 0.0])
        start, end = self.distance(arcs.starts), self.distance(arcs.ends)
        gap = np.minimum(np.minimum(start, end), arc_distance(arcs, corners).min(axis=-1))
        bent = arcs.curvatures[..., None] > STRAIGHT
        radius = 1.0 / np.maximum(arcs.curvatures, STRAIGHT)[..., None]
        center = np.where(bent, arcs.starts + radius * arcs.normals, arcs.starts)[..., None, :]  # (..., n, 1, 3)
        height = np.einsum("...md,md->...m", center - corners, across)
        foot = np.einsum("...md,md->...m", center - corners, along)
        touch = np.abs(height) - radius
        beside = bent & (touch >= 0.0) & (foot >= 0.0) & (foot <= size)
        inward = -np.sign(height)[..., None] * across  # from the centre to the edge
        gap = np.minimum(gap, np.where(beside & on_arc(arcs, inward), touch, np.inf).min(axis=-1))
        half = np.sqrt(np.maximum(radius**2 - height**2, 0.0))
        for sign in (1.0, -1.0):
            at = foot + sign * half
            spoke = corners + at[..., None] * along - center
            gap = np.where((bent & (touch < 0.0) & (at >= 0.0) & (at <= size) & on_arc(arcs, spoke)).any(axis=-1),
                           np.minimum(gap, 0.0), gap)  # fmt: skip
        reach = np.einsum("...d,md->...m", arcs.tangents, across)
        ahead = -height / np.where(np.abs(reach) < 1e-300, 1e-300, reach)
        at = foot + ahead * np.einsum("...d,md->...m", arcs.tangents, along)
        crossed = ~bent & (ahead >= 0.0) & (ahead <= arcs.lengths[..., None]) & (at >= 0.0) & (at <= size)
        return np.where(crossed.any(axis=-1), np.minimum(gap, 0.0), gap)


class MeshObstacle:
    """The inside of a closed surface; distances to its triangles are exact."""

    kind = "mesh"

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self._wall = WallDistance(surface, closed_ends=True)

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm."""
        return -self._wall.clearance(points.reshape(-1, 3)).reshape(points.shape[:-1])


class MaskObstacle:
    """The voxels of a label volume.

    Between voxel centres the distance field is interpolated. Each of its values is a distance
    between centres, off from that to the voxel's box by half a diagonal at most, and the interpolation
    adds at most half a diagonal: `bound` is one diagonal, and `distance` is less by so much, never more than the
    true distance.

    Parameters
    ----------
    mask : Volume
        Voxels above 0 are the obstacle.
    """

    kind = "mask"

    def __init__(self, mask: Volume) -> None:
        inside = np.asarray(mask.voxels) > 0
        if not inside.any():
            raise CaseError("a mask obstacle has no voxel above 0; expected a label volume in which the obstacle is marked")
        spacing = tuple(float(step) for step in mask.spacing)
        self.volume = mask
        self.bound = float(np.linalg.norm(spacing))
        outside = ndimage.distance_transform_edt(~inside, sampling=spacing)
        within = ndimage.distance_transform_edt(inside, sampling=spacing)
        self._field = np.asarray(outside - within, dtype=np.float32)

    def rim(self) -> FloatArray:
        """Centres, mm, (k, 3), of the obstacle's voxels that touch another one."""
        inside = np.asarray(self.volume.voxels) > 0
        return self.volume.to_lps(np.argwhere(inside & ~ndimage.binary_erosion(inside)))

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance, mm, less its error bound; outside the volume that of the nearest voxel within, plus the way to it."""
        flat = points.reshape(-1, 3)
        index = self.volume.to_index(flat)
        last = np.array(self._field.shape) - 1.0
        held = np.clip(index, 0.0, last)
        value = ndimage.map_coordinates(self._field, held.T, order=1, mode="nearest").astype(float)
        beyond = np.linalg.norm((index - held) * np.asarray(self.volume.spacing), axis=1)
        # Beyond the volume's faces nothing is known; the obstacle is taken to end with the image.
        return np.asarray(np.maximum(value - self.bound, beyond - self.bound) if beyond.any() else value - self.bound).reshape(
            points.shape[:-1]
        )


def check_radius(kind: str, radius: float) -> None:
    """Refuse a radius that is none."""
    if not 0.0 < radius <= 1000.0:
        raise CaseError(f"a {kind} obstacle has radius_mm {radius:g}, expected more than 0 and at most 1000")


def segment_distance(points: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Distance, mm, of (..., d) points to each of m segments, (m, d) ends: (..., m)."""
    way = second - first
    square = np.maximum(np.einsum("md,md->m", way, way), 1e-300)
    off = points[..., None, :] - first
    share = np.clip(np.einsum("...md,md->...m", off, way) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(off - share[..., None] * way, axis=-1))


def on_arc(arcs: Arcs, spokes: FloatArray) -> BoolArray:
    """Whether directions from the circles' centres, (..., n, m, 3), lead to a point of the arc, (..., n, m)."""
    x = np.einsum("...md,...d->...m", spokes, arcs.tangents)
    y = np.einsum("...md,...d->...m", spokes, arcs.normals)
    angle = np.mod(np.arctan2(x, -y), 2.0 * np.pi)
    return np.asarray(angle <= (arcs.lengths * arcs.curvatures)[..., None])


def arc_distance(arcs: Arcs, centers: FloatArray) -> FloatArray:
    """Exact distance, mm, of each piece, (..., n), to each of m points, (m, 3): (..., n, m).

    The nearest point of the whole circle lies in the half plane of the point; if it is not
    on the arc, the nearest is an end. Unlike the printed formula (Huo 2015, eq. 13), which
    compares with the tangents at the ends and holds for arcs under half a turn, this one holds up to a
    full turn. With k the curvature, x along the tangent, y towards the centre, z across:
    distance^2 = ((k (x^2 + y^2) - 2 y) / (1 + q))^2 + z^2, q^2 = (k x)^2 + (1 - k y)^2, exact for k = 0 too.
    """
    # Coordinates of the points in each piece's own frame, (..., n, m): products of matrices, no array of differences.
    x, y, z = (
        axis @ centers.T - np.einsum("...d,...d->...", axis, arcs.starts)[..., None]
        for axis in (arcs.tangents, arcs.normals, cross(arcs.tangents, arcs.normals))
    )
    forward, aside = (v[..., None] for v in chord(arcs.lengths, arcs.curvatures))
    flat, across = x * x + y * y, z * z
    k = np.maximum(arcs.curvatures, STRAIGHT)[..., None]
    kx, ky = k * x, 1.0 - k * y
    radial = (k * flat - 2.0 * y) / (1.0 + np.sqrt(kx * kx + ky * ky))
    angle = np.arctan2(kx, ky)
    whole = (arcs.lengths * arcs.curvatures)[..., None]
    beside = np.where(
        arcs.curvatures[..., None] > STRAIGHT,
        np.where(angle < 0, angle + 2.0 * np.pi, angle) <= whole,
        (x >= 0.0) & (x <= arcs.lengths[..., None]),
    )
    ends = np.minimum(flat, (x - forward) ** 2 + (y - aside) ** 2)
    return np.sqrt(np.where(beside, radial * radial, ends) + across)


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
        return np.asarray(np.min([body.distance(points) for body in self.obstacles], axis=0))

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
        return body.distance(arcs.starts[piece] + forward * arcs.tangents[piece] + aside * arcs.normals[piece])


def body_distance(body: Obstacle, points: FloatArray) -> FloatArray:
    """Signed distance, mm, to a body, without what a label volume's keeps back for its error bound: for drawing."""
    return body.distance(points) + (body.bound if isinstance(body, MaskObstacle) else 0.0)


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
