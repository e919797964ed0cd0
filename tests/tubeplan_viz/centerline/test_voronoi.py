"""The Voronoi graph of a wall: spheres that are inscribed, edges that stay inside, costs in closed form."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial import cKDTree

from segmentation.errors import GeometryError
from segmentation.mesh import Cap, Surface
from tubeplan_viz.centerline import voronoi_graph
from tubeplan_viz.centerline.sampling import wall_samples
from tubeplan_viz.centerline.voronoi import circumspheres, mean_reciprocal
from tubeplan_viz.geometry import WallDistance


@pytest.mark.parametrize("name", ["swept", "structured", "marching cubes", "junction"])
def test_every_edge_of_the_graph_lies_inside_the_lumen(name: str, prepared: Callable[[str], Any]) -> None:
    case = prepared(name)
    rng = np.random.default_rng(1)
    edges = case.graph.edges[rng.choice(len(case.graph.edges), 2000, replace=False)]
    share = rng.uniform(0.0, 1.0, (2000, 1))
    points = (1.0 - share) * case.graph.nodes[edges[:, 0]] + share * case.graph.nodes[edges[:, 1]]
    assert case.wall.inside(points).all()


def test_radii_are_inscribed_up_to_the_sampling_of_the_wall(prepared: Callable[[str], Any]) -> None:
    case = prepared("swept")
    exact = case.wall.distance(case.graph.nodes)
    # The nearest wall sample is a vertex: never nearer than the wall, up to the micrometre of jitter.
    assert np.all(case.graph.radii >= exact - 2e-3)
    middle = case.graph.radii > 2.5
    # Facets with 0.44 mm edges lie within 0.013 mm of the tube.
    assert np.abs(case.graph.radii - exact)[middle].max() < 0.03


@pytest.mark.parametrize(("r0", "r1"), [(1.0, 1.0), (1.0, 3.0), (3.0, 1.0), (2.0, 2.0 + 1e-9), (0.01, 5.0)])
def test_mean_reciprocal_is_the_integral_of_one_over_a_linear_radius(r0: float, r1: float) -> None:
    exact = quad(lambda t: 1.0 / (r0 + t * (r1 - r0)), 0.0, 1.0)[0]
    assert mean_reciprocal(np.array([r0]), np.array([r1]))[0] == pytest.approx(exact, rel=1e-6)


def test_edge_costs_add_omega_per_mm(prepared: Callable[[str], Any]) -> None:
    graph = prepared("straight").graph
    np.testing.assert_allclose(graph.edge_costs(0.5) - graph.edge_costs(0.1), 0.4 * graph.lengths, rtol=1e-9, atol=1e-12)


def test_circumspheres_pass_through_all_four_corners() -> None:
    points = np.random.default_rng(3).normal(0.0, 5.0, (40, 3))
    simplices = np.arange(40).reshape(10, 4)
    centers, radii = circumspheres(points, simplices)
    np.testing.assert_allclose(
        np.linalg.norm(points[simplices] - centers[:, None], axis=2), np.repeat(radii[:, None], 4, axis=1), rtol=1e-8
    )


def test_long_faces_are_sampled_between_their_vertices_and_caps_are_left_out(prepared: Callable[[str], Any]) -> None:
    surface = prepared("straight").model.surface
    coarse = wall_samples(surface, 5.0)
    assert len(coarse) == len(np.unique(surface.wall_faces))
    fine = wall_samples(surface, 0.2)
    assert len(fine) > 4 * len(coarse)
    # Nothing in the middle of the caps: every sample is at the tube's radius, up to the facets' sagitta.
    assert np.linalg.norm(fine[:, [0, 2]], axis=1).min() > 2.95


def test_wall_samples_without_an_inscribed_sphere_are_refused(prepared: Callable[[str], Any]) -> None:
    case = prepared("straight")
    elsewhere = np.random.default_rng(6).normal(0.0, 1.0, (50, 3)) + np.array([0.0, 9000.0, 0.0])
    with pytest.raises(GeometryError, match=f"no inscribed sphere found among {len(elsewhere)} wall points; .* refine it"):
        voronoi_graph(case.model.surface, case.wall, points=elsewhere)


def test_samples_of_slivers_grow_with_their_length_and_leave_no_place_far_from_one() -> None:
    # A tube of 48 faces, 400 mm long and 0.8 mm wide each, as a drawing program makes it.
    turn = 2.0 * np.pi * np.arange(24) / 24
    ring = 3.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    vertices = np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in (0.0, 400.0)])
    j, k = np.arange(24), (np.arange(24) + 1) % 24
    sides = np.concatenate([np.column_stack([j, k, k + 24]), np.column_stack([j, k + 24, j + 24])])
    fans = [np.column_stack([np.zeros(22, int), j[2:], j[1:-1]]), np.column_stack([np.full(22, 24), j[1:-1] + 24, j[2:] + 24])]
    faces = np.concatenate([sides, *fans])
    face_cap = np.repeat([-1, 0], [48, 44])
    surface = Surface(vertices, faces, face_cap, (Cap("C1", "flat end", np.zeros(3), np.array([0.0, 0.0, -1.0]), 1.0),), "mesh")
    spacing = 1.0
    points = wall_samples(surface, spacing)
    # 48 edges along the tube, half of them diagonals; 2.5 times as many as at the full spacing at most.
    assert 48 * 400 < len(points) < 2.5 * 48 * 400
    share = np.random.default_rng(2).dirichlet(np.ones(3), 48 * 100)
    asked = np.einsum("nk,nkx->nx", share, vertices[np.repeat(sides, 100, axis=0)])
    # The radius around an equilateral triangle whose edges are as long as the spacing.
    assert cKDTree(points).query(asked)[0].max() <= spacing / np.sqrt(3.0)


def test_a_sheet_is_refused_before_it_fills_the_memory(phantoms: ModuleType) -> None:
    vertices, faces = phantoms.box((0.0, 0.0, 0.0), (1900.0, 1900.0, 1.0))
    surface = Surface(vertices, faces, np.full(12, -1), (), "mesh")
    with pytest.raises(GeometryError, match="a lumen is no such sheet"):
        voronoi_graph(surface, WallDistance(surface))
