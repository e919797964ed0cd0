"""The tree of centerlines from one root to many targets: branches with generations, lengths, radii and angles."""

# Strategy: one shortest-path tree gives the chains of all targets. They share their
# vertices up to where they part, so a branch is a stretch of chain with the same targets beyond. Each branch is
# brought to the middle once, together with a few millimetres of its neighbours, so
# that the line goes on smoothly through the junctions.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray, IntArray, frozen_array
from tubeplan_viz.centerline.line import Centerline
from tubeplan_viz.centerline.trace import (
    CenterlineSettings,
    Chain,
    even_curve,
    least_cost_chains,
    middle_line,
    polyline_length,
)
from tubeplan_viz.centerline.voronoi import VoronoiGraph
from tubeplan_viz.geometry import WallDistance

# Two partings closer together than this share of the lumen's radius are one junction.
ONE_JUNCTION = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Branch:
    """One edge of the tree, from junction to junction or tip.

    Attributes
    ----------
    line : Centerline
        Begins where the parent's line ends.
    parent : int
        Number of the branch that it leaves; -1 for the root's.
    generation : int
        0 for the root's branch.
    targets : tuple of int
        Numbers of the targets that are reached through it.
    angle : float, rad
        Between its direction past the junction and its parent's before it; 0 for the root's branch.
    """

    line: Centerline
    parent: int
    generation: int
    targets: tuple[int, ...]
    angle: float

    @property
    def length(self) -> float:
        """Length of the line, mm."""
        return float(self.line.arc_length[-1])

    @property
    def mean_radius(self) -> float:
        """Mean radius of the inscribed spheres over the length, mm."""
        s = self.line.arc_length
        return float(np.trapezoid(self.line.radii, s) / s[-1])

    @property
    def least_radius(self) -> float:
        """Smallest inscribed sphere at the line's points, mm."""
        return float(self.line.radii.min())


@dataclass(frozen=True, eq=False, kw_only=True)
class CenterlineTree:
    """Branches from one root.

    Attributes
    ----------
    branches : tuple of Branch
        Parents before children; the first is the root's. Empty when no target was reached.
    last_branch : (k,) int array
        For each target the number of the branch that ends there; -1 where no chain of
        inscribed spheres leads to it.
    """

    branches: tuple[Branch, ...]
    last_branch: IntArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "last_branch", frozen_array(self.last_branch, (None,), "last_branch", dtype=np.int64))

    def path(self, target: int) -> Centerline | None:
        """Line from the root to a target through its branches; None where there is none.

        The points are those of the branches, so that lines to several targets share them; spacing
        is even on each branch.
        """
        number = int(self.last_branch[target])
        if number < 0:
            return None
        lines = []
        while number >= 0:
            lines.append(self.branches[number].line)
            number = self.branches[number].parent
        points = [lines[-1].points, *(line.points[1:] for line in lines[-2::-1])]
        radii = [lines[-1].radii, *(line.radii[1:] for line in lines[-2::-1])]
        return Centerline(np.concatenate(points), np.concatenate(radii))


def centerline_tree(
    graph: VoronoiGraph,
    wall: WallDistance,
    root: ArrayLike,
    targets: ArrayLike,
    settings: CenterlineSettings | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> CenterlineTree:
    """Centerlines from a root to all targets in one pass.

    Parameters
    ----------
    graph : VoronoiGraph
    wall : WallDistance
    root : (3,) array_like, mm
    targets : (k, 3) array_like, mm
        Inside the lumen or on caps.
    progress : callable, optional
        Called with the number of branches done and of all.

    Raises
    ------
    CaseError
        If the root or a target lies in no inscribed sphere.
    """
    settings = settings or CenterlineSettings()
    chains = least_cost_chains(graph, wall, root, np.atleast_2d(np.asarray(targets, dtype=float)), settings)
    stretches = split_chains(chains)
    branches: list[Branch] = []
    for number, stretch in enumerate(stretches):
        begin = branches[stretch.parent].line if stretch.parent >= 0 else None
        children = [other for other in stretches if other.parent == number]
        after = max(children, key=lambda other: len(other.targets)).chain if children else None
        before = stretches[stretch.parent].chain if stretch.parent >= 0 else None
        points = branch_points(stretch.chain, before, after, begin, wall, settings)
        line = Centerline(points, wall.distance(points))
        generation = branches[stretch.parent].generation + 1 if stretch.parent >= 0 else 0
        angle = turning_angle(begin, line) if begin is not None else 0.0
        branches.append(Branch(line=line, parent=stretch.parent, generation=generation, targets=stretch.targets, angle=angle))
        if progress is not None:
            progress(number + 1, len(stretches))
    last = np.full(len(chains), -1)
    for number, stretch in enumerate(stretches):
        last[list(stretch.targets)] = number  # children come after parents
    return CenterlineTree(branches=tuple(branches), last_branch=last)


@dataclass(frozen=True, eq=False, kw_only=True)
class Stretch:
    """Part of the chains with the same targets beyond; the first vertex is the last of its parent."""

    chain: Chain
    parent: int
    targets: tuple[int, ...]


def split_chains(chains: list[Chain | None]) -> list[Stretch]:
    """Stretches of chains of one shortest-path tree, parents before children."""
    stretches: list[Stretch] = []
    # Open ends: targets whose chains run together, the place in them, and the stretch before.
    waiting: list[tuple[tuple[int, ...], int, int]] = []
    reached = tuple(number for number, chain in enumerate(chains) if chain is not None)
    if reached:
        waiting.append((reached, 0, -1))
    while waiting:
        group, first, parent = waiting.pop(0)
        members = [chain.nodes for number in group if (chain := chains[number]) is not None]
        shortest = min(len(nodes) for nodes in members)
        together = np.array([nodes[:shortest] for nodes in members])
        same = np.all(together == together[0], axis=0)
        last = shortest if same.all() else int(np.argmin(same))
        chain = chains[group[0]]
        assert chain is not None
        beyond: dict[int, list[int]] = {}
        for target, nodes in zip(group, members, strict=True):
            if len(nodes) > last:
                beyond.setdefault(int(nodes[last]), []).append(target)
        part = chain.part(first, last)
        if len(beyond) > 1 and parent >= 0 and polyline_length(part.points)[-1] < ONE_JUNCTION * part.radii[-1]:
            waiting += [(tuple(targets), first, parent) for targets in beyond.values()]
            continue
        stretches.append(Stretch(chain=part, parent=parent, targets=group))
        waiting += [(tuple(targets), last - 1, len(stretches) - 1) for targets in beyond.values()]
    return stretches


def branch_points(
    chain: Chain,
    before: Chain | None,
    after: Chain | None,
    begin: Centerline | None,
    wall: WallDistance,
    settings: CenterlineSettings,
) -> FloatArray:
    """Even, smooth points of one branch, (n, 3) mm, from the end of its parent's line."""
    context = 2.0 * settings.smoothing
    parts = [chain]
    if before is not None:
        reversed_length = polyline_length(before.points[::-1])
        count = int(np.searchsorted(reversed_length, context)) + 1
        parts.insert(0, before.part(max(len(before.nodes) - count, 0), len(before.nodes) - 1))
    if after is not None:
        parts.append(after.part(1, int(np.searchsorted(polyline_length(after.points), context)) + 2))
    whole = Chain(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("nodes", "points", "radii")))
    line = middle_line(whole, wall, settings)
    first = nearest_place(line, chain.points[0] if begin is None else begin.points[-1]) if before is not None else 0
    last = nearest_place(line, chain.points[-1]) if after is not None else len(line) - 1
    line = line[min(first, last - 1) : last + 1].copy() if last > 0 else line[:2].copy()
    if begin is not None:
        # The parent's line was drawn with another neighbour beyond the junction: go on along it and turn into the branch.
        s = polyline_length(line)
        share = np.clip(s / max(min(max(settings.smoothing, float(begin.radii[-1])), s[-1]), 1e-9), 0.0, 1.0)
        onward = begin.points[-1] + s[:, None] * end_direction(begin, settings.smoothing)
        line = onward + (share * share * (3.0 - 2.0 * share))[:, None] * (line - onward)
    return even_curve(line, settings.step)


def end_direction(line: Centerline, within: float) -> FloatArray:
    """Unit vector along the last `within` mm of a line, at most half of it, (3,)."""
    away = chord(line, float(line.arc_length[-1]) - min(within, 0.5 * float(line.arc_length[-1])), float(line.arc_length[-1]))
    return np.asarray(away / max(float(np.linalg.norm(away)), 1e-12))


def nearest_place(line: FloatArray, point: FloatArray) -> int:
    """Index of the vertex nearest to a point."""
    return int(np.argmin(np.linalg.norm(line - point, axis=1)))


def turning_angle(parent: Centerline, child: Centerline) -> float:
    """Angle between the end of the parent's line and the child's beyond the junction, rad.

    Both directions are chords over one diameter; the child's begins one radius past the
    junction, where its line has left the parent's lumen.
    """
    radius = float(parent.radii[-1])
    incoming = chord(parent, parent.arc_length[-1] - 3.0 * radius, parent.arc_length[-1] - radius)
    outgoing = chord(child, radius, radius + 2.0 * float(np.median(child.radii)))
    cosine = incoming @ outgoing / max(float(np.linalg.norm(incoming) * np.linalg.norm(outgoing)), 1e-12)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def chord(line: Centerline, begin: float, end: float) -> FloatArray:
    """Vector from one arc length to another, kept within the line, (3,) mm."""
    length = float(line.arc_length[-1])
    low, high = np.clip(begin, 0.0, 0.9 * length), np.clip(end, 0.1 * length, length)
    at = [np.array([np.interp(s, line.arc_length, line.points[:, k]) for k in range(3)]) for s in (low, high)]
    return np.asarray(at[1] - at[0])
