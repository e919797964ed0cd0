"""tubeplan bench faults: faults planted between the samples of finished plans, and plans without any."""

# Strategy: a random path in a random tube is a valid plan when its limits are set by its own proof, 0.05 mm below
# the proved clearance and at the proved curvature. A fault is planted between two neighbouring samples of such a
# plan: the spline gets knots there and one control point of the new, narrow basis function moves, by as much as makes the
# breach 0.1 mm deep or the curvature 2 % too large. Points, curvature and clearance of every sample stay true; only what
# the file says of the path between them is false. The verifier sees the document and the triangles, as in a run
# folder; some are written as folders.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from scipy.interpolate import BSpline
from scipy.optimize import brentq

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from segmentation.mesh_files import write_ply
from tubeplan_viz.bench.random_tubes import random_path, random_tube
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.cases.tube import case_table, case_text, make_case
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.pipeline import Notify
from tubeplan_viz.pipeline.tube import surface_details
from tubeplan_viz.plan import Feature, FeatureKind, Limits, Plan, PlanStatus, PlanStep
from tubeplan_viz.profile import certify, measure_closely, measure_path, path_metrics, profile_at
from tubeplan_viz.result import Provenance, RunFolder, build_result, path_csv, slicer_markups
from tubeplan_viz.verify import Check, check_path, verify_run

Fault = Literal["breach", "bend"]

CASES, QUICK_CASES = 1000, 30
FOLDERS, QUICK_FOLDERS = 20, 4
# What a bad plan hides, mm below the one limit and share above the other, and what a good one has to spare, mm.
BREACH, EXCESS, SPARE = 0.1, 0.02, 0.05
SWAY = 0.45
# Half width of the planted basis function as a share of the gap between two samples: nothing reaches the samples.
REACH = 0.4
LEAST_CLEARANCE = 0.2
# Name of the check that must refuse each kind of fault, beside the status.
NAMED: dict[Fault, str] = {"breach": "flagged intervals: clearance", "bend": "flagged intervals: curvature"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Claimed:
    """A plan that says of itself that it is ok, and the surface it was made for."""

    plan: Plan
    surface: Surface

    def document(self) -> dict[str, Any]:
        """The content of result.json."""
        limits, (start, goal) = self.plan.limits, self.plan.profile.points[[0, -1]]
        case = make_case(
            {
                "input": {"mesh": "mesh.ply", "case_id": "planted"},
                "limits": {"curvature_max": limits.curvature_max, "clearance_min": limits.clearance_min},
                "planner": {"start": start.tolist(), "goal": goal.tolist()},
            }
        )
        return build_result(
            self.plan,
            frame="mesh",
            timings_s={},
            provenance=Provenance(inputs=(), rng_seed=0, settings=case_table(case)),
            details={"surface": surface_details(self.surface), "case_id": "planted", "closed_ends": False},
        )

    def refused_by(self) -> list[Check]:
        """The verifier's checks of the path that do not hold."""
        corners = self.surface.vertices[self.surface.faces]
        own = self.surface.face_cap < 0
        return [check for check in check_path(self.document(), corners[own], corners[~own]) if not check.ok]

    def write(self, folder: Path) -> None:
        """The run folder of the plan, without page and recording."""
        result = self.document()
        with RunFolder(folder) as run:
            write_ply(self.surface, run.path("mesh.ply"))
            run.write_text("case.toml", case_text(make_case(result["provenance"]["settings"]), folder))
            run.write_text("path.csv", path_csv(self.plan.profile))
            run.write_json("path.mrk.json", slicer_markups(result))
            run.finish(result)


def faults(*, quick: bool, notify: Notify) -> list[Row]:
    """Planted faults that the verifier must refuse, and valid plans that it must not.

    Parameters
    ----------
    quick : bool
        30 of each instead of 1000, and 4 whole folders instead of 20.
    notify : Notify
    """
    count = QUICK_CASES if quick else CASES
    whole = QUICK_FOLDERS if quick else FOLDERS
    seeds = np.random.SeedSequence(2024).spawn(count)
    refused = {"breach": 0, "bend": 0}
    planted_of = {"breach": 0, "bend": 0}
    wronged: list[str] = []
    folders_refused = folders_held = 0
    for number, seed in enumerate(seeds):
        notify("planted faults and valid plans", number, count)
        rng = np.random.default_rng(seed)
        valid = valid_plan(rng)
        kind: Fault = "breach" if number % 2 else "bend"
        bad = planted(valid, kind, rng)
        planted_of[kind] += 1
        names = {check.name for check in bad.refused_by()}
        refused[kind] += "status" in names and NAMED[kind] in names
        wronged += [check.name for check in valid.refused_by()][:1]
        if number < whole:
            with TemporaryDirectory() as place:
                valid.write(Path(place) / "valid")
                bad.write(Path(place) / "planted")
                folders_held += verify_run(Path(place) / "valid").holds
                folders_refused += not verify_run(Path(place) / "planted").holds
    rows = [
        ("0.1 mm breach between two samples, named by the verifier", refused["breach"], planted_of["breach"]),
        ("curvature 2 % above its limit between two samples, named", refused["bend"], planted_of["bend"]),
        (f"valid plans with {SPARE} mm to spare that are not refused", count - len(wronged), count),
        ("whole folders with a fault that are refused", folders_refused, whole),
        ("whole folders without a fault that hold", folders_held, whole),
    ]
    case = f"{count} random plans"
    return [
        Row(case=case, figure=figure, ours=ours, reference=of, source="planted or made", target="all", holds=ours == of)
        for figure, ours, of in rows
    ]


def valid_plan(rng: np.random.Generator) -> Claimed:
    """A path in a random tube with the limits that its proof allows, and 0.05 mm to spare."""
    while True:
        tube = random_tube(rng)
        curve = random_path(tube, rng, sway=float(rng.uniform(0.0, SWAY)))
        wall = WallDistance(tube.surface)
        loose = certify(curve, wall, Limits(curvature_max=10.0, clearance_min=0.0))
        # A path that bends by less than 0.5 mm or comes nearer to the wall is no plan for any instrument.
        if loose.curvature_upper_bound < 2.0 and loose.clearance_lower_bound > SPARE + LEAST_CLEARANCE:
            break
    s = np.linspace(0.0, tube.axis.length, int(np.ceil(tube.axis.length)) + 1)
    points = tube.axis.at(s)[0]
    limits = Limits(curvature_max=loose.curvature_upper_bound, clearance_min=loose.clearance_lower_bound - SPARE)
    return Claimed(plan=claimed(curve, wall, Centerline(points, wall.distance(points)), limits), surface=tube.surface)


def claimed(curve: SplineCurve, wall: WallDistance, centerline: Centerline, limits: Limits) -> Plan:
    """A plan as the planner would give it out, measured and proved."""
    profile, fine = measure_path(curve, wall), measure_closely(curve, wall, limits)
    metrics = path_metrics(profile, centerline) | {
        "curvature_max_per_mm": float(max(fine.curvature.max(), profile.curvature.max())),
        "clearance_min_mm": float(min(fine.clearance.min(), profile.clearance.min())),
    }
    features = tuple(
        Feature(kind=kind, point=curve([u])[0], u=u) for kind, u in ((FeatureKind.START, 0.0), (FeatureKind.GOAL, 1.0))
    )
    return Plan(
        planner="tube",
        method="optimal",
        status=PlanStatus.OK,
        reason=None,
        limits=limits,
        curve=curve,
        profile=profile,
        features=features,
        centerline=centerline,
        steps=(PlanStep(index=0, curve=curve, features=features, profile=profile, flagged=()),),
        flagged=(),
        certificate=certify(curve, wall, limits),
        metrics=metrics,
    )


def planted(valid: Claimed, kind: Fault, rng: np.random.Generator) -> Claimed:
    """The plan with a fault between two of its samples; all of its samples stay true, and its claims stay as they were."""
    plan, wall = valid.plan, WallDistance(valid.surface)
    u = plan.curve.parameter(plan.profile.arc_length)
    gap = chosen_gap(plan, kind, rng)
    middle = 0.5 * (u[gap] + u[gap + 1])
    at = plan.curve([middle])
    if kind == "breach":
        distance, _, foot = wall.nearest(at)
        direction = (foot[0] - at[0]) / distance[0]
        wanted = plan.limits.clearance_min - BREACH

        def value(curve: SplineCurve) -> float:
            return wanted - float(wall.clearance(curve([middle]))[0])
    else:
        first, second = plan.curve([middle], 1)[0], plan.curve([middle], 2)[0]
        across = second - (second @ first) / (first @ first) * first
        # The basis function bends away from where it is moved.
        direction = -across / np.linalg.norm(across)
        top = plan.limits.curvature_max * (1.0 + EXCESS)

        def value(curve: SplineCurve) -> float:
            return float(curve.curvature([middle])[0]) - top

    bump = bumped(plan.curve, middle, REACH * (u[gap + 1] - u[gap]), direction)
    curve = bump(brentq(lambda size: value(bump(size)), 0.0, size_bracket(lambda size: value(bump(size)))))
    # Arc lengths too are those that were believed: true ones would show a breach as a step that is too long.
    profile = replace(profile_at(curve, wall, u), arc_length=plan.profile.arc_length)
    return replace(valid, plan=replace(plan, curve=curve, profile=profile))


def chosen_gap(plan: Plan, kind: Fault, rng: np.random.Generator) -> int:
    """Number of the sample before the fault: anywhere for a bend, among the tightest tenth of the path for a breach."""
    # The gaps at the very ends have no room for the knots.
    last = len(plan.profile.arc_length) - 3
    if kind == "bend":
        return int(rng.integers(2, last))
    tightest = 2 + np.argsort(plan.profile.clearance[2:last])
    return int(rng.choice(tightest[: max(last // 10, 1)]))


def bumped(curve: SplineCurve, middle: float, reach: float, direction: FloatArray) -> Callable[[float], SplineCurve]:
    """The curve with a bump of given height, mm, that is zero farther than `reach` in u from the middle."""
    spline = BSpline(curve.knots, curve.control_points, curve.degree)
    for knot in middle + reach * np.array([-1.0, -0.5, 0.0, 0.5, 1.0]):
        spline = spline.insert_knot(knot)
    knots, control = np.asarray(spline.t), np.asarray(spline.c)
    # The basis function over these five knots and no other; a uniform one, which is 2/3 at its middle.
    k = int(np.searchsorted(knots, middle - reach * 1.0000001))

    def of(size: float) -> SplineCurve:
        moved = np.array(control)
        moved[k] += 1.5 * size * direction
        return SplineCurve(3, knots, moved)

    return of


def size_bracket(value: Callable[[float], float]) -> float:
    """A height at which a value that rises from below zero is above it."""
    size = 1e-7
    while value(size) <= 0.0:
        size *= 2.0
    return size
