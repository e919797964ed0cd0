"""Measures of an airway tree: generations, lengths, diameters, angles."""

from __future__ import annotations

import numpy as np

from tubeplan_viz.centerline import Branch, Centerline
from tubeplan_viz.measures.lines import Lumen, angle_between, place
from tubeplan_viz.measures.measure import Drawing, Measure, lacking


def airway_measures(lumen: Lumen) -> tuple[tuple[Measure, ...], Drawing]:
    """Measure a tree that begins at the trachea: the trachea, the carina, and each branch."""
    tree = lumen.tree
    measures: list[Measure] = []
    trachea = middle_diameter(lumen, tree.branches[0].line)
    measures += (
        lacking("no cross-section of the trachea has a closed outline in the mesh and a wall in the CT", "trachea_diameter_mm")
        if trachea is None
        else [Measure(key="trachea_diameter_mm", value=trachea)]
    )
    daughters = [branch for branch in tree.branches if branch.parent == 0]
    if len(daughters) == 2:
        one, other = (heading(branch) for branch in daughters)
        measures.append(Measure(key="carinal_angle_deg", value=angle_between(one, other)))
    else:
        measures += lacking(f"the first branching has {len(daughters)} daughters, expected 2", "carinal_angle_deg")
    for number, branch in enumerate(tree.branches):
        measures += branch_measures(lumen, branch, branch_name(lumen, number, branch))
    lines = {f"branch {number}": branch.line.points for number, branch in enumerate(tree.branches)}
    return tuple(measures), Drawing(lines=lines, points={"root": tree.branches[0].line.points[0]})


def branch_name(lumen: Lumen, number: int, branch: Branch) -> str:
    """A branch by its number and the tips beyond it."""
    labels = [lumen.labels[target] for target in branch.targets]
    return f"branch {number} to {', '.join(labels[:3])}{' ...' if len(labels) > 3 else ''}"


def branch_measures(lumen: Lumen, branch: Branch, of: str) -> list[Measure]:
    """Generation, length, diameter and angle of one branch."""
    made = [
        Measure(key="generation", of=of, value=float(branch.generation)),
        Measure(key="branch_length_mm", of=of, value=branch.length),
    ]
    diameter = middle_width(lumen, branch.line)
    if diameter is None:
        made += lacking(
            "no cross-section in its middle half has a closed outline in the mesh and a wall in the CT",
            "branch_diameter_mm",
            of=of,
        )
    elif diameter > branch.length:
        made += lacking(
            "the branch is shorter than it is wide: its sections are those of the branching", "branch_diameter_mm", of=of
        )
    else:
        made.append(Measure(key="branch_diameter_mm", of=of, value=diameter))
    if branch.parent < 0:
        return made + lacking("the first branch has no parent", "branch_angle_deg", of=of)
    return [*made, Measure(key="branch_angle_deg", of=of, value=float(np.degrees(branch.angle)))]


def middle_diameter(lumen: Lumen, line: Centerline) -> float | None:
    """Median diameter of the cross-sections of the middle half of a line, mm."""
    length = float(line.arc_length[-1])
    diameters = lumen.diameters(line, 0.25 * length, 0.75 * length)
    return float(np.median(diameters)) if len(diameters) else None


def middle_width(lumen: Lumen, line: Centerline) -> float | None:
    """Median width of the cross-sections of the middle half of a line, mm: beside a branching most chords miss the neighbour."""
    length = float(line.arc_length[-1])
    widths = lumen.widths(line, 0.25 * length, 0.75 * length)
    return float(np.median(widths)) if len(widths) else None


def heading(branch: Branch) -> np.ndarray:
    """Direction of a branch between one and two of its radii past the branching, at least over its middle third, (3,)."""
    length, radius = branch.length, branch.mean_radius
    begin = min(float(branch.line.radii[0]), length / 3.0)
    end = min(max(begin + 2.0 * radius, 2.0 * length / 3.0), length)
    return place(branch.line, end) - place(branch.line, begin)
