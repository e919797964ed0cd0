"""The nasal septum: the sheet of soft tissue, cartilage and bone between the two airways of the nose.

Strategy: every line across the head meets the septum as a short run of tissue with air on both sides, near the plane of
symmetry. Runs of neighbouring lines that overlap form sheets; the septum is the one with the largest sagittal extent
close to the midline. Where a turbinate touches it the run is too long or missing; there the sheet is carried on from its
neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse

from segmentation.arrays import BoolArray, FloatArray, IntArray, VoxelArray

GAP_MAX = -200.0
"""Air gaps beside the septum are narrower than a voxel: half of the way between soft tissue and what is left of air there, HU."""
WIDTH_MAX = 10.0
"""Thickest septum, mm; with its swell body it measures up to 9 mm in adults."""
OFF_MAX = 11.0
"""Largest distance of the middle of the septum from the plane of symmetry, mm."""
SLOPE_MAX = 1.0
"""How far a side of the septum moves sideways per mm along the sheet."""
STRAY = 3.0
"""Farthest that a run lies off the smooth surface, mm: cells of the ethmoid hang on to the sheet."""
BEHIND_MAX = 18.0
"""How far the vomer reaches behind the lower end of the septum, mm."""
LOW = (0.02, 0.2)
"""The lower part of the septum, as quantiles of the height of its lines, without stray ones."""
BRIDGE = 8.0
"""Holes in the sheet, up to twice this wide, are carried over, mm."""
AREA_MIN = 400.0
"""Least sagittal area of a septum, mm^2; a whole one has about 2000 to 3500."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """The septum in a box of voxels.

    Attributes
    ----------
    mask : (up, back, left) bool array
    seen : (up, back) bool array
        Lines on which both sides of the septum border on air.
    carried : (up, back) bool array
        Lines on which it was carried on from neighbours.
    choana : float
        Index along back of the septum's lower rear end, where both airways join.
    """

    mask: BoolArray
    seen: BoolArray
    carried: BoolArray
    choana: float

    @property
    def confidence(self) -> float:
        """Share of the sheet that is bordered by air on both sides."""
        whole = int(np.count_nonzero(self.seen | self.carried))
        return float(np.count_nonzero(self.seen)) / whole if whole else 0.0


def find_septum(
    hu: VoxelArray, inside: BoolArray, across: FloatArray, spacing: FloatArray, *, seed: FloatArray | None = None
) -> Sheet | None:
    """The septum in a box about the nose; None where no sheet is large enough.

    Parameters
    ----------
    hu : (up, back, left) int16 array, HU
    inside : (up, back, left) bool array
        The head with its nostrils closed: air outside of it bounds no septum.
    across : (up, back, left) float array, mm
        Distance from the plane of symmetry, growing to the left.
    spacing : (3,) float array, mm
    seed : (3,) float array, optional
        A place in it, [up, back, left]; otherwise the largest sheet near the midline is taken.
    """
    tissue = (hu > GAP_MAX) | ~inside
    runs = _runs(tissue, across, float(spacing[2]))
    if not len(runs.first):
        return None
    sheet = _sheets(runs, tissue.shape, spacing)
    middle = np.abs(across[runs.up, runs.back, (runs.first + runs.beyond) // 2])
    # One line holds a run of a sheet once, so that counting runs measures the sagittal area.
    count = np.bincount(sheet)
    score = count / (1.0 + np.bincount(sheet, weights=middle) / count / 3.0)
    best = int(score.argmax())
    if seed is not None:
        places = np.stack([runs.up, runs.back, 0.5 * (runs.first + runs.beyond - 1)], axis=1)
        best = int(sheet[np.linalg.norm((places - seed) * spacing, axis=1).argmin()])
    chosen = sheet == best
    if np.count_nonzero(chosen) * spacing[0] * spacing[1] < AREA_MIN:
        return None
    names = _one_per_line(runs, chosen, tissue.shape, spacing)
    height, choana = lower_end(runs.up[names], runs.back[names])
    names = _before_sphenoid(runs, names, tissue, spacing, height=height, choana=choana)
    return _carried_on(runs, names, tissue, spacing, choana=choana)


@dataclass(frozen=True, eq=False)
class _Runs:
    """Runs of tissue between air along lines across the head: line (up, back), first voxel and the one beyond the last."""

    up: IntArray
    back: IntArray
    first: IntArray
    beyond: IntArray


def _runs(tissue: BoolArray, across: FloatArray, step: float) -> _Runs:
    """Runs that are thin and near the midline."""
    edges = np.diff(np.pad(tissue, ((0, 0), (0, 0), (1, 1))).astype(np.int8), axis=2)
    up, back, first = np.nonzero(edges == 1)
    beyond = np.nonzero(edges == -1)[2]  # lines are in the same order, so that the runs are too
    kept = (first > 0) & (beyond < tissue.shape[2]) & ((beyond - first) * step <= WIDTH_MAX)
    kept &= np.abs(across[up, back, np.minimum((first + beyond) // 2, tissue.shape[2] - 1)]) <= OFF_MAX
    return _Runs(up[kept], back[kept], first[kept], beyond[kept])


def _sheets(runs: _Runs, shape: tuple[int, ...], spacing: FloatArray) -> IntArray:
    """Number of the sheet that each run belongs to: both sides go on from line to neighbouring line."""
    number = np.zeros(shape, dtype=np.int32)
    starts = np.zeros((shape[0], shape[1], shape[2] + 1), dtype=np.int32)
    names = np.arange(1, len(runs.first) + 1)
    starts[runs.up, runs.back, runs.first] = names
    starts[runs.up, runs.back, runs.beyond] -= names
    number = np.cumsum(starts, axis=2)[:, :, :-1]
    pairs = []
    for one, other, step in ((number[:-1], number[1:], spacing[0]), (number[:, :-1], number[:, 1:], spacing[1])):
        both = (one > 0) & (other > 0)
        linked = np.unique(np.stack([one[both], other[both]], axis=1), axis=0) - 1
        slip = (SLOPE_MAX * step + spacing[2]) / spacing[2]
        goes_on = (np.abs(runs.first[linked[:, 0]] - runs.first[linked[:, 1]]) <= slip) & (
            np.abs(runs.beyond[linked[:, 0]] - runs.beyond[linked[:, 1]]) <= slip
        )
        pairs.append(linked[goes_on])
    ends = np.concatenate(pairs)
    graph = sparse.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(names), len(names)))
    return np.asarray(sparse.csgraph.connected_components(graph, directed=False)[1])


def _one_per_line(runs: _Runs, chosen: BoolArray, shape: tuple[int, ...], spacing: FloatArray) -> IntArray:
    """Of each line the run that lies nearest to the smooth surface through all of them, if it lies near."""
    names = np.flatnonzero(chosen)
    middle = 0.5 * (runs.first[names] + runs.beyond[names] - 1)
    kept = np.ones(len(names), dtype=bool)
    for sigma in (6.0, 4.0, 3.0):
        weight, value = np.zeros(shape[:2]), np.zeros(shape[:2])
        np.add.at(weight, (runs.up[names[kept]], runs.back[names[kept]]), 1.0)
        np.add.at(value, (runs.up[names[kept]], runs.back[names[kept]]), middle[kept])
        smooth = [ndimage.gaussian_filter(field, sigma / spacing[:2]) for field in (value, weight)]
        surface = smooth[0] / np.maximum(smooth[1], 1e-12)
        off = np.abs(middle - surface[runs.up[names], runs.back[names]])
        order = np.lexsort((off, runs.back[names], runs.up[names]))
        line = runs.up[names[order]] * shape[1] + runs.back[names[order]]
        kept = np.zeros(len(names), dtype=bool)
        kept[order[np.flatnonzero(np.diff(line, prepend=-1))]] = True
        kept &= off * spacing[2] <= STRAY
    return names[kept]


def lower_end(up: IntArray, back: IntArray) -> tuple[float, float]:
    """Height (up) of the septum's lower fifth, and where (back) it ends there: at the choana.

    Parameters
    ----------
    up, back : (n,) int array
        The lines across the head that meet the septum.
    """
    # The head may be tilted: heights are taken above a line along the septum's lower edge, without the columella.
    places = np.unique(back)
    lowest = np.array([up[back == place].min() for place in places])
    over = (places >= np.quantile(back, 0.25)) & (places <= np.quantile(back, 0.65))  # the palate
    # Imported here: a fifth of what a command takes to start, and only heads need it.
    from scipy.stats import theilslopes

    slope = float(theilslopes(lowest[over], places[over])[0]) if np.count_nonzero(over) > 2 else 0.0
    level = np.rint(up - slope * back).astype(int)
    first, last = np.quantile(level, LOW)
    low = (level >= first) & (level <= last)
    choana = float(np.median([back[low & (level == height)].max() for height in np.unique(level[low])]))
    return float(last + slope * choana), choana


def _before_sphenoid(
    runs: _Runs, names: IntArray, tissue: BoolArray, spacing: FloatArray, *, height: float, choana: float
) -> IntArray:
    """Without the septum of the sphenoid sinus.

    Behind the choana the septum borders on the airway that goes on downwards, above it the sinus has a floor of its own.
    """
    behind = names[(runs.back[names] - choana) * spacing[1] > 1.0]
    dropped = []
    for back in np.unique(runs.back[behind]):
        labels, count = ndimage.label(~tissue[:, back])
        lowest = ndimage.minimum(np.indices(labels.shape)[0], labels, np.arange(count + 1))
        here = behind[runs.back[behind] == back]
        sides = labels[runs.up[here], runs.first[here] - 1], labels[runs.up[here], runs.beyond[here]]
        closed = np.maximum(lowest[sides[0]], lowest[sides[1]]) > height
        dropped.append(here if (back - choana) * spacing[1] > BEHIND_MAX else here[closed])
    return np.setdiff1d(names, np.concatenate(dropped)) if dropped else names


def _carried_on(runs: _Runs, chosen: IntArray, tissue: BoolArray, spacing: FloatArray, *, choana: float) -> Sheet:
    """The sheet over its holes: middle and width of each line from the lines around it."""
    columns = np.arange(tissue.shape[2], dtype=float)
    line = runs.up[chosen], runs.back[chosen]
    seen = np.zeros(tissue.shape[:2], dtype=bool)
    middle, width = np.zeros(seen.shape), np.zeros(seen.shape)
    seen[line] = True
    middle[line] = 0.5 * (runs.first[chosen] + runs.beyond[chosen] - 1)
    width[line] = runs.beyond[chosen] - runs.first[chosen]
    reach = np.ceil(BRIDGE / spacing[:2]).astype(int) + 1
    flat = np.pad(seen, [(int(r), int(r)) for r in reach])
    near = ndimage.distance_transform_edt(~flat, sampling=spacing[:2]) <= BRIDGE
    whole = ndimage.distance_transform_edt(near, sampling=spacing[:2]) > BRIDGE
    whole = whole[reach[0] : -reach[0], reach[1] : -reach[1]] | seen
    # Each line's own sides where they are seen and agree with the neighbours, the neighbours' elsewhere.
    sigma = 2.0 / spacing[:2]
    weight = ndimage.gaussian_filter(seen.astype(float), sigma)
    smooth_middle = ndimage.gaussian_filter(np.where(seen, middle, 0.0), sigma) / np.maximum(weight, 1e-12)
    smooth_width = ndimage.gaussian_filter(np.where(seen, width, 0.0), sigma) / np.maximum(weight, 1e-12)
    nearest: IntArray = ndimage.distance_transform_edt(weight < 1e-3, return_distances=False, return_indices=True)
    smooth_middle, smooth_width = smooth_middle[tuple(nearest)], smooth_width[tuple(nearest)]
    agrees = seen & (np.abs(middle - smooth_middle) * spacing[2] <= 3.0)
    carried = whole & ~agrees
    middle = np.where(agrees, middle, smooth_middle)
    width = np.where(agrees, width, smooth_width)
    mask = np.abs(columns - middle[:, :, None]) <= 0.5 * width[:, :, None]
    return Sheet(mask & tissue & whole[:, :, None], agrees, carried, choana)
