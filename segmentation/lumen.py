"""From a CT to the lumen of one tube: the one entry point of growing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from segmentation.anatomy.airway import AIRWAY, find_trachea
from segmentation.anatomy.generic import GENERIC
from segmentation.anatomy.preset import Limit, Preset
from segmentation.anatomy.urinary import URINARY, find_collecting_system
from segmentation.anatomy.vessel import VESSEL
from segmentation.errors import CaseError, RegionError
from segmentation.half_maximum import at_half_maximum
from segmentation.region_growing import NOISE_RADIUS, GrowthSettings, Region, grow
from segmentation.smoothing import HU_HIGHEST, HU_LOWEST, noise
from segmentation.tube_shape import TubeShape, refuse_unless_tube, tube_shape
from segmentation.volume import Volume

PRESETS = {preset.name: preset for preset in (AIRWAY, URINARY, VESSEL, GENERIC)}

# Voids in real airways are under 1 % of the lumen.
HOLLOW_MAX = 0.15

# A hip implant has 23 to 66 % above this, depending on the limit; bone and contrast medium hardly reach it.
METAL, METAL_SHARE_MAX = 2500.0, 0.1


@dataclass(frozen=True, kw_only=True)
class SegmentationSettings:
    """What is grown, from where, and between which limits.

    Attributes
    ----------
    anatomy : {"airway", "urinary", "vessel", "generic"}
    seed_point : (3,) float tuple or None, mm, LPS
        None lets the airway and urinary presets find their own.
    hu_min, hu_max : float, "auto" or None, HU
        ``"auto"`` chooses the limit before the region leaks (at most one of the two);
        None is the preset's choice.
    connectivity : {6, 26}
    smoothing : float or None, mm
        Standard deviation of a Gaussian before growing; 0 for none, None for the
        preset's choice by the noise around the seed.
    """

    anatomy: str
    seed_point: tuple[float, float, float] | None = None
    hu_min: Limit = None
    hu_max: Limit = None
    connectivity: int = 6
    smoothing: float | None = None

    def __post_init__(self) -> None:
        if self.anatomy not in PRESETS:
            raise CaseError(f"anatomy is {self.anatomy!r}, expected one of {', '.join(PRESETS)}")
        for name, limit in (("hu_min", self.hu_min), ("hu_max", self.hu_max)):
            if isinstance(limit, str) and limit != "auto":
                raise CaseError(f"{name} is {limit!r}, expected a number of HU or auto")
            if isinstance(limit, int | float) and not -32768.0 <= limit <= 32767.0:
                raise CaseError(f"{name} is {limit:g} HU, expected -32768 to 32767")
        if self.hu_min == "auto" and self.hu_max == "auto":
            raise CaseError("hu_min and hu_max are both auto; only one limit can be searched, give the other as a number")
        if self.connectivity not in (6, 26):
            raise CaseError(f"connectivity is {self.connectivity}, expected 6 or 26")
        if self.smoothing is not None and not 0.0 <= self.smoothing <= 10.0:
            raise CaseError(f"smoothing is {self.smoothing:g} mm, expected 0 to 10")
        if self.seed_point is not None and not (len(self.seed_point) == 3 and np.isfinite(self.seed_point).all()):
            raise CaseError(f"seed_point is {self.seed_point}, expected three numbers in mm (LPS)")


def segment_lumen(
    volume: Volume, settings: SegmentationSettings, *, progress: Callable[[int, int], None] | None = None
) -> Region:
    """Grow the lumen and refuse what is no tube.

    Parameters
    ----------
    volume : Volume
    settings : SegmentationSettings
    progress : callable, optional
        Called with the number of limits flooded and their count.

    Returns
    -------
    Region
        With the growth curve when a limit was chosen automatically.

    Raises
    ------
    RegionError
        If the seed is not found or unfit, nothing grows, the region leaks, or is no tube.
    CaseError
        If a limit or seed that the preset cannot choose is missing.
    """
    preset = PRESETS[settings.anatomy]
    seed = _seed(volume, settings)
    smoothing = settings.smoothing
    if smoothing is None:
        smoothing = preset.smoothing if noise(volume, seed, radius=NOISE_RADIUS) > preset.noise_max else 0.0
    region = grow(volume, seed, _growth(preset, settings, smoothing), progress=progress)
    if preset.half_maximum and region.curve is not None and region.curve.varied == "hu_min":
        region = at_half_maximum(volume, region)
    share = np.count_nonzero(region.mask) / volume.voxels.size
    name = f"the region grown from {region.hu_min:.0f} to {region.hu_max:.0f} HU"
    if share > 0.5:
        raise RegionError(f"{name} is no tube: it fills {100 * share:.0f} % of the image; tighten the limits or check the seed")
    _refuse_hollow_or_metal(volume, region, name)
    refuse_unless_tube(measure_shape(volume, region), preset.tube, name)
    return region


def _refuse_hollow_or_metal(volume: Volume, region: Region, name: str) -> None:
    """Bone's cortex around marrow, and implants, can have the shape of a tube."""
    count = np.count_nonzero(region.mask)
    hollow = 1.0 - count / np.count_nonzero(region.filled)
    if hollow > HOLLOW_MAX:
        raise RegionError(
            f"{name} is a shell, as of bone around marrow: {100 * hollow:.0f} % of what it encloses did not grow, "
            f"expected at most {100 * HOLLOW_MAX:.0f} %; check the seed"
        )
    box = tuple(slice(lo, lo + n) for lo, n in zip(region.lower, region.mask.shape, strict=True))
    metal = float(np.mean(volume.voxels[box][region.mask] >= METAL))
    if metal > METAL_SHARE_MAX:
        raise RegionError(
            f"{name} is metal: {100 * metal:.0f} % of it is above {METAL:g} HU, "
            f"expected at most {100 * METAL_SHARE_MAX:.0f} % in a lumen with contrast medium; check the seed"
        )


def measure_shape(volume: Volume, region: Region) -> TubeShape:
    """Length, width and cross-sections of a region with its voids closed."""
    return tube_shape(region.filled, volume.spacing)


def _seed(volume: Volume, settings: SegmentationSettings) -> tuple[int, int, int]:
    if settings.seed_point is None:
        if settings.anatomy == "airway":
            return find_trachea(volume)
        if settings.anatomy == "urinary":
            return find_collecting_system(volume)
        raise CaseError(
            f"anatomy {settings.anatomy} does not find its own seed; give a point in the lumen with --seed-point X,Y,Z (LPS, mm)"
        )
    point = settings.seed_point
    if not volume.contains(point):
        corners = volume.to_lps(np.array([np.full(3, -0.5), np.array(volume.voxels.shape) - 0.5]))
        low, high = corners.min(axis=0), corners.max(axis=0)
        box = ", ".join(f"{a:.1f} to {b:.1f}" for a, b in zip(low, high, strict=True))
        raise RegionError(
            f"the seed ({', '.join(f'{x:.1f}' for x in point)}) mm lies outside the image, "
            f"which spans ({box}) mm in LPS; check its frame (LPS) and unit (mm)"
        )
    index = np.clip(np.round(volume.to_index(point)).astype(int), 0, np.array(volume.voxels.shape) - 1)
    return int(index[0]), int(index[1]), int(index[2])


def _growth(preset: Preset, settings: SegmentationSettings, smoothing: float) -> GrowthSettings:
    """Limits of the preset and the user together."""
    hu_min = preset.hu_min if settings.hu_min is None else settings.hu_min
    hu_max = preset.hu_max if settings.hu_max is None else settings.hu_max
    varied = "hu_min" if hu_min == "auto" else "hu_max" if hu_max == "auto" else None
    if hu_min is None and hu_max is None:
        raise CaseError(
            f"anatomy {preset.name} needs at least one limit; "
            "give --hu-max for a dark lumen or --hu-min for a bright one (a number or auto)"
        )
    loosest = preset.loosest
    low = float(HU_LOWEST) if hu_min is None else hu_min
    high = float(HU_HIGHEST) if hu_max is None else hu_max
    if low == "auto":
        low = loosest if loosest is not None and preset.lumen != "dark" else float(HU_LOWEST)
    if high == "auto":
        high = loosest if loosest is not None and preset.lumen != "bright" else float(HU_HIGHEST)
    return GrowthSettings(
        hu_min=float(low),
        hu_max=float(high),
        varied=varied,
        leak=preset.leak,
        connectivity=settings.connectivity,
        smoothing=smoothing,
    )
