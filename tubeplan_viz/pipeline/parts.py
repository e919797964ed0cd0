"""The lumen as its anatomy sees it: from which end it is followed, and what its parts are called."""

from __future__ import annotations

from collections.abc import Sequence

from segmentation.volume import Volume
from tubeplan_viz.bronchoscope.naming import NamedBranch, name_branches
from tubeplan_viz.centerline import CenterlineSettings
from tubeplan_viz.geometry.section import SurfaceSections
from tubeplan_viz.measures import (
    CtSections,
    Lumen,
    Part,
    PlainSections,
    collecting_system,
    nearest_parts,
    ureter_root,
    urinary_parts,
)
from tubeplan_viz.pipeline.tree import Branching, Tree, branches_from_end

# A bronchus whose name is less sure than this may as well be another.
SURE = 0.6


def lumen_parts(
    anatomy: str | None, tree: Tree, volume: Volume | None, settings: CenterlineSettings | None = None
) -> tuple[Part, ...]:
    """Parts of a lumen by name; none where its anatomy has no names for them or it has no branches."""
    if len(tree.endpoints) < 3:
        return ()
    if anatomy == "airway":
        return airway_parts(airway_lumen(tree, volume, settings))
    if anatomy == "urinary":
        lumen = urinary_lumen(tree, volume, settings)
        return urinary_parts(lumen, collecting_system(lumen))
    return ()


def end_names(parts: Sequence[Part], tree: Tree) -> dict[str, str]:
    """For the label of each end point the part in which it lies; empty where no parts are known."""
    if not parts:
        return {}
    numbers = nearest_parts(parts, [tip.point for tip in tree.endpoints])
    return {tip.label: parts[int(number)].name for tip, number in zip(tree.endpoints, numbers, strict=True)}


def airway_parts(lumen: Lumen) -> tuple[Part, ...]:
    """The bronchi of a lumen followed from the trachea, named by the shape of its tree and not by an atlas.

    One whose name is not sure bears the name of the nearest above it that is.
    """
    branches = name_branches(lumen.tree.branches, {}, frame=lumen.frame)
    return tuple(
        Part(name=sure_name(branches, number), points=branch.line.points, parent=branch.parent)
        for number, branch in enumerate(branches)
    )


def sure_name(branches: Sequence[NamedBranch], number: int) -> str:
    """Name of a branch, or of the first one above it whose name is sure."""
    while branches[number].confidence < SURE and branches[number].parent >= 0:
        number = branches[number].parent
    return branches[number].name


def urinary_lumen(
    tree: Tree, volume: Volume | None, settings: CenterlineSettings | None, grown: Branching | None = None
) -> Lumen:
    """The collecting system followed from the ureter's end."""
    # Which end is the ureter's does not hang on the end that the branches are followed from: those at hand tell it too.
    first = (
        grown if grown is not None and grown.joins_ends else branches_from_end(tree, tree.endpoints[0].label, settings=settings)
    )
    assert first.root is not None
    return lumen_from(tree, ureter_root(first.branches, first.labels, first.root), volume, settings, first)


def airway_lumen(tree: Tree, volume: Volume | None, settings: CenterlineSettings | None, grown: Branching | None = None) -> Lumen:
    """The airway followed from its first end point, the trachea's."""
    return lumen_from(tree, tree.endpoints[0].label, volume, settings, grown)


def lumen_from(
    tree: Tree, root: str, volume: Volume | None, settings: CenterlineSettings | None, grown: Branching | None = None
) -> Lumen:
    """The branches from one end point to all others: those at hand, where they have this root."""
    at_hand = grown is not None and grown.joins_ends and grown.root == root
    branching = grown if grown is not None and at_hand else branches_from_end(tree, root, settings=settings)
    sections = SurfaceSections(tree.surface)
    return Lumen(
        tree=branching.branches,
        labels=branching.labels,
        wall=tree.wall,
        sections=PlainSections(sections) if volume is None else CtSections(volume, sections),
        frame=tree.surface.frame,
    )
