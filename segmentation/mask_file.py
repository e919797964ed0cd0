"""The grown lumen as a NIfTI mask in the grid of its CT."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import SimpleITK as sitk

from segmentation.region_growing import Region
from segmentation.volume import Volume


def write_mask(region: Region, volume: Volume, path: Path) -> None:
    """Write the region as an 8-bit image, 1 inside and 0 outside, on the CT's whole grid.

    Opens over the CT in 3D Slicer and other viewers as it is.
    """
    full = np.zeros(volume.voxels.shape, dtype=np.uint8)
    lower = np.array(region.lower)
    upper = lower + region.mask.shape
    full[lower[0] : upper[0], lower[1] : upper[1], lower[2] : upper[2]] = region.mask
    image = sitk.GetImageFromArray(full)
    # SimpleITK counts axes x first, which is column, row, slice here.
    spacing = volume.spacing[::-1]
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(volume.index_to_lps[:3, 3].tolist())
    image.SetDirection((volume.index_to_lps[:3, 2::-1] / spacing).ravel().tolist())
    sitk.WriteImage(image, str(path), useCompression=True)
