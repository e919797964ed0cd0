"""Seeded region growing with leak control."""

from __future__ import annotations

from dataclasses import dataclass

from segmentation.arrays import BoolArray, FloatArray, frozen_array


@dataclass(frozen=True, eq=False, kw_only=True)
class GrowthCurve:
    """Grown volume as a function of the HU limit that was varied.

    Attributes
    ----------
    varied : {"hu_max", "hu_min"}
    limits : (n,) float array, HU
        In the order tried: from tight to loose.
    volumes_ml : (n,) float array, ml
    chosen : float, HU
        The limit used.
    leak_limit : float or None, HU
        The first limit at which the region explodes, if any was met.
    leak_voxel : (3,) int tuple or None
        ``[slice, row, column]`` of the voxel through which the leak begins.
    leak_point : (3,) float array or None, mm, LPS
    """

    varied: str
    limits: FloatArray
    volumes_ml: FloatArray
    chosen: float
    leak_limit: float | None = None
    leak_voxel: tuple[int, int, int] | None = None
    leak_point: FloatArray | None = None

    def __post_init__(self) -> None:
        limits = frozen_array(self.limits, (None,), "limits")
        object.__setattr__(self, "limits", limits)
        object.__setattr__(self, "volumes_ml", frozen_array(self.volumes_ml, (len(limits),), "volumes_ml"))


@dataclass(frozen=True, eq=False, kw_only=True)
class Region:
    """A grown region, cropped to its box with one voxel of margin where the image has one.

    Attributes
    ----------
    mask : (k, l, m) bool array
    lower : (3,) int tuple
        Index ``[slice, row, column]`` of ``mask[0, 0, 0]`` in the volume.
    seed : (3,) int tuple
        Index of the seed voxel in the volume.
    hu_min, hu_max : float, HU
        The limits used.
    volume_ml : float, ml
    border : dict of str to int
        Voxels on each face of the image that the region touches, e.g. ``{"first slice": 120}``.
    curve : GrowthCurve or None
        Present when a limit was chosen automatically.
    """

    mask: BoolArray
    lower: tuple[int, int, int]
    seed: tuple[int, int, int]
    hu_min: float
    hu_max: float
    volume_ml: float
    border: dict[str, int]
    curve: GrowthCurve | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mask", frozen_array(self.mask, (None, None, None), "mask", dtype=bool))
