"""tubeplan bench infeasible: limits that cannot be met, and the least that would have to give.

Every case goes the whole way, from a mesh file to its run folder. What the run says would do is planned again, as
it is and two percent short of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from segmentation.mesh_files import write_ply
from tubeplan_viz.bench.models import Model, narrow_neck, torus_piece, variant_2
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.cases.tube import make_case
from tubeplan_viz.pipeline import Notify, RunOptions, run_tube

SHORT = 0.02
PLACE_MM, AVAILABLE = 1.0, 0.02
# A proved bound may be so far above what a path can have, and below it by what a mesh's facets take.
PROOF, FACETS = 0.04, 0.002
NECK = 1.0
BEND, TUBE = 8.0, 2.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Hindered:
    """Limits that a model cannot meet, and the truth about them.

    Attributes
    ----------
    name : str
    build : callable
        Makes the model.
    curvature_max, clearance_min : float, 1/mm and mm
    clearance : float, mm
        Largest that a path under the curvature limit can have.
    bend_radius : float or None, mm
        Largest at which a path with the clearance asked for exists; None when none does.
    source : str
        Where both come from.
    place : float or None
        Share of the way at which the limit is broken most.
    """

    name: str
    build: Callable[[], Model]
    curvature_max: float
    clearance_min: float
    clearance: float
    bend_radius: float | None
    source: str
    place: float | None


def clearance_at_bend(path_bend: float, *, bend: float = BEND, radius: float = TUBE) -> float:
    """Largest least clearance of a path bent by `path_bend` mm in a quarter bend, mm, from axis end to axis end.

    Of all paths that keep the bend radius the arc through both ends bulges most (Schur's comparison theorem), and so comes
    nearest to the axis' middle: it misses it by the difference of the two arcs' sagittas over their common chord.

    Examples
    --------
    >>> round(clearance_at_bend(10.0), 4), round(bend_at_clearance(2.0), 4)
    (1.9106, 9.6024)
    """
    half = bend * np.sqrt(0.5)
    return radius - (sagitta(bend, half) - sagitta(path_bend, half))


def bend_at_clearance(clearance: float, *, bend: float = BEND, radius: float = TUBE) -> float:
    """The inverse of `clearance_at_bend`: the largest bend radius, mm, with which that clearance can be kept."""
    half = bend * np.sqrt(0.5)
    rise = sagitta(bend, half) - (radius - clearance)
    return float((half**2 + rise**2) / (2.0 * rise))


def sagitta(radius: float, half_chord: float) -> float:
    """Height of an arc over its chord, mm."""
    return float(radius - np.sqrt(radius**2 - half_chord**2))


CLOSED = "closed form"
CASES = (
    Hindered(
        name="stenosis of 1 mm radius, instrument of 1.2 mm",
        build=lambda: narrow_neck(neck=NECK),
        curvature_max=0.1,
        clearance_min=1.2,
        clearance=NECK,
        bend_radius=None,
        source=CLOSED,
        place=0.5,
    ),
    Hindered(
        name="quarter bend of 8 mm, instrument of 10 mm bend radius",
        build=lambda: torus_piece(bend_radius=BEND, radius=TUBE),
        curvature_max=0.1,
        clearance_min=2.0,
        clearance=clearance_at_bend(10.0),
        bend_radius=bend_at_clearance(2.0),
        source=CLOSED,
        place=0.5,
    ),
    Hindered(
        name="quarter bend of 8 mm, instrument of 13 mm bend radius",
        build=lambda: torus_piece(bend_radius=BEND, radius=TUBE),
        curvature_max=1.0 / 13.0,
        clearance_min=1.8,
        clearance=clearance_at_bend(13.0),
        bend_radius=bend_at_clearance(1.8),
        source=CLOSED,
        place=0.5,
    ),
    Hindered(
        name="variant 2, instrument of 2.7 mm at 0.100",
        build=variant_2,
        curvature_max=0.1,
        clearance_min=2.7,
        clearance=2.585,
        # Between the planar optima 2.585 at 0.100 and 2.754 at 0.110 the clearance rises evenly: within 0.5 %.
        bend_radius=1.0 / (0.100 + 0.010 * (2.7 - 2.585) / (2.754 - 2.585)),
        source="planar optimum",
        place=None,
    ),
)
QUICK_CASES = CASES[:2]


def infeasible(*, quick: bool, notify: Notify) -> list[Row]:
    """Verdict, place, values and relaxation of limits that cannot be met.

    Parameters
    ----------
    quick : bool
        The stenosis and one bend only.
    notify : Notify
    """
    rows: list[Row] = []
    for case in QUICK_CASES if quick else CASES:
        notify(case.name, 0, 0)
        with TemporaryDirectory() as place:
            rows += case_rows(case, Runs(case.build(), Path(place)))
    return rows


class Runs:
    """Run folders of one model under changing limits.

    Parameters
    ----------
    model : Model
    folder : Path
        Where its mesh file and run folders are made.
    """

    def __init__(self, model: Model, folder: Path) -> None:
        self._model, self._folder, self._count = model, folder, 0
        write_ply(model.surface, folder / "model.ply")

    def plan(self, curvature_max: float, clearance_min: float) -> dict[str, Any]:
        """The content of result.json for these limits."""
        self._count += 1
        table = {
            "input": {"mesh": "model.ply"},
            "limits": {"curvature_max": curvature_max, "clearance_min": clearance_min},
            "planner": {"method": "optimal", "start": self._model.start.tolist(), "goal": self._model.goal.tolist()},
        }
        options = RunOptions(recording=False, report=False)
        return run_tube(make_case(table, folder=self._folder), self._folder / f"run-{self._count}", options)

    def hold(self, curvature_max: float, clearance_min: float) -> bool:
        """Whether a plan under these limits is proved."""
        result = self.plan(curvature_max, clearance_min)
        return bool(result["status"] == "ok" and result["certificate"]["holds"])


def case_rows(case: Hindered, runs: Runs) -> list[Row]:
    """What the run says of one case, held against the truth and against planning again."""
    result = runs.plan(case.curvature_max, case.clearance_min)
    bottleneck, relaxation = result["details"]["bottleneck"], result["details"]["relaxation"]
    proved = bool(bottleneck["proves_impossible"])
    bound = bottleneck["bend"]["clearance_upper_bound_mm"] if bottleneck["bend"] else bottleneck["clearance_upper_bound_mm"]
    rows = [
        Row(
            case=case.name,
            figure="proved impossible (1)",
            ours=proved,
            target="1, and status infeasible",
            holds=proved and result["status"] == "infeasible",
        ),
        Row(
            case=case.name,
            figure="required mm, as stated",
            ours=bottleneck["required_mm"],
            reference=case.clearance_min,
            source="limit",
            target="the limit",
            holds=bottleneck["required_mm"] == case.clearance_min,
        ),
        Row(
            case=case.name,
            figure="no path keeps more, mm, proved",
            ours=bound,
            reference=case.clearance,
            source=case.source,
            # A proof below what a path can have would be none; the meshes' facets lie within the walls.
            target=f"from {1.0 - FACETS:.1%} to {1.0 + PROOF:.0%}, below the limit",
            holds=(1.0 - FACETS) * case.clearance <= bound <= min((1.0 + PROOF) * case.clearance, case.clearance_min),
        ),
        near(case, "available mm at the given bend radius", relaxation["clearance_mm"], case.clearance),
    ]
    if case.place is not None:
        off = abs(broken_at(result) - case.place * result["metrics"]["length_mm"])
        rows.append(
            Row(
                case=case.name,
                figure="worst place off the truth mm",
                ours=off,
                target=f"at most {PLACE_MM:g}",
                holds=off <= PLACE_MM,
            )
        )
    if case.bend_radius is None:
        none = relaxation["bend_radius_mm"] is None
        rows.append(
            Row(case=case.name, figure="bend radii that would do", ours=float(not none), target="none is named", holds=none)
        )
    else:
        rows.append(near(case, "bend radius that would do mm", relaxation["bend_radius_mm"], case.bend_radius))
    return [*rows, *again(case, relaxation, runs)]


def broken_at(result: dict[str, Any]) -> float:
    """Arc length, mm, of the worst place of the stretch that breaks the clearance limit most."""
    flags = [flag for flag in result["flagged_intervals"] if flag["kind"] == "clearance"]
    return float(min(flags, key=lambda flag: flag["worst"])["worst_at_mm"])


def near(case: Hindered, figure: str, ours: float, truth: float) -> Row:
    """A value beside the truth, which the mesh's facets and the proof may miss by `AVAILABLE`."""
    return Row(
        case=case.name,
        figure=figure,
        ours=ours,
        reference=truth,
        source=case.source,
        target=f"within {AVAILABLE:.0%}",
        holds=abs(ours / truth - 1.0) <= AVAILABLE,
    )


def again(case: Hindered, relaxation: dict[str, Any], runs: Runs) -> list[Row]:
    """Planning again with each value that would do, and 2 % short of it."""
    thinner, softer = relaxation["clearance_mm"], relaxation["curvature_per_mm"]
    tried = [("instrument radius", (case.curvature_max, thinner), (case.curvature_max, (1.0 + SHORT) * thinner))]
    if softer is not None:
        tried.append(("bend radius", (softer, case.clearance_min), ((1.0 - SHORT) * softer, case.clearance_min)))
    rows = []
    for name, enough, short in tried:
        for figure, limits, wanted in ((f"{name} named, planned again", enough, True), (f"{name} 2 % short", short, False)):
            held = runs.hold(*limits)
            rows.append(
                Row(
                    case=case.name,
                    figure=f"{figure}: proved path",
                    ours=held,
                    target="1" if wanted else "0",
                    holds=held is wanted,
                )
            )
    line = relaxation["pareto"]
    inner = line[1:-1]
    held_all = sum(runs.hold(trade["curvature_per_mm"], trade["clearance_mm"]) for trade in inner)
    rising = all(
        a["clearance_mm"] < b["clearance_mm"] and a["curvature_per_mm"] < b["curvature_per_mm"] for a, b in pairwise(line)
    )
    return [
        *rows,
        Row(
            case=case.name,
            figure=f"trades between the two, of {len(inner)}, that plan to a proved path",
            ours=held_all,
            target="all, each thicker than the stiffer one before",
            holds=held_all == len(inner) and rising,
        ),
    ]
