"""A head with a hollow nose, made of planes, ellipsoids and round cones: HU and the truth side by side.

Millimetres, LPS: x to the patient's left, y backwards, z upwards. The face lies at about y = -60, the tip of the
nose at y = -82, the nostrils open downwards at z = -6, the floor of the nose is z = -10 and its roof z = 34. The
head is symmetric but for the septum, which may deviate.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from segmentation.anatomy.nasal.scene import Tissue
from segmentation.arrays import BoolArray, FloatArray
from segmentation.synthetic.shapes import Canvas, ellipsoid_level, round_cone_distance

AIR, SOFT, MUCOSA, FAT, EYE, BRAIN, NERVE = -1000.0, 45.0, 60.0, -90.0, 15.0, 36.0, 30.0
BONE, CARTILAGE = 900.0, 130.0

FLOOR, ROOF, CHOANA = -10.0, 34.0, -10.0
SEPTUM_HALF, SEPTUM_CORE = 2.5, 0.7
WALL = 4.5
"""Thickness of the nose's front wall, mm; its lower end is rounded."""
ALA = 3.5
CAVITY_HALF = 15.0
TURBINATE = (10.5, -2.0)
"""Axis of the inferior turbinate: |x| and z, mm; it runs along y."""
TURBINATE_ENDS, TURBINATE_RADIUS, TURBINATE_CORE = (-56.0, -18.0), 4.0, 1.0
ORBIT, ORBIT_RADIUS, APEX, APEX_RADIUS = (32.0, -36.0, 22.0), 13.5, (16.0, -6.0, 26.0), 2.5
LESION = (11.6, 3.0, 27.0)
"""In the bone between sphenoid sinus and optic nerve: what a decompression removes; |x|, y, z."""
SINUS_HALF = 10.5


def face(x: FloatArray | float) -> FloatArray:
    """Foremost y of the head without its nose at a lateral place, mm."""
    return np.asarray(20.0 - 80.0 * np.sqrt(np.maximum(1.0 - (np.asarray(x) / 70.0) ** 2, 0.0)))


def rim(x: FloatArray | float) -> FloatArray:
    """Lowest z of the nose's front wall, mm."""
    return np.asarray(-6.0 + 0.02 * np.asarray(x) ** 2)


def dorsum(x: FloatArray | float, z: FloatArray | float) -> FloatArray:
    """Foremost y of the nose, mm; straight from the root at z = 42 to the centre of its rounded lower end."""
    height = np.maximum(z, rim(x) + WALL / 2)
    return np.asarray(-60.0 - 22.0 * (42.0 - height) / 48.0 + 0.03 * np.asarray(x) ** 2)


def half_width(z: FloatArray | float) -> FloatArray:
    """Half the outer width of the nose, mm."""
    return np.asarray(7.0 + 10.0 * np.clip((42.0 - np.asarray(z)) / 48.0, 0.0, 1.0))


def inner_width(x: FloatArray | float, z: FloatArray | float) -> FloatArray:
    """Half the inner width of the nose, mm; below the rim of the nostril it stays what it is there."""
    return np.asarray(half_width(np.maximum(z, rim(x))) - ALA)


def front_edge(x: float) -> FloatArray:
    """Lowest point of the nose's contour in the sagittal plane at x: (y, z) mm."""
    low = float(rim(x))
    return np.array([float(dorsum(x, low)) + WALL / 2, low])


def rear_edge(x: float) -> FloatArray:
    """Foremost point of the nasal floor in the sagittal plane at x: (y, z) mm."""
    return np.array([float(face(x)), FLOOR])


class Head:
    """HU and truth under construction; each solid is painted over what was there.

    Attributes
    ----------
    canvas : Canvas
    tissue : (slices, rows, columns) uint8 array
        Class of the last solid that holds the voxel's centre.
    masks : dict of str to bool array
    hull : (slices, rows, columns) bool array
        The head with its nose filled down to the segments between the edges of the nostrils.
    """

    def __init__(self, canvas: Canvas, *, deviation: float) -> None:
        self.canvas = canvas
        self.tissue = np.full(canvas.hu.shape, Tissue.AIR, dtype=np.uint8)
        self.masks: dict[str, BoolArray] = {}
        self.x, self.y, self.z = canvas.axes()
        self.across = np.abs(self.x)
        bump = np.exp(-(((self.y + 38.0) / 14.0) ** 2) - ((self.z - 4.0) / 12.0) ** 2)
        self.from_septum = np.abs(self.x - deviation * bump)
        steps: tuple[Callable[[], None], ...] = (
            self._skin, self._skull, self._orbits, self._sphenoid, self._face, self._airway, self._septum, self._turbinates,
        )  # fmt: skip
        for step in steps:
            step()

    def _put(self, level: FloatArray, hu: float, kind: Tissue, *, inner: bool = False) -> BoolArray:
        """Paint a solid; structures lose what it takes from them unless it is an `inner` part of theirs."""
        level = np.broadcast_to(level, self.tissue.shape)
        self.canvas.paint((slice(None),) * 3, level, hu)
        inside: BoolArray = level < 0.0
        self.tissue[inside] = kind
        if not inner:
            for name in self.masks:
                self.masks[name] = self.masks[name] & ~inside
        return inside

    def _box(self, half: float | tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> FloatArray:
        """Level of a box on both sides: |x| below `half` or between two values."""
        inner, outer = half if isinstance(half, tuple) else (-np.inf, half)
        return _both(
            inner - self.across, self.across - outer, y[0] - self.y, self.y - y[1], z[0] - self.z, self.z - z[1]
        )  # fmt: skip

    def _cone(self, a: tuple[float, float, float], b: tuple[float, float, float], ra: float, rb: float) -> FloatArray:
        """Signed distance to a round cone on both sides; computed on one half of each row, by |x|."""
        points = np.stack(np.broadcast_arrays(self.across, self.y, self.z), axis=-1)
        return round_cone_distance(points, np.array(a), np.array(b), ra, rb)

    def _skin(self) -> None:
        oval = ellipsoid_level((self.x, self.y, np.maximum(self.z - 10.0, 0.0)), (0.0, 20.0, 0.0), (70.0, 80.0, 75.0))
        self._put(oval, SOFT, Tissue.SOFT)
        low, front = rim(self.x), dorsum(self.x, self.z)
        wedge = _both(front - self.y, self.y - 0.0, self.across - half_width(self.z), self.z - 42.0)
        solid = _both(np.broadcast_to(wedge, self.tissue.shape), low + WALL / 2 - self.z)
        end = np.hypot(self.y - front - WALL / 2, self.z - low - WALL / 2) - WALL / 2
        flush = _both(wedge, low - self.z, _either(self.across - SEPTUM_HALF, inner_width(self.x, self.z) - self.across))
        self._put(_either(solid, _both(end, self.across - half_width(self.z)), flush), SOFT, Tissue.SOFT)
        # The nostril's segments: from the front wall's lowest line to the foremost line of the floor.
        y_front, y_rear = dorsum(self.x, low) + WALL / 2, face(self.x)
        share = np.clip((self.y - y_front) / (y_rear - y_front), 0.0, 1.0)
        self.hull: BoolArray = np.broadcast_to(
            _either(oval, _both(wedge, low + share * (FLOOR - low) - self.z)) < 0.0, solid.shape
        )
        nasal_bone = _both(front + 1.2 - self.y, self.y - front - 3.4, self.across - half_width(self.z) + 1.2, 18.0 - self.z)
        self._put(_both(nasal_bone, self.z - 40.0), BONE, Tissue.BONE)

    def _skull(self) -> None:
        def inside(grow: float) -> FloatArray:
            oval = ellipsoid_level(
                (self.x, self.y, self.z), (0.0, 22.0, 15.0), (58.0 + 2 * grow, 68.0 + 2 * grow, 62.0 + 2 * grow)
            )
            fossae = _either(
                39.0 - grow - self.z,
                _both(16.0 - grow - self.y, 4.0 - grow - self.z),
                _both(24.0 - grow - self.across, 4.0 - grow - self.y, 14.0 - grow - self.z),
            )
            return _both(oval, fossae)

        self._put(inside(2.5), BONE, Tissue.BONE)
        self.masks["brain"] = self._put(inside(0.0), BRAIN, Tissue.SOFT)

    def _orbits(self) -> None:
        wall = self._cone(ORBIT, APEX, ORBIT_RADIUS + 2.0, APEX_RADIUS + 2.0)
        self._put(_both(wall, -46.0 - self.y), BONE, Tissue.BONE)
        content = _both(self._cone(ORBIT, APEX, ORBIT_RADIUS, APEX_RADIUS), face(self.x) + 2.5 - self.y)
        inside = self._put(content, FAT, Tissue.SOFT)
        self._put(_both(content, self._cone((32.0, -37.0, 22.0), (32.0, -37.0, 22.0), 11.5, 11.5)), EYE, Tissue.SOFT, inner=True)
        self._put(_both(content, self._cone((30.0, -28.0, 23.0), APEX, 2.0, 2.0)), NERVE, Tissue.SOFT, inner=True)
        self.masks["orbit_left"] = inside & (self.x > 0.0)
        self.masks["orbit_right"] = inside & (self.x < 0.0)

    def _sphenoid(self) -> None:
        self._put(self._box(14.0, (-10.0, 14.0), (12.0, 36.0)), BONE, Tissue.BONE)
        canal = self._cone(APEX, (10.0, 15.0, 32.0), APEX_RADIUS, 2.0)
        self._put(_both(canal, -6.0 - self.y, self.y - 17.0, SINUS_HALF + 2.0 - self.across), NERVE, Tissue.SOFT)
        self._put(self._box(SINUS_HALF, (-8.5, 10.0), (14.0, 33.0)), AIR, Tissue.AIR)

    def _face(self) -> None:
        middle, radii = (28.5, -34.0, -3.0), (11.0, 14.0, 9.0)
        antrum = ellipsoid_level((self.across, self.y, self.z), middle, radii)
        self._put(antrum - 1.6, BONE, Tissue.BONE)
        self._put(antrum, AIR, Tissue.AIR)
        self._put(self._box((CAVITY_HALF, CAVITY_HALF + 2.0), (-54.0, CHOANA), (FLOOR - 2.0, ROOF + 2.5)), BONE, Tissue.BONE)
        self._put(self._box(CAVITY_HALF + 2.0, (-56.0, CHOANA), (ROOF, ROOF + 2.5)), BONE, Tissue.BONE)
        self._put(self._box(CAVITY_HALF + 6.0, (-54.0, CHOANA), (FLOOR - 4.0, FLOOR)), BONE, Tissue.BONE)

    def _airway(self) -> None:
        self._put(self._box(CAVITY_HALF, (-54.0, CHOANA), (FLOOR, ROOF)), AIR, Tissue.AIR)
        self._put(self._box(12.0, (CHOANA, 8.0), (-np.inf, 10.0)), AIR, Tissue.AIR)
        self._put(self._box(6.0, (CHOANA - 1.0, -8.0), (18.0, 28.0)), AIR, Tissue.AIR)
        inner = inner_width(self.x, self.z)
        vestibule = _both(
            dorsum(self.x, self.z) + WALL - self.y, self.y + 53.0, self.across - inner, FLOOR - self.z, self.z - 30.0
        )
        self._put(vestibule, AIR, Tissue.AIR)

    def _septum(self) -> None:
        behind_front = dorsum(self.x, self.z) + WALL - self.y
        below = _either(FLOOR - self.z, rim(self.x) - self.z)
        in_front = _both(rim(self.x) - self.z, self.y - face(0.0))
        sheet = _both(
            self.from_septum - SEPTUM_HALF, behind_front, self.y - CHOANA, self.z - ROOF, below,
            _either(in_front, _both(FLOOR - self.z, face(0.0) - self.y)),
        )  # fmt: skip
        self.masks["septum"] = self._put(sheet, MUCOSA, Tissue.SOFT)
        core = self.from_septum - SEPTUM_CORE
        self._put(_both(sheet + 1.0, core, self.y + 52.0), CARTILAGE, Tissue.SOFT, inner=True)
        self.masks["septum_core"] = self._put(_both(sheet, core, -52.0 - self.y), BONE, Tissue.BONE, inner=True)

    def _turbinates(self) -> None:
        (x, z), (front, rear) = TURBINATE, TURBINATE_ENDS
        body = self._cone((x, front, z), (x, rear, z), TURBINATE_RADIUS, TURBINATE_RADIUS)
        root = self._box((x, CAVITY_HALF), (front, rear), (z - 1.5, z + 1.5))
        inside = self._put(_either(body, root), MUCOSA, Tissue.SOFT)
        core = _either(
            self._cone((x, front + 3.0, z), (x, rear - 3.0, z), TURBINATE_CORE, TURBINATE_CORE),
            self._box((x, CAVITY_HALF), (front + 3.0, rear - 3.0), (z - 0.7, z + 0.7)),
        )
        hard = self._put(core, BONE, Tissue.BONE, inner=True)
        for side, there in (("left", self.x > 0.0), ("right", self.x < 0.0)):
            self.masks[f"turbinate_{side}"] = inside & there
            self.masks[f"turbinate_{side}_core"] = hard & there


def _both(*levels: FloatArray) -> FloatArray:
    """Level of an intersection."""
    out = levels[0]
    for level in levels[1:]:
        out = np.maximum(out, level)
    return np.asarray(out)


def _either(*levels: FloatArray) -> FloatArray:
    """Level of a union."""
    out = levels[0]
    for level in levels[1:]:
        out = np.minimum(out, level)
    return np.asarray(out)
