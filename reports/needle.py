"""The page of a needle's plan: path and obstacles in space and in the CT, how it was searched, forms, controls, insertions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from reports import workspace
from reports.derived import derived_values
from reports.folds import Fold, folds
from reports.needle_charts import convergence_charts
from reports.needle_ct import Space, Surroundings, ct_drawings, space_of
from reports.needle_drawings import cloud_drawings, flat_view, layers_of
from reports.needle_tables import (
    chances_table,
    controls_table,
    forms_table,
    front_table,
    insertion_table,
    obstacles_table,
)
from reports.numbers import Phrase, Source, phrase, printed, sentence
from reports.parts import Drawing, Key, PlanPage, Table, place_keys

WORDS = {"ok": "Holds", "flagged": "Flagged", "infeasible": "No path"}
PLACES, TIP_PLACES = 2, 3
TOUCH_MM = 0.005  # what is printed as 0.00
CUTS_LINE = (
    "Planes along the needle and through the tightest place (white dot), {} window. Outlines: obstacles; dashed: the safety "
    "distance around them. The path is faint where it is more than 3 mm from the plane."
)


@dataclass(frozen=True)
class NeedlePage(PlanPage):
    """What the template prints after the head, in its order."""

    cuts_line: str
    cuts: tuple[Drawing, ...]
    frame: str
    space: Space | None
    ramp: tuple[str, str] | None
    narrowest: float | None
    views_line: str
    views: tuple[Drawing, ...]
    charts: Mapping[str, Markup]
    units: Mapping[str, str]
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
    ramp = None
    if course is not None and course.clearance is not None:
        ramp = workspace.roominess(course, source.value("limits.clearance_min_mm"))[0]
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
        headline=phrase(_headline(source, status)),
        lead=_lead(source, status),
        warnings=tuple(sentence(str(text)) for text in details.get("warnings") or ()),
        keys=_keys(source),
        cuts_line="" if window is None else CUTS_LINE.format(window.label.lower()),
        cuts=cuts,
        frame=str(result["frame"]),
        space=space_of(result, around, ramp),
        ramp=None if ramp is None else (printed(ramp[0], 1), printed(ramp[1], 1)),
        narrowest=None if course is None or course.clearance is None else float(course.arc[course.clearance.argmin()]),
        views_line=_views_line(result),
        views=tuple(Drawing(title, flat_view(result, axes, layers, _shown(result, title))) for title, axes in views),
        charts=charts,
        units={"clearance": "mm from the path to the nearest obstacle", "curvature": "1/mm"},
        clouds=cloud_drawings(result),
        convergence=tuple(
            Drawing(title, chart, unit) for title, unit, chart in convergence_charts(details.get("convergence") or ())
        ),
        tables=tuple(tables),
        folds=folds(source, ()),
    )


def _shown(result: Mapping[str, Any], title: str) -> str:
    """What a flat drawing shows, in words."""
    count = len(result["details"].get("obstacles", ()))
    past = f"{count} obstacle{'' if count == 1 else 's'}" if count else "no obstacle"
    path = "path from entry to target" if result["path"] is not None else "entry and target without a path"
    return f"{title}: {path} and {past}"


def _views_line(result: Mapping[str, Any]) -> str:
    details = result["details"]
    forms = sum(form["feasible"] for form in details.get("forms", ()))
    shown = f"The chosen path and the other {forms - 1} feasible forms." if forms > 1 else "The planned path."
    pushed = " Dashed red: the path pushed after the events." if details.get("insertion") else ""
    trials = " Faint: insertions at random." if details.get("monte_carlo") else ""
    kinds = {body["kind"] for body in details.get("obstacles", ())}
    asked = float(result["limits"]["clearance_min_mm"])
    rings = " Dashed rings and pale bands: the safety distance around obstacles." if kinds - {"mask", "mesh"} and asked else ""
    dots = " Dots: the rim of obstacles from files." if kinds & {"mask", "mesh"} else ""
    return shown + pushed + trials + rings + dots


def _touched(source: Source) -> bool:
    """Whether no distance was asked and none is kept: the path runs along the rim of an obstacle."""
    asked, least = source.value("limits.clearance_min_mm"), source.value("metrics.clearance_min_mm")
    return asked == 0.0 and least is not None and least < TOUCH_MM


def _nearest(source: Source) -> str:
    """The obstacle to which the path comes nearest, as the table of obstacles names it; empty for an older result."""
    bodies = source.result["details"].get("obstacles") or ()
    told = [(float(body["clearance_mm"]), k) for k, body in enumerate(bodies) if "clearance_mm" in body]
    return f"obstacle {min(told)[1] + 1} ({bodies[min(told)[1]]['kind']})" if told else ""


def _headline(source: Source, status: str) -> str:
    if status != "ok":
        return "No path for this needle"
    kept = "grazes an obstacle on the way" if _touched(source) else "keeps its distance"
    return f"The needle reaches the target and {kept}"


def _lead(source: Source, status: str) -> Phrase:
    reason = source.result.get("reason")
    if status != "ok":
        return phrase(sentence(str(reason)))
    least = source.figure("metrics.clearance_min_mm", PLACES, "mm")
    asked = source.need("limits.clearance_min_mm", PLACES, "mm")
    error = source.need("metrics.tip_error_mm", TIP_PLACES, "mm")
    if least is None:
        kept = phrase("There is no obstacle.")
    elif _touched(source):
        kept = phrase(
            f"No distance was asked, and it touches {_nearest(source) or 'an obstacle'}; a safety distance keeps it off."
        )
    else:
        kept = phrase("It passes obstacles at ", least, " or more, ", asked, " asked.")
    return phrase(kept, " The tip ends ", error, " from the target.")


def _keys(source: Source) -> tuple[Key, ...]:
    asked = source.need("limits.clearance_min_mm", PLACES, "mm")
    curvature = source.need("limits.curvature_max_per_mm", 4, "1/mm")
    radius = source.need("derived:bend_radius_limit_mm", 1, "mm")
    made = [Key("Needle bends with radius", phrase(radius), phrase("curvature ", curvature, ", clearance asked ", asked))]
    near = _nearest(source)
    for key in place_keys(source):
        if key.term == "Worst margin":
            value = phrase(source.need("derived:margin_mm", PLACES, "mm")) if _touched(source) else key.value
            key = Key(key.term, value, phrase(key.more, f", from {near}" if near else ""), key.tone)
        made.append(key)
    length = source.figure("metrics.length_mm", 1, "mm")
    if length is not None:
        made.append(Key("Length", phrase(length), phrase("from entry to tip")))
    angle = source.figure("details.insertion_angle_deg", 1, "°")
    if angle is not None:
        made.append(Key("Insertion angle", phrase(angle), phrase(f"form {source.result['details'].get('chosen_form')}")))
    return tuple(made)
