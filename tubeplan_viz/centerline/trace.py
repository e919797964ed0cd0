"""One centerline from a start to a goal through the Voronoi diagram."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from segmentation.arrays import FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.centerline.line import Centerline
from tubeplan_viz.centerline.ridge import to_ridge
from tubeplan_viz.centerline.voronoi import VoronoiGraph, mean_reciprocal
from tubeplan_viz.geometry import WallDistance

# How far the line may move to the exact middle, in radii: by what thinned samples can be off.
REACH = 0.25
# A point that the first move left where it was, within this share of the radius, needs no second.
SETTLED = 0.02


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
    chain = least_cost_chains(graph, wall, start, np.atleast_2d(np.asarray(goal, dtype=float)), settings)[0]
    if chain is None:
        return None
    line = even_curve(middle_line(chain, wall, settings), settings.step)
    return Centerline(line, wall.distance(line))


@dataclass(frozen=True, eq=False)
class Chain:
    """A way through the diagram: vertex numbers, points (n, 3) mm and radii (n,) mm of their spheres.

    The start and the goals are numbered after the graph's own vertices.
    """

    nodes: IntArray
    points: FloatArray
    radii: FloatArray

    def part(self, first: int, last: int) -> Chain:
        """Vertices from `first` up to, not including, `last`."""
        return Chain(self.nodes[first:last], self.points[first:last], self.radii[first:last])


def least_cost_chains(
    graph: VoronoiGraph, wall: WallDistance, start: ArrayLike, goals: FloatArray, settings: CenterlineSettings
) -> list[Chain | None]:
    """Ways of least cost (Dai 2024, eq. 1) from the start to every goal, all from one tree; None where there is none.

    Raises
    ------
    CaseError
        If the start or a goal lies in no inscribed sphere.
    """
    ends = np.concatenate([np.asarray(start, dtype=float)[None], goals])
    radii = np.maximum(wall.distance(ends), 1e-3)
    n = len(graph.nodes)
    i, j = graph.edges.T
    rows, columns, weights = [i], [j], [graph.edge_costs(settings.omega)]
    for number, (end, radius) in enumerate(zip(ends, radii, strict=True)):
        held = holding_spheres(graph, wall, end)
        length = np.linalg.norm(graph.nodes[held] - end, axis=1)
        cost = length * (mean_reciprocal(np.full(len(held), radius), graph.radii[held]) + settings.omega)
        rows.append(np.full(len(held), n + number))
        columns.append(held)
        weights.append(np.maximum(cost, 1e-12))
    a, b, cost = np.concatenate(rows), np.concatenate(columns), np.concatenate(weights)
    size = n + len(ends)
    matrix = csr_matrix((np.concatenate([cost, cost]), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(size, size))
    _, previous = dijkstra(matrix, indices=n, return_predecessors=True)
    points, spheres = np.concatenate([graph.nodes, ends]), np.concatenate([graph.radii, radii])
    chains = [walk_back(previous, n + 1 + number) for number in range(len(goals))]
    return [None if chain is None else Chain(chain, points[chain], spheres[chain]) for chain in chains]


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


def middle_line(chain: Chain, wall: WallDistance, settings: CenterlineSettings) -> FloatArray:
    """Smooth points, half a step apart, along the middle of the lumen beside a chain; the ends stay where they are."""
    fine = 0.5 * settings.step
    s = polyline_length(chain.points)
    raw = even_points(chain.points, fine)
    radii = np.interp(np.linspace(0.0, s[-1], len(raw)), s, chain.radii)
    line = smoothed(raw, 0.5 * settings.smoothing, fine)
    # Start and goal may lie off the middle, and the line takes a sphere's radius to get there.
    s = polyline_length(line)
    onset = np.minimum(1.0, s / chain.radii[0]) * np.minimum(1.0, (s[-1] - s) / chain.radii[-1])
    reach = onset * (REACH * radii + np.linalg.norm(line - raw, axis=1))
    first, found = to_ridge(line, wall, radii=radii, reach=reach)
    again = np.where(np.linalg.norm(first - line, axis=1) > SETTLED * radii, 0.25 * reach, 0.0)
    line, radii = to_ridge(first, wall, radii=found, reach=again)
    smooth = smoothed(line, settings.smoothing, fine)
    # A fit may cut a corner of a tight lumen: keep it only where it stays as clear of the wall. A
    # shift by less than a tenth of the radius cannot take more than a tenth.
    far = np.flatnonzero(np.linalg.norm(smooth - line, axis=1) > 0.1 * radii)
    if len(far):
        cut = far[wall.clearance(smooth[far]) < 0.9 * wall.distance(line[far])]
        smooth[cut] = line[cut]
    return smooth


def polyline_length(points: FloatArray) -> FloatArray:
    """Length from the first point of a polyline up to each, (n,) mm."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def smoothed(line: FloatArray, width: float, spacing: float) -> FloatArray:
    """Local quadratic fits over `width` mm, fading out towards the ends, which stay."""
    window = 2 * round(0.5 * width / spacing) + 1
    if not len(line) > window > 3:
        return line
    # Imported here: it brings scipy.stats, a fifth of what a command takes to start, also one that traces nothing.
    from scipy.signal import savgol_filter

    blend = np.minimum(1.0, np.arange(len(line)) / (window // 2))
    blend = (blend * blend[::-1])[:, None]
    return np.asarray(blend * savgol_filter(line, window, 2, axis=0, mode="interp") + (1.0 - blend) * line)


def even_points(points: FloatArray, spacing: float) -> FloatArray:
    """Points evenly spaced along a polyline, ends kept, at most `spacing` apart."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], steps > 1e-9])]
    s = polyline_length(points)
    count = max(int(np.ceil(s[-1] / spacing - 1e-9)), 2)
    return np.column_stack([np.interp(np.linspace(0.0, s[-1], count + 1), s, points[:, k]) for k in range(3)])


def even_curve(points: FloatArray, spacing: float) -> FloatArray:
    """Points evenly spaced along the cubic spline through smooth points, ends kept, at most `spacing` apart.

    Points taken from the chords would lie a sagitta inside every bend.
    """
    if len(points) < 4:
        return even_points(points, spacing)
    s = polyline_length(points)
    count = max(int(np.ceil(s[-1] / spacing - 1e-9)), 2)
    return np.asarray(CubicSpline(s, points)(np.linspace(0.0, s[-1], count + 1)))
