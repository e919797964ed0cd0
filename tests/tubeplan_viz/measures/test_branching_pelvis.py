"""Where ureter, pelvis and calyces part: in lumens of known widths, and in two kidneys whose parts are known by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.centerline import Branch, Centerline, CenterlineTree
from tubeplan_viz.measures import collecting_system, path_parts, urinary_parts
from tubeplan_viz.measures.collecting_system import ureter_end
from tubeplan_viz.measures.pelvis import division, widest_place
from tubeplan_viz.pipeline import entered_tree, load_lumen
from tubeplan_viz.pipeline.parts import urinary_lumen

DATA = Path(__file__).parents[4] / "shared" / "data" / "hubmap_ureter_female"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the shared data folder is not beside the repository")
# The artist's parts overlap by up to 6 mm, and a pelvis in arms goes over into the major calyces without an edge.
URETER_MM, PELVIS_MM = 6.0, 10.0


def straight(*stretches: tuple[float, float]) -> Centerline:
    """A line along z with stretches of (length, radius), mm, and a point each millimetre."""
    radii = np.concatenate([np.full(round(length), radius) for length, radius in stretches])
    s = np.arange(float(len(radii)))
    return Centerline(np.column_stack([0.0 * s, 0.0 * s, s]), radii)


def tree_of(*branches: tuple[float, int]) -> CenterlineTree:
    """A tree of branches with (length in mm, parent)."""
    made = [
        Branch(line=straight((length + 1.0, 2.0)), parent=parent, generation=0, targets=(), angle=0.0)
        for length, parent in branches
    ]
    return CenterlineTree(branches=tuple(made), last_branch=np.array([-1]))


def test_a_lumen_divides_where_two_parts_lead_on() -> None:
    # A bulge of 4 mm leaves after 50 mm; after 30 more the lumen divides.
    assert division(tree_of((50.0, -1), (4.0, 0), (30.0, 0), (20.0, 2), (12.0, 2))) == 80.0
    assert division(tree_of((50.0, -1), (4.0, 0), (30.0, 0))) is None
    # Two short parts of a short one lead on together.
    assert division(tree_of((50.0, -1), (6.0, 0), (30.0, 0), (5.0, 1), (5.0, 1))) == 50.0


def test_the_pelvis_is_widest_before_the_neck_though_a_calyx_is_wider() -> None:
    way = straight((50, 2.0), (5, 5.0), (5, 6.0), (20, 2.0), (10, 8.0))
    assert widest_place(way, 52.0) == 55
    # A ureter narrows before the division too, which is no neck.
    waves = straight((20, 2.0), (20, 1.0), (20, 2.5), (10, 6.0), (20, 2.0), (10, 8.0))
    assert widest_place(waves, 58.0) == 60
    assert widest_place(way, None) == 80


def test_the_ureter_ends_at_its_narrowest_or_where_it_divides_before_it_widens() -> None:
    bag = straight((40, 2.0), (3, 1.5), (7, 2.2), (10, 6.0))
    assert ureter_end(bag, 6.0, 55.0) == 40.0
    assert ureter_end(bag, 6.0, None) == 40.0
    # Divided at 45 mm, where it is 2.2 mm wide, it has no branches any more.
    assert ureter_end(bag, 6.0, 45.0) == 45.0


@needs_data
@pytest.mark.parametrize("side", ["L", "R"])
def test_parts_are_those_that_the_reference_organ_names(side: str) -> None:
    surface = load_lumen(InputCase(mesh=DATA / f"fused_F_{side}_mm.stl")).surface
    tree = entered_tree(surface, "urinary")
    lumen = urinary_lumen(tree, None)
    system = collecting_system(lumen)
    parts = urinary_parts(lumen, system)
    # E1 is the ureter's lower end: y is up.
    assert tree.endpoints[0].point[1] == min(tip.point[1] for tip in tree.endpoints)
    named, owner = reference(side)
    majors: dict[str, set[str]] = {}
    for target, way in system.ways.items():
        truth = [owner[k] for k in named.query(way.points)[1]]
        found = path_parts(parts, way.points, way.arc_length, way.points)
        majors.setdefault(last_of("major", truth), set()).add(lumen.labels[target])
        assert [part["name"].split(",")[0].split()[0] for part in found][:2] == ["ureter", "renal"]
        ends = {part["name"].split(",")[0].split()[0]: part["to_mm"] for part in found}
        assert ends["ureter"] == pytest.approx(way.arc_length[end_of("ureter", truth)], abs=URETER_MM)
        if "calyx" in ends:
            assert ends["renal"] == pytest.approx(way.arc_length[end_of("pelvis", truth)], abs=PELVIS_MM)
            assert [part["name"].split(",")[0].split()[0] for part in found] == ["ureter", "renal", "infundibulum", "calyx"]
    # Infundibula are the major calyces; what ends in the pelvis, a bulge of its wall, is in none.
    majors.pop("", None)
    groups = {frozenset(lumen.labels[target] for target in one.targets) for one in system.infundibula}
    assert groups == {frozenset(labels) for labels in majors.values()}


def reference(side: str) -> tuple[cKDTree, list[str]]:
    """Places on the named parts of the organ, mm, and their names; papillae are no part of the lumen."""
    scene = trimesh.load(DATA / f"VH_F_Ureter_{side}.glb", process=False)
    places, names = [], []
    for node in scene.graph.nodes_geometry:
        if "papilla" in node:
            continue
        frame, geometry = scene.graph[node]
        part = scene.geometry[geometry].copy().apply_transform(frame).apply_scale(1000.0)
        places.append(trimesh.sample.sample_surface(part, 4000, seed=0)[0])
        names += [node] * 4000
    return cKDTree(np.concatenate(places)), names


def end_of(kind: str, truth: Sequence[str]) -> int:
    """Index of the last place of a way on a kind of part."""
    return max(k for k, name in enumerate(truth) if kind in name)


def last_of(kind: str, truth: Sequence[str]) -> str:
    """The last part of a kind on a way; empty without one."""
    return next((name for name in reversed(truth) if kind in name), "")
