"""Trees of centerlines against trees of tubes with known axes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from segmentation.mesh_files import read_surface
from tubeplan_viz.bench.trees import TreeModel, airway_tree, renal_tree
from tubeplan_viz.centerline import CenterlineTree, centerline_tree, trace_centerline, voronoi_graph
from tubeplan_viz.centerline.tree import split_chains
from tubeplan_viz.geometry import WallDistance

Prepare = Callable[[str], Any]


@pytest.fixture(scope="module")
def airway() -> tuple[TreeModel, WallDistance, CenterlineTree]:
    """Three generations below the trachea, eight tips, at a coarser voxel than the benchmark's."""
    model = airway_tree(generations=3, voxel=1.1)
    wall = WallDistance(model.surface)
    graph = voronoi_graph(model.surface, wall)
    return model, wall, centerline_tree(graph, wall, model.root, model.targets)


def test_every_branch_of_the_airway_is_found_with_its_generation(airway: tuple[TreeModel, WallDistance, CenterlineTree]) -> None:
    model, _, tree = airway
    assert len(tree.branches) == len(model.branches) == 15
    assert sorted(b.generation for b in tree.branches) == sorted(b.generation for b in model.branches)
    assert all(tree.branches[b.parent].generation == b.generation - 1 for b in tree.branches if b.parent >= 0)
    assert sorted(tree.last_branch) == sorted(k for k, b in enumerate(tree.branches) if b.generation == 3)
    for number, last in enumerate(tree.last_branch):
        np.testing.assert_allclose(tree.branches[last].line.points[-1], model.targets[number], atol=1e-9)
        assert tree.branches[last].targets == (number,)


def test_lengths_radii_and_angles_are_those_of_the_model(airway: tuple[TreeModel, WallDistance, CenterlineTree]) -> None:
    model, _, tree = airway
    for branch in tree.branches:
        true = next(b for b in model.branches if b.generation == branch.generation)
        # Where two branches part is known to about a third of the radius.
        assert branch.length == pytest.approx(true.axis.length, abs=0.35 * true.radius + 1.0)
        assert branch.mean_radius == pytest.approx(true.radius, rel=0.04)
        assert branch.least_radius <= branch.mean_radius
        if branch.parent >= 0:
            # Tangents part by 35.5 degrees; the chords include some of the branches' own bend.
            assert np.degrees(branch.angle) == pytest.approx(38.0, abs=6.0)
    assert tree.branches[0].angle == 0.0


def test_lines_of_the_airway_lie_on_its_axes(airway: tuple[TreeModel, WallDistance, CenterlineTree]) -> None:
    model, wall, tree = airway
    points = np.concatenate([branch.line.points for branch in tree.branches])
    gap = model.off_axis(points, end_length=5.0, junction_radii=2.5)
    assert len(gap) > 100
    assert gap.mean() < 0.01
    assert gap.max() < 0.03
    assert wall.inside(points).all()
    for branch in tree.branches:
        np.testing.assert_allclose(branch.line.radii, wall.distance(branch.line.points), atol=1e-12)


def test_a_path_joins_the_branches_without_a_gap(airway: tuple[TreeModel, WallDistance, CenterlineTree]) -> None:
    model, _, tree = airway
    for target in range(len(model.targets)):
        line = tree.path(target)
        assert line is not None
        np.testing.assert_allclose(line.points[0], model.root, atol=1e-9)
        np.testing.assert_allclose(line.points[-1], model.targets[target], atol=1e-9)
        assert np.linalg.norm(np.diff(line.points, axis=0), axis=1).max() < 1.01
        steps = np.diff(line.points, axis=0)
        cosine = (
            np.einsum("ij,ij->i", steps[:-1], steps[1:]) / np.linalg.norm(steps[:-1], axis=1) / np.linalg.norm(steps[1:], axis=1)
        )
        # No corner at a junction: less than 30 degrees from one millimetre to the next.
        assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 30.0


def test_three_calyces_leave_one_junction() -> None:
    model = renal_tree(voxel=0.8)
    wall = WallDistance(model.surface)
    tree = centerline_tree(voronoi_graph(model.surface, wall), wall, model.root, model.targets)
    assert [branch.generation for branch in tree.branches] == [0, 1, 1, 1]
    gap = model.off_axis(np.concatenate([b.line.points for b in tree.branches]), end_length=5.0, junction_radii=2.5)
    assert gap.max() < 0.03


def test_one_target_gives_the_traced_line(prepared: Prepare) -> None:
    case = prepared("swept")
    tree = centerline_tree(case.graph, case.wall, case.model.start, case.model.goal)
    line = trace_centerline(case.graph, case.wall, case.model.start, case.model.goal)
    path = tree.path(0)
    assert line is not None
    assert path is not None
    np.testing.assert_allclose(path.points, line.points, atol=1e-9)


def test_a_target_in_another_part_is_not_reached(prepared: Prepare, phantoms: ModuleType) -> None:
    case = prepared("straight")
    far = np.array([30.0, 0.0, 0.0])
    surface = phantoms.twice(case.model.surface, far)
    wall = WallDistance(surface)
    tree = centerline_tree(voronoi_graph(surface, wall), wall, case.model.start, [case.model.goal + far, case.model.goal])
    assert tree.last_branch.tolist() == [-1, 0]
    assert tree.path(0) is None
    assert tree.path(1) is not None


def test_no_chain_at_all_gives_no_branch() -> None:
    assert split_chains([None, None]) == []


def test_open_and_capped_meshes_give_the_same_line(prepared: Prepare, tmp_path: Path) -> None:
    case = prepared("swept")
    surface = case.model.surface
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in surface.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in surface.wall_faces]
    (tmp_path / "open.obj").write_text("\n".join(lines))
    closed = read_surface(tmp_path / "open.obj", mesh_unit="mm").surface
    assert len(closed.caps) == 2
    wall = WallDistance(closed)
    ends = [
        cap.center - 1e-3 * cap.normal for cap in sorted(closed.caps, key=lambda c: np.linalg.norm(c.center - case.model.start))
    ]
    line = trace_centerline(voronoi_graph(closed, wall), wall, *ends)
    capped = trace_centerline(case.graph, case.wall, *ends)
    assert line is not None
    assert capped is not None
    # Must show: they agree to 0.05 mm.
    np.testing.assert_allclose(line.points, capped.points, atol=0.05)
