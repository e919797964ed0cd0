"""A tube that forks: one wide and one narrow branch, both bent, made by marching cubes from a known distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from tubeplan_viz.centerline import Endpoint, VoronoiGraph, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.instruments import ReachSettings, Target, find_targets

STEM, BEND, WIDE, NARROW, STEP = 30.0, 12.0, 2.0, 1.2, 0.6  # mm
START = np.array([0.0, 0.0, 2.0])


@dataclass(frozen=True, eq=False)
class Fork:
    """A stem along z that turns into a branch of radius 2 mm towards +x and one of 1.2 mm towards -x."""

    surface: Surface
    wall: WallDistance
    graph: VoronoiGraph
    goals: tuple[Endpoint, ...]
    targets: tuple[Target, ...]


def axes() -> list[tuple[FloatArray, float]]:
    """Points of the stem and of both branches, with their radii, mm."""
    stem = np.column_stack([np.zeros(60), np.zeros(60), np.linspace(0.0, STEM, 60)])
    made = [(stem, WIDE)]
    for sign, radius in ((1.0, WIDE), (-1.0, NARROW)):
        angle = np.linspace(0.0, np.pi / 2.0, 60)
        arc = np.column_stack([sign * BEND * (1.0 - np.cos(angle)), 0.0 * angle, STEM + BEND * np.sin(angle)])
        out = arc[-1] + np.column_stack([sign * np.linspace(0.0, 8.0, 30), np.zeros(30), np.zeros(30)])
        made.append((np.concatenate([arc, out]), radius))
    return made


@pytest.fixture(scope="session")
def fork() -> Fork:
    low, high = np.array([-24.0, -4.0, -4.0]), np.array([24.0, 4.0, 46.0])
    shape = np.ceil((high - low) / STEP).astype(int) + 1
    grid = np.stack(np.meshgrid(*(low[k] + STEP * np.arange(shape[k]) for k in range(3)), indexing="ij"), axis=-1)
    level = np.full(shape, np.inf)
    for points, radius in axes():
        level = np.minimum(level, cKDTree(points).query(grid.reshape(-1, 3))[0].reshape(shape) - radius)
    vertices, faces, _, _ = marching_cubes(level, 0.0)
    vertices = low + STEP * vertices
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    if np.einsum("ij,ij->i", a, np.cross(b, c)).sum() < 0.0:
        faces = faces[:, ::-1]
    surface = Surface(vertices, faces.astype(np.int64), np.full(len(faces), -1), (), "mesh")
    wall = WallDistance(surface)
    graph = voronoi_graph(surface, wall)
    goals = tuple(
        Endpoint(label=label, point=np.array([x, 0.0, STEM + BEND]), radius=radius, branch_length=30.0, confidence=1.0, cap=None)
        for label, x, radius in (("E2", 18.0, WIDE), ("E3", -18.0, NARROW))
    )
    return Fork(surface, wall, graph, goals, find_targets(wall, graph, START, goals, ReachSettings()))
