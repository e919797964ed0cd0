"""Urinary tract filled with contrast medium: a bright lumen inside the kidney, found without a hand."""

# Strategy: at 250 HU an excretory-phase CT shows the collecting system, bone and metal. Bone lies in
# muscle and fat; calyces and pelvis lie in the kidney, whose enhanced parenchyma (100 to 250 HU) is
# the only large tissue of that brightness. So each bright body is judged by the share of its
# neighbourhood, a few mm out, that is parenchyma; its deepest voxel is the seed.

from __future__ import annotations

import numpy as np
from scipy import ndimage

from segmentation.anatomy.preset import Preset
from segmentation.errors import RegionError
from segmentation.leak import LeakRule
from segmentation.smoothing import block_mean
from segmentation.volume import Volume

# 100 HU lies below enhanced parenchyma, so the search meets the leak into it. That leak comes by
# degrees, first through noise; 0.35 of the way back to the lumen is clear of it (no tunnel in the
# generated urography, 18 of them at 20 HU from the leak). The wall is then moved to half maximum.
URINARY = Preset(
    name="urinary",
    lumen="bright",
    hu_min="auto",
    hu_max=3071.0,
    loosest=100.0,
    half_maximum=True,
    leak=LeakRule(volume_min=1.0, volume_max=80.0, jump=8.0, margin_share=0.35),
)

BRIGHT = 250.0
PARENCHYMA = (100.0, 250.0)
COARSE = 1.4
# The ring in which parenchyma is looked for, beyond partial volume at the body's own edge.
RING = (2.0, 5.0)
VOLUME_MIN = 0.3
# On the generated urography the collecting system has 0.53, bone at most 0.13.
SHARE_MIN = 0.3


def find_collecting_system(volume: Volume) -> tuple[int, int, int]:
    """A voxel in the middle of the widest part of the contrast-filled collecting system.

    Of two kidneys it is the one with more contrast medium.

    Parameters
    ----------
    volume : Volume

    Returns
    -------
    (3,) int tuple
        ``[slice, row, column]``.

    Raises
    ------
    RegionError
        If no bright body lies in enhanced parenchyma.
    """
    factor = np.maximum(np.round(COARSE / volume.spacing), 1).astype(int)
    image = block_mean(volume.voxels, (int(factor[0]), int(factor[1]), int(factor[2])))
    step = volume.spacing * factor
    labels, _ = ndimage.label(image >= BRIGHT)
    sizes = np.bincount(labels.ravel()) * float(np.prod(step)) / 1000.0
    boxes = ndimage.find_objects(labels)
    reach = np.ceil((RING[1] + step) / step).astype(int)
    best, best_share, place = 0.0, 0.0, (0, 0, 0)
    bodies = [int(part) for part in np.flatnonzero((sizes >= VOLUME_MIN) & (sizes <= URINARY.leak.volume_max)) if part]
    for part in bodies:
        wide = tuple(slice(max(s.start - r, 0), s.stop + r) for s, r in zip(boxes[part - 1], reach, strict=True))
        body = labels[wide] == part
        away = ndimage.distance_transform_edt(~body, sampling=step)
        ring = image[wide][(away >= RING[0]) & (away <= RING[1])]
        share = float(np.mean((ring >= PARENCHYMA[0]) & (ring < PARENCHYMA[1]))) if ring.size else 0.0
        if share >= SHARE_MIN and share * sizes[part] > best:
            depth = ndimage.distance_transform_edt(body, sampling=step)
            deepest = np.unravel_index(int(np.argmax(depth)), depth.shape)
            place = (int(deepest[0]) + wide[0].start, int(deepest[1]) + wide[1].start, int(deepest[2]) + wide[2].start)
            best = share * sizes[part]
        best_share = max(best_share, share)
    if best == 0.0:
        raise RegionError(
            f"no collecting system found: of {len(bodies)} bodies above {BRIGHT:g} HU the best has "
            f"{100 * best_share:.0f} % enhanced kidney around it, expected at least {100 * SHARE_MIN:.0f} %; "
            "give a point in the lumen with --seed-point"
        )
    middle = (np.array(place) + 0.5) * factor - 0.5
    # A block's brightest voxel near its middle is inside even where a calyx is narrow.
    lower = np.maximum(np.floor(middle - 0.5 * factor + 0.5), 0).astype(int)
    block = volume.voxels[tuple(slice(lo, lo + int(f)) for lo, f in zip(lower, factor, strict=True))]
    inside = np.unravel_index(int(np.argmax(block)), block.shape)
    return int(lower[0] + inside[0]), int(lower[1] + inside[1]), int(lower[2] + inside[2])
