"""What a rigid planner needs to know of a head: tissue, named structures as masks, the nostrils."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from segmentation.arrays import BoolArray, FloatArray, frozen_array
from segmentation.volume import Volume

SIDES = ("left", "right")  # the patient's
STRUCTURES = ("brain", "orbit_left", "orbit_right", "septum", "turbinate_left", "turbinate_right")


class Tissue(IntEnum):
    """Classes of the tissue volume."""

    AIR = 0
    SOFT = 1
    BONE = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class EntryRegion:
    """Where an instrument may go in on one side.

    Attributes
    ----------
    side : str
        One of `SIDES`.
    nostril : (slices, rows, columns) bool array
        Voxels on the segments between front and rear edge of the nostril.
    widened : (slices, rows, columns) bool array
        The same with the skin's give: 10 mm sideways, away from the septum, and 10 mm upwards. Contains `nostril`.
    confidence : float
        0 to 1.
    origin : str
        "traced", "mask" or "box".
    """

    side: str
    nostril: BoolArray
    widened: BoolArray
    confidence: float
    origin: str


@dataclass(frozen=True, eq=False, kw_only=True)
class NasalScene:
    """A head CT as the rigid planner sees it; all masks lie on the voxels of `volume`.

    Attributes
    ----------
    volume : Volume
    tissue : (slices, rows, columns) uint8 array
        Values of `Tissue`; the air outside the head is AIR too.
    structures : mapping of name to bool array
        Names of `STRUCTURES`; one that could not be proposed is absent.
    entries : mapping of side to EntryRegion
    confidence : mapping of structure to float, 0 to 1
    origin : mapping of structure to str
        "proposed", "mask", "seed" or "box".
    midline : (4,) float array
        Plane n . x = d in LPS mm that splits left from right; n points to the patient's left.
    notes : tuple of str
        What a reader must know: doubts, what could not be found and why.
    """

    volume: Volume
    tissue: NDArray[np.uint8]
    structures: Mapping[str, BoolArray]
    entries: Mapping[str, EntryRegion]
    confidence: Mapping[str, float]
    origin: Mapping[str, str]
    midline: FloatArray
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        shape = self.volume.voxels.shape
        object.__setattr__(self, "tissue", frozen_array(self.tissue, shape, "tissue", dtype=np.uint8))
        # Many and large: looked at, not copied.
        for name, mask in self.structures.items():
            if mask.shape != shape:
                raise ValueError(f"{name} has shape {mask.shape}, expected {shape}: one value for each voxel")
