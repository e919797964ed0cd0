"""The page of a needle's plan: path and obstacles in space and in the CT, how it was searched, forms, controls, insertions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from reports import workspace
from reports.derived import derived_values
from reports.folds import Fold, folds
from reports.needle_charts import convergence_charts
from reports.needle_ct import Surroundings, ct_drawings, space_drawing
from reports.needle_drawings import cloud_drawings, flat_view, layers_of
from reports.needle_tables import (
    chances_table,
    controls_table,
    forms_table,
    front_table,
    insertion_table,
    obstacles_table,
)
from reports.numbers import Phrase, Source, phrase, sentence
from reports.parts import Drawing, Key, PlanPage, Table, place_keys

WORDS = {"ok": "Holds", "flagged": "Flagged", "infeasible": "No path"}
PLACES = 2
CUTS_LINE = (
    "Planes along the needle and through the tightest place (white dot), {} window. Outlines: obstacles; dashed: the safety "
    "distance around them. The path is faint where it is more than 3 mm from the plane."
)


@dataclass(frozen=True)
class NeedlePage(PlanPage):
    """What the template prints after the head, in its order."""

    cuts_line: str
    cuts: tuple[Drawing, ...]
    space: Drawing | None
    views_line: str
    views: tuple[Drawing, ...]
    charts: tuple[Drawing, ...]
    clouds: tuple[Drawing, ...]
    convergence: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    folds: tuple[Fold, ...]


def make_needle_page(case_id: str, result: Mapping[str, Any], around: Surroundings) -> NeedlePage:
    """Everything that the page shows."""
    source = Source(result, derived_values(result))
    status = str(result["status"])
    flat = result["planner"]["name"] == "needle2d"
    details = result["details"]
    course = workspace.make_course(result["path"] or {}, None, 2)
    charts = workspace.profiles(course, source, {}) if course is not None else {}
    units = {"clearance": "mm from the path to the nearest obstacle", "curvature": "1/mm"}
    makers = (forms_table, controls_table, front_table, insertion_table, chances_table, obstacles_table)
    tables = [made for maker in makers if (made := maker(source)) is not None]
    views = [("In the plane: y to the right, z downwards", (1, 2))]
    if not flat:
        views = [
            ("x to the right, z downwards", (0, 2)),
            ("y to the right, z downwards", (1, 2)),
            ("x to the right, y downwards", (0, 1)),
        ]
    cuts, window = ct_drawings(result, around)
    layers = layers_of(result)
    return NeedlePage(
        title=f"{WORDS[status]}: case {case_id}",
        case_id=case_id,
        status=status,
        word=WORDS[status],
        line="Planned onto the target" if status == "ok" else "Nothing to insert as it stands",
        headline=phrase("The needle reaches the target and keeps its distance" if status == "ok" else "No path for this needle"),
        lead=_lead(source, status),
        warnings=tuple(str(text) for text in details.get("warnings") or ()),
        keys=_keys(source),
        cuts_line="" if window is None else CUTS_LINE.format(window.label.lower()),
        cuts=cuts,
        space=space_drawing(result, around),
        views_line=_views_line(details),
        views=tuple(Drawing(title, flat_view(result, axes, layers)) for title, axes in views),
        charts=tuple(
            Drawing(kind.capitalize(), charts[kind], units[kind]) for kind in ("clearance", "curvature") if kind in charts
        ),
        clouds=cloud_drawings(result),
        convergence=tuple(
            Drawing(title, chart, unit) for title, unit, chart in convergence_charts(details.get("convergence") or ())
        ),
        tables=tuple(tables),
        folds=folds(source, ()),
    )


def _views_line(details: Mapping[str, Any]) -> str:
    forms = sum(form["feasible"] for form in details.get("forms", ()))
    shown = f"The chosen path and the other {forms - 1} feasible forms." if forms > 1 else "The planned path."
    pushed = " Dashed red: the path pushed after the events." if details.get("insertion") else ""
    trials = " Faint: insertions at random." if details.get("monte_carlo") else ""
    kinds = {body["kind"] for body in details.get("obstacles", ())}
    rings = " Dashed rings and pale bands: the safety distance around obstacles." if kinds - {"mask", "mesh"} else ""
    dots = " Dots: the rim of obstacles from files." if kinds & {"mask", "mesh"} else ""
    return shown + pushed + trials + rings + dots


def _lead(source: Source, status: str) -> Phrase:
    reason = source.result.get("reason")
    if status != "ok":
        return phrase(sentence(str(reason)))
    least = source.figure("metrics.clearance_min_mm", PLACES, "mm")
    asked = source.need("limits.clearance_min_mm", PLACES, "mm")
    error = source.need("metrics.tip_error_mm", 6, "mm")
    kept = (
        phrase("It passes obstacles at ", least, " or more, ", asked, " asked.")
        if least is not None
        else phrase("There is no obstacle.")
    )
    return phrase(kept, " The tip ends ", error, " from the target.")


def _keys(source: Source) -> tuple[Key, ...]:
    asked = source.need("limits.clearance_min_mm", PLACES, "mm")
    curvature = source.need("limits.curvature_max_per_mm", 4, "1/mm")
    radius = source.need("derived:bend_radius_limit_mm", 1, "mm")
    made = [Key("Needle bends with radius", phrase(radius), phrase("curvature ", curvature, ", clearance asked ", asked))]
    made += place_keys(source)
    length = source.figure("metrics.length_mm", 3, "mm")
    if length is not None:
        made.append(Key("Length", phrase(length), phrase("from entry to tip")))
    angle = source.figure("details.insertion_angle_deg", 3, "°")
    if angle is not None:
        made.append(Key("Insertion angle", phrase(angle), phrase(f"form {source.result['details'].get('chosen_form')}")))
    return tuple(made)
