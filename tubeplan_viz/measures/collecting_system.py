"""A collecting system taken apart: ureter, renal pelvis, infundibula, calyces."""

# Strategy: the pelvis is what balls nearly as large as the largest before the necks of the calyces reach. The way from the
# ureter to each calyx leaves it for good at the lip of the pelvis; ways that leave it on the same branch share an
# infundibulum, which goes on to where they part.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tubeplan_viz.centerline import Branch, Centerline, CenterlineTree
from tubeplan_viz.measures.balls import PLATEAU, WidePart
from tubeplan_viz.measures.ends import Rim
from tubeplan_viz.measures.lines import Lumen
from tubeplan_viz.measures.outward import OutwardWall
from tubeplan_viz.measures.parts import Part, stretch
from tubeplan_viz.measures.pelvis import division, pelvis_parts

JUNCTION_SEARCH_MM = 15.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Infundibulum:
    """The way from the pelvis to one or more calyces.

    Attributes
    ----------
    name : str
        "upper", "middle" or "lower" with a number where there are several; "1", "2", ... in the axes of a mesh.
    targets : tuple of int
        Of the tree, one for each calyx.
    lip : float, mm
        Arc length on the ways at which they leave the pelvis.
    end : float, mm
        Arc length at which the ways part; at the widest place of the calyx where there is but one.
    """

    name: str
    targets: tuple[int, ...]
    lip: float
    end: float


@dataclass(frozen=True, eq=False, kw_only=True)
class CollectingSystem:
    """A lumen that begins at the ureter's end, taken apart.

    Attributes
    ----------
    ways : dict of int to Centerline
        From the ureter's end to each target that is reached.
    pelvis : WidePart
        All arms of one that divides before it widens.
    rim : Rim
        Where its edge is.
    radius : float, mm
        Of the pelvis, to its edge in the CT.
    blur : float, mm
        Of that edge.
    trunk : Centerline or None
        From the ureter's end to the widest place; None where that is the end itself.
    junction : float or None, mm
        Arc length on the ways at which the ureter ends; None where the image shows none.
    infundibula : tuple of Infundibulum
    """

    ways: dict[int, Centerline]
    pelvis: WidePart
    rim: Rim
    radius: float
    blur: float
    trunk: Centerline | None
    junction: float | None
    infundibula: tuple[Infundibulum, ...]


def ureter_root(tree: CenterlineTree, labels: tuple[str, ...], root: str) -> str:
    """Label of the tip at the ureter's end: that of the longest branch without side branches."""
    if not tree.branches:
        return root
    ends = {root: tree.branches[0].length}
    for target, number in enumerate(tree.last_branch.tolist()):
        if number > 0:
            ends[labels[target]] = tree.branches[number].length
    return max(ends, key=lambda label: ends[label])


def collecting_system(lumen: Lumen, wall: OutwardWall | None = None) -> CollectingSystem:
    """Take apart a lumen whose tree begins at the ureter's end."""
    lines = [lumen.tree.path(target) for target in range(len(lumen.labels))]
    ways = {target: line for target, line in enumerate(lines) if line is not None}
    divided = division(lumen.tree)
    widest, at, arms = pelvis_parts(lumen.wall, ways, divided)
    pelvis = WidePart(centers=np.vstack([arm.centers for arm in arms]), radii=np.concatenate([arm.radii for arm in arms]))
    rim = Rim(pelvis, wall or OutwardWall(lumen.wall.surface), lumen)
    margin, blur = rim.margin()
    radius = pelvis.largest + margin
    trunk = Centerline(ways[widest].points[: at + 1], ways[widest].radii[: at + 1]) if at > 0 else None
    return CollectingSystem(
        ways=ways,
        pelvis=pelvis,
        rim=rim,
        radius=radius,
        blur=blur,
        trunk=trunk,
        junction=None if trunk is None else ureter_end(trunk, radius, divided),
        infundibula=find_infundibula(lumen, ways, pelvis, rim),
    )


def urinary_parts(lumen: Lumen, system: CollectingSystem) -> tuple[Part, ...]:
    """Ureter, renal pelvis, infundibula and calyces with their middle lines."""
    ureter = system.junction or 0.0
    parts: dict[str, Part] = {}
    held = {target: one for one in system.infundibula for target in one.targets}
    for target, way in system.ways.items():
        whole = float(way.arc_length[-1])
        one = held.get(target)
        lip, end = (whole, whole) if one is None else (one.lip, calyx_mouth(one, way))
        places = [("ureter", 0.0, min(ureter, lip)), ("renal pelvis", min(ureter, lip), lip)]
        if one is not None:
            places.append((part_name(one.name, "infundibulum", lumen.frame), lip, end))
            places.append((part_name(one.name, f"calyx {lumen.labels[target]}", lumen.frame), end, whole))
        before = -1
        for name, begin, finish in places:
            if finish - begin < 1e-6:
                continue
            known, line = parts.get(name), stretch(way, begin, finish)
            points = line if known is None else np.vstack([known.points, line])
            parts[name] = Part(name=name, points=points, parent=before if known is None else known.parent)
            before = list(parts).index(name)
    return tuple(parts.values())


def calyx_mouth(infundibulum: Infundibulum, way: Centerline) -> float:
    """Arc length at which a way enters its calyx: where the ways part; for a single one where its widest ball begins, mm."""
    if len(infundibulum.targets) > 1:
        return infundibulum.end
    radius = float(np.interp(infundibulum.end, way.arc_length, way.radii))
    return max(infundibulum.lip, infundibulum.end - radius)


def part_name(group: str, kind: str, frame: str) -> str:
    """A part of an infundibulum's group in words: "lower calyx E3"; a mesh's groups have numbers, which follow."""
    if group == "only":
        return kind
    return f"{group} {kind}" if frame == "LPS" else f"{kind}, group {group}"


def find_infundibula(lumen: Lumen, ways: dict[int, Centerline], pelvis: WidePart, rim: Rim) -> tuple[Infundibulum, ...]:
    """Group the ways by the branch on which they leave the pelvis, and name the groups from above.

    Parameters
    ----------
    pelvis : WidePart
    rim : Rim
        Where its edge is.
    """
    groups: dict[int, list[int]] = {}
    lips: dict[int, float] = {}
    for target, line in ways.items():
        level = pelvis.level(line.points)
        inside = np.flatnonzero(level <= 0.0)
        if not len(inside) or inside[-1] == len(line.points) - 1:
            continue  # leaves the ureter before the pelvis, or is a bulge of the pelvis
        k = int(inside[-1])
        level -= rim.margin(line.points[k])[0]
        inside = np.flatnonzero(level <= 0.0)
        k = min(int(inside[-1]) if len(inside) else k, len(level) - 2)
        share = float(np.clip(level[k] / (level[k] - level[k + 1]), 0.0, 1.0))
        lip = float(line.arc_length[k] + share * (line.arc_length[k + 1] - line.arc_length[k]))
        if line.arc_length[-1] - lip < 2.0 * line.radii[k]:
            continue  # as long as the lumen is wide there: a bulge of the pelvis
        lips[target] = lip
        groups.setdefault(branch_at(lumen.tree, target, lips[target]), []).append(target)
    found = []
    for number, targets in groups.items():
        end = branch_end(lumen.tree, number)
        if len(targets) == 1:
            line = ways[targets[0]]
            distal = line.arc_length >= 0.5 * (lips[targets[0]] + line.arc_length[-1])
            end = float(line.arc_length[distal][line.radii[distal].argmax()])
        tips = np.array([ways[target].points[-1] for target in targets])
        found.append((float(tips[:, 2].mean()), tuple(targets), lips[targets[0]], end))
    found.sort(key=lambda group: -group[0])
    names = group_names(len(found)) if lumen.frame == "LPS" else [str(k + 1) for k in range(len(found))]
    return tuple(
        Infundibulum(name=name, targets=targets, lip=lip, end=max(end, lip))
        for name, (_, targets, lip, end) in zip(names, found, strict=True)
    )


def group_names(count: int) -> list[str]:
    """Names of infundibula from above; a single one has no other to be above of."""
    if count < 2:
        return ["only"][:count]
    middle = ["middle"] if count == 3 else [f"middle {k + 1}" for k in range(count - 2)]
    return ["upper", *middle, "lower"]


def branches_to(tree: CenterlineTree, target: int) -> list[int]:
    """Numbers of the branches from the root to a target."""
    numbers = [int(tree.last_branch[target])]
    while tree.branches[numbers[-1]].parent >= 0:
        numbers.append(tree.branches[numbers[-1]].parent)
    return numbers[::-1]


def branch_at(tree: CenterlineTree, target: int, s: float) -> int:
    """Number of the branch on the way to a target at an arc length."""
    reached = 0.0
    for number in branches_to(tree, target):
        reached += tree.branches[number].length
        if s < reached:
            return number
    return int(tree.last_branch[target])


def branch_end(tree: CenterlineTree, number: int) -> float:
    """Arc length from the root at which a branch ends."""
    branch: Branch | None = tree.branches[number]
    length = 0.0
    while branch is not None:
        length += branch.length
        branch = tree.branches[branch.parent] if branch.parent >= 0 else None
    return length


def ureter_end(trunk: Centerline, radius: float, divided: float | None) -> float | None:
    """Arc length of the ureteropelvic junction, mm: the narrowest place just before the lumen widens into the pelvis.

    Where it divides before it is nearly as wide as the pelvis the ureter ends at the division: no ureter has branches.
    """
    s = trunk.arc_length
    if divided is not None and float(trunk.radii[s <= divided].max()) < PLATEAU * radius:
        return divided
    narrow = np.flatnonzero(trunk.radii <= 0.5 * radius)
    if not len(narrow):
        return None
    before = np.flatnonzero((s <= s[narrow[-1]]) & (s >= s[narrow[-1]] - JUNCTION_SEARCH_MM))
    return float(s[before[trunk.radii[before].argmin()]])
