"""From a finished run to what the page prints: every choice, rounding and word is made here, none in the template.

Every printed figure that stands in result.json is a `reports.numbers.Figure`: the page
holds ``<data class="v" value="EXACT" data-key="metrics.length_mm">124.9</data>``, with the
dotted path into result.json (list positions as numbers). Figures that result.json does
not hold have a key that begins with ``derived:``; `reports.derived.DERIVED` lists each
with its formula, `reports.derived.derived_values` works them out. Figures in drawings and
those of iteration 0's profile (table "Before", but for the rows that stand in
``iterations.0``) are not marked, since result.json does not hold them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from reports import workspace
from reports.derived import derived_values
from reports.folds import Fact, Fold, folds
from reports.measures import Section, measures_section
from reports.numbers import Figure, Source, phrase, printed, typeset
from reports.places import Place, critical_places
from reports.relaxation import Relief, relief
from reports.slices import LEVELS, REACH_MM, ReducedVolume, Window, reduce_volume, windows_for
from reports.still import Label, View, choose_view, still_picture
from reports.tables import KINDS, FeatureRow, MeasureRow, feature_rows, measures
from reports.tolerance import PoseErrors, pose_errors
from reports.turnable import rounded, turnable
from reports.walk import Walk, film_data, walk_of
from reports.wall import RIM_PLACES, RIM_STEP_MM, LightMesh, light_mesh, packed
from reports.words import Verdict, capitalised, verdict, worst_place
from reports.workspace import Course, Straight
from tubeplan_viz.result import Review

LABELLED_FLAGS = 4  # flagged places named in the scene; all of them are coloured
TITLES = {"ok": "Holds", "flagged": "Flagged", "infeasible": "No path"}


@dataclass(frozen=True)
class Growth:
    """How the lumen was grown: the chart and what it says."""

    chart: Markup
    caption: str


@dataclass(frozen=True)
class Page:
    """What the template prints, in its order."""

    title: str
    case_id: str
    frame: str
    verdict: Verdict
    strip: Markup
    charts: Mapping[str, Markup]
    straight: Straight | None
    still: Markup
    windows: tuple[Window, ...]
    ramp: tuple[str, str] | None
    asked: str
    narrowest: float | None
    sharpest: float | None
    places: tuple[Place, ...]
    walk: Walk | None
    relief: Relief | None
    pose_errors: PoseErrors | None
    measures: tuple[MeasureRow, ...]
    steps: Mapping[str, Markup]
    steps_line: str
    features: tuple[FeatureRow, ...]
    features_line: str
    has_parts: bool
    clinical: Section | None
    facts: tuple[Fact, ...]
    growth: Growth | None
    folds: tuple[Fold, ...]
    result: Mapping[str, Any]
    scene: Mapping[str, Any]


def make_page(review: Review) -> Page:
    """Everything that the page of one run shows.

    Raises
    ------
    KeyError
        If the result lacks a key that its schema makes mandatory; optional ones may be absent or null.
    """
    result = review.result
    source = Source(result, derived_values(result))
    details = result.get("details") or {}
    parts = tuple(details.get("parts") or ())
    surface = review.surface
    course = workspace.make_course(result.get("path") or {}, surface, RIM_PLACES)
    mesh = light_mesh(surface) if surface is not None else None
    volume = review.volume
    windows: tuple[Window, ...] = ()
    reduced = None
    if volume is not None and course is not None:
        index = np.clip(np.round(volume.to_index(course.points)).astype(int), 0, np.array(volume.voxels.shape) - 1)
        windows = windows_for(_anatomy(details), float(np.median(volume.voxels[tuple(index.T)])))
        reduced = reduce_volume(volume, course.points, windows)
    window = windows[0] if windows else None
    line = course.points if course is not None else np.empty((0, 3))
    spots = np.vstack([mesh.vertices, line]) if mesh is not None else line
    view = (
        choose_view(np.vstack([line[:1], spots, line[-1:]]) if len(line) else spots, str(result.get("frame")))
        if len(spots) > 2
        else None
    )
    labels = _labels(course, source) if course is not None else _ends_asked(details)
    stretches = _stretches(course, source)
    ramp = (
        workspace.roominess(course, source.value("limits.clearance_min_mm"))[0]
        if course is not None and course.clearance is not None
        else None
    )
    asked = source.value("limits.clearance_min_mm")
    first = review.first or {}
    charts = workspace.profiles(course, source, first) if course is not None else {}
    said = verdict(source, parts)
    parts = tuple({**part, "name": capitalised(str(part["name"]))} for part in parts)
    return Page(
        title=f"{TITLES[said.status]}: case {review.case_id}",
        case_id=review.case_id,
        frame=str(result.get("frame")),
        verdict=said,
        strip=workspace.strip(course, source, parts) if course is not None else Markup(""),
        charts=charts,
        straight=workspace.straight(course, source, volume, window) if course is not None else None,
        still=still_picture(mesh, line, stretches, labels, view, _still_words(source, course))
        if view is not None
        else Markup(""),
        windows=windows,
        ramp=(printed(ramp[0], 1), printed(ramp[1], 1)) if ramp else None,
        asked=printed(asked, 2) if asked else "",
        narrowest=_value(worst_place(source, "clearance")),
        sharpest=_value(worst_place(source, "curvature")),
        places=critical_places(course, source, volume, window) if course is not None else (),
        walk=walk_of(source, review.film),
        relief=relief(source),
        pose_errors=pose_errors(source),
        measures=measures(source, first),
        steps=workspace.steps(source),
        steps_line=_steps_line(source),
        features=feature_rows(source, parts),
        features_line=_features_line(source),
        has_parts=bool(parts),
        clinical=measures_section(source),
        facts=_facts(review, source, mesh, reduced),
        growth=_growth(review),
        folds=folds(source, parts),
        result=result,
        scene=_scene(course, source, first, mesh, reduced, windows, view, labels, stretches, parts, ramp)
        | {"film": film_data(review.film)},
    )


def _value(figure: Figure | None) -> float | None:
    return None if figure is None else figure.value


def _anatomy(details: Mapping[str, Any]) -> str | None:
    named = details.get("anatomy")
    name = named.get("name") if isinstance(named, Mapping) else named
    return str(name) if name else None


def _stretches(course: Course | None, source: Source) -> list[tuple[str, int, int]]:
    """Flagged parts as (kind, first sample, last sample), at least two samples long."""
    if course is None:
        return []
    out = []
    for flag in source.result.get("flagged_intervals") or []:
        first, last = course.index_at(flag["from_mm"]), course.index_at(flag["to_mm"])
        first = min(first, len(course.points) - 2)
        out.append((str(flag["kind"]), first, max(last, first + 1)))
    return out


def _labels(course: Course, source: Source) -> tuple[Label, ...]:
    """Start, goal and the gravest flagged places, in words."""
    details = source.result.get("details") or {}
    labels = [Label(course.points[k], _end_words(details, name), name, 0) for k, name in ((0, "start"), (-1, "goal"))]
    flags = source.result.get("flagged_intervals") or []
    for kind, better in (("clearance", 1.0), ("curvature", -1.0)):
        mine = sorted((f for f in flags if f["kind"] == kind), key=lambda f: better * f["worst"])
        for rank, flag in enumerate(mine[: LABELLED_FLAGS // 2]):
            point = course.points[course.index_at(flag["worst_at_mm"])]
            if kind == "clearance":
                text = f"{printed(flag['worst'], 2)} of {printed(source.value('limits.clearance_min_mm') or 0.0, 2)} mm"
            else:
                radius = 1.0 / flag["worst"]
                text = f"radius {printed(radius, 1)} of {printed(source.value('derived:bend_radius_limit_mm') or 0.0, 1)} mm"
            labels.append(Label(point, text, kind, rank + 1))
    return tuple(labels)


def _end_words(details: Mapping[str, Any], name: str) -> str:
    """``Start`` or ``Goal``, with the label by which it was asked for."""
    label = details.get(f"{name}_label")
    return f"{name.capitalize()} {label}" if label else name.capitalize()


def _ends_asked(details: Mapping[str, Any]) -> tuple[Label, ...]:
    """Start and goal as they were asked for, where no path joins them."""
    return tuple(
        Label(np.asarray(details[f"{name}_mm"], float), _end_words(details, name), name, 0)
        for name in ("start", "goal")
        if len(details.get(f"{name}_mm") or ()) == 3
    )


def _still_words(source: Source, course: Course | None) -> str:
    if course is None:
        return "The wall of the lumen; there is no path to show."
    flags = len(source.result.get("flagged_intervals") or [])
    stretches = "stretch" if flags == 1 else "stretches"
    return f"The wall of the lumen with the planned path from start to goal; {flags or 'no'} flagged {stretches}."


def _steps_line(source: Source) -> str:
    states = source.result.get("iterations") or []
    if len(states) < 2:
        return ""
    moved, added = (sum(state.get(name) or 0 for state in states) for name in ("moved", "added"))
    text = f"{_counted(len(states) - 1, 'iteration')} from the first spline to the planned path"
    return text + (f"; {_counted(moved, 'move')} of feature points, {_counted(added, 'point')} added." if moved or added else ".")


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _features_line(source: Source) -> str:
    """How many points of each kind carry the spline, and which scans looked for them."""
    kinds = [str(feature["kind"]) for feature in source.result.get("feature_points") or []]
    found = [
        f"{KINDS.get(kind, kind).lower()} ({kinds.count(kind)})" for kind in dict.fromkeys(kinds) if kind not in ("start", "goal")
    ]
    scans = (source.result.get("details") or {}).get("feature_scans") or []
    told = f"The points that carry the spline: {', '.join(['start', 'goal', *found])}." if kinds else ""
    return told + (f" Scans used: {', '.join(str(scan) for scan in scans)}." if scans else "")


def _facts(review: Review, source: Source, mesh: LightMesh | None, reduced: ReducedVolume | None) -> tuple[Fact, ...]:
    # Padding decides nothing by itself: it stands with the provenance.
    facts = [Fact(str(term), phrase(typeset(str(value)))) for term, value in review.facts.items() if term != "Padding"]
    deviation = [source.figure(f"details.surface.deviation_mm.{name}", 3, "mm") for name in ("mean", "p95", "max")]
    mean, most, largest = deviation
    if mean is not None and most is not None and largest is not None and not any("eviation" in term for term in review.facts):
        facts.append(Fact("Deviation from CT", phrase("mean ", mean, ", 95 % below ", most, ", largest ", largest)))
    narrow = source.figure("details.centerline_radius_min.radius_mm", 2, "mm")
    if narrow is not None:
        at = source.figure("details.centerline_radius_min.at_mm", 1, "mm")
        where = (", ", at, " along the centerline") if at is not None else ()
        facts.append(Fact("Narrowest lumen", phrase("inscribed radius ", narrow, *where)))
    shown = []
    if reduced is not None:
        shown.append(f"CT reduced to {printed(reduced.step, 2)} mm and {LEVELS} grey levels within {REACH_MM:.0f} mm of the path")
    if mesh is not None and len(mesh.faces) < mesh.planned:
        shown.append(f"wall drawn with {_thousands(len(mesh.faces))} of {_thousands(mesh.planned)} triangles")
    if shown:
        facts.append(Fact("Shown here", phrase("; ".join(shown) + "; planning used the full data")))
    return tuple(facts)


def _thousands(count: int) -> str:
    return f"{count:,}".replace(",", "\u202f")


def _growth(review: Review) -> Growth | None:
    """The growth curve from the region, or from the result where only that is at hand."""
    curve = review.region.curve if review.region is not None else None
    if curve is not None:
        limits, volumes, chosen, leak, varied = curve.limits, curve.volumes_ml, curve.chosen, curve.leak_limit, curve.varied
    else:
        told = (review.result.get("details") or {}).get("growth") or {}
        if len(told.get("limits_hu") or ()) < 2 or told.get("chosen_hu") is None:
            return None
        limits, volumes = np.asarray(told["limits_hu"], float), np.asarray(told["volumes_ml"], float)
        chosen, leak, varied = told["chosen_hu"], told.get("leak_limit_hu"), str(told.get("varied"))
    if len(limits) < 2:
        return None
    side = "upper" if varied == "hu_max" else "lower"
    return Growth(workspace.growth(limits, volumes, float(chosen), leak, varied), f"ml, by {side} limit in HU")


def _scene(
    course: Course | None,
    source: Source,
    first: Mapping[str, Any],
    mesh: LightMesh | None,
    reduced: ReducedVolume | None,
    windows: Sequence[Window],
    view: View | None,
    labels: Sequence[Label],
    stretches: Sequence[tuple[str, int, int]],
    parts: Sequence[Mapping[str, Any]],
    ramp: tuple[float, float] | None,
) -> dict[str, Any]:
    """What the page's script needs beside result.json itself; null where there is none."""
    features = source.result.get("feature_points") or []
    before = np.asarray(first.get("points_mm") or [], float).reshape(-1, 3)
    return turnable(mesh, view, labels, start=_start_index(course, source), ramp=ramp, before=before) | {
        "ct": reduced.packed() if reduced is not None else None,
        "windows": {window.name: [window.centre, window.width] for window in windows},
        "rims": _packed_rims(course),
        "stretches": [list(stretch) for stretch in stretches],
        "features": [
            {"kind": str(f["kind"]), "point": rounded(np.asarray(f["point_mm"], float), 3), "s": f.get("s_mm")} for f in features
        ],
        "parts": [{"name": str(part["name"]), "from": part["from_mm"], "to": part["to_mm"]} for part in parts],
    }


def _start_index(course: Course | None, source: Source) -> int:
    """The cursor begins at the worst place: the gravest broken limit, otherwise the tightest place."""
    if course is None:
        return 0
    margin, over = source.value("derived:margin_mm"), source.value("derived:curvature_excess_percent")
    sharp = over is not None and over > 0 and (margin is None or margin >= 0)
    at = worst_place(source, "curvature" if sharp or course.clearance is None else "clearance")
    return course.index_at(at.value) if at is not None else 0


def _packed_rims(course: Course | None) -> dict[str, Any] | None:
    if course is None:
        return None
    return {
        "places": [int(k) for k in course.places],
        "directions": course.rims.shape[1] if course.rims is not None else 0,
        "step": RIM_STEP_MM,
        "values": packed(np.round(course.rims / RIM_STEP_MM), "u2") if course.rims is not None else "",
        "normal": [rounded(normal) for normal in course.normal],
    }


__all__ = ["Growth", "Page", "make_page"]
