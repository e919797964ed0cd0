"""Where an instrument may go in: the edges of the nostrils, traced sagittal slice by sagittal slice.

Strategy: in each sagittal slice near the nose the skin is followed from its foremost point downwards, and backwards
where below is air, until both are air. There the front wall of a nostril ends; where there is no nostril the walk runs
out of the image, or past the lip. From that front edge the nearest skin with air above it, backwards and downwards, is the
rear edge [1]_.
Two cases that the text leaves open: a tip that hangs lower than the columella ends the walk too; there the segment
between the edges closes no pocket of air. And beside a traced slice the roof of a nostril may run into its rear wall, so
that the walk goes all through it and out below; there the front edge is where the walk turned back.

References
----------
.. [1] Multi-constraint path planning (Chinese patent text, 2021), paragraphs 80 and 81.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray, IntArray

REACH = 25.0
"""Half the width in which nostrils are looked for about the tip, mm: half of a wide nose and the error of its middle."""
WINDOW = (40.0, 25.0)
"""How far below and above the tip a slice's foremost skin may lie, mm."""
BELOW = 30.0
"""How far below the tip the nose may reach, mm: farther down the walk has left it for lip and chin."""
OPENING = 35.0
"""Longest nostril, mm."""
POCKET = 10.0
"""Least area of the closed-off air that reaches beyond the edges, mm^2."""
BEYOND = 2.0
"""How far it must reach, above the front edge or behind the rear edge, mm: a fold beside the nose does not."""
THROUGH = 2.0
"""How long a nostril's segment may run through tissue between its edges, mm: partly filled pixels, but no wall."""
LEDGE = 4.0
"""How far the walk goes back under a roof before it counts as one, mm."""


@dataclass(frozen=True, eq=False)
class Trace:
    """The edges of the nostrils, slice by slice.

    Attributes
    ----------
    columns : (n,) int array
        Sagittal slices with a nostril, ascending.
    front, rear : (n, 2) int array
        [up, back] of the edges in each of them.
    """

    columns: IntArray
    front: IntArray
    rear: IntArray

    def part(self, chosen: BoolArray) -> Trace:
        """The slices for which `chosen`, (n,), holds."""
        return Trace(self.columns[chosen], self.front[chosen], self.rear[chosen])

    def mask(self, shape: tuple[int, ...]) -> BoolArray:
        """Voxels on the segments, edges included, [up, back, left]."""
        drawn = np.zeros(shape, dtype=bool)
        for column, front, rear in zip(self.columns, self.front, self.rear, strict=True):
            line = segment(front, rear)
            drawn[line[:, 0], line[:, 1], column] = True
        return drawn


def segment(front: IntArray, rear: IntArray) -> IntArray:
    """Pixels from one edge to the other, both included, (n, 2)."""
    steps = int(np.abs(rear - front).max())
    return np.rint(np.linspace(front, rear, steps + 1)).astype(int)


def trace_nostrils(skin: BoolArray, spacing: FloatArray, *, tip: IntArray) -> Trace:
    """Follow the skin in every sagittal slice near the tip of the nose.

    Parameters
    ----------
    skin : (up, back, left) bool array
        Soft tissue and bone of the head.
    spacing : (3,) float array, mm
    tip : (3,) int array
        Foremost voxel of the nose.

    Returns
    -------
    Trace
        Possibly without a slice.
    """
    reach = int(np.ceil(REACH / spacing[2]))
    first, last = max(int(tip[2]) - reach, 0), min(int(tip[2]) + reach, skin.shape[2] - 1)
    floor = max(int(tip[0] - BELOW / spacing[0]), 0)
    found: dict[int, tuple[IntArray, IntArray]] = {}
    ledges: dict[int, tuple[IntArray, IntArray]] = {}
    for column in range(first, last + 1):
        tissue = skin[:, :, column]
        start = _foremost(tissue, spacing, tip)
        if start is None:
            continue
        front, ledge = _walk(tissue, *start, floor=floor, ledge=LEDGE / float(spacing[1]))
        for place, kept in ((front, found), (ledge, ledges)):
            rear = None if place is None else _rear(tissue, spacing, place)
            if place is not None and rear is not None and _closes(tissue, spacing, place, rear):
                kept[column] = place, rear
    traced = sorted(found)
    for way in (1, -1):
        for column in traced:
            while column + way not in found and column + way in ledges:
                column += way
                found[column] = ledges[column]
    columns = sorted(found)
    edges = np.array([found[column] for column in columns], dtype=int).reshape(-1, 2, 2)
    return Trace(np.array(columns, dtype=int), edges[:, 0], edges[:, 1])


def _foremost(tissue: BoolArray, spacing: FloatArray, tip: IntArray) -> tuple[int, int] | None:
    """Foremost pixel of the slice at about the height of the tip."""
    low = max(int(tip[0] - WINDOW[0] / spacing[0]), 0)
    window = tissue[low : int(tip[0] + WINDOW[1] / spacing[0]) + 1]
    if not window.any():
        return None
    first = np.where(window.any(axis=1), window.argmax(axis=1), tissue.shape[1])
    return low + int(first.argmin()), int(first.min())


def _walk(tissue: BoolArray, z: int, y: int, *, floor: int, ledge: float) -> tuple[IntArray | None, IntArray | None]:
    """Down along the skin, and back where below is air.

    Returns
    -------
    end : [up, back] or None
        The lowest point, where back and below are air; None where the walk comes down to `floor` first.
    turn : [up, back] or None
        Where the walk first went back by more than `ledge` pixels in one row.
    """
    turn: IntArray | None = None
    since = y
    while z > floor:
        if tissue[z - 1, y]:
            z, since = z - 1, y
        elif y + 1 < tissue.shape[1] and tissue[z, y + 1]:
            y += 1
            if turn is None and y - since > ledge:
                turn = np.array([z, since])
        else:
            # The middle of the lowest row of a rounded end is its lowest point.
            return np.array([z, (since + y) // 2]), turn
    return None, turn


def _rear(tissue: BoolArray, spacing: FloatArray, front: IntArray) -> IntArray | None:
    """The nearest pixel with air above it, behind and not above the front edge."""
    z, y = (int(i) for i in front)
    near = slice(y + 1, y + 1 + int(OPENING / spacing[1]))
    edge = tissue[: z + 1, near] & ~tissue[1 : z + 2, near]
    rows, columns = np.nonzero(edge)
    away = np.hypot((rows - z) * spacing[0], (columns + 1) * spacing[1])
    if not away.size or away.min() > OPENING:
        return None
    nearest = int(away.argmin())
    return np.array([rows[nearest], columns[nearest] + y + 1])


def _closes(tissue: BoolArray, spacing: FloatArray, front: IntArray, rear: IntArray) -> bool:
    """Whether the segment lies in air and closes off a pocket of it."""
    line = segment(front, rear)
    step = float(np.linalg.norm((rear - front) * spacing[:2])) / (len(line) - 1)
    if len(line) < 3 or np.count_nonzero(tissue[line[1:-1, 0], line[1:-1, 1]]) * step > THROUGH:
        return False
    margin = np.ceil(OPENING / spacing[:2]).astype(int)
    low = np.maximum(line.min(axis=0) - margin, 0)
    box = tuple(slice(int(a), int(b)) for a, b in zip(low, line.max(axis=0) + margin + 1, strict=True))
    air = ~tissue[box]
    inner = line - low
    air[inner[:, 0], inner[:, 1]] = False
    # The segment is connected across corners, so that air that is connected across faces cannot pass it.
    labels, _ = ndimage.label(air)
    behind = np.zeros_like(air)
    behind[inner[:, 0], inner[:, 1]] = True
    touched = np.setdiff1d(labels[ndimage.binary_dilation(behind)], [0, *labels[:, 0], *labels[0]])
    pocket = np.argwhere(np.isin(labels, touched)) + low
    beyond = ((pocket - [front[0], rear[1]]) * spacing[:2] > BEYOND).any(axis=1)
    return bool(np.count_nonzero(beyond) * spacing[0] * spacing[1] >= POCKET)


def widened(nostril: BoolArray, spacing: FloatArray, *, outwards: int, give: tuple[float, float]) -> BoolArray:
    """A nostril with the skin's give: everything up to so far outwards and upwards of it.

    Parameters
    ----------
    nostril : (up, back, left) bool array
    spacing : (3,) float array, mm
    outwards : int
        1 if away from the septum is to the left, -1 if it is to the right.
    give : (sideways, upwards), mm
    """
    out = nostril.copy()
    for axis, way, distance in ((2, outwards, give[0]), (0, 1, give[1])):
        steps = round(distance / float(spacing[axis]))
        before = out.copy()
        for step in range(1, min(steps, out.shape[axis] - 1) + 1):
            source, target = [slice(None)] * 3, [slice(None)] * 3
            source[axis] = slice(None, -step) if way > 0 else slice(step, None)
            target[axis] = slice(step, None) if way > 0 else slice(None, -step)
            out[tuple(target)] |= before[tuple(source)]
    return out
