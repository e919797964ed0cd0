"""Cross-sections of bodies whose sections are known."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.mesh import Surface
from tubeplan_viz.exports.scene import octasphere, swept_tube
from tubeplan_viz.geometry.section import SurfaceSections


def surface(vertices: np.ndarray, faces: np.ndarray) -> Surface:
    return Surface(vertices, faces, np.full(len(faces), -1))


def test_sections_of_a_ball_are_circles() -> None:
    sections = SurfaceSections(surface(*octasphere(np.array([1.0, 2.0, 3.0]), 5.0, 5)))
    for height in (0.0, 3.0, 4.0):
        found = sections.outline(np.array([1.0, 2.0, 3.0 + height]), np.array([0.0, 0.0, 2.0]))
        assert found is not None
        # Facets lie inside the ball by the square of their size, 0.16 mm, over eight radii.
        assert found.area == pytest.approx(np.pi * (25.0 - height**2), rel=4e-3)
        np.testing.assert_allclose(found.radii(np.linspace(0.0, 6.0, 9)), np.sqrt(25.0 - height**2), rtol=4e-3)


def test_only_the_part_that_holds_the_point_is_measured() -> None:
    one, other = octasphere(np.zeros(3), 3.0, 4), octasphere(np.array([10.0, 0.0, 0.0]), 5.0, 4)
    both = SurfaceSections(surface(np.vstack([one[0], other[0]]), np.vstack([one[1], other[1] + len(one[0])])))
    assert both.diameter(np.zeros(3), np.array([0.0, 0.0, 1.0])) == pytest.approx(6.0, rel=6e-3)
    assert both.outline(np.array([4.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])) is None  # between them


def test_a_hole_is_taken_off() -> None:
    outer, inner = octasphere(np.zeros(3), 6.0, 4), octasphere(np.array([2.5, 0.0, 0.0]), 2.0, 4)
    shell = SurfaceSections(surface(np.vstack([outer[0], inner[0]]), np.vstack([outer[1], inner[1][:, ::-1] + len(outer[0])])))
    found = shell.outline(np.array([-2.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    assert found is not None
    assert found.area == pytest.approx(np.pi * (36.0 - 4.0), rel=0.01)
    # The first wall towards the hole is the hole's, at x = 0.5; away from it the ball's, at -6.
    toward, away = (np.arctan2(*(found.plane @ [side, 0.0, 0.0])[::-1]) for side in (1.0, -1.0))
    np.testing.assert_allclose(found.radii(np.array([toward, away])), [2.5, 4.0], rtol=6e-3)


def test_a_swept_tube_is_closed_outward_and_as_thick_as_asked() -> None:
    s = np.linspace(0.0, np.pi, 60)
    vertices, faces = swept_tube(20.0 * np.column_stack([np.cos(s), np.sin(s), 0.0 * s]), 1.5)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].tolist() == [2] * (len(edges) // 2)
    area = 0.5 * 12 * 1.5**2 * np.sin(2.0 * np.pi / 12)  # of the twelve-sided section
    # Pappus: volume is section times the way of its centroid; 60 stations cut the half circle by 0.1 %.
    assert surface(vertices, faces).volume_ml * 1000.0 == pytest.approx(area * 20.0 * np.pi, rel=3e-3)
