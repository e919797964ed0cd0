"""Seeded region growing with leak control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, frozen_array
from segmentation.errors import RegionError
from segmentation.flooding import Flood, bounding_box, flood, flood_once, without_voids
from segmentation.leak import LeakRule, leak_index, leak_voxel, noise_end
from segmentation.smoothing import HU_HIGHEST, HU_LOWEST, STEPS_PER_HU, GrowingVoxels, noise
from segmentation.volume import Volume

FACES = (("first slice", "last slice"), ("first row", "last row"), ("first column", "last column"))

# A flood for a curve goes on past the greatest plausible volume to show the explosion.
CURVE_BEYOND = 2.5

# Noise is measured within this distance of the seed: inside a large lumen, near the wall of a small one.
NOISE_RADIUS = 4.0
# More than this is structure, as in bone: an image with more noise is smoothed first (see the presets).
NOISE_MAX = 25.0

# A seed a little off the lumen is answered with the nearest voxel that would do.
NEAR = 10.0


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
    smoothing : float, mm
        Standard deviation of the Gaussian that was applied before growing, 0 for none.
    wall_limits : (k, l, m) float array or None, HU
        Local lower limits of a bright lumen whose wall was moved to half maximum.
    """

    mask: BoolArray
    lower: tuple[int, int, int]
    seed: tuple[int, int, int]
    hu_min: float
    hu_max: float
    volume_ml: float
    border: dict[str, int]
    curve: GrowthCurve | None = None
    smoothing: float = 0.0
    wall_limits: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mask", frozen_array(self.mask, (None, None, None), "mask", dtype=bool))
        if self.wall_limits is not None:
            object.__setattr__(self, "wall_limits", frozen_array(self.wall_limits, self.mask.shape, "wall_limits"))

    @cached_property
    def filled(self) -> BoolArray:
        """The mask with its voids closed, (k, l, m)."""
        return frozen_array(without_voids(self.mask), self.mask.shape, "filled", dtype=bool)


@dataclass(frozen=True, kw_only=True)
class GrowthSettings:
    """How a region grows.

    Attributes
    ----------
    hu_min, hu_max : float, HU
        Both belong to the region. The one named by `varied` is the loosest that the search may try.
    varied : {"hu_max", "hu_min"} or None
        The limit to choose automatically: ``hu_max`` for a dark lumen, ``hu_min`` for a bright one.
    leak : LeakRule
        Without `varied`, only its `volume_max` is used: growth beyond it is refused.
    connectivity : {6, 26}
    smoothing : float, mm
        Standard deviation of the Gaussian before growing, 0 for none.
    """

    hu_min: float
    hu_max: float
    varied: str | None
    leak: LeakRule
    connectivity: int = 6
    smoothing: float = 0.0

    def __post_init__(self) -> None:
        if self.varied not in (None, "hu_max", "hu_min") or self.connectivity not in (6, 26):
            raise ValueError(
                f"varied is {self.varied!r} and connectivity {self.connectivity}, expected hu_max, hu_min or None and 6 or 26"
            )
        if not self.hu_min < self.hu_max:
            raise RegionError(f"the limits are {self.hu_min:g} to {self.hu_max:g} HU; the lower one must be below the upper")


def grow(
    volume: Volume, seed: tuple[int, int, int], settings: GrowthSettings, *, progress: Callable[[int, int], None] | None = None
) -> Region:
    """Grow a region from a seed voxel between HU limits.

    With `settings.varied` the region is grown through all limits 1 HU apart in one
    pass, from the seed's own value to the loosest; the limit is set before the
    explosion by the margin of the leak rule, or to the loosest when nothing leaks.

    Parameters
    ----------
    volume : Volume
    seed : (3,) int tuple
        ``[slice, row, column]``.
    settings : GrowthSettings
    progress : callable, optional
        Called with the number of limits done and their count.

    Raises
    ------
    RegionError
        If the seed lies outside the limits, or the region leaks.
    """
    seed_hu = _check_seed(volume, seed, settings)
    if settings.varied is None:
        values = GrowingVoxels(volume=volume, smoothing=settings.smoothing)
        mask, lower, complete = flood_once(
            lambda box: values.between(box, settings.hu_min, settings.hu_max),
            seed,
            values.shape,
            connectivity=settings.connectivity,
            voxels_max=int(settings.leak.volume_max / volume.voxel_ml),
        )
        if not complete:
            raise RegionError(_too_much(volume, seed_hu, settings))
        return _region(volume, seed, mask, lower, settings, None)

    # Everything is told in terms of a dark lumen: a bright one is turned upside down.
    bright = settings.varied == "hu_min"
    values = GrowingVoxels(
        volume=volume, smoothing=settings.smoothing, bright=bright, bound=settings.hu_max if bright else settings.hu_min
    )
    sign = -1 if bright else 1
    loosest = settings.hu_min if bright else settings.hu_max
    limits = np.arange(np.ceil(sign * seed_hu), np.floor(sign * loosest) + 1.0)
    steps = np.floor(limits * STEPS_PER_HU).astype(np.int64)
    flooded = flood(
        values,
        seed,
        steps,
        connectivity=settings.connectivity,
        voxels_max=int(settings.leak.volume_max * CURVE_BEYOND / volume.voxel_ml),
        progress=progress,
    )
    volumes = np.asarray(flooded.counts * volume.voxel_ml, dtype=np.float64)
    limits = limits[: len(volumes)]
    spread = min(noise(volume, seed, radius=NOISE_RADIUS, smoothing=settings.smoothing), NOISE_MAX)
    settled = noise_end(flooded.values, steps, STEPS_PER_HU * spread)
    leak = leak_index(volumes, settings.leak, first=settled)
    chosen = len(limits) - 1 if leak is None else _before_leak(leak, limits, volumes, flooded, settings, seed_hu)
    where, point = None, None
    if leak is not None:
        held = np.concatenate(flooded.joined[:leak])
        where = leak_voxel(
            flooded.joined[leak], held, flooded.values[leak], volume.voxels.shape, connectivity=settings.connectivity
        )
        point = volume.to_lps(where)
    curve = GrowthCurve(
        varied=settings.varied,
        limits=sign * limits,
        volumes_ml=volumes,
        chosen=float(sign * limits[chosen]),
        leak_limit=None if leak is None else float(sign * limits[leak]),
        leak_voxel=where,
        leak_point=point,
    )
    index = np.column_stack(np.unravel_index(np.concatenate(flooded.joined[: chosen + 1]), volume.voxels.shape))
    first = index.min(axis=0)
    mask = np.zeros(index.max(axis=0) + 1 - first, dtype=bool)
    mask[tuple((index - first).T)] = True
    return _region(volume, seed, mask, (int(first[0]), int(first[1]), int(first[2])), settings, curve)


def _before_leak(
    leak: int,
    limits: FloatArray,
    volumes: FloatArray,
    flooded: Flood,
    settings: GrowthSettings,
    seed_hu: float,
) -> int:
    """Index of the limit to use when the region leaks at `limits[leak]`, told in terms of a dark lumen."""
    # The lumen's own grey is taken a margin before the leak, where what leaks has hardly begun to join.
    chosen = int(np.searchsorted(limits, limits[leak] - settings.leak.margin, side="right")) - 1
    lumen = np.concatenate(flooded.values[: max(chosen + 1, 1)])
    median = float(np.median(lumen)) / STEPS_PER_HU if len(lumen) else limits[0]
    margin = max(settings.leak.margin, settings.leak.margin_share * (limits[leak] - median))
    chosen = int(np.searchsorted(limits, limits[leak] - margin, side="right")) - 1
    sign = -1 if settings.varied == "hu_min" else 1
    if chosen < 0 or volumes[chosen] < 0.5 * min(volumes[leak - 1], settings.leak.volume_min):
        raise RegionError(
            f"the region leaks at {sign * limits[leak]:.0f} HU, from {volumes[leak - 1]:.2f} to over {volumes[leak]:.0f} ml, "
            f"too close to the seed's {seed_hu:.0f} HU to stop before it; "
            "smooth the image first, move the seed to the middle of the lumen, or give the limit"
        )
    return chosen


def _check_seed(volume: Volume, seed: tuple[int, int, int], settings: GrowthSettings) -> float:
    """The seed's HU as grown; a seed outside the limits is refused and the nearest voxel inside is named."""
    low, high = settings.hu_min * STEPS_PER_HU, settings.hu_max * STEPS_PER_HU
    values = GrowingVoxels(volume=volume, smoothing=settings.smoothing)
    reach = np.ceil(NEAR / volume.spacing).astype(int)
    lower, upper = np.maximum(np.array(seed) - reach, 0), np.minimum(np.array(seed) + reach + 1, volume.voxels.shape)
    first, second, third = (slice(int(a), int(b)) for a, b in zip(lower, upper, strict=True))
    box = values[first, second, third]
    grey = float(box[tuple(np.array(seed) - lower)])
    if low <= grey <= high:
        return grey / STEPS_PER_HU
    inside = np.argwhere((box >= low) & (box <= high)) + lower
    hint = f"no voxel within {NEAR:g} mm lies between them; check the seed and the limits"
    if len(inside):
        away = np.linalg.norm((inside - seed) * volume.spacing, axis=1)
        nearest = int(np.argmin(away))
        point = ", ".join(f"{x:.1f}" for x in volume.to_lps(inside[nearest]))
        hint = (
            f"the nearest voxel between them is {away[nearest]:.1f} mm away at LPS ({point}) mm: "
            "take it as the seed if that is the lumen"
        )
    smoothed = " after smoothing" if settings.smoothing > 0 else ""
    raise RegionError(
        f"nothing grows: the seed has {grey / STEPS_PER_HU:.0f} HU{smoothed}, "
        f"outside the limits {settings.hu_min:g} to {settings.hu_max:g} HU; {hint}"
    )


def _too_much(volume: Volume, seed_hu: float, settings: GrowthSettings) -> str:
    whole = volume.voxels.size * volume.voxel_ml
    return (
        f"the region leaks: between {settings.hu_min:g} and {settings.hu_max:g} HU it holds more than "
        f"{settings.leak.volume_max:.0f} ml (the whole image {whole:.0f} ml, the seed {seed_hu:.0f} HU); "
        "tighten the limits, or let one be chosen with 'auto'"
    )


def _region(
    volume: Volume,
    seed: tuple[int, int, int],
    mask: BoolArray,
    lower: tuple[int, int, int],
    settings: GrowthSettings,
    curve: GrowthCurve | None,
) -> Region:
    """The grown voxels, given in a box from `lower` on, as a cropped mask with what it touches."""
    shape = volume.voxels.shape
    ends = bounding_box(mask)
    grown = mask[tuple(slice(a, b + 1) for a, b in ends)]
    first = ends[:, 0] + lower
    border = {}
    for axis, names in enumerate(FACES):
        for name, place, at in zip(
            names, (0, -1), (first[axis] == 0, ends[axis, 1] + lower[axis] == shape[axis] - 1), strict=True
        ):
            if at:
                border[name] = int(np.count_nonzero(grown.take(place, axis=axis)))
    origin = np.maximum(first - 1, 0)
    past = np.minimum(first + grown.shape + 1, shape)
    hu_min, hu_max = settings.hu_min, settings.hu_max
    if curve is not None:
        hu_min, hu_max = (curve.chosen, hu_max) if curve.varied == "hu_min" else (hu_min, curve.chosen)
    return Region(
        mask=np.pad(grown, np.column_stack([first - origin, past - first - grown.shape])),
        lower=(int(origin[0]), int(origin[1]), int(origin[2])),
        seed=seed,
        hu_min=max(hu_min, float(HU_LOWEST)),
        hu_max=min(hu_max, float(HU_HIGHEST)),
        volume_ml=np.count_nonzero(grown) * volume.voxel_ml,
        border=border,
        curve=curve,
        smoothing=settings.smoothing,
    )
