"""The tables of a needle's page: forms, controls, front, insertion, insertions at random, obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from reports.needle_charts import error_chart, front_chart
from reports.numbers import Phrase, Source, phrase, typeset
from reports.parts import Table
from reports.tables import DASH, or_dash

MISPRINT = (
    "In Zhao et al. (2013), table 2, the printed lengths and angles of RL and LRL miss the target by 6.8 mm and 3.8 mm with the "
    "stated radius of 50 mm; the paths here end on it."
)


def cells(source: Source, key: str, *names: tuple[str, int]) -> tuple[Phrase, ...]:
    """The figures of some keys with their decimals, a dash for what is not there."""
    return tuple(or_dash(source.figure(f"{key}.{name}", digits)) for name, digits in names)


def forms_table(source: Source) -> Table | None:
    """Every planar form: its best path, or why there is none."""
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
        measures = cells(
            source, key, ("score", 3), ("score_bound", 3), ("length_mm", 3), ("insertion_angle_deg", 3), ("clearance_min_mm", 3)
        )
        rows.append((phrase(name), *measures, pieces if form["feasible"] else phrase(typeset(str(form["reason"])))))
    head = (
        "Form",
        "F",
        "F is at least",
        "Length, mm",
        "Insertion angle, °",
        "Least clearance, mm",
        "Pieces, mm, or why there is none",
    )
    line = (
        "L is a line, R an arc, in order; the best path of each form that ends on the target. F = a1 L + a2 D + a4 N. "
        "No path of a form has a smaller F than its bound: every cell of piece lengths that could hold one is excluded."
    )
    return Table("forms", "Forms", line, head, tuple(rows), note=MISPRINT)


def controls_table(source: Source) -> Table | None:
    """What the drive does, piece by piece."""
    details = source.result["details"]
    controls = details.get("controls")
    if not controls:
        return None
    names = [("turn_deg", 3), ("length_mm", 4), ("curvature_per_mm", 5)]
    head = ["Piece", "Turn, °", "Push, mm", "Curvature, 1/mm"]
    note = ""
    if "duty_cycle" in details:
        names, head = [*names, ("duty", 4)], [*head, "Spinning, share of the push"]
        cycle, off = (source.need(f"details.duty_cycle.{name}", 3) for name in ("cycle_mm", "tip_deviation_mm"))
        note = f"With one whole revolution on every {cycle.text} mm of such a push the tip ends {off.text} mm from the plan."
    rows = tuple((phrase(str(k + 1)), *cells(source, f"details.controls.{k}", *names)) for k in range(len(controls)))
    line = "What the needle's drive does, piece by piece: turn the bevel, then push."
    return Table("controls", "Controls", line, tuple(head), rows, note=note)


def front_table(source: Source) -> Table | None:
    """The Pareto front with its chart."""
    front = source.result["details"].get("pareto")
    if not front:
        return None
    names = (("error_mm", 4), ("length_mm", 3), ("danger", 3), ("clearance_mm", 2))
    rows = tuple((phrase(str(k + 1)), *cells(source, f"details.pareto.{k}", *names)) for k in range(len(front)))
    return Table(
        "front",
        "Pareto front",
        "No path found is better than one of these in error, length and danger at once; full dots end on the target, "
        "pale ones up to 5 mm off.",
        ("Path", "Tip error, mm", "Length, mm", "Danger", "Least clearance, mm"),
        rows,
        drawing=front_chart(front),
    )


def insertion_table(source: Source) -> Table | None:
    """The log of the simulated insertion."""
    insertion = source.result["details"].get("insertion")
    if not insertion:
        return None
    rows = [
        (
            phrase(step["cause"]),
            *cells(source, f"details.insertion.replans.{k}", ("at_mm", 1)),
            phrase("replanned" if step["found"] else "no path from here"),
            *cells(source, f"details.insertion.replans.{k}", ("length_mm", 3)),
        )
        for k, step in enumerate(insertion["replans"])
    ]
    end = "withdrawn" if insertion["withdrawn"] else "at the target"
    rows.append((phrase("end of the insertion"), *cells(source, "details.insertion", ("length_mm", 1)), phrase(end), DASH))
    error = source.need("details.insertion.error_mm", 4)
    return Table(
        "insertion",
        "Insertion",
        "Simulated with what the events say; the tip is measured and the rest planned anew from the pose reached.",
        ("Cause", "At, mm", "Outcome", "Path then expected, mm"),
        tuple(rows),
        note=f"The tip ended {error.text} mm from the target.",
    )


def chances_table(source: Source) -> Table | None:
    """Final errors of insertions at random."""
    found = source.result["details"].get("monte_carlo")
    if not found:
        return None
    key = "details.monte_carlo"
    words = {share: "all end within" if share == "100" else f"{share} % end within" for share in found["percentiles_mm"]}
    rows = [(phrase(word), *cells(source, f"{key}.percentiles_mm", (share, 3))) for share, word in words.items()]
    named = {"ended": "that ended", "withdrawn": "withdrawn before the target", "touched": "that touched an obstacle"}
    counts = [(phrase(f"insertions {word}"), *cells(source, key, (name, 0))) for name, word in named.items()]
    s = found["settings"]
    line = (
        f"{found['runs']} insertions of this plan, simulated: true curvature off by {100 * s['curvature_error']:g} % (standard "
        f"deviation), tip measured with {s['tip_noise_mm']:g} mm of noise along each axis, target moved by "
        f"{s['target_motion_mm']:g} mm on the way."
    )
    causes = "; ".join(f"{cause}: {count}" for cause, count in found["withdrawn_causes"].items())
    return Table(
        "chances",
        "Insertions at random",
        line,
        ("Final tip error", "mm, or how many"),
        tuple(rows + counts),
        note=f"Withdrawn, by cause: {causes}." if causes else "",
        drawing=error_chart(found["errors_mm"]) if found["ended"] else None,
    )


def obstacles_table(source: Source) -> Table | None:
    """What the path keeps away from."""
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
            else phrase(file_words(body))
        )
        rows.append((phrase(f"{k + 1}, {body['kind']}"), place, *cells(source, key, ("radius_mm", 2), ("clearance_mm", 2))))
    head = ("Obstacle", "Centre (x, y, z), mm", "Radius, mm", "Clearance, mm")
    return Table("obstacles", "Obstacles", "As given in the case file, and how near the path comes to each.", head, tuple(rows))


def file_words(body: Mapping[str, Any]) -> str:
    """Where an obstacle without a centre comes from."""
    if "file" not in body:
        return f"{len(body['points_mm'])} points"
    most = f" to {body['hu_max']:g}" if "hu_max" in body else ""
    return str(body["file"]) + (f", HU from {body['hu_min']:g}{most}" if "hu_min" in body else "")
