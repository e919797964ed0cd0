"""tubeplan bench centerline: ours and the peers that are installed, on the same meshes, against exact axes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from segmentation.mesh_files import read_surface, write_ply
from tubeplan_viz.bench import centerline_methods
from tubeplan_viz.bench.alone import run_alone
from tubeplan_viz.bench.centerline_methods import METHODS, NEEDS
from tubeplan_viz.bench.curvature import curvature_rows
from tubeplan_viz.bench.models import Meshing, Model, bent_cylinder_1
from tubeplan_viz.bench.peers import SCRIPT as VMTK_SCRIPT
from tubeplan_viz.bench.peers import VMTK_RUNS_ON, vmtk_python
from tubeplan_viz.bench.rows import Row, under
from tubeplan_viz.bench.trees import TreeModel, airway_tree, renal_tree
from tubeplan_viz.centerline import trace_centerline, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.pipeline import Notify

# Measured once on a 2-core machine: VMTK 1.5.2, raw line, greatest mean error of the three meshes.
VMTK_ERROR = 0.006
VMTK_METHOD = "VMTK"
VMTK = "VMTK 1.5.2, 2 cores, measured before"
# Away from the ends, where the line leaves the axis for the picked point, and from junctions,
# where the middle of the lumen lies off all axes.
END_LENGTH = 5.0
JUNCTION_RADII = 2.5
# A slow peer is not worth more.
TIME_LIMIT = 600.0
PEAK_MEMORY = 400.0
# An open mesh and its capped version may differ by so much, mm, at places evenly along the line.
OPEN_APART, EVEN = 0.05, 500


@dataclass(frozen=True, eq=False, kw_only=True)
class Trial:
    """One mesh with its ends, the measure of error, and the time aimed at.

    Attributes
    ----------
    name : str
    surface : Surface
    ends : (k, 3) float array, mm
        The root first.
    interior_gap : callable
        Distances to the axes, mm, of those of the given points that lie away from ends and junctions.
    seconds, vmtk_seconds : float
        Target of ours, and what VMTK took.
    """

    name: str
    surface: Surface
    ends: FloatArray
    interior_gap: Callable[[FloatArray], FloatArray]
    seconds: float
    vmtk_seconds: float


def centerline(*, quick: bool, notify: Notify) -> list[Row]:
    """Error, time and memory of every method on cylinder 1, a renal tree and an airway; open meshes; curvature at scale.

    Parameters
    ----------
    quick : bool
        Cylinder 1 and the renal tree only, ours and the fast peers.
    notify : Notify
    """
    rows: list[Row] = []
    for trial in trials(quick=quick):
        for method in (*METHODS, VMTK_METHOD):
            if quick and method not in ("tubeplan", "scikit-image thinning"):
                continue
            notify(f"{trial.name}, {method}", 0, 0)
            rows += method_rows(trial, method)
    for kind in ("structured", "marching_cubes"):
        notify(kind, 0, 0)
        rows += radius_rows(f"cylinder 1, {kind.replace('_', ' ')}", bent_cylinder_1(meshing=kind))
    notify("open and capped", 0, 0)
    meshings: tuple[Meshing, ...] = ("swept", "structured")
    for kind in meshings:
        rows.append(open_row(f"cylinder 1, {kind}", bent_cylinder_1(meshing=kind)))
    notify("curvature at scale", 0, 0)
    return [*rows, *curvature_rows()]


def trials(*, quick: bool) -> list[Trial]:
    """The meshes, with the times aimed at and those of VMTK."""
    cylinder = bent_cylinder_1()
    found = [
        Trial(
            name="cylinder 1",
            surface=cylinder.surface,
            ends=np.array([cylinder.start, cylinder.goal]),
            interior_gap=lambda points: off_axis(points[between_ends(points, cylinder)], cylinder)[0],
            seconds=0.3,
            vmtk_seconds=3.0,
        ),
        tree_trial(renal_tree(), seconds=0.6, vmtk_seconds=7.7),
    ]
    return found if quick else [*found, tree_trial(airway_tree(), seconds=5.0, vmtk_seconds=280.0)]


def tree_trial(model: TreeModel, *, seconds: float, vmtk_seconds: float) -> Trial:
    """A tree with all its tips as targets."""
    return Trial(
        name=f"{model.name}, {len(model.surface.faces)} faces, {len(model.targets)} targets",
        surface=model.surface,
        ends=np.concatenate([model.root[None], model.targets]),
        interior_gap=lambda points: model.off_axis(points, end_length=END_LENGTH, junction_radii=JUNCTION_RADII),
        seconds=seconds,
        vmtk_seconds=vmtk_seconds,
    )


def between_ends(points: FloatArray, model: Model) -> np.ndarray:
    """Which points have their foot on the axis away from its ends, (n,) bool."""
    s = model.arc_length[cKDTree(model.axis_points).query(points)[1]]
    return np.asarray((s > END_LENGTH) & (s < model.length - END_LENGTH))


@dataclass(frozen=True, eq=False, kw_only=True)
class Timed:
    """What a method found on one mesh, (n, 3) mm, and what two runs in a process of its own took: s, s, s and MB."""

    points: FloatArray
    cold: float
    warm: float
    whole: float
    peak: float


def method_rows(trial: Trial, method: str) -> list[Row]:
    """Rows of one method on one mesh, run in a process of its own; one row saying so when it is not installed."""
    case = f"{trial.name}: {method}"
    python = vmtk_python() if method == VMTK_METHOD else sys.executable
    if python is None:
        return [Row(case=case, figure="installed (0 no, 1 yes)", ours=0.0, source=f"not installed: {VMTK_RUNS_ON}")]
    if method in NEEDS and find_spec(NEEDS[method]) is None:
        return [Row(case=case, figure="installed (0 no, 1 yes)", ours=0.0, source=f"not installed: {NEEDS[method]}")]
    with TemporaryDirectory() as folder:
        mesh, ends, out = (Path(folder) / name for name in ("mesh.ply", "ends.npy", "out.npz"))
        write_ply(trial.surface, mesh)
        np.save(ends, trial.ends)
        script = [VMTK_SCRIPT] if method == VMTK_METHOD else [Path(centerline_methods.__file__), method]
        begun = time.perf_counter()
        command = [python, "-P", *map(str, (*script, mesh, ends, out))]
        ended = run_alone(command, limit=TIME_LIMIT)
        if ended.status is None:
            return [Row(case=case, figure="stopped after s", ours=TIME_LIMIT)]
        whole = time.perf_counter() - begun
        if ended.status != 0:
            return [Row(case=case, figure="failed (exit status)", ours=float(ended.status), source=ended.reason)]
        with np.load(out) as found:
            cold, warm, peak = (float(found[name]) for name in ("cold", "warm", "peak"))
            timed = Timed(points=found["points"], cold=cold, warm=warm, whole=whole, peak=peak)
    return timed_rows(case, trial, timed, aimed=method == "tubeplan")


def timed_rows(case: str, trial: Trial, timed: Timed, *, aimed: bool) -> list[Row]:
    """Error, time and memory, with targets where they are aimed at."""
    gap = trial.interior_gap(timed.points)
    inside = 100.0 * float(WallDistance(trial.surface).inside(timed.points).mean())
    # A line may break off near an end (VMTK's does on a tube of regular rings): then it has no error away from them.
    errors: list[tuple[str, float, float | None, float | None]] = []
    if len(gap):
        errors = [
            ("interior error mm, mean", float(gap.mean()), VMTK_ERROR, 0.01),
            ("interior error mm, largest", float(gap.max()), None, 0.03),
        ]
    figures: list[tuple[str, float, float | None, float | None]] = [
        *errors,
        ("warm, mesh file to lines, CPU s", timed.warm, trial.vmtk_seconds, trial.seconds),
        ("first run in a process, CPU s", timed.cold, None, None),
        ("process with two runs, s", timed.whole, None, None),
        ("peak memory MB", timed.peak, None, PEAK_MEMORY),
    ]
    rows = [Row(case=case, figure="points inside %", ours=inside)]
    if aimed:
        rows = [Row(case=case, figure="points inside %", ours=inside, target="100", holds=inside == 100.0 and len(gap) > 0)]
    rows.append(Row(case=case, figure="points away from ends and junctions", ours=len(gap)))
    for figure, value, reference, limit in figures:
        source = VMTK if reference is not None else ""
        if aimed and limit is not None:
            rows.append(under(case, figure, value, limit, reference, source))
        else:
            rows.append(Row(case=case, figure=figure, ours=value, reference=reference, source=source))
    return rows


def radius_rows(case: str, model: Model) -> list[Row]:
    """Error of line and radius, and how much of the axis is covered, for one way of meshing."""
    wall = WallDistance(model.surface)
    line = trace_centerline(voronoi_graph(model.surface, wall), wall, model.start, model.goal)
    assert line is not None
    interior = between_ends(line.points, model)
    gap, clearance = off_axis(line.points[interior], model)
    covered = 100.0 * float(line.arc_length[-1]) / model.length
    return [
        under(case, "interior error mm, mean", float(gap.mean()), 0.01),
        under(case, "interior error mm, largest", float(gap.max()), 0.03),
        under(case, "radius error mm, mean", float(np.abs(line.radii[interior] - clearance).mean()), 0.02),
        Row(case=case, figure="axis covered %", ours=covered, target="100 ± 0.5", holds=abs(covered - 100.0) < 0.5),
    ]


def open_row(name: str, model: Model) -> Row:
    """How far the line of a tube moves when its caps are left out of the file and made anew on reading."""
    surface = model.surface
    with TemporaryDirectory() as folder:
        file = Path(folder) / "open.obj"
        corners = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in surface.vertices]
        file.write_text("\n".join(corners + [f"f {a} {b} {c}" for a, b, c in surface.wall_faces + 1]), encoding="ascii")
        closed = read_surface(file, mesh_unit="mm").surface
    # A micrometre before the caps: rounding may put the middle of one version's cap outside the other.
    ends = [
        cap.center - 1e-3 * cap.normal for cap in sorted(closed.caps, key=lambda cap: np.linalg.norm(cap.center - model.start))
    ]
    lines = []
    for one in (surface, closed):
        wall = WallDistance(one)
        line = trace_centerline(voronoi_graph(one, wall), wall, ends[0], ends[-1])
        assert line is not None
        s = np.linspace(0.0, line.arc_length[-1], EVEN)
        lines.append(np.column_stack([np.interp(s, line.arc_length, line.points[:, k]) for k in range(3)]))
    off = float(np.linalg.norm(lines[0] - lines[1], axis=1).max())
    return under(name, "lines of the open and of the capped mesh apart mm, largest", off, OPEN_APART)


def off_axis(points: FloatArray, model: Model) -> tuple[FloatArray, FloatArray]:
    """Distance of (n, 3) points to the exact axis, and the axis' own clearance at the foot: both (n,) mm."""
    nearest = cKDTree(model.axis_points).query(points)[1]
    gap, clearance = np.full(len(points), np.inf), np.empty(len(points))
    for first in (nearest - 1, nearest):
        # The axis points are 0.1 mm apart; the nearest lies on one of the two pieces beside it.
        i = np.clip(first, 0, len(model.axis_points) - 2)
        a, piece = model.axis_points[i], model.axis_points[i + 1] - model.axis_points[i]
        share = np.clip(np.einsum("ij,ij->i", points - a, piece) / np.einsum("ij,ij->i", piece, piece), 0.0, 1.0)
        found = np.linalg.norm(a + share[:, None] * piece - points, axis=1)
        there = (1.0 - share) * model.clearance[i] + share * model.clearance[i + 1]
        gap, clearance = np.where(found < gap, found, gap), np.where(found < gap, there, clearance)
    return gap, clearance
