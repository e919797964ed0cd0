"""Generated CT for the front end's benchmark: a chest whose airway and lungs are known, and a tube with a closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray
from segmentation.synthetic import Airway, round_cone_distance, weibel_airway
from segmentation.synthetic.shapes import Canvas, ellipsoid_level
from segmentation.volume import Volume

AIR, LUNG, TISSUE = -1000.0, -860.0, 40.0
# Standard deviation of the noise, HU, and of the Gaussian that it went through, in pixels.
NOISE, GRAIN = 15.0, 0.7
# A bronchus' wall takes about a fifth of its outer diameter (Weibel 1963), and no less than a CT shows.
WALL_SHARE, WALL_MIN = 0.15, 0.8
# Half axes of body and lungs, and the lungs' middles to each side, mm.
BODY, LUNGS, LUNG_AT = (165.0, 110.0), (68.0, 85.0, 105.0), (80.0, 0.0, -110.0)
SLAB = 20


@dataclass(frozen=True, eq=False, kw_only=True)
class Chest:
    """A generated CT with what is known about it.

    Attributes
    ----------
    volume : Volume
    airway : Airway
    """

    volume: Volume
    airway: Airway

    def lumen(self, volume: Volume, lower: tuple[int, ...], upper: tuple[int, ...]) -> BoolArray:
        """Voxels of the box ``lower <= index < upper`` of a volume of the same chest whose middles lie in the true lumen."""
        index = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(lower, upper, strict=True)), indexing="ij"), axis=-1)
        points = volume.to_lps(index.reshape(-1, 3))
        return np.asarray(self.airway.clearance(points) > 0.0).reshape(index.shape[:3])


def chest(shape: tuple[int, int, int] = (200, 512, 512), spacing: tuple[float, float, float] = (1.0, 0.7, 0.7)) -> Chest:
    """An airway of five generations in two lungs, partial volume and noise, always the same.

    Parameters
    ----------
    shape : (slices, rows, columns)
    spacing : (slice, row, column), mm
        The last slice lies 1 mm above the trachea's upper end.
    """
    airway = weibel_airway(voxel=1.0)
    first = np.array([-0.5 * spacing[2] * (shape[2] - 1), -0.5 * spacing[1] * (shape[1] - 1), 1.0 - spacing[0] * (shape[0] - 1)])
    z, y, x = (first[2 - axis] + spacing[axis] * np.arange(shape[axis]) for axis in range(3))
    rng = np.random.default_rng(1)
    voxels = np.empty(shape, dtype=np.int16)
    # In slabs: the whole in floating point would be four times the CT.
    for begin in range(0, shape[0], SLAB):
        canvas = Canvas(x, y, z[begin : begin + SLAB], np.full((len(z[begin : begin + SLAB]), *shape[1:]), AIR, dtype=np.float32))
        paint(canvas, airway)
        for number, plane in enumerate(canvas.hu, start=begin):
            grain = ndimage.gaussian_filter(rng.standard_normal(shape[1:], dtype=np.float32), GRAIN)
            voxels[number] = np.clip(np.rint(plane + grain * (NOISE / grain.std())), -1024, 3071)
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(spacing[::-1])[:, ::-1]
    matrix[:3, 3] = first
    return Chest(volume=Volume(voxels, matrix), airway=airway)


def paint(canvas: Canvas, airway: Airway) -> None:
    """Body, lungs, walls of the bronchi, and their lumen."""
    x, y, z = canvas.axes()
    whole = (slice(None),) * 3
    canvas.paint(whole, ellipsoid_level((x, y), (0.0, 0.0), BODY), TISSUE)
    for side in (-1.0, 1.0):
        canvas.paint(whole, ellipsoid_level((x, y, z), (side * LUNG_AT[0], *LUNG_AT[1:]), LUNGS), LUNG)
    for wall in (True, False):
        for branch in airway.branches:
            radius = branch.radius + (max(WALL_MIN, WALL_SHARE * branch.radius) if wall else 0.0)
            for a, b in zip(branch.points[:-1], branch.points[1:], strict=True):
                box = canvas.box(np.minimum(a, b) - radius - 2.0, np.maximum(a, b) + radius + 2.0)
                if all(part.stop > part.start for part in box):
                    canvas.paint(box, round_cone_distance(canvas.points(box), a, b, radius, radius), TISSUE if wall else AIR)


@dataclass(frozen=True, eq=False, kw_only=True)
class BentTube:
    """A dark tube along an arc in tissue, without noise and blur; its wall has a closed form.

    Attributes
    ----------
    volume : Volume
    radius, bend : float, mm
        Of the tube and of the arc that its axis is, about `center` in the plane through it at right angles to `normal`.
    center, normal, start : (3,) float array, mm
        `start` is the unit direction from the centre to the arc's beginning.
    angle : float, rad
    """

    volume: Volume
    radius: float
    bend: float
    center: FloatArray
    normal: FloatArray
    start: FloatArray
    angle: float

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance in mm of (n, 3) points to the wall, negative inside; its ends are half balls."""
        offset = points - self.center
        third = np.cross(self.normal, self.start)
        along, across, height = offset @ self.start, offset @ third, offset @ self.normal
        # The nearest point of the arc: at the point's own angle, or at one of the ends.
        middle = 0.5 * self.angle
        turn = np.angle(np.exp(1j * (np.arctan2(across, along) - middle)))
        turn = np.clip(turn, -middle, middle) + middle
        foot = self.bend * np.column_stack([np.cos(turn), np.sin(turn)])
        return np.asarray(np.sqrt((along - foot[:, 0]) ** 2 + (across - foot[:, 1]) ** 2 + height**2) - self.radius)


def bent_tube(voxel: float = 0.7, *, radius: float = 3.0, bend: float = 25.0, angle: float = 2.0) -> BentTube:
    """The tube on cubic voxels, its plane askew to them."""
    normal = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    start = np.array([2.0, -1.0, 0.0]) / np.sqrt(5.0)
    count = int(np.ceil((2.0 * (bend + radius) + 12.0) / voxel))
    matrix = np.eye(4)
    matrix[:3, :3] = voxel * np.eye(3)[:, ::-1]
    made = BentTube(
        volume=Volume(np.zeros((3, 3, 3), dtype=np.int16), matrix),
        radius=radius,
        bend=bend,
        center=np.full(3, 0.5 * voxel * count) + 0.137,
        normal=normal,
        start=start,
        angle=angle,
    )
    index = np.stack(np.meshgrid(*(np.arange(count),) * 3, indexing="ij"), axis=-1)
    # Partial volume: half of a voxel is inside where its middle lies on a flat wall. A scanner's blur of standard deviation
    # s would shift the halfway value of a tube inwards by s^2 / (2 radius), which is no error of the front end.
    level = made.distance(made.volume.to_lps(index.reshape(-1, 3))).reshape((count,) * 3)
    inside = np.clip(0.5 - level / voxel, 0.0, 1.0)
    hu = TISSUE + (AIR - TISSUE) * inside
    volume = Volume(np.rint(hu).astype(np.int16), matrix)
    return BentTube(volume=volume, radius=radius, bend=bend, center=made.center, normal=normal, start=start, angle=angle)
