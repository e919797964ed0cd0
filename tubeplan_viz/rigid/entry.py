"""The way in: start points, and the border that keeps the whole instrument within the entry region.

# Strategy: seen along the way to the lesion the region is a flat figure. The text dilates its edges by 3x3 and counts the
# new voxels as an obstacle. One voxel would hold a shaver in, but let an endoscope pass beyond it, 6 mm away; so the ring
# is dilated until it is as wide as the coupled instrument. Each of its voxels lies as deep as the nearest part of the region.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, binary_fill_holes, distance_transform_edt

from segmentation.anatomy.nasal.scene import EntryRegion
from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import CaseError
from segmentation.volume import Volume
from tubeplan_viz.rigid.instrument import UP, CoupledInstrument, unit

BORDER = "nostril border"


def entry_points(volume: Volume, region: EntryRegion) -> FloatArray:
    """Centres of the region's voxels, (n, 3) LPS mm: the starts that are tried.

    Raises
    ------
    CaseError
        If the region has none.
    """
    index = np.argwhere(region.widened)
    if not len(index):
        raise CaseError(f"the {region.side} entry region is empty; mark it by hand (a mask or a box)")
    return volume.to_lps(index)


def entry_border(volume: Volume, region: EntryRegion, goal: FloatArray, instrument: CoupledInstrument) -> BoolArray:
    """Voxels around the region that the instrument may not touch, (slices, rows, columns).

    Parameters
    ----------
    volume : Volume
    region : EntryRegion
    goal : (3,) float array, mm
        The lesion; the region is seen from the middle of the nostril towards it.
    instrument : CoupledInstrument
        Sets the width of the ring: nothing of it can pass outside while another part passes inside.
    """
    points = entry_points(volume, region)
    nostril = volume.to_lps(np.argwhere(region.nostril)) if region.nostril.any() else points
    middle = nostril.mean(axis=0)
    ahead = unit(goal - middle)
    across = unit(np.cross(ahead, UP) if abs(ahead @ UP) < 0.99 else np.cross(ahead, np.array([0.0, 1.0, 0.0])))
    basis = np.stack([across, np.cross(across, ahead), ahead])
    seen = (points - middle) @ basis.T
    pitch = float(volume.spacing.min())
    width = instrument.offset + instrument.scope_radius + instrument.shaver_radius
    rounds = int(np.ceil(width / pitch))
    pad = rounds + 4
    low = seen[:, :2].min(axis=0) - pad * pitch
    pixel = np.rint((seen[:, :2] - low) / pitch).astype(int)
    shape = tuple(pixel.max(axis=0) + pad + 1)
    total, count = np.zeros(shape), np.zeros(shape)
    np.add.at(total, tuple(pixel.T), seen[:, 2])
    np.add.at(count, tuple(pixel.T), 1.0)
    square = np.ones((3, 3), dtype=bool)
    # Voxels farther apart than a pixel leave holes in the figure.
    gaps = int(np.ceil(volume.spacing.max() / pitch))
    figure = binary_fill_holes(binary_closing(count > 0.0, square, iterations=gaps))
    ring = binary_dilation(figure, square, iterations=rounds) & ~figure
    nearest = distance_transform_edt(count == 0.0, return_distances=False, return_indices=True)
    depth = (total / np.maximum(count, 1.0))[tuple(nearest)]
    border = np.zeros(volume.voxels.shape, dtype=bool)
    # Half a pixel apart, so that the marked voxels leave no hole.
    for shift in np.stack(np.meshgrid([0.0, 0.5], [0.0, 0.5]), axis=-1).reshape(-1, 2):
        flat = np.argwhere(ring)
        place = np.column_stack([low + (flat + shift) * pitch, depth[tuple(flat.T)]]) @ basis + middle
        index = np.rint(volume.to_index(place)).astype(int)
        inside = ((index >= 0) & (index < np.array(border.shape))).all(axis=1)
        border[tuple(index[inside].T)] = True
    return np.asarray(border & ~region.widened)
