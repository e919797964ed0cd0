"""The wide part of a lumen: everything that balls nearly as large as the largest one reach."""

# Strategy: the size of a hollow at a place is that of the largest ball that fits into it and holds the place (local
# thickness, Hildebrand and Rüegsegger 1997). The pelvis is then where this size is near its largest, and a calyx
# likewise; both end where such balls cannot go on into a neck. Unlike one ball this follows a long pelvis to its ends,
# and unlike a width along a middle line it does not ask where the line runs.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray, frozen_array
from tubeplan_viz.geometry import WallDistance

# A ball counts as nearly the largest from this share of its radius. The largest one alone would be a matter of noise.
PLATEAU = 0.85
GRID_MM = 0.5
PAIRS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False, kw_only=True)
class WidePart:
    """Balls that fit into a lumen, all nearly as large as the largest of them.

    Attributes
    ----------
    centers : (k, 3) float array, mm
    radii : (k,) float array, mm
    """

    centers: FloatArray
    radii: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "centers", frozen_array(self.centers, (None, 3), "centers"))
        object.__setattr__(self, "radii", frozen_array(self.radii, (len(self.centers),), "radii"))

    @property
    def center(self) -> FloatArray:
        """Mean of all centres, (3,) mm: the largest ball has much the same size over some millimetres."""
        return np.asarray(self.centers.mean(axis=0))

    @property
    def largest(self) -> float:
        """Radius of the largest ball, mm."""
        return float(self.radii.max())

    def level(self, points: FloatArray) -> FloatArray:
        """Distance to the nearest ball, (n,) mm; negative in one."""
        block = max(PAIRS_AT_ONCE // len(self.centers), 1)
        parts = [points[k : k + block] for k in range(0, len(points), block)]
        return np.concatenate([(np.linalg.norm(part[:, None] - self.centers, axis=2) - self.radii).min(axis=1) for part in parts])


def wide_part(
    wall: WallDistance, near: FloatArray, radius: float, *, within: Callable[[FloatArray], BoolArray] | None = None
) -> WidePart:
    """The balls around a ball that is nearly the largest of its surroundings.

    Parameters
    ----------
    wall : WallDistance
    near : (3,) float array, mm
        Centre of that ball.
    radius : float, mm
        Its radius.
    within : callable, optional
        Says of points, (n, 3) mm, which may be centres.

    References
    ----------
    .. [1] Hildebrand, T. and Rüegsegger, P. (1997). A new method for the model-independent assessment of thickness in
       three-dimensional images. Journal of Microscopy 185(1), 67-75.
    """
    reach = np.tile(np.ceil(radius / GRID_MM) + 1.0, (3, 2))  # grid steps to either side
    while True:
        grid = np.stack(np.meshgrid(*(GRID_MM * np.arange(-low, high + 1.0) for low, high in reach), indexing="ij"), axis=-1)
        sites = near + grid.reshape(-1, 3)
        clearance = wall.clearance(sites)
        clearance[~within(sites) if within is not None else np.zeros(len(sites), dtype=bool)] = -np.inf
        middle = tuple(int(low) for low in reach[:, 0])
        joined = joined_to(clearance.reshape(grid.shape[:3]), (middle[0], middle[1], middle[2]))
        borders = np.array([[joined.take(0, axis=k).any(), joined.take(-1, axis=k).any()] for k in range(3)])
        if not borders.any():
            kept = joined.ravel()
            peak, largest = climbed(wall, sites[kept][clearance[kept].argmax()])
            return WidePart(centers=np.vstack([sites[kept], peak]), radii=np.append(clearance[kept], largest))
        reach = reach + borders * np.ceil(radius / GRID_MM)


def climbed(wall: WallDistance, start: FloatArray) -> tuple[FloatArray, float]:
    """Centre and radius of the largest ball beside a grid point, to a hundredth of the grid."""
    around = np.stack(np.meshgrid(*([-1.0, 0.0, 1.0],) * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    step, place = 0.5 * GRID_MM, start
    while step > 0.01 * GRID_MM:
        sites = place + step * around
        clearance = wall.clearance(sites)
        best = int(clearance.argmax())
        if clearance[best] <= clearance[len(around) // 2]:
            step *= 0.5
        place = sites[best] if clearance[best] > clearance[len(around) // 2] else place
    return place, float(wall.clearance(place[None])[0])


def joined_to(clearance: FloatArray, middle: tuple[int, int, int]) -> BoolArray:
    """Grid points joined to one of them, or to a larger ball beside it, by balls of `PLATEAU` of the largest."""
    labels, _ = ndimage.label(clearance >= PLATEAU * clearance[middle])
    peak = int(np.where(labels == labels[middle], clearance, -np.inf).argmax())
    labels, _ = ndimage.label(clearance >= PLATEAU * clearance.flat[peak])
    return np.asarray(labels == labels.flat[peak])
