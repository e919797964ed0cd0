"""Slice positions to one affine, or the reason why they make none.

highdicom orders the slices and builds the affine; the gate's own rules decide
before that whether the positions are those of one uniform stack. SliceThickness is
never used: it says how thick a slice is, not how far the next one lies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from highdicom.spatial import get_volume_positions
from highdicom.volume import VolumeGeometry

from segmentation.arrays import FloatArray, frozen_array
from segmentation.dicom.headers import SliceHeader
from segmentation.errors import SeriesError

MIN_SPACING, MAX_SPACING = 0.05, 5.0
MAX_RESIDUAL = 0.1
"""Of the spacing: how far a slice may lie from the uniform line."""
MAX_GAP = 1.5
"""Of the median gap: a larger one is a missing slice."""
MAX_DRIFT = 0.2
"""mm: how far slices may wander sideways from the stack's normal."""
_UNIT_TOLERANCE = 2e-4


@dataclass(frozen=True, eq=False)
class Stack:
    """A uniform stack of slices.

    Attributes
    ----------
    order : tuple of int
        ``order[k]`` is the place in the given sequence of the slice with index ``k``.
    index_to_lps : (4, 4) float array, mm
    residual : float, mm
        Largest distance of a slice's own position from where the affine puts it.
    """

    order: tuple[int, ...]
    index_to_lps: FloatArray
    residual: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "index_to_lps", frozen_array(self.index_to_lps, (4, 4), "index_to_lps"))


def build_stack(slices: Sequence[SliceHeader]) -> Stack:
    """Order the slices and build the affine of their volume.

    Parameters
    ----------
    slices : sequence of SliceHeader
        One series, any order, any orientation.

    Raises
    ------
    SeriesError
        If positions, orientation or spacing are missing, implausible or not those of a
        uniform, straight stack of at least three slices. The message lacks the folder.
    """
    if len(slices) < 3:
        raise SeriesError(f"the series has {len(slices)} slices, expected at least 3; export all of it")
    spacing = _one_spacing(slices)
    row, column = _one_orientation(slices)
    positions = _positions(slices)  # (n, 3)
    depth = positions @ np.cross(column, row)  # (n,)
    order = np.argsort(depth, kind="stable")
    _check_gaps([slices[k] for k in order], depth[order])
    _check_straight([slices[k] for k in order], positions[order], np.cross(column, row))
    _check_uniform([slices[k] for k in order], depth[order])

    orientation = [*row, *column]
    # The tolerances are wide because the rules above, which name the slice, have decided.
    between, places = get_volume_positions(positions, orientation, rtol=0.3, perpendicular_tol=0.1)
    if between is None or places is None:
        raise SeriesError("the slice positions make no regular volume; export the series again")
    order = np.argsort(places)
    rows, columns = slices[0].matrix
    geometry = VolumeGeometry.from_attributes(
        image_position=positions[order[0]].tolist(),
        image_orientation=orientation,
        rows=rows,
        columns=columns,
        pixel_spacing=spacing,
        spacing_between_slices=between,
        number_of_frames=len(slices),
        coordinate_system="PATIENT",
    )
    affine = np.asarray(geometry.affine, dtype=float)
    expected = np.arange(len(slices))[:, None] * affine[:3, 0] + affine[:3, 3]
    residual = float(np.linalg.norm(positions[order] - expected, axis=1).max())
    if residual > MAX_DRIFT + MAX_RESIDUAL * between:
        raise SeriesError(f"a slice lies {residual:.2f} mm from its place in the volume; export the series again")
    return Stack(tuple(int(k) for k in order), affine, residual)


def _one_spacing(slices: Sequence[SliceHeader]) -> tuple[float, float]:
    first = slices[0].spacing or (math.nan, math.nan)
    for slice_ in slices:
        if slice_.spacing is None or not all(math.isfinite(value) for value in slice_.spacing):
            raise SeriesError(f"{slice_.name} has no usable PixelSpacing; export it again")
        if not all(MIN_SPACING <= value <= MAX_SPACING for value in slice_.spacing):
            raise SeriesError(
                f"{slice_.name} has pixels of {slice_.spacing[0]:g} x {slice_.spacing[1]:g} mm, "
                f"expected {MIN_SPACING} to {MAX_SPACING:g} mm; its header is damaged"
            )
        if any(abs(a - b) > 1e-4 * b for a, b in zip(slice_.spacing, first, strict=True)):
            raise SeriesError(f"{slice_.name} has another pixel spacing than {slices[0].name}; separate the reconstructions")
    return first[0], first[1]


def _one_orientation(slices: Sequence[SliceHeader]) -> tuple[FloatArray, FloatArray]:
    first = slices[0].orientation or ()
    for slice_ in slices:
        axes = slice_.orientation
        if axes is None or not all(math.isfinite(value) for value in axes):
            raise SeriesError(f"{slice_.name} has no usable ImageOrientationPatient; export it again")
        row, column = np.array(axes[:3]), np.array(axes[3:])
        fault = max(abs(np.linalg.norm(row) - 1), abs(np.linalg.norm(column) - 1), abs(row @ column))
        if fault > _UNIT_TOLERANCE:
            raise SeriesError(f"{slice_.name} has image axes that are not two perpendicular unit vectors (off by {fault:.2g})")
        if max(abs(a - b) for a, b in zip(axes, first, strict=True)) > 1e-4:
            raise SeriesError(f"{slice_.name} is turned against {slices[0].name}; separate the reconstructions")
    left, _, right = np.linalg.svd(np.reshape(first, (2, 3)), full_matrices=False)
    row, column = left @ right  # nearest orthonormal pair: headers carry few decimals
    return row, column


def _positions(slices: Sequence[SliceHeader]) -> FloatArray:
    for slice_ in slices:
        if slice_.position is None or not all(math.isfinite(value) and abs(value) < 1e5 for value in slice_.position):
            raise SeriesError(f"{slice_.name} has no usable ImagePositionPatient; export it again")
    return np.array([slice_.position for slice_ in slices], dtype=float)


def _check_gaps(ordered: Sequence[SliceHeader], depth: FloatArray) -> None:
    gaps = np.diff(depth)
    median = float(np.median(gaps))
    doubled = np.flatnonzero(gaps < max(0.01, 0.1 * median))
    if len(doubled):
        k = int(doubled[0])
        raise SeriesError(
            f"{ordered[k].name} and {ordered[k + 1].name} lie at the same place ({len(doubled)} such pairs); "
            "two phases or reconstructions are mixed, separate them"
        )
    if not MIN_SPACING <= median <= MAX_SPACING:
        raise SeriesError(
            f"the slices are {median:.3g} mm apart, expected {MIN_SPACING} to {MAX_SPACING:g} mm; choose a thinner series"
        )
    k = int(np.argmax(gaps))
    if gaps[k] > MAX_GAP * median:
        raise SeriesError(
            f"{ordered[k].name} and {ordered[k + 1].name} are {gaps[k]:.2f} mm apart, the others {median:.2f} mm; "
            "a slice is missing, export the series again"
        )


def _check_straight(ordered: Sequence[SliceHeader], positions: FloatArray, normal: FloatArray) -> None:
    sideways = positions - np.outer(positions @ normal, normal)  # (n, 3)
    wander = np.linalg.norm(sideways - sideways[0], axis=1)
    if wander.max() <= MAX_DRIFT:
        return
    depth = positions @ normal
    centred = depth - depth.mean()
    slope = centred @ sideways / (centred @ centred)  # (3,) mm sideways per mm of depth
    straight = sideways.mean(axis=0) + np.outer(centred, slope)
    if np.linalg.norm(sideways - straight, axis=1).max() <= MAX_DRIFT:
        angle = math.degrees(math.atan(float(np.linalg.norm(slope))))
        raise SeriesError(
            f"the slices are stacked at {angle:.1f} degrees to their normal (gantry tilt); "
            "a straight volume is needed, reconstruct or resample the series without tilt"
        )
    step = int(np.argmax(np.linalg.norm(np.diff(sideways, axis=0), axis=1)))
    raise SeriesError(
        f"the slices wander {wander.max():.2f} mm sideways, most from {ordered[step].name} to {ordered[step + 1].name}, "
        f"expected at most {MAX_DRIFT} mm; export the series again"
    )


def _check_uniform(ordered: Sequence[SliceHeader], depth: FloatArray) -> None:
    line = np.linspace(depth[0], depth[-1], len(depth))
    off = np.abs(depth - line)
    between = float((depth[-1] - depth[0]) / (len(depth) - 1))
    k = int(np.argmax(off))
    if off[k] > MAX_RESIDUAL * between:
        gaps = np.diff(depth)
        raise SeriesError(
            f"the gaps between slices vary from {gaps.min():.2f} to {gaps.max():.2f} mm and {ordered[k].name} "
            f"lies {off[k]:.2f} mm from a uniform stack, expected at most {MAX_RESIDUAL * between:.2f} mm; "
            "choose a series of even spacing"
        )
