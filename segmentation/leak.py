"""Where a grown volume explodes as its limit is loosened, and which limit to use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.arrays import FloatArray, IntArray, VoxelArray


@dataclass(frozen=True, kw_only=True)
class LeakRule:
    """What counts as a leak, and how far before it the limit is set.

    Attributes
    ----------
    volume_min : float, ml
        Growth is not judged before the region holds this much: a seed's pocket joining
        its own lumen is a large step too.
    volume_max : float, ml
        More than any lumen of this anatomy; a region beyond it has leaked.
    jump : float, ml
        Least step that counts as an explosion. On the four real airways the step is 360 ml
        and more (the flood is stopped there), the largest step without a leak 2 ml.
    factor : float
        Least ratio of the volumes before and after an explosion.
    onset : float
        Where a leak comes by degrees, it begins where the volume grows by this ratio over `window`: the
        kidney around a collecting system joins so, by noise first.
    window : int, HU
        The step is taken over this many HU, since a leak through several weak voxels
        may take a few.
    margin : float, HU
        Least distance of the chosen limit to the leak. With 10 HU of noise added, the leak limits of
        three real airways moved by 1.5 to 5 HU (standard deviation): 20 HU is four times that.
    margin_share : float
        The distance as a share of the way from the lumen's median to the leak, if that is more.
    """

    volume_min: float
    volume_max: float
    jump: float
    factor: float = 1.5
    onset: float = 1.25
    window: int = 5
    margin: float = 20.0
    margin_share: float = 0.15


def leak_index(volumes: FloatArray, rule: LeakRule, *, first: int = 0) -> int | None:
    """Index of the first limit, from tight to loose, at which the region has leaked.

    Parameters
    ----------
    volumes : (n,) float array, ml
        Grown volume at limits 1 HU apart, rising.
    rule : LeakRule
    first : int
        Steps at limits before this one are no explosions: the lumen itself joins there, see `noise_end`.

    Returns
    -------
    int or None
        None when the volume never explodes nor passes `rule.volume_max`.
    """
    steepest = None
    for index in range(1, len(volumes)):
        before = volumes[max(index - rule.window, min(first, index)) : index]
        before = before[before >= rule.volume_min]
        if np.any((volumes[index] - before > rule.jump) & (volumes[index] > rule.factor * before)):
            steepest = index - len(before) + 1 + int(np.argmax(np.diff(volumes[index - len(before) : index + 1])))
            break
        if volumes[index] > rule.volume_max:
            # A slow leak: its steepest part lies on the way to the impossible volume.
            start = min(first, index - 1)
            steepest = 1 + start + int(np.argmax(np.diff(volumes[start : index + 1])))
            break
    return None if steepest is None else _onset(volumes, steepest, rule, first)


def noise_end(values: Sequence[VoxelArray], limits: IntArray, noise: float) -> int:
    """Index of the first limit that lies clear of the lumen's own noise.

    Within its noise a lumen joins by percolation, almost all of it within a few HU, which is as steep
    as any leak. Three standard deviations above the median of what is held all of it has joined.

    Parameters
    ----------
    values : sequence of (n,) int16 arrays
        Grey values that joined at each limit, lower is further inside.
    limits : (m,) int array
        Rising, in the unit of `values`.
    noise : float
        Standard deviation, in the same unit.

    Returns
    -------
    int
        The number of limits reached when none is.
    """
    lowest = min((int(part.min()) for part in values if len(part)), default=0)
    counts = np.zeros(int(limits[-1]) - lowest + 1, dtype=np.int64)
    for index, (part, limit) in enumerate(zip(values, limits, strict=False)):
        counts += np.bincount(part.astype(np.int64) - lowest, minlength=len(counts))
        held = np.cumsum(counts)
        if held[-1] and limit >= lowest + int(np.searchsorted(held, 0.5 * held[-1])) + 3.0 * noise:
            return index
    return len(values)


def _onset(volumes: FloatArray, steepest: int, rule: LeakRule, earliest: int) -> int:
    """Back from the steepest step of a leak to where the volume began to run away."""
    index = steepest
    while (
        index > max(rule.window, earliest + 1)
        and volumes[index - rule.window] >= rule.volume_min
        and volumes[index] >= rule.onset * volumes[index - rule.window]
    ):
        index -= 1
    first = index if index == steepest else index + 1
    # The limit named as the leak is one at which voxels join.
    return first + int(np.argmax(np.diff(volumes[first - 1 : steepest + 1]) > 0))


def leak_voxel(
    joined: IntArray, held: IntArray, values: VoxelArray, shape: tuple[int, int, int], *, connectivity: int
) -> tuple[int, int, int]:
    """The voxel through which the leak begins.

    Of the voxels that joined at the leaking limit, the largest connected part is the
    leak; its lowest voxel that touches the region before is the gap in the wall.

    Parameters
    ----------
    joined, held : (n,) and (m,) int array
        Flat indices of the voxels that joined at the leaking limit, and before it.
    values : (n,) int16 array
        Grey values of `joined`, lower is further inside.
    shape : (3,) int tuple
        Shape of the image.
    connectivity : {6, 26}
        As grown.
    """
    index = np.column_stack(np.unravel_index(joined, shape))
    lower = np.maximum(index.min(axis=0) - 1, 0)
    upper = np.minimum(index.max(axis=0) + 2, shape)
    box = np.zeros(upper - lower, dtype=bool)
    box[tuple((index - lower).T)] = True
    structure = ndimage.generate_binary_structure(3, 1 if connectivity == 6 else 3)
    labels, count = ndimage.label(box, structure)
    label = labels[tuple((index - lower).T)]
    largest = 1 + int(np.argmax(np.bincount(label, minlength=count + 1)[1:]))

    before = np.column_stack(np.unravel_index(held, shape))
    before = before[np.all((before >= lower) & (before < upper), axis=1)] - lower
    box[:] = False
    box[tuple(before.T)] = True
    touching = ndimage.binary_dilation(box, structure)[tuple((index - lower).T)]
    gate = np.flatnonzero((label == largest) & touching)
    chosen = index[gate[np.argmin(values[gate])]]
    return int(chosen[0]), int(chosen[1]), int(chosen[2])
