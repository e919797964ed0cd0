"""Model tubes with their wall and Voronoi graph, each made once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import pytest

from tubeplan_viz.bench.models import (
    Model,
    bent_cylinder_1,
    helix_tube,
    narrow_neck,
    straight_tube,
    torus_piece,
    y_junction,
)
from tubeplan_viz.centerline import VoronoiGraph, voronoi_graph
from tubeplan_viz.geometry import WallDistance


@dataclass(frozen=True, eq=False)
class Prepared:
    model: Model
    wall: WallDistance
    graph: VoronoiGraph


BUILDERS: dict[str, Callable[[], Model]] = {
    "swept": bent_cylinder_1,
    "structured": lambda: bent_cylinder_1(meshing="structured"),
    "marching cubes": lambda: bent_cylinder_1(meshing="marching_cubes"),
    "straight": straight_tube,
    "torus": torus_piece,
    "helix": helix_tube,
    "neck": narrow_neck,
    "junction": y_junction,
}


@pytest.fixture(scope="package")
def prepared() -> Callable[[str], Prepared]:
    """A model by name with its wall and graph."""

    @cache
    def prepare(name: str) -> Prepared:
        model = BUILDERS[name]()
        wall = WallDistance(model.surface)
        return Prepared(model, wall, voronoi_graph(model.surface, wall))

    return prepare
