"""Names of bronchi where their geometry tells them, each with a confidence.

The rule, from the trachea on. Body axes are those of LPS; on a mesh, down is the trachea's direction, left runs from the
right to the left main bronchus, and front is their cross product.

1. The trachea ends at the first division of which two parts lead on for 15 mm or more.
2. Main bronchi: in LPS the one more to the left is the left one. On a mesh the right one is the wider, the shorter and the
   one that turns less away from the trachea: each of the three votes, where the two differ. Without a majority the sides are
   not known: both are main bronchi, with a letter, and nothing below them is named either.
3. Right upper lobe: the child of the right main bronchus that leads most upwards and outwards; of two children the other is
   the bronchus intermedius. Of its children the foremost is the middle lobe, the other the right lower lobe.
4. Left upper lobe: the child of the left main bronchus that leads most upwards and to the front; the other is the lower lobe. A
   left main bronchus shorter than 1.5 of its own widths (an adult's has about four) is cut by the image's border: no lobes.
5. Segments: of the right upper lobe the uppermost is apical, of the others the foremost anterior, the hindmost posterior; of
   the left upper lobe the upper child is the upper division, the other the lingula; of a lower lobe the hindmost child
   is the superior segment, the other the basal trunk.

Children without a rule carry their parent's name and a letter, from the uppermost down. A name's confidence is its parent's
times a share between one half (the two candidates score alike) and one (they differ by 0.4 or more in the cosines
compared, or all votes agree); names are not checked against an atlas.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.centerline import Branch, Centerline

LEADS_ON = 15.0  # mm that a part of the first division must lead on for
CLEAR = 0.4  # difference of cosines that leaves no doubt
LEFT_MAIN_WIDTHS = 1.5  # least length of a left main bronchus in its own widths, for its lobes to be told
UNDECIDED = 0.5  # confidence of a choice between equals
# Main bronchi cast a vote on their sides where their widths or lengths differ by this share, their turns by this angle, rad.
UNLIKE, UNLIKE_TURN = 0.1, np.radians(10.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class NamedBranch:
    """One branch with its name.

    Attributes
    ----------
    name : str
        Unique in its tree.
    confidence : float
        0 to 1, of the name.
    label : str or None
        Of the end point in which it ends.
    line : Centerline
    parent : int
        -1 for the trachea's first.
    generation : int
        0 for the trachea.
    angle : float, rad
        Between its direction past the junction and its parent's before it.
    """

    name: str
    confidence: float
    label: str | None
    line: Centerline
    parent: int
    generation: int
    angle: float

    @property
    def length(self) -> float:
        """Length of its line, mm."""
        return float(self.line.arc_length[-1])

    @property
    def median_radius(self) -> float:
        """Median of the inscribed radii, mm, past the parent's lumen, which holds the first millimetres of its line."""
        past = self.line.arc_length >= min(float(self.line.radii[0]), 0.4 * self.length)
        return float(np.median(self.line.radii[past]))

    @property
    def least_radius(self) -> float:
        """Smallest inscribed radius on its line, mm."""
        return float(self.line.radii.min())


@dataclass(frozen=True, eq=False)
class Axes:
    """Body axes as unit vectors."""

    left: FloatArray
    back: FloatArray
    up: FloatArray


def name_branches(branches: Sequence[Branch], labels: Mapping[int, str], *, frame: str) -> tuple[NamedBranch, ...]:
    """Names for the branches of one tree.

    Parameters
    ----------
    branches : sequence of Branch
        Parents before children.
    labels : mapping of branch number to label
        For branches that end in a tip.
    frame : {"LPS", "mesh"}
    """
    children = [[k for k, b in enumerate(branches) if b.parent == number] for number in range(len(branches))]
    found: dict[int, tuple[str, float]] = {}
    trunk = [0]
    while True:
        on = [k for k in children[trunk[-1]] if reach(branches, children, k) >= LEADS_ON]
        if len(on) != 1:
            break
        trunk.append(on[0])
    for number, k in enumerate(trunk):
        found[k] = ("trachea" if number == 0 else f"trachea, part {number + 1}", 1.0)
    division = trunk[-1]
    mains = sorted(children[division], key=lambda k: -reach(branches, children, k))[:2]
    if len(mains) == 2:
        (left, right), certainty, axes = sides(branches, children, division, mains, frame)
        if certainty > UNDECIDED:
            found[right], found[left] = ("right main bronchus", certainty), ("left main bronchus", certainty)
            name_right(branches, children, right, axes, found)
            name_left(branches, children, left, axes, found)
        else:
            found[mains[0]], found[mains[1]] = ("main bronchus a", 1.0), ("main bronchus b", 1.0)
    else:
        axes = body_axes(direction(branches[0]), None, frame)
    name_rest(branches, children, axes, found)
    depth = [0] * len(branches)
    for k, branch in enumerate(branches):
        depth[k] = 0 if k in trunk else depth[branch.parent] + 1
    return tuple(
        NamedBranch(
            name=found[k][0],
            confidence=round(found[k][1], 3),
            label=labels.get(k),
            line=branch.line,
            parent=branch.parent,
            generation=depth[k],
            angle=branch.angle,
        )
        for k, branch in enumerate(branches)
    )


def reach(branches: Sequence[Branch], children: list[list[int]], number: int) -> float:
    """Length of the longest way on through a branch, mm."""
    return branches[number].length + max((reach(branches, children, k) for k in children[number]), default=0.0)


def direction(branch: Branch) -> FloatArray:
    """Unit chord of a branch beyond its parent's lumen, (3,)."""
    line = branch.line
    first = int(np.searchsorted(line.arc_length, min(float(line.radii[0]), 0.4 * branch.length)))
    chord = line.points[-1] - line.points[min(first, len(line.points) - 2)]
    return np.asarray(chord / max(float(np.linalg.norm(chord)), 1e-12))


def sides(
    branches: Sequence[Branch], children: list[list[int]], division: int, mains: list[int], frame: str
) -> tuple[tuple[int, int], float, Axes]:
    """Left and right main bronchus, the confidence of that, and the body axes."""
    one, two = mains
    if frame == "LPS":
        lead = float((direction(branches[one]) - direction(branches[two]))[0])
        left, right = (one, two) if lead > 0.0 else (two, one)
        return (left, right), share(abs(lead)), body_axes(direction(branches[division]), None, frame)
    # The right one is the wider, the shorter, and turns less: a positive vote is for the first.
    widths = [branches[k].mean_radius for k in mains]
    lengths = [main_length(branches, children, k) for k in mains]
    leads = (widths[0] - widths[1], lengths[1] - lengths[0], branches[two].angle - branches[one].angle)
    needed = (UNLIKE * max(widths), UNLIKE * max(lengths), UNLIKE_TURN)
    votes = [int(np.sign(lead)) for lead, least in zip(leads, needed, strict=True) if abs(lead) >= least]
    right, left = (one, two) if sum(votes) > 0 else (two, one)
    axes = body_axes(direction(branches[division]), direction(branches[left]) - direction(branches[right]), frame)
    if sum(votes) == 0:
        return (left, right), UNDECIDED, axes
    agreed = abs(sum(votes)) == len(votes)
    return (left, right), (0.9 if len(votes) > 1 else 0.75) if agreed else 0.6, axes


def main_length(branches: Sequence[Branch], children: list[list[int]], number: int) -> float:
    """Length of a main bronchus; one that does not divide in the image says nothing and counts as average."""
    return branches[number].length if children[number] else 35.0


def body_axes(down: FloatArray, leftwards: FloatArray | None, frame: str) -> Axes:
    """Body axes; on a mesh without a division any direction across the trachea is called left."""
    if frame == "LPS":
        return Axes(*np.eye(3))
    up = -down
    across = np.array([1.0, 0.0, 0.0]) if leftwards is None else leftwards
    across = across - (across @ up) * up
    if float(np.linalg.norm(across)) < 1e-6:
        across = np.cross(up, np.roll(up, 1))
    left = across / np.linalg.norm(across)
    return Axes(left=left, back=np.cross(up, left), up=up)


def share(lead: float) -> float:
    """Confidence of a choice by how much one score leads."""
    return 0.5 + 0.5 * min(1.0, lead / CLEAR)


def ranked(branches: Sequence[Branch], numbers: Sequence[int], towards: FloatArray) -> tuple[list[int], float]:
    """Branches by how much they lead in a direction, the most first, and the lead of the first over the second."""
    scores = {k: float(direction(branches[k]) @ towards) for k in numbers}
    order = sorted(numbers, key=lambda k: -scores[k])
    return order, scores[order[0]] - scores[order[1]] if len(order) > 1 else 0.0


def name_right(
    branches: Sequence[Branch], children: list[list[int]], main: int, axes: Axes, found: dict[int, tuple[str, float]]
) -> None:
    """Right lobes and segments."""
    if len(children[main]) < 2:
        return
    order, lead = ranked(branches, children[main], axes.up - 0.5 * axes.left)
    sure = found[main][1] * share(lead)
    found[order[0]] = ("right upper lobe", sure)
    name_upper_right(branches, children[order[0]], axes, sure, found)
    lower = order[1:]
    if len(order) == 2:
        found[order[1]] = ("bronchus intermedius", sure)
        lower = children[order[1]]
    if len(lower) >= 2:
        order, lead = ranked(branches, lower, -axes.back)
        found[order[0]], found[order[-1]] = ("right middle lobe", sure * share(lead)), ("right lower lobe", sure * share(lead))
        name_lower(branches, children[order[-1]], axes, "right", sure * share(lead), found)


def name_upper_right(
    branches: Sequence[Branch], numbers: Sequence[int], axes: Axes, sure: float, found: dict[int, tuple[str, float]]
) -> None:
    """Segments of the right upper lobe."""
    if len(numbers) < 2:
        return
    order, lead = ranked(branches, numbers, axes.up)
    found[order[0]] = ("right apical segment", sure * share(lead))
    rest, gap = ranked(branches, order[1:], -axes.back)
    if len(rest) == 1:
        side = float(direction(branches[rest[0]]) @ -axes.back)
        found[rest[0]] = (f"right {'anterior' if side > 0.0 else 'posterior'} segment", sure * share(abs(side)))
    else:
        found[rest[0]] = ("right anterior segment", sure * share(gap))
        found[rest[-1]] = ("right posterior segment", sure * share(gap))


def name_left(
    branches: Sequence[Branch], children: list[list[int]], main: int, axes: Axes, found: dict[int, tuple[str, float]]
) -> None:
    """Left lobes and segments."""
    trunk = branches[main]
    if len(children[main]) < 2 or trunk.length < LEFT_MAIN_WIDTHS * 2.0 * trunk.mean_radius:
        return
    order, lead = ranked(branches, children[main], axes.up - 0.5 * axes.back)
    sure = found[main][1] * share(lead)
    found[order[0]], found[order[-1]] = ("left upper lobe", sure), ("left lower lobe", sure)
    if len(children[order[0]]) >= 2:
        upper, lead = ranked(branches, children[order[0]], axes.up)
        found[upper[0]], found[upper[-1]] = ("left upper division", sure * share(lead)), ("lingula", sure * share(lead))
    name_lower(branches, children[order[-1]], axes, "left", sure, found)


def name_lower(
    branches: Sequence[Branch], numbers: Sequence[int], axes: Axes, side: str, sure: float, found: dict[int, tuple[str, float]]
) -> None:
    """Superior segment and basal trunk of a lower lobe."""
    if len(numbers) < 2:
        return
    order, lead = ranked(branches, numbers, axes.back + 0.5 * axes.up)
    found[order[0]] = (f"{side} superior segment", sure * share(lead))
    found[order[-1]] = (f"{side} basal trunk", sure * share(lead))


def name_rest(branches: Sequence[Branch], children: list[list[int]], axes: Axes, found: dict[int, tuple[str, float]]) -> None:
    """Letters for all branches that no rule named."""
    for number in range(len(branches)):
        without = [k for k in children[number] if k not in found]
        if not without:
            continue
        order, _ = ranked(branches, without, axes.up)
        stem, sure = found[number]
        for letter, k in zip("abcdefghijklmnopqrstuvwxyz", order, strict=False):
            found[k] = (f"{stem} {letter}" if " " not in stem[-2:] else f"{stem}{letter}", sure)
