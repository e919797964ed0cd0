"""Parts of the anatomy along a path."""

from __future__ import annotations

import numpy as np
import pytest

from tubeplan_viz.measures import Part, nearest_parts, path_parts


def line(*corners: tuple[float, float, float]) -> np.ndarray:
    """Points 0.5 mm apart through corners, (n, 3) mm."""
    pieces = []
    for a, b in zip(np.array(corners[:-1]), np.array(corners[1:]), strict=True):
        count = round(float(np.linalg.norm(b - a)) / 0.5)
        pieces.append(a + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (b - a))
    return np.vstack([*pieces, corners[-1]])


def arc_length(points: np.ndarray) -> np.ndarray:
    return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]


STEM = Part(name="stem", points=line((0, 0, 0), (0, 0, 40)))
LEFT = Part(name="left", points=line((0, 0, 40), (30, 0, 70)), parent=0)
RIGHT = Part(name="right", points=line((0, 0, 40), (-30, 0, 70)), parent=0)


def test_parts_of_a_fork_follow_each_other_without_gaps() -> None:
    way = line((0, 0, 0), (0, 0, 40), (30, 0, 70))
    s = arc_length(way)
    found = path_parts((STEM, LEFT, RIGHT), way, s, way)
    assert [part["name"] for part in found] == ["stem", "left"]
    assert found[0]["from_mm"] == 0.0
    assert found[0]["to_mm"] == found[1]["from_mm"] == pytest.approx(40.0, abs=0.5)  # the spacing of the samples
    assert found[1]["to_mm"] == s[-1]


def test_a_branch_that_is_not_taken_is_no_part_of_the_path_though_it_runs_beside_it() -> None:
    beside = Part(name="beside", points=line((1, 0, 42), (11, 0, 52)), parent=0)
    way = line((0, 0, 0), (0, 0, 40), (30, 0, 70))
    off = way + np.array([0.9, 0.0, 0.0])  # nearer to the branch beside than to its own centerline
    found = path_parts((STEM, LEFT, RIGHT, beside), way, arc_length(off), off)
    assert [part["name"] for part in found] == ["stem", "left"]


def test_a_path_from_one_branch_to_another_crosses_the_fork() -> None:
    stem = Part(name="stem", points=line((0, 0, 0), (0, 0, 40), (0, 3, 40)))
    way = line((30, 0, 70), (0, 0, 40), (-30, 0, 70))
    names = [part["name"] for part in path_parts((stem, LEFT, RIGHT), way, arc_length(way), way)]
    assert names == ["left", "right"]


def test_one_known_part_tells_no_place_and_an_end_is_named_by_the_nearest_line() -> None:
    way = line((0, 0, 0), (0, 0, 40))
    assert path_parts((STEM,), way, arc_length(way), way) == []
    assert nearest_parts((STEM, LEFT, RIGHT), [(-29.0, 1.0, 69.0), (0.0, 2.0, 3.0)]).tolist() == [2, 0]
