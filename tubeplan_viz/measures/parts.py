"""Which part of the anatomy each stretch of a path runs through."""

# Strategy: a path may leave the middle line by as much as the lumen is wide, and branches run side by side where they part,
# so near a fork a place can lie nearer to a branch that is not taken. Only parts between the start's and the goal's are
# therefore in question, and each place of the path is put on its own centerline first.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, IntArray, frozen_array
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.measures.lines import place

SHORTEST_MM = 2.0  # a shorter stretch between two others is where two named lines share a fork, not a part of its own


@dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """A part of the anatomy with a stretch of its middle line.

    Attributes
    ----------
    name : str
    points : (n, 3) float array, mm
    parent : int
        Number of the part that it leaves; -1 for the first.
    """

    name: str
    points: FloatArray
    parent: int = -1

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_array(self.points, (None, 3), "points"))


def path_parts(parts: Sequence[Part], centerline: FloatArray, arc_length: FloatArray, points: FloatArray) -> list[dict[str, Any]]:
    """The parts along a path, in order and without gaps, for result.json.

    Parameters
    ----------
    parts : sequence of Part
    centerline : (m, 3) float array, mm
        From the path's start to its goal.
    arc_length : (n,) float array, mm
    points : (n, 3) float array, mm
        The path.

    Returns
    -------
    list of dict
        ``name``, ``from_mm`` and ``to_mm``; empty where fewer than two parts are known, which say nothing of where.
    """
    if len(parts) < 2 or len(points) < 2:
        return []
    ends = nearest_parts(parts, centerline[[0, -1]])
    crossed = sorted({number for end in ends.tolist() for number in ancestry(parts, end)})
    parts = [parts[number] for number in crossed]
    owner = nearest_parts(parts, centerline)
    along = owner[cKDTree(centerline).query(points)[1]]
    begins = np.flatnonzero(np.r_[True, along[1:] != along[:-1]])
    edges = np.r_[0.0, 0.5 * (arc_length[begins[1:] - 1] + arc_length[begins[1:]]), arc_length[-1]]
    runs = [(parts[int(along[k])].name, float(a), float(b)) for k, a, b in zip(begins, edges, edges[1:], strict=False)]
    merged: list[tuple[str, float, float]] = []
    for name, start, end in runs:
        if merged and (merged[-1][0] == name or end - start < SHORTEST_MM):
            merged[-1] = (merged[-1][0], merged[-1][1], end)
        elif merged and merged[-1][2] - merged[-1][1] < SHORTEST_MM:
            merged[-1] = (name, merged[-1][1], end)
        else:
            merged.append((name, start, end))
    return [{"name": name, "from_mm": start, "to_mm": end} for name, start, end in merged]


def nearest_parts(parts: Sequence[Part], places: ArrayLike) -> IntArray:
    """Number of the part whose line passes nearest to each place, (n,)."""
    owner = np.repeat(np.arange(len(parts)), [len(part.points) for part in parts])
    tree = cKDTree(np.concatenate([part.points for part in parts]))
    return np.asarray(owner[tree.query(np.asarray(places, dtype=float))[1]])


def ancestry(parts: Sequence[Part], number: int) -> list[int]:
    """A part and all that lie between it and the first."""
    found = [number]
    while parts[found[-1]].parent >= 0:
        found.append(parts[found[-1]].parent)
    return found


def stretch(line: Centerline, begin: float, end: float) -> FloatArray:
    """Points of a line between two arc lengths, with both ends, (n, 3) mm."""
    inside = (line.arc_length > begin) & (line.arc_length < end)
    return np.vstack([place(line, begin), line.points[inside], place(line, end)])
