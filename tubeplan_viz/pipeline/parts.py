"""The lumen as its anatomy sees it: from which end it is followed, and what its parts are called."""

from __future__ import annotations

from collections.abc import Sequence

from segmentation.mesh import Surface
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
from tubeplan_viz.pipeline.tree import Tree, branches_from_end, first_end, grow_tree

# A bronchus whose name is less sure than this may as well be another.
SURE = 0.7
# The end by which an airway is entered is at least this share as wide as its widest end.
ENTRANCE = 0.5


def entered_tree(
    surface: Surface, anatomy: str | None, *, closed_ends: bool = False, settings: CenterlineSettings | None = None
) -> Tree:
    """The end points of a lumen, E1 the one by which its anatomy is entered.

    That is the ureter's end of a collecting system, and the uppermost wide end of an airway whose axes are the patient's;
    otherwise the root that `grow_tree` has found.
    """
    tree = grow_tree(surface, closed_ends=closed_ends, settings=settings)
    if anatomy == "urinary" and len(tree.endpoints) > 2:
        return first_end(tree, urinary_root(tree))
    if anatomy == "airway" and surface.frame == "LPS":
        wide = ENTRANCE * max(tip.radius for tip in tree.endpoints)
        return first_end(tree, max((tip for tip in tree.endpoints if tip.radius >= wide), key=lambda tip: tip.point[2]).label)
    return tree


def lumen_parts(anatomy: str | None, tree: Tree, volume: Volume | None) -> tuple[Part, ...]:
    """Parts of a lumen by name; none where its anatomy has no names for them. Without branches only an airway's is known."""
    if anatomy == "airway" and len(tree.endpoints) > 1:
        return airway_parts(airway_lumen(tree, volume))
    if anatomy == "urinary" and len(tree.endpoints) > 2:
        lumen = urinary_lumen(tree, volume)
        return urinary_parts(lumen, collecting_system(lumen))
    return ()


def end_names(parts: Sequence[Part], tree: Tree) -> dict[str, str]:
    """For the label of each end point the part in which it lies; empty where no parts are known.

    The two ends of a single part are told apart where the axes are the patient's.
    """
    if not parts:
        return {}
    numbers = nearest_parts(parts, [tip.point for tip in tree.endpoints])
    names = {tip.label: parts[int(number)].name for tip, number in zip(tree.endpoints, numbers, strict=True)}
    if len(parts) > 1 or len(names) != 2 or tree.surface.frame != "LPS":
        return names
    low, high = sorted(tree.endpoints, key=lambda tip: float(tip.point[2]))
    return {low.label: f"lower end of the {names[low.label]}", high.label: f"upper end of the {names[high.label]}"}


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
    """Name of a branch, or of the first one above it whose name is sure; a main bronchus without its side where that is not."""
    below = number
    while branches[number].confidence < SURE and branches[number].parent >= 0:
        below, number = number, branches[number].parent
    return "main bronchus" if branches[number].generation < branches[below].generation == 1 else branches[number].name


def urinary_root(tree: Tree) -> str:
    """Label of the ureter's end; from which end the branches are followed does not matter."""
    grown = branches_from_end(tree, tree.endpoints[0].label)
    return ureter_root(grown.branches, grown.labels, tree.endpoints[0].label)


def urinary_lumen(tree: Tree, volume: Volume | None) -> Lumen:
    """The collecting system followed from the ureter's end."""
    return lumen_from(tree, urinary_root(tree), volume)


def airway_lumen(tree: Tree, volume: Volume | None) -> Lumen:
    """The airway followed from its first end point, the trachea's."""
    return lumen_from(tree, tree.endpoints[0].label, volume)


def lumen_from(tree: Tree, root: str, volume: Volume | None) -> Lumen:
    """The branches from one end point to all others."""
    branching = branches_from_end(tree, root)
    sections = SurfaceSections(tree.surface)
    return Lumen(
        tree=branching.branches,
        labels=branching.labels,
        wall=tree.wall,
        sections=PlainSections(sections) if volume is None else CtSections(volume, sections),
        frame=tree.surface.frame,
    )
