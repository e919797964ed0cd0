"""One centerline from a start to a goal through the Voronoi diagram."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import savgol_filter
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.centerline.line import Centerline
from tubeplan_viz.centerline.voronoi import VoronoiGraph, mean_reciprocal
from tubeplan_viz.geometry import WallDistance


@dataclass(frozen=True, kw_only=True)
class CenterlineSettings:
    """How the centerline is found.

    Attributes
    ----------
    omega : float, 1/mm
        Regularisation of the cost 1/R + omega (Dai 2024, eq. 1). A small value: it
        only decides where R is very large.
    step : float, mm
        Distance between the points given out (Dai 2024: 1 mm).
    smoothing : float, mm
        Window of the local quadratic fit that takes out the zigzag of Voronoi edges.
        A quadratic leaves arcs where they are, which a moving average does not.
    """

    omega: float = 0.01
    step: float = 1.0
    smoothing: float = 5.0

    def __post_init__(self) -> None:
        if not 0.01 <= self.step <= 100.0:
            raise CaseError(f"the centerline's step is {self.step:g} mm, expected 0.01 to 100 (Dai 2024: about 1)")
        if not 0.0 <= self.smoothing <= 100.0:
            raise CaseError(f"the centerline's smoothing is {self.smoothing:g} mm, expected 0 to 100")
        if not 0.0 <= self.omega <= 100.0:
            raise CaseError(f"the centerline's omega is {self.omega:g} 1/mm, expected 0 to 100")


def trace_centerline(
    graph: VoronoiGraph, wall: WallDistance, start: ArrayLike, goal: ArrayLike, settings: CenterlineSettings | None = None
) -> Centerline | None:
    """Least-cost line through the inscribed spheres from `start` to `goal`.

    Start and goal are joined to every Voronoi vertex whose inscribed sphere holds
    them, so that no joining piece can leave the lumen.

    Parameters
    ----------
    graph : VoronoiGraph
    wall : WallDistance
    start, goal : (3,) array_like, mm
        Inside the lumen or on a cap.

    Returns
    -------
    Centerline or None
        None when no chain of inscribed spheres joins the two: they lie in different parts.
    """
    settings = settings or CenterlineSettings()
    ends = np.array([start, goal], dtype=float)
    spheres = [holding_spheres(graph, wall, point) for point in ends]
    n = len(graph.nodes)
    i, j = graph.edges.T
    rows, columns, weights = [i], [j], [graph.edge_costs(settings.omega)]
    end_radius = np.maximum(wall.distance(ends), 1e-3)
    for number, held in enumerate(spheres):
        length = np.linalg.norm(graph.nodes[held] - ends[number], axis=1)
        cost = length * (mean_reciprocal(np.full(len(held), end_radius[number]), graph.radii[held]) + settings.omega)
        rows.append(np.full(len(held), n + number))
        columns.append(held)
        weights.append(np.maximum(cost, 1e-12))
    matrix = csr_matrix((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), shape=(n + 2, n + 2))
    _, previous = dijkstra(matrix, directed=False, indices=n, return_predecessors=True)
    chain = walk_back(previous, n + 1)
    if chain is None:
        return None
    points = np.concatenate([graph.nodes, ends])[chain]
    return resample(points, wall, settings)


def holding_spheres(graph: VoronoiGraph, wall: WallDistance, point: FloatArray) -> IntArray:
    """Voronoi vertices whose inscribed sphere holds the point.

    Raises
    ------
    CaseError
        If there is none: the point is outside, or in a fold finer than the mesh.
    """
    gap = np.linalg.norm(graph.nodes - point, axis=1)
    # The wall distance is 1-Lipschitz, so a vertex inside the point's own inscribed sphere
    # is reached in a straight line as well.
    held = np.flatnonzero((gap <= graph.radii) | (gap <= float(wall.distance(point)[0])))
    if len(held) == 0:
        nearest = int(np.argmin(gap - graph.radii))
        x, y, z = graph.nodes[nearest]
        raise CaseError(
            f"the point ({point[0]:.2f}, {point[1]:.2f}, {point[2]:.2f}) mm lies in no inscribed sphere of the lumen; "
            f"the nearest middle point is ({x:.2f}, {y:.2f}, {z:.2f}) mm, use that"
        )
    return held


def walk_back(previous: IntArray, node: int) -> IntArray | None:
    """Nodes from the source of a shortest-path tree to `node`, or None when it was not reached."""
    if previous[node] < 0:
        return None
    chain = [node]
    while previous[chain[-1]] >= 0:
        chain.append(int(previous[chain[-1]]))
    return np.array(chain[::-1])


def resample(points: FloatArray, wall: WallDistance, settings: CenterlineSettings) -> Centerline:
    """Smooth, even points along a Voronoi polyline; the ends stay where they are."""
    fine = 0.25 * settings.step
    line = even_points(points, fine)
    window = 2 * round(0.5 * settings.smoothing / fine) + 1
    if len(line) > window > 3:
        smooth = savgol_filter(line, window, 2, axis=0, mode="interp")
        # A fit may cut a corner of a tight lumen: keep it only where it stays as clear of the wall.
        blend = np.minimum(1.0, np.arange(len(line)) / (window // 2))
        blend = (blend * blend[::-1])[:, None]
        smooth = blend * smooth + (1.0 - blend) * line
        keep = wall.clearance(smooth) >= 0.9 * wall.distance(line)
        line = np.where(keep[:, None], smooth, line)
    line = even_points(line, settings.step)
    return Centerline(line, wall.distance(line))


def even_points(points: FloatArray, spacing: float) -> FloatArray:
    """Points evenly spaced along a polyline, ends kept, at most `spacing` apart."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = np.concatenate([[True], steps > 1e-9])
    points = points[keep]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    count = max(int(np.ceil(s[-1] / spacing - 1e-9)), 2)
    return np.column_stack([np.interp(np.linspace(0.0, s[-1], count + 1), s, points[:, k]) for k in range(3)])
