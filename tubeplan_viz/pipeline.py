"""The one way through: case -> volume -> surface -> plan -> outputs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from reports import write_report
from segmentation.caps import mark_flat_ends
from segmentation.errors import CaseError
from segmentation.images import read_ct
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.mask_file import write_mask
from segmentation.mesh import Surface
from segmentation.mesh_files import read_surface, write_ply
from segmentation.region_growing import Region
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.volume import Volume
from tubeplan_viz.case import Case, InputCase, Place, case_table, case_text
from tubeplan_viz.centerline import CenterlineSettings, Endpoint, VoronoiGraph, find_endpoints, voronoi_graph
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import Plan, PlanStep
from tubeplan_viz.recording import Recording
from tubeplan_viz.result import Provenance, Review, RunFolder, build_result, path_csv, plain, slicer_markups
from tubeplan_viz.tube import TubeProblem, conclude, pose_problem, tube_steps

# The first names the kind of folder.
SEGMENTATION_FILES = ("segmentation.json", "mask.nii.gz", "mesh.ply")

# Called with the stage, and how many of how many parts of it are done (0 of 0: unknown).
Notify = Callable[[str, int, int], None]


def silent(stage: str, done: int, total: int) -> None:
    """Progress for nobody."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Lumen:
    """The wall that a case gives, and what it was made from.

    Attributes
    ----------
    surface : Surface
    volume, region : Volume and Region, or None for a mesh
    facts : mapping of str to str
        Image and surface facts as label and printed value.
    warnings : tuple of str
    inputs : tuple of (name, sha256)
    details : mapping
        For result.json: growth curve, deviation from the CT, seed.
    """

    surface: Surface
    volume: Volume | None
    region: Region | None
    facts: Mapping[str, str]
    warnings: tuple[str, ...]
    inputs: tuple[tuple[str, str], ...]
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class Tree:
    """The lumen made ready for planning: flat ends found, Voronoi graph, end points."""

    surface: Surface
    wall: WallDistance
    graph: VoronoiGraph
    endpoints: tuple[Endpoint, ...]


class Stopwatch:
    """Seconds per stage, in the order in which the stages ran."""

    def __init__(self, notify: Notify) -> None:
        self.seconds: dict[str, float] = {}
        self._notify = notify

    @contextmanager
    def stage(self, name: str) -> Iterator[Callable[[int, int], None]]:
        """Time a block under `name`; yields the progress callback of that stage."""
        self._notify(name, 0, 0)
        begun = time.perf_counter()
        yield lambda done, total: self._notify(name, done, total)
        self.seconds[name] = round(self.seconds.get(name, 0.0) + time.perf_counter() - begun, 4)


def load_lumen(case: InputCase, *, near: Place | None = None, watch: Stopwatch | None = None) -> Lumen:
    """The wall of the lumen, from a CT or from a mesh file.

    Parameters
    ----------
    case : InputCase
    near : point or label, optional
        The start: of a mesh with several components the one that holds it is kept.
    watch : Stopwatch, optional

    Raises
    ------
    TubeplanError
        If the input cannot be read, or holds no tube.
    """
    watch = watch or Stopwatch(silent)
    return lumen_of_mesh(case, near, watch) if case.mesh is not None else lumen_of_ct(case, watch)


def lumen_of_mesh(case: InputCase, near: Place | None, watch: Stopwatch) -> Lumen:
    """Read a mesh file as the wall."""
    assert case.mesh is not None
    with watch.stage("read mesh"):
        given = read_surface(case.mesh, mesh_unit=case.mesh_unit, part=case.part, near=None if isinstance(near, str) else near)
    return Lumen(surface=given.surface, volume=None, region=None, facts=given.facts, warnings=given.warnings, inputs=given.inputs)


def lumen_of_ct(case: InputCase, watch: Stopwatch) -> Lumen:
    """Read a CT, grow the lumen and make its surface."""
    assert case.ct is not None
    settings = segmentation_settings(case)
    with watch.stage("read CT") as progress:
        image = read_ct(case.ct, series=case.series, progress=progress)
    with watch.stage("grow region") as progress:
        region = segment_lumen(image.volume, settings, progress=progress)
    with watch.stage("surface"):
        made = lumen_surface(image.volume, region, SurfaceSettings())
    deviation = {"mean": made.deviation.mean, "p95": made.deviation.p95, "max": made.deviation.max}
    seed = image.volume.to_lps(region.seed)
    facts = {
        **image.facts,
        "Lumen": f"{settings.anatomy}, grown from {region.hu_min:.0f} to {region.hu_max:.0f} HU, {region.volume_ml:.1f} ml",
        "Seed": "{:.1f}, {:.1f}, {:.1f} mm".format(*seed),
        "Surface": f"{len(made.surface.faces)} triangles, closed, {made.surface.volume_ml:.1f} ml",
        "Deviation from the CT": "mean {mean:.2f} mm, 95 % below {p95:.2f} mm, largest {max:.2f} mm".format(**deviation),
    }
    if region.border:
        facts["Cut by the image"] = ", ".join(f"{name} ({count} voxels)" for name, count in region.border.items())
    return Lumen(
        surface=made.surface,
        volume=image.volume,
        region=region,
        facts=facts,
        warnings=(*image.warnings, *made.notes),
        inputs=image.inputs,
        details={
            "anatomy": settings.anatomy,
            "seed_mm": seed,
            "hu_min": region.hu_min,
            "hu_max": region.hu_max,
            "growth": growth_details(region),
            "deviation_mm": deviation,
        },
    )


def segmentation_settings(case: InputCase) -> SegmentationSettings:
    """Settings of region growing; without an anatomy, seed and limits must say everything."""
    anatomy = case.anatomy
    if anatomy is None:
        if case.seed_point is None or (case.hu_min is None and case.hu_max is None):
            raise CaseError(
                "a CT needs --anatomy (airway, urinary, vessel), which brings its own limits and seed, "
                "or a seed point and HU limits (--seed-point with --hu-min or --hu-max)"
            )
        anatomy = "generic"
    return SegmentationSettings(
        anatomy=anatomy,
        seed_point=case.seed_point,
        hu_min=case.hu_min,
        hu_max=case.hu_max,
        connectivity=case.connectivity,
        smoothing=case.smoothing_mm,
    )


def growth_details(region: Region) -> dict[str, Any] | None:
    """The growth curve for result.json, or None when both limits were given."""
    curve = region.curve
    if curve is None:
        return None
    return {
        "varied": curve.varied,
        "limits_hu": curve.limits,
        "volumes_ml": curve.volumes_ml,
        "chosen_hu": curve.chosen,
        "leak_limit_hu": curve.leak_limit,
        "leak_voxel": curve.leak_voxel,
        "leak_point_mm": curve.leak_point,
    }


def grow_tree(surface: Surface, *, closed_ends: bool = False, settings: CenterlineSettings | None = None) -> Tree:
    """End points of the lumen with their labels; the same surface always gives the same labels.

    Flat discs at the tips are recognised as caps first, since they move the tips onto
    their centres.
    """
    tree = tips_of(surface, closed_ends=closed_ends, settings=settings)
    if closed_ends:
        return tree
    marked = mark_flat_ends(surface, np.array([tip.point for tip in tree.endpoints]))
    return tree if len(marked.caps) == len(surface.caps) else tips_of(marked, closed_ends=False, settings=settings)


def tips_of(surface: Surface, *, closed_ends: bool, settings: CenterlineSettings | None) -> Tree:
    """Wall, graph and end points of a surface as it is."""
    wall = WallDistance(surface, closed_ends=closed_ends)
    graph = voronoi_graph(surface, wall)
    return Tree(surface=surface, wall=wall, graph=graph, endpoints=find_endpoints(graph, wall, settings=settings))


def resolve_end(name: str, given: Place | None, endpoints: tuple[Endpoint, ...]) -> np.ndarray:
    """Coordinates of a start or goal given as coordinates or as a label.

    Raises
    ------
    CaseError
        If nothing was given or there is no such label.
    """
    listing = "; ".join("{} ({:.1f}, {:.1f}, {:.1f})".format(tip.label, *tip.point) for tip in endpoints)
    if given is None:
        raise CaseError(f"no {name} was given; give --{name} X,Y,Z in mm or one of the lumen's end points: {listing}")
    if not isinstance(given, str):
        return np.array(given, dtype=float)
    for tip in endpoints:
        if tip.label == given:
            return np.array(tip.point)
    raise CaseError(f"the lumen has no end point {given}; it has {listing}")


def pose_case(case: Case, lumen: Lumen) -> tuple[TubeProblem, Tree]:
    """Start and goal on the wall made ready, and the centerline between them."""
    settings = case.tube_settings
    tree = grow_tree(lumen.surface, closed_ends=settings.closed_ends, settings=settings.centerline)
    start, goal = (resolve_end(name, getattr(case.planner, name), tree.endpoints) for name in ("start", "goal"))
    if not settings.closed_ends:
        marked = mark_flat_ends(tree.surface, np.array([start, goal]))
        if len(marked.caps) != len(tree.surface.caps):
            wall = WallDistance(marked)
            tree = replace(tree, surface=marked, wall=wall, graph=voronoi_graph(marked, wall))
    problem = pose_problem(tree.surface, start, goal, case.limits, settings, wall=tree.wall, graph=tree.graph)
    return problem, tree


def run_case(
    case: Case,
    target: Path,
    *,
    force: bool = False,
    recording: bool = True,
    report: bool = True,
    light: bool = False,
    connect: str | None = None,
    notify: Notify = silent,
) -> dict[str, Any]:
    """Plan one case and write its run folder.

    Parameters
    ----------
    case : Case
    target : Path
        The run folder; refused if it exists, unless `force` is set.
    recording, report : bool
        Whether recording.rrd and report.html are made.
    light : bool
        Leave the CT out of the recording and thin its mesh, for recorded examples.
    connect : str, optional
        Address of a running rerun viewer that is fed while planning.
    notify : Notify

    Returns
    -------
    dict
        The content of result.json.

    Raises
    ------
    TubeplanError
        If the input is bad or no path can be begun; then no folder is left.
    """
    watch = Stopwatch(notify)
    with RunFolder(target, force=force) as folder:
        lumen = load_lumen(case.input, near=case.planner.start, watch=watch)
        with watch.stage("centerline"):
            problem, tree = pose_case(case, lumen)
        warnings = list(lumen.warnings)
        stream = None
        if recording:
            stream = Recording.open(
                folder.path("recording.rrd"),
                case_id=case_name(case),
                limits=case.limits,
                planner=case.planner.name,
                method=case.planner.method,
                frame=problem.surface.frame,
                connect=connect,
                light=light,
            )
            warnings.extend(stream.warnings)
        try:
            if stream is not None:
                with watch.stage("recording"):
                    record_anatomy(stream, lumen, problem, light=light)
            with watch.stage("plan") as progress:
                steps = follow(tube_steps(problem, time_budget=case.planner.time_budget), stream, case, progress)
            with watch.stage("verify and prove"):
                plan = conclude(problem, steps)
            # mesh.ply holds wall faces first and then the caps; result.json counts on that order.
            written = write_ply(problem.surface, folder.path("mesh.ply"))
            provenance = Provenance(inputs=lumen.inputs, rng_seed=case.planner.rng_seed, settings=case_table(case))
            details = case_details(case, lumen, tree, written, warnings)

            def document() -> dict[str, Any]:
                return build_result(plan, frame=written.frame, timings_s=watch.seconds, provenance=provenance, details=details)

            if stream is not None:
                with watch.stage("recording"):
                    stream.finish(document())
                    stream.close()
        except BaseException:
            if stream is not None:
                stream.abort()
            raise
        result = document()
        folder.write_text("case.toml", case_text(case, target))
        folder.write_text("path.csv", path_csv(plan.profile))
        folder.write_json("path.mrk.json", slicer_markups(result))
        if report:
            with watch.stage("report"):
                write_report(review_of(case, lumen, written, plan, result), folder.path("report.html"))
        return folder.finish(result)


def follow(
    steps: Iterator[PlanStep], stream: Recording | None, case: Case, progress: Callable[[int, int], None]
) -> list[PlanStep]:
    """Run the iteration, feeding each step to the recording as it happens."""
    done: list[PlanStep] = []
    for step in steps:
        done.append(step)
        progress(step.index, case.refine.max_rounds)
        if stream is not None:
            stream.log_step(step)
    return done


def record_anatomy(stream: Recording, lumen: Lumen, problem: TubeProblem, *, light: bool) -> None:
    """What stays the same over the iterations."""
    if lumen.volume is not None and not light:
        stream.log_volume(lumen.volume, lumen.region)
    stream.log_surface(problem.surface)
    stream.log_centerline(problem.centerline)
    if lumen.region is not None and lumen.region.curve is not None:
        stream.log_growth(lumen.region.curve)
    for warning in lumen.warnings:
        stream.log_decision(warning, level="WARN")


def case_name(case: Case) -> str:
    """The case's own id; never taken from the data, which may hold a name."""
    return case.input.case_id or "case"


def case_details(case: Case, lumen: Lumen, tree: Tree, surface: Surface, warnings: list[str]) -> dict[str, Any]:
    """The planner-independent part of result.json's details."""
    details = dict(lumen.details)
    deviation = details.pop("deviation_mm", None)
    return {
        **details,
        "case_id": case_name(case),
        "surface": surface_details(surface) | {"deviation_mm": deviation},
        "endpoints": [endpoint_details(tip) for tip in tree.endpoints],
        "image": dict(lumen.facts),
        "warnings": warnings,
    }


def surface_details(surface: Surface) -> dict[str, Any]:
    """Faces and caps as they stand in mesh.ply: wall first, then each cap."""
    first = len(surface.wall_faces)
    caps = []
    for index, cap in enumerate(surface.caps):
        count = int(np.count_nonzero(surface.face_cap == index))
        caps.append(
            {
                "label": cap.label,
                "origin": cap.origin,
                "center_mm": cap.center,
                "normal": cap.normal,
                "area_mm2": cap.area,
                "first_face": first,
                "faces": count,
            }
        )
        first += count
    return {"faces": len(surface.faces), "wall_faces": len(surface.wall_faces), "volume_ml": surface.volume_ml, "caps": caps}


def endpoint_details(tip: Endpoint) -> dict[str, Any]:
    """One end point for result.json and ``tubeplan endpoints --json``."""
    return {
        "label": tip.label,
        "point_mm": tip.point.tolist(),
        "radius_mm": tip.radius,
        "branch_length_mm": tip.branch_length,
        "confidence": tip.confidence,
        "cap": tip.cap,
    }


def review_of(case: Case, lumen: Lumen, surface: Surface, plan: Plan, result: Mapping[str, Any]) -> Review:
    """The run as the report sees it."""
    return Review(
        case_id=case_name(case),
        result=result,
        surface=surface,
        volume=lumen.volume,
        region=lumen.region,
        facts=lumen.facts,
        first=profile_lists(plan.steps[0]),
        last=profile_lists(plan.steps[-1]),
    )


def profile_lists(step: PlanStep) -> dict[str, Any]:
    """A profile under the names of result.json."""
    profile = step.profile
    return {
        "s_mm": profile.arc_length.tolist(),
        "points_mm": profile.points.tolist(),
        "curvature_per_mm": profile.curvature.tolist(),
        "clearance_mm": profile.clearance.tolist(),
    }


def segment_case(case: InputCase, target: Path, *, force: bool = False, notify: Notify = silent) -> dict[str, Any]:
    """Write mask.nii.gz, mesh.ply and segmentation.json of a CT's lumen into a folder.

    Returns
    -------
    dict
        What segmentation.json holds: facts, warnings, caps, growth curve, digests of the inputs.
    """
    if case.ct is None:
        raise CaseError("segmenting needs a CT; give --ct")
    watch = Stopwatch(notify)
    with RunFolder(target, force=force, files=SEGMENTATION_FILES) as folder:
        lumen = lumen_of_ct(case, watch)
        assert lumen.volume is not None
        assert lumen.region is not None
        with watch.stage("write"):
            write_mask(lumen.region, lumen.volume, folder.path("mask.nii.gz"))
            surface = write_ply(lumen.surface, folder.path("mesh.ply"))
        summary: dict[str, Any] = {
            "provenance": {"software": "tubeplan"},
            "use": "research use, not for clinical decisions",
            "frame": surface.frame,
            "facts": dict(lumen.facts),
            "warnings": list(lumen.warnings),
            "details": plain(lumen.details),
            "surface": plain(surface_details(surface)),
            "inputs": [{"name": name, "sha256": digest} for name, digest in lumen.inputs],
            "timings_s": watch.seconds,
        }
        folder.write_json("segmentation.json", summary)
        folder.appear()
    return summary
