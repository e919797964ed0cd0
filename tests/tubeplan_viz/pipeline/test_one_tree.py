"""Centerlines are grown once per root: what one grew serves the others, and changes none of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from segmentation.synthetic import weibel_airway
from tubeplan_viz.measures import Measure, ureter_root
from tubeplan_viz.pipeline import Tree, grow_tree
from tubeplan_viz.pipeline import tree as trees
from tubeplan_viz.pipeline.measures import measured_airway
from tubeplan_viz.pipeline.parts import end_names, lumen_parts
from tubeplan_viz.pipeline.tree import GOAL, branches_from_end, branches_on_way, first_end


@pytest.fixture(scope="module")
def airway() -> Tree:
    return grow_tree(weibel_airway(generations=2, voxel=1.0).surface)


@pytest.fixture
def roots(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Where trees are grown from, as it happens."""
    grown_from: list[np.ndarray] = []
    grow = trees.centerline_tree

    def counted(graph: Any, wall: Any, root: Any, *more: Any) -> Any:
        grown_from.append(np.asarray(root))
        return grow(graph, wall, root, *more)

    monkeypatch.setattr(trees, "centerline_tree", counted)
    return grown_from


def values(measures: Sequence[Measure]) -> dict[tuple[str, str], float | None]:
    return {(one.of, one.key): one.value for one in measures}


def test_walk_names_and_measures_share_one_tree_and_the_measures_stay_the_same(airway: Tree, roots: list[np.ndarray]) -> None:
    tree = replace(airway)
    trachea, goal = tree.endpoints[0], tree.endpoints[2]
    assert end_names(lumen_parts("airway", tree, None), tree)[trachea.label] == "trachea"
    grown, number = branches_on_way(tree, trachea.point, goal.point)
    assert grown.labels[number] == goal.label
    shared = measured_airway(tree, None)[0]
    assert len(roots) == 1
    own = measured_airway(replace(airway), None)[0]
    assert len(roots) == 2
    assert values(shared) == values(own)


def test_a_goal_away_from_the_ends_has_a_branch_that_the_measures_do_not_see(airway: Tree, roots: list[np.ndarray]) -> None:
    tree = replace(airway)
    trachea = tree.endpoints[0]
    line = branches_from_end(tree, trachea.label).branches.branches[0].line
    grown, number = branches_on_way(tree, trachea.point, line.points[len(line.points) // 2])
    assert grown.labels[number] == GOAL
    assert len(grown.branches.path(number).points) < len(line.points)
    assert len(roots) == 2
    shared = measured_airway(tree, None)[0]
    assert len(roots) == 2
    assert values(shared) == values(measured_airway(replace(airway), None)[0])


def test_another_first_end_moves_no_tip_and_keeps_the_order_of_the_others(airway: Tree) -> None:
    tree = replace(airway)
    branches_from_end(tree, "E1")
    chosen = first_end(tree, "E3")
    assert [tip.label for tip in chosen.endpoints] == [tip.label for tip in airway.endpoints]
    order = [2, 0, 1, *range(3, len(airway.endpoints))]
    for tip, number in zip(chosen.endpoints, order, strict=True):
        np.testing.assert_array_equal(tip.point, airway.endpoints[number].point)
    np.testing.assert_array_equal(branches_from_end(chosen, "E1").branches.branches[0].line.points[0], chosen.endpoints[0].point)


def test_a_start_beside_an_end_stands_for_it_and_is_no_root_of_the_measures(airway: Tree) -> None:
    trachea, goal = airway.endpoints[0], airway.endpoints[1]
    inward = airway.graph.nodes[np.linalg.norm(airway.graph.nodes - trachea.point, axis=1).argmin()]
    beside = trachea.point + 0.5 * (inward - trachea.point)
    assert 1e-3 < np.linalg.norm(beside - trachea.point) < trachea.radius
    grown, number = branches_on_way(airway, beside, goal.point)
    assert grown.root is None
    assert trachea.label not in grown.labels
    assert grown.labels[number] == goal.label


def test_the_end_of_the_longest_tube_is_found_from_every_end(airway: Tree) -> None:
    found = set()
    for tip in airway.endpoints:
        grown = branches_from_end(airway, tip.label)
        found.add(ureter_root(grown.branches, grown.labels, tip.label))
    assert len(found) == 1
