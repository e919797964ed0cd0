"""The page of a needle's plan: path and obstacles drawn flat, forms, controls, front and insertion as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from reports import workspace
from reports.derived import derived_values
from reports.folds import Fold, folds
from reports.numbers import Phrase, Source, phrase
from reports.tables import DASH, or_dash
from segmentation.arrays import FloatArray

WORDS = {"ok": "Holds", "flagged": "Flagged", "infeasible": "No path"}
VIEW_SIZE = 560  # px of the longest side of all drawings together; they share one scale
PLACES = 2
MISPRINT = (
    "In Zhao et al. (2013), table 2, the printed lengths and angles of RL and LRL miss the target by 6.8 mm and 3.8 mm with the "
    "stated radius of 50 mm; the paths here end on it."
)


@dataclass(frozen=True)
class Key:
    """One figure under the verdict."""

    term: str
    value: Phrase
    more: Phrase


@dataclass(frozen=True)
class Drawing:
    """One drawing with its title and unit."""

    title: str
    drawing: Markup
    unit: str = ""


@dataclass(frozen=True)
class Table:
    """One section with a table."""

    id: str
    title: str
    line: str
    head: tuple[str, ...]
    rows: tuple[tuple[Phrase, ...], ...]
    note: str = ""
    drawing: Markup | None = None


@dataclass(frozen=True)
class NeedlePage:
    """What the template prints, in its order."""

    title: str
    case_id: str
    status: str
    word: str
    line: str
    headline: Phrase
    lead: Phrase
    warnings: tuple[str, ...]
    keys: tuple[Key, ...]
    views_line: str
    views: tuple[Drawing, ...]
    charts: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    folds: tuple[Fold, ...]


def make_needle_page(case_id: str, result: Mapping[str, Any]) -> NeedlePage:
    """Everything that the page shows."""
    source = Source(result, derived_values(result))
    status = str(result["status"])
    flat = result["planner"]["name"] == "needle2d"
    details = result["details"]
    course = workspace.make_course(result["path"] or {}, None, 2)
    charts = workspace.profiles(course, source, {}) if course is not None else {}
    units = {"clearance": "mm from the path to the nearest obstacle", "curvature": "1/mm"}
    tables = (_forms(source), _controls(source), _front(source), _insertion(source), _obstacles(source))
    views = [("In the plane: y to the right, z downwards", (1, 2))]
    if not flat:
        views = [
            ("x to the right, z downwards", (0, 2)),
            ("y to the right, z downwards", (1, 2)),
            ("x to the right, y downwards", (0, 1)),
        ]
    forms = sum(form["feasible"] for form in details.get("forms", ()))
    shown = f"The chosen path and the other {forms - 1} feasible forms." if forms > 1 else "The planned path."
    pushed = " Dashed red: the path pushed after the events." if details.get("insertion") else ""
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
        views_line=f"{shown}{pushed} Dashed rings: the safety distance around obstacles. Dots: the rim of obstacles from files.",
        views=tuple(Drawing(title, _view(result, axes)) for title, axes in views),
        charts=tuple(
            Drawing(kind.capitalize(), charts[kind], units[kind]) for kind in ("clearance", "curvature") if kind in charts
        ),
        tables=tuple(table for table in tables if table is not None),
        folds=folds(source, ()),
    )


def _lead(source: Source, status: str) -> Phrase:
    reason = source.result.get("reason")
    if status != "ok":
        text = str(reason)
        return phrase(text[:1].upper() + text[1:] + ("" if text.endswith(".") else "."))
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
    length = source.figure("metrics.length_mm", 3, "mm")
    if length is not None:
        made.append(
            Key("Length", phrase(length), phrase("largest curvature ", source.need("metrics.curvature_max_per_mm", 4, "1/mm")))
        )
    least = source.figure("metrics.clearance_min_mm", PLACES, "mm")
    if least is not None:
        made.append(
            Key("Least clearance", phrase(least), phrase("margin ", source.need("derived:margin_mm", 4, "mm", signed=True)))
        )
    angle = source.figure("details.insertion_angle_deg", 4, "°")
    if angle is not None:
        made.append(Key("Insertion angle", phrase(angle), phrase(f"form {source.result['details'].get('chosen_form')}")))
    return tuple(made)


def _cells(source: Source, key: str, *names: tuple[str, int]) -> tuple[Phrase, ...]:
    return tuple(or_dash(source.figure(f"{key}.{name}", digits)) for name, digits in names)


def _forms(source: Source) -> Table | None:
    details = source.result["details"]
    forms = details.get("forms")
    if not forms:
        return None
    rows = []
    for k, form in enumerate(forms):
        key = f"details.forms.{k}"
        pieces = phrase(
            *(
                part
                for j in range(len(form.get("lengths_mm", ())))
                for part in (" + " if j else "", source.figure(f"{key}.lengths_mm.{j}", 2))
            )
        )
        name = form["form"] + (" (chosen)" if form["form"] == details["chosen_form"] else "")
        cells = _cells(source, key, ("score", 3), ("length_mm", 3), ("insertion_angle_deg", 3), ("clearance_min_mm", 3))
        rows.append((phrase(name), *cells, pieces if form["feasible"] else phrase(str(form["reason"]))))
    head = ("Form", "F", "Length, mm", "Insertion angle, °", "Least clearance, mm", "Pieces, mm, or why there is none")
    line = "L is a line, R an arc, in order; the best path of each form that ends on the target. F = a1 L + a2 D + a4 N."
    return Table("forms", "Forms", line, head, tuple(rows), note=MISPRINT)


def _controls(source: Source) -> Table | None:
    controls = source.result["details"].get("controls")
    if not controls:
        return None
    names = (("turn_deg", 3), ("length_mm", 4), ("curvature_per_mm", 5))
    rows = tuple((phrase(str(k + 1)), *_cells(source, f"details.controls.{k}", *names)) for k in range(len(controls)))
    line = "What the needle's drive does, piece by piece: turn the bevel, then push."
    return Table("controls", "Controls", line, ("Piece", "Turn, °", "Push, mm", "Curvature, 1/mm"), rows)


def _front(source: Source) -> Table | None:
    front = source.result["details"].get("pareto")
    if not front:
        return None
    names = (("error_mm", 4), ("length_mm", 3), ("danger", 3), ("clearance_mm", 2))
    rows = tuple((phrase(str(k + 1)), *_cells(source, f"details.pareto.{k}", *names)) for k in range(len(front)))
    points = np.array([[p["length_mm"], p["danger"]] for p in front])
    exact = np.array([p["error_mm"] == 0.0 for p in front])
    return Table(
        "front",
        "Pareto front",
        "No path found is better than one of these in error, length and danger at once; full dots end on the target.",
        ("Path", "Tip error, mm", "Length, mm", "Danger", "Least clearance, mm"),
        rows,
        drawing=_scatter(points, exact),
    )


def _insertion(source: Source) -> Table | None:
    insertion = source.result["details"].get("insertion")
    if not insertion:
        return None
    rows = [
        (
            phrase(step["cause"]),
            *_cells(source, f"details.insertion.replans.{k}", ("at_mm", 1)),
            phrase("replanned" if step["found"] else "no path from here"),
            *_cells(source, f"details.insertion.replans.{k}", ("length_mm", 3)),
        )
        for k, step in enumerate(insertion["replans"])
    ]
    end = "withdrawn" if insertion["withdrawn"] else "at the target"
    rows.append((phrase("end of the insertion"), *_cells(source, "details.insertion", ("length_mm", 1)), phrase(end), DASH))
    error = source.need("details.insertion.error_mm", 4)
    return Table(
        "insertion",
        "Insertion",
        "Simulated with what the events say; the tip is measured and the rest planned anew from the pose reached.",
        ("Cause", "At, mm", "Outcome", "Path then expected, mm"),
        tuple(rows),
        note=f"The tip ended {error.text} mm from the target.",
    )


def _obstacles(source: Source) -> Table | None:
    obstacles = source.result["details"].get("obstacles")
    if not obstacles:
        return None
    rows = []
    for k, body in enumerate(obstacles):
        key = f"details.obstacles.{k}"
        center = tuple(source.figure(f"{key}.center_mm.{axis}", 1) for axis in range(3))
        place = (
            phrase(*(part for j, figure in enumerate(center) for part in (", " if j else "", figure)))
            if all(center)
            else phrase(str(body.get("file", f"{len(body.get('points_mm', ()))} points")))
        )
        rows.append((phrase(f"{k + 1}, {body['kind']}"), place, *_cells(source, key, ("radius_mm", 2))))
    return Table(
        "obstacles", "Obstacles", "As given in the case file.", ("Obstacle", "Centre (x, y, z), mm", "Radius, mm"), tuple(rows)
    )


def _scatter(points: FloatArray, exact: Any) -> Markup:
    """Danger over length as a plain drawing."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-6)
    at = (points - low) / span
    dots = Markup("").join(
        Markup('<circle cx="{}" cy="{}" r="4" class="needle-dot" fill-opacity="{}"/>').format(
            round(60 + 600 * x, 1), round(200 - 170 * y, 1), 1 if full else 0.3
        )
        for (x, y), full in zip(at, exact, strict=True)
    )
    words = Markup('<text class="needle-words" x="60" y="225">length from {} to {} mm</text>').format(
        f"{low[0]:.1f}", f"{high[0]:.1f}"
    )
    words += Markup('<text class="needle-words" x="60" y="16">danger from {} (below) to {}</text>').format(
        f"{low[1]:.2f}", f"{high[1]:.2f}"
    )
    return Markup('<svg viewBox="0 0 720 235" role="img" aria-label="Pareto front">{}{}</svg>').format(dots, words)


def _view(result: Mapping[str, Any], axes: tuple[int, int]) -> Markup:
    """Path and obstacles projected onto two axes; the second runs downwards."""
    details, path = result["details"], result["path"]
    safety = result["limits"]["clearance_min_mm"]
    ends = np.array([details["entry_mm"], details["target_mm"]], float)
    lines = [("needle-form", np.array(f["points_mm"], float)) for f in details.get("forms", ()) if f["feasible"]]
    if path is not None:
        lines.append(("needle-path", np.array(path["points_mm"], float)[::2]))
    if details.get("insertion"):
        lines.append(("needle-pushed", np.array(details["insertion"]["points_mm"], float)))
    bodies = [_outline(body) for body in details.get("obstacles", ())]
    extent = np.vstack(
        [
            ends,
            *(line for _, line in lines),
            *(c + s * r for c, r in bodies if r >= 0 for s in (-1.0, 1.0)),
            *(c for c, r in bodies if r < 0),
        ]
    )
    room = 6.0 + safety
    low, high = extent.min(axis=0) - room, extent.max(axis=0) + room
    scale = VIEW_SIZE / float(max(high - low))
    low, high = low[list(axes)], high[list(axes)]
    low, high = np.minimum(low, 0.5 * (low + high) - 20.0), np.maximum(high, 0.5 * (low + high) + 20.0)
    size = (high - low) * scale

    def spot(points: FloatArray) -> FloatArray:
        return (np.atleast_2d(points)[:, list(axes)] - low) * scale

    drawn: list[Markup] = []
    for body, (centers, radius) in zip(details.get("obstacles", ()), bodies, strict=True):
        if body["kind"] in ("sphere", "circle"):
            x, y = spot(centers)[0]
            for name, r in (("needle-body", radius), ("needle-shell", radius + safety)):
                drawn.append(Markup('<circle class="{}" cx="{:.1f}" cy="{:.1f}" r="{:.1f}"/>').format(name, x, y, r * scale))
        elif len(centers):
            closed = "Z" if body["kind"] == "polygon" else ""
            width = 2 * max(radius, 0.0) * scale
            drawn.append(
                Markup('<path class="needle-body" d="{}" style="stroke-width:{:.1f};stroke-opacity:.4{}"/>').format(
                    _way(spot(centers)) + closed, max(width, 1.0), "" if closed else ";fill:none;stroke-linecap:round"
                )
            )
        for x, y in spot(np.array(body["outline_mm"], float)) if body.get("outline_mm") else ():
            if 0.0 <= x <= size[0] and 0.0 <= y <= size[1]:
                drawn.append(Markup('<circle class="needle-rim" cx="{:.1f}" cy="{:.1f}" r="1.5"/>').format(x, y))
    for name, line in lines:
        drawn.append(Markup('<path class="{}" d="{}"/>').format(name, _way(spot(line))))
    for place, word in zip(ends, ("entry", "target"), strict=True):
        x, y = spot(place)[0]
        drawn.append(Markup('<circle class="needle-dot" cx="{:.1f}" cy="{:.1f}" r="4"/>').format(x, y))
        drawn.append(Markup('<text class="needle-words" x="{:.1f}" y="{:.1f}">{}</text>').format(x + 7, y + 4, escape(word)))
    bar = 10.0 * scale
    drawn.append(
        Markup(
            '<path class="needle-path" d="M8 {0:.1f}h{1:.1f}"/><text class="needle-words" x="8" y="{2:.1f}">10 mm</text>'
        ).format(size[1] - 8, bar, size[1] - 13)
    )
    return Markup(
        '<svg width="{0:.0f}" viewBox="0 0 {0:.0f} {1:.0f}" role="img" aria-label="Path and obstacles">{2}</svg>'
    ).format(size[0], size[1], Markup("").join(drawn))


def _outline(body: Mapping[str, Any]) -> tuple[FloatArray, float]:
    """Points of an obstacle's middle, (k, 3) mm, and its radius around them; a file's obstacle has no points here."""
    if "center_mm" in body:
        return np.array([body["center_mm"]], float), float(body["radius_mm"])
    if "points_mm" in body:
        return np.array(body["points_mm"], float), float(body.get("radius_mm", -1.0))
    return np.zeros((0, 3)), -1.0


def _way(points: Sequence[Sequence[float]] | FloatArray) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
