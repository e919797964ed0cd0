"""tubeplan bench vmtk: the optimal path beside what a careful user makes today of VMTK's line and a smoothing spline."""

# Strategy: the peer's line (VMTK's where a Python with VMTK is found, otherwise the exact Voronoi line by
# scipy, and the rows say so) is given the true ends and smoothed by scipy's smoothing spline. Its smoothing factor is
# swept. Two results within the curvature limit stand for the peer: the one with the largest least clearance, better than any
# one setting that a user would guess, and the straightest that keeps half of that, where the spline cuts corners. Each time
# the optimal path is asked for at the very curvature that the spline has. Where an end is the narrowest
# place of the whole way no path can do better than it; that is said by the row's target.

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.interpolate import BSpline, splprep

from segmentation.arrays import FloatArray
from segmentation.errors import TubeplanError
from segmentation.mesh import Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.bench.anatomies import anatomies
from tubeplan_viz.bench.centerline_methods import delaunay_chains
from tubeplan_viz.bench.optimal_anatomies import proved
from tubeplan_viz.bench.peers import VMTK_RUNS_ON, run_vmtk, vmtk_python
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.bench.trees import TreeModel, airway_tree, renal_tree
from tubeplan_viz.centerline import trace_centerline, voronoi_graph
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.pipeline import Notify
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import OptimalSettings, TubeProblem, TubeSettings, optimise
from tubeplan_viz.tube.optimal import passage_of

CURVATURE_MAX = 0.125
# Root mean square distance, mm, that the smoothing spline may leave its line by.
SMOOTHINGS = np.geomspace(0.01, 3.0, 19)
LINE_STEP, SAMPLE_STEP = 1.0, 0.05
# Of the line within so much of an end nothing is kept: it runs to the end's own point instead.
END_LENGTH = 2.0
# The true end is held by a weight of this many line points.
END_WEIGHT = 1000.0
# A clearance this near to the ends' own is as large as any path's.
TIE = 0.01
# Through necks narrower than this, mm, no instrument goes, and a mesh's facets bend more than a path may.
NECK = 0.3


@dataclass(frozen=True, eq=False, kw_only=True)
class Ways:
    """A tree of tubes with the ways that are compared in it.

    Attributes
    ----------
    name : str
    surface : Surface
    root : (3,) float array, mm
    targets : mapping of str to (3,) float array, mm
        By their names.
    """

    name: str
    surface: Surface
    root: FloatArray
    targets: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False, kw_only=True)
class Peer:
    """The best smoothing spline within the curvature limit.

    Attributes
    ----------
    curvature : float, 1/mm
        Largest, of samples `SAMPLE_STEP` apart.
    least, mean : float, mm
        Sampled clearance.
    smoothing : float, mm
    """

    curvature: float
    least: float
    mean: float
    smoothing: float


def vmtk_line(*, quick: bool, notify: Notify) -> list[Row]:
    """Least clearance at equal curvature on a renal and an airway tree and on the data sets at hand, target by target.

    Parameters
    ----------
    quick : bool
        The generated renal tree only.
    notify : Notify
    """
    rows: list[Row] = []
    for ways in compared_ways(quick=quick):
        notify(ways.name, 0, 0)
        rows += tree_rows(ways)
    return rows


def compared_ways(*, quick: bool) -> Iterator[Ways]:
    """The generated trees, then every data set at hand."""
    for model in [renal_tree()] if quick else [renal_tree(), airway_tree(generations=2, voxel=0.8)]:
        yield ways_of(model)
    if quick:
        return
    for anatomy in anatomies():
        yield Ways(name=anatomy.name, surface=anatomy.tree.surface, root=anatomy.start, targets=dict(anatomy.goals))


def ways_of(model: TreeModel) -> Ways:
    """From the root of a generated tree to all its tips."""
    names = [f"target {number + 1} of {len(model.targets)}" for number in range(len(model.targets))]
    return Ways(name=model.name, surface=model.surface, root=model.root, targets=dict(zip(names, model.targets, strict=True)))


def tree_rows(ways: Ways) -> list[Row]:
    """Rows of one tree."""
    wall = WallDistance(ways.surface)
    lines, source = peer_lines(ways, wall)
    graph = voronoi_graph(ways.surface, wall)
    rows = []
    for line, (name, goal) in zip(lines, ways.targets.items(), strict=True):
        case = f"{ways.name}, {name}"
        peers = smoothed(line, ways.root, goal, wall)
        if not peers:
            rows.append(Row(case=case, figure="smoothing splines within the curvature limit", ours=0.0, source=source))
            continue
        middle = trace_centerline(graph, wall, ways.root, goal)
        if middle is None:
            raise TubeplanError(f"{case}: no centerline was found, expected one; check the tree's mesh")
        for kind, peer in peers.items():
            problem = TubeProblem(
                surface=ways.surface,
                wall=wall,
                centerline=middle,
                start=ways.root,
                goal=goal,
                limits=limits_of(peer),
                settings=TubeSettings(),
            )
            found = target_rows(f"{case}, {kind}", problem, peer, source)
            if middle.radii.min() < NECK:
                found = [replace(row, target=f"shown only: a neck under {NECK:g} mm", holds=None) for row in found]
            rows += found
    return rows


def limits_of(peer: Peer) -> Limits:
    """The peer's own curvature as the limit, the common one where the peer leaves the lumen; the clearance is compared."""
    return Limits(curvature_max=peer.curvature if peer.least > 0.0 else CURVATURE_MAX, clearance_min=0.0)


def target_rows(case: str, problem: TubeProblem, peer: Peer, source: str) -> list[Row]:
    """The optimal path at the peer's curvature, beside the peer."""
    ends = float(problem.wall.distance(problem.centerline.points[[0, -1]]).min())
    bound, mean, curvature = whole_method(problem) if peer.least <= 0.0 else refinement(problem)
    kept = curvature <= peer.curvature
    # A spline that leaves the lumen is no path, and at its curvature there may be none: ours has to be one, whatever it needs.
    if peer.least <= 0.0:
        holds, target = bound > 0.0, f"over 0: the spline leaves the lumen at {peer.curvature:.4f} 1/mm"
    elif peer.least >= ends - TIE:
        holds, target = kept and bound >= ends - TIE, f"the ends' own {ends:.3f} mm, which both have"
    else:
        holds, target = kept and bound > peer.least, "more"
    return [
        Row(
            case=case,
            figure=f"least clearance mm at {curvature if peer.least <= 0.0 else peer.curvature:.4f} 1/mm, proved",
            ours=bound,
            reference=peer.least,
            source=f"{source}, sampled, smoothed by {peer.smoothing:.2f} mm",
            target=target,
            holds=bool(holds),
        ),
        Row(case=case, figure="mean clearance mm", ours=mean, reference=peer.mean, source=source),
    ]


def refinement(problem: TubeProblem) -> tuple[float, float, float]:
    """Least clearance, mm, proved; mean clearance, mm, and curvature bound, 1/mm, of the refinement's first phase."""
    passage = passage_of(problem.wall, problem.centerline, problem.limits)
    first = next((proposal for proposal in optimise(passage, OptimalSettings()) if proposal.clearance is not None), None)
    if first is None or first.clearance is None:
        raise TubeplanError("the search ended without a proof, expected one")
    return first.clearance.bound, first.mean, first.curvature


def whole_method(problem: TubeProblem) -> tuple[float, float, float]:
    """The same of the method's last path, with all that it tries where the refinement alone keeps no curvature limit."""
    best = proved(problem)
    mean = float(problem.wall.clearance(best.curve(best.curve.uniform_parameters(SAMPLE_STEP))).mean())
    return best.clearance, mean, best.curvature


def peer_lines(tree: Ways, wall: WallDistance) -> tuple[list[FloatArray], str]:
    """The peer's line from the root to each target, (n, 3) mm, and what it is."""
    ends = np.array([tree.root, *tree.targets.values()])
    python = vmtk_python()
    if python is None:
        chains = delaunay_chains(tree.surface, wall, ends)
        return chains, f"Voronoi line by scipy (VMTK absent: {VMTK_RUNS_ON}) + smoothing spline"
    with TemporaryDirectory() as place:
        mesh = Path(place) / "mesh.ply"
        write_ply(tree.surface, mesh)
        return list(run_vmtk(python, mesh, ends, runs=1).lines), "VMTK line + smoothing spline"


def smoothed(line: FloatArray, start: FloatArray, goal: FloatArray, wall: WallDistance) -> dict[str, Peer]:
    """The best and the straightest useful smoothing spline of a line that keep the curvature limit; empty when none does."""
    found = []
    for smoothing in SMOOTHINGS:
        curve = smoothing_spline(line, start, goal, float(smoothing))
        u = curve.uniform_parameters(SAMPLE_STEP)
        curvature = float(curve.curvature(u).max())
        if curvature > CURVATURE_MAX:
            continue
        clearance = wall.clearance(curve(u[::4]))
        least, mean = float(clearance.min()), float(clearance.mean())
        found.append(Peer(curvature=curvature, least=least, mean=mean, smoothing=float(smoothing)))
    if not found:
        return {}
    # Of equal clearances, to a micrometre, the straighter path.
    best = max(found, key=lambda peer: (round(peer.least, 3), -peer.curvature))
    # Where even the best leaves the lumen, it alone stands for the peer.
    enough = min(best.least, 0.5 * best.least)
    straightest = min((peer for peer in found if peer.least >= enough), key=lambda peer: peer.curvature)
    return {"widest spline": best} | ({} if straightest is best else {"straightest spline": straightest})


def smoothing_spline(line: FloatArray, start: FloatArray, goal: FloatArray, smoothing: float) -> SplineCurve:
    """A cubic smoothing spline (scipy's) of a line resampled evenly, held at its true ends."""
    away = np.minimum(np.linalg.norm(line - start, axis=1), np.linalg.norm(line - goal, axis=1)) > END_LENGTH
    whole = np.concatenate([start[None], line[away], goal[None]])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(whole, axis=0), axis=1))])
    even = np.linspace(0.0, s[-1], int(np.ceil(s[-1] / LINE_STEP)) + 1)
    points = np.column_stack([np.interp(even, s, whole[:, k]) for k in range(3)])
    weights = np.ones(len(points))
    weights[[0, -1]] = END_WEIGHT
    (knots, control, degree), _ = splprep(points.T, w=weights, u=even / s[-1], s=len(points) * smoothing**2, k=3)
    spline = BSpline(knots, np.column_stack(control), degree)
    return SplineCurve(3, np.asarray(spline.t), np.asarray(spline.c))
