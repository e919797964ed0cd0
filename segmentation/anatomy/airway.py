"""Airways: a dark lumen that starts in the trachea, which is found without a hand."""

# Strategy: in slices across the body the trachea is a small, compact, nearly black patch ringed by
# soft tissue, and it stays in place from slice to slice for centimetres. Lung is larger and ringed by
# lung, air outside the body is larger or open, gas in the bowel changes from slice to slice. Patches
# are found on voxels of about 1.8 mm, linked downwards by overlap, and the chain with the largest
# score (length times how well the ring is tissue) is the trachea; its middle slice gives the seed.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.anatomy.preset import Preset
from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import RegionError
from segmentation.leak import LeakRule
from segmentation.smoothing import block_mean
from segmentation.volume import Volume

# -650 HU: halfway between air at -1000 and a thin wall seen at -300; beyond it a trachea
# grows by partial volume alone (18 to 22 ml in a scan without any leak).
AIRWAY = Preset(
    name="airway",
    lumen="dark",
    hu_min=-1024.0,
    hu_max="auto",
    loosest=-650.0,
    leak=LeakRule(volume_min=3.0, volume_max=150.0, jump=10.0),
)

# A patch of the trachea: lumen diameters of adults lie between 10 and 27 mm (Breatnach et al.,
# AJR 142 (1984) 903-906); a cut by the image border or a coarse grid takes up to three quarters away.
AREA_MIN, AREA_MAX = 40.0, 700.0
AIR_MAX = -800.0
TISSUE_MIN = -400.0
RING = 4.0
RING_TISSUE_MIN = 0.3
COARSE = 1.8
LENGTH_MIN = 25.0
# Chains of the four real airways score 26 to 50, the best of an abdomen 7.
SCORE_MIN = 12.0
SHIFT_MAX = 1.2


@dataclass(frozen=True)
class _Patch:
    """One dark patch of one slice: centroid in mm from the first voxel, area in mm^2, and how much of its ring is tissue."""

    slice: int
    center: tuple[float, float]
    area: float
    tissue: float


def find_trachea(volume: Volume) -> tuple[int, int, int]:
    """A voxel in the middle of the trachea.

    Parameters
    ----------
    volume : Volume
        Axial or nearly so: the slice axis within 45 degrees of the body's long axis.

    Returns
    -------
    (3,) int tuple
        ``[slice, row, column]``.

    Raises
    ------
    RegionError
        If the slices are not axial, or no chain of patches is a trachea.
    """
    direction = volume.index_to_lps[:3, 0] / volume.spacing[0]
    if abs(direction[2]) < 0.7:
        raise RegionError("the trachea is looked for in axial slices and these are not; give a point in it with --seed-point")
    factor = np.maximum(np.round(COARSE / volume.spacing[1:]), 1).astype(int)
    coarse = block_mean(volume.voxels, (1, int(factor[0]), int(factor[1])))
    step = volume.spacing[1:] * factor
    chains = _linked([_patches(coarse[k], k, step) for k in range(len(coarse))], float(volume.spacing[0]))
    scored = [(_score(chain, float(volume.spacing[0])), number) for number, chain in enumerate(chains)]
    score, number = max(scored, default=(0.0, -1))
    if score < SCORE_MIN or _length(chains[number], float(volume.spacing[0])) < LENGTH_MIN:
        longest = max((_length(chain, float(volume.spacing[0])) for chain in chains), default=0.0)
        raise RegionError(
            f"no trachea found: the best dark column with tissue around it scores {score:.0f}, expected at least {SCORE_MIN:g} "
            f"(the longest is {longest:.0f} mm); give a point in the lumen with --seed-point"
        )
    chain = chains[number]
    return _core(volume, chain[len(chain) // 2], factor, step, float(np.sqrt(max(p.area for p in chain) / np.pi)))


def _patches(image: FloatArray, number: int, step: FloatArray) -> list[_Patch]:
    """Compact dark patches of one slice with tissue around them."""
    labels, count = ndimage.label(image <= AIR_MAX)
    if count == 0:
        return []
    pixel = float(np.prod(step))
    areas = np.bincount(labels.ravel(), minlength=count + 1) * pixel
    found = []
    boxes = ndimage.find_objects(labels)
    reach = np.ceil(np.maximum(RING, 1.5 * step.max()) / step).astype(int)
    pad = [(int(r), int(r)) for r in reach]
    padded, padded_labels = np.pad(image, pad, constant_values=AIR_MAX), np.pad(labels, pad)
    for part in np.flatnonzero((areas >= AREA_MIN) & (areas <= AREA_MAX)):
        if part == 0:
            continue
        box = boxes[part - 1]
        sides = [(s.stop - s.start) * d for s, d in zip(box, step, strict=True)]
        if max(sides) > 3.0 * max(min(sides), float(step.max())) or areas[part] < 0.45 * sides[0] * sides[1]:
            continue
        at_border = sum(int(s.start == 0) + int(s.stop == n) for s, n in zip(box, image.shape, strict=True))
        if at_border > 1:
            continue
        # Beyond the image's border nothing is known to be tissue.
        wide = tuple(slice(s.start, s.stop + 2 * r) for s, r in zip(box, reach, strict=True))
        patch = padded_labels[wide] == part
        ring = _grown(patch, step) & ~patch
        tissue = float(np.mean(padded[wide][ring] >= TISSUE_MIN))
        if tissue < RING_TISSUE_MIN:
            continue
        rows, columns = np.nonzero(patch)
        center = (
            float((rows.mean() + box[0].start - reach[0]) * step[0]),
            float((columns.mean() + box[1].start - reach[1]) * step[1]),
        )
        found.append(_Patch(number, center, float(areas[part]), tissue))
    return found


def _grown(patch: BoolArray, step: FloatArray) -> BoolArray:
    """The patch and everything within `RING` mm of it."""
    return np.asarray(ndimage.distance_transform_edt(~patch, sampling=step) <= max(RING, 1.5 * float(step.max())))


def _linked(slices: list[list[_Patch]], spacing: float) -> list[list[_Patch]]:
    """Chains of patches in neighbouring slices whose centres move at most `SHIFT_MAX` radii and whose areas are alike."""
    chains: list[list[_Patch]] = []
    open_chains: list[list[_Patch]] = []
    for patches in slices:
        free = list(patches)
        going_on = []
        for chain in sorted(open_chains, key=len, reverse=True):
            last = chain[-1]
            reach = SHIFT_MAX * float(np.sqrt(last.area / np.pi)) + spacing
            near = [p for p in free if p.area < 2.5 * last.area and last.area < 2.5 * p.area]
            if near:
                follow = min(near, key=lambda p: _apart(p, last))
                if _apart(follow, last) <= reach:
                    free.remove(follow)
                    chain.append(follow)
                    going_on.append(chain)
        new = [[patch] for patch in free]
        chains.extend(new)
        open_chains = going_on + new
    return chains


def _apart(one: _Patch, other: _Patch) -> float:
    return float(np.hypot(one.center[0] - other.center[0], one.center[1] - other.center[1]))


def _length(chain: list[_Patch], spacing: float) -> float:
    return len(chain) * spacing


def _score(chain: list[_Patch], spacing: float) -> float:
    """Length up to 120 mm, times the mean share of tissue in the rings squared, times the evenness of the areas."""
    areas = np.array([p.area for p in chain])
    even = float(1.0 / (1.0 + areas.std() / areas.mean()))
    return min(_length(chain, spacing), 120.0) * float(np.mean([p.tissue for p in chain])) ** 2 * even


def _core(volume: Volume, patch: _Patch, factor: FloatArray, step: FloatArray, radius: float) -> tuple[int, int, int]:
    """The voxel of the patch's slice that is farthest from anything that is not air."""
    row, column = ((np.array(patch.center) / step + 0.5) * factor - 0.5).round().astype(int)
    reach = np.ceil(1.5 * radius / volume.spacing[1:] + 2).astype(int)
    lower = np.maximum([row - reach[0], column - reach[1]], 0)
    image = volume.voxels[patch.slice, lower[0] : row + reach[0] + 1, lower[1] : column + reach[1] + 1]
    # A light median keeps single noisy voxels of a sharp kernel from splitting the lumen.
    air = ndimage.median_filter(np.maximum(image, -1024), 3, mode="nearest") <= AIR_MAX
    labels, _ = ndimage.label(air)
    center = labels[tuple(np.clip(np.array([row, column]) - lower, 0, np.array(air.shape) - 1))]
    if center:
        air = labels == center
    padded = np.pad(air, 1, mode="edge")
    depth = ndimage.distance_transform_edt(padded, sampling=volume.spacing[1:])[1:-1, 1:-1]
    place = np.unravel_index(int(np.argmax(depth)), depth.shape)
    return patch.slice, int(place[0] + lower[0]), int(place[1] + lower[1])
