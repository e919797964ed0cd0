"""The air inside a head, told from the air around it: what a picture of the nose may show without a face."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from segmentation.anatomy.nasal import solids
from segmentation.anatomy.nasal.scene import NasalScene, Tissue
from segmentation.anatomy.nasal.upright import Upright
from segmentation.arrays import BoolArray

SEAL_MM = 8.0
"""Radius that closes nostrils (up to 15 mm wide) and leaves the hollow beside the nose open."""
CELL_MM = 1.5
"""Voxels are taken together up to this side: the border between inside and outside lies in the nostrils, wherever exactly."""


def inner_air(scene: NasalScene) -> BoolArray:
    """Air voxels that lie inside once the nostrils are closed: cavities of the nose and its sinuses, mouth, throat.

    Parameters
    ----------
    scene : NasalScene
        Only its tissue is read; after shrinkage what the mucosa left is air too.

    Returns
    -------
    (slices, rows, columns) bool array
        On the voxels of the scene's volume.
    """
    upright = Upright(scene.volume)
    air = upright.turn(scene.tissue == Tissue.AIR)
    step = np.maximum(np.floor(CELL_MM / upright.spacing).astype(int), 1)
    cells = ~air[:: step[0], :: step[1], :: step[2]]
    sealed = solids.closed(cells, SEAL_MM, upright.spacing * step)
    # A scan ends above and below in the head; in front, behind and beside it there is air.
    outside, _ = ndimage.label(~np.pad(sealed, ((0, 0), (1, 1), (1, 1))))
    inside = (outside != outside[0, 0, 0])[:, 1:-1, 1:-1]
    for axis, count in enumerate(step):
        inside = np.repeat(inside, count, axis=axis)
    return np.asarray(upright.restore(air & inside[: air.shape[0], : air.shape[1], : air.shape[2]]))
