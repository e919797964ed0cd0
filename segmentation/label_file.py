"""Masks that the user brings, from NIfTI, MetaImage or DICOM SEG, laid onto the CT's grid."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from segmentation.arrays import BoolArray, FloatArray
from segmentation.dicom.seg_reader import read_segments
from segmentation.errors import CaseError
from segmentation.volume import Volume
from segmentation.volume_files import VOLUME_SUFFIXES, read_volume_file

_OFF = 0.1
"""Share of a voxel by which a mask's grid may miss the CT's. Writers that keep four digits behind the point are off by half
of the last one at each step: 0.05 mm over a thousand voxels, a tenth of the finest voxel of a CT, which moves no voxel of the
mask."""


def read_mask(path: Path, volume: Volume, *, label: str | int | None = None) -> BoolArray:
    """A mask on the voxels of a CT; see `read_mask_file`."""
    return read_mask_file(path, volume, label=label)[0]


def read_mask_file(
    path: Path, volume: Volume, *, label: str | int | None = None
) -> tuple[BoolArray, tuple[tuple[str, str], ...]]:
    """A mask on the voxels of a CT, and name and SHA-256 of each file that was read.

    Parameters
    ----------
    path : Path
        ``.nii``, ``.nii.gz``, ``.mha``, ``.mhd`` or a DICOM SEG file.
    volume : Volume
        The CT.
    label : str or int, optional
        Which value (NIfTI, MetaImage) or which segment, by number or label (DICOM SEG); without it every value but 0, and the
        only segment.

    Raises
    ------
    VolumeError, SeriesError
        If the file cannot be read.
    CaseError
        If the label is not in it, or its grid is not the CT's.
    """
    if path.name.lower().endswith(VOLUME_SUFFIXES):
        file = read_volume_file(path, labels=True)
        mask = file.voxels != 0 if label is None else file.voxels == _number(path, label)
        return onto_grid(mask, file.index_to_lps, volume, path.name), file.inputs
    segments = read_segments(path)
    chosen = [s for s in segments if label is None or label in (s.number, s.label) or str(s.number) == label]
    if len(chosen) != 1:
        names = ", ".join(f"{s.number} ({s.label})" for s in segments)
        wanted = "one of them has to be named" if label is None else f"{label!r} was asked for"
        raise CaseError(f"{path.name}: holds the segments {names}; {wanted}")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return onto_grid(chosen[0].mask, chosen[0].index_to_lps, volume, path.name), ((path.name, digest),)


def onto_grid(mask: BoolArray, index_to_lps: FloatArray, volume: Volume, name: str) -> BoolArray:
    """A mask on the CT's whole grid, whatever the order and direction of its axes; it may cover a part of it.

    Parameters
    ----------
    mask : (slices, rows, columns) bool array
    index_to_lps : (4, 4) float array
        Of the mask's own voxels.
    volume : Volume
        The CT.
    name : str
        Of the mask's file, for messages.

    Raises
    ------
    CaseError
        If its voxels are not those of the CT, it reaches out of the CT, or it holds none.
    """
    step = volume.lps_to_index @ index_to_lps
    turn = np.rint(step[:3, :3])
    corners = np.array([[0, 0, 0], np.array(mask.shape) - 1])
    placed = corners @ step[:3, :3].T + step[:3, 3]
    exact = corners @ turn.T + np.rint(step[:3, 3])
    if np.abs(turn @ turn.T - np.eye(3)).max() > 0.0 or np.abs(placed - exact).max() > _OFF:
        have, want = (
            " x ".join(f"{s:.2f}" for s in spacing) for spacing in (np.linalg.norm(index_to_lps[:3, :3], axis=0), volume.spacing)
        )
        off = float(np.abs(placed - np.rint(placed)).max())
        raise CaseError(
            f"{name}: lies on another grid than the CT (voxels of {have} mm, the CT's {want} mm, up to {off:.2f} voxels off); "
            "save it on the grid of this CT"
        )
    low, high = exact.min(axis=0).astype(int), exact.max(axis=0).astype(int) + 1
    if np.any(low < 0) or np.any(high > volume.voxels.shape):
        have, want = (" x ".join(map(str, shape)) for shape in (mask.shape, volume.voxels.shape))
        raise CaseError(f"{name}: reaches out of the CT ({have} voxels, the CT {want}); save it on the grid of this CT")
    if not mask.any():
        raise CaseError(f"{name}: the mask holds no voxel; draw it again")
    axes = np.abs(turn).argmax(axis=1)  # which of the mask's axes runs along each of the CT's
    turned = mask.transpose(axes)
    turned = turned[tuple(slice(None, None, int(turn[k, axes[k]])) for k in range(3))]
    out = np.zeros(volume.voxels.shape, dtype=bool)
    out[tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))] = turned
    return out


def _number(path: Path, label: str | int) -> int:
    try:
        return int(label)
    except ValueError:
        raise CaseError(f"{path.name}: label {label!r} is no number, and this kind of file has no names; give a number") from None
