"""The page of the bronchoscope robot: one plan with its stages and steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports import workspace
from reports.derived import derived_values
from reports.figures import Steps, step_chart
from reports.folds import Fold, folds
from reports.numbers import Phrase, Source, phrase, printed, sentence
from reports.parts import Drawing, Key, PlanPage, Table, place_keys, with_article
from reports.still import Label, View, choose_view, still_picture
from reports.svg import in_all_widths
from reports.tables import DASH, or_dash
from reports.turnable import turnable
from reports.walk import Walk, stages_walk
from reports.wall import LightMesh, light_mesh
from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from tubeplan_viz.endoluminal import Still

WORDS = {"ok": "Reached", "flagged": "Flagged", "infeasible": "Not reached"}
PLACES = 2


@dataclass(frozen=True)
class RobotPage(PlanPage):
    """What the template prints after the head, in its order."""

    frame: str
    views_title: str
    views_line: str
    still: Markup
    scene: Mapping[str, Any]
    profiles: Mapping[str, Markup]
    units: Mapping[str, str]
    narrowest: float | None
    ramp: tuple[str, str] | None
    charts: tuple[Drawing, ...]
    tables: tuple[Table, ...]
    folds: tuple[Fold, ...]
    foot: str
    walk: Walk | None = None


def make_bronchoscope_page(case_id: str, result: Mapping[str, Any], surface: Surface, stills: Sequence[Still] = ()) -> RobotPage:
    """Everything that the page of one plan shows."""
    source = Source(result, derived_values(result))
    status, details = str(result["status"]), result["details"]
    tables = (_stages(source), _route(source), _steps(source))
    course = workspace.make_course(result["path"] or {}, None, 2)
    tight, ramp = None, None
    if course is not None and course.clearance is not None:
        tight = int(course.clearance.argmin())
        ramp = workspace.roominess(course, source.value("limits.clearance_min_mm"))[0]
    picture = _picture(result, surface)
    still, scene = picture.shown(start=tight or 0, ramp=ramp)
    return RobotPage(
        title=f"{WORDS[status]}: case {case_id}",
        case_id=case_id,
        status=status,
        word=WORDS[status],
        line=f"Bronchoscope robot, {result['planner']['method']} plan",
        headline=_headline(result),
        lead=_lead(source),
        warnings=tuple(sentence(str(text)) for text in details.get("warnings") or ()),
        keys=_keys(source),
        views_title="Way of the tip",
        views_line="The track of the tip through the airway, with the sub-goals of the stages. " + str(details["assumption"]),
        frame=str(result["frame"]),
        still=still,
        scene=scene,
        # The simulated tip may turn on the spot: only its sections have a limit.
        profiles={}
        if course is None
        else workspace.profiles(course, source, {}, free=("curvature",) if result["planner"]["method"] == "dynamic" else ()),
        units={"clearance": "mm from the tip's track to the wall", "curvature": "1/mm, of the tip's track"},
        narrowest=None if course is None or tight is None else float(course.arc[tight]),
        ramp=None if ramp is None else (printed(ramp[0], 1), printed(ramp[1], 1)),
        charts=_charts(source),
        tables=tables,
        folds=folds(source, ()),
        foot="Clearance is the distance from the tip's track, or the robot's axis, to the wall; the robot's radius is taken "
        "off where a table says so.",
        walk=stages_walk(source, stills),
    )


def _headline(result: Mapping[str, Any]) -> Phrase:
    details = result["details"]
    name = with_article(str(details["target"]["branch"]))
    if not details["reached"]:
        return phrase(f"The robot does not reach {name}")
    broken = " but breaks a limit on the way" if result["status"] == "flagged" else ""
    return phrase(f"The robot reaches its target in {name}{broken}")


def _lead(source: Source) -> Phrase:
    reason = source.result.get("reason")
    route = " → ".join(str(part["name"]) for part in source.result["details"]["route"])
    error = source.need("metrics.tip_error_mm", PLACES, "mm")
    disc = source.need("metrics.disc_clearance_end_mm", PLACES, "mm")
    tail = phrase("The tip ends ", error, " from the target, its front disc ", disc, " from the wall.")
    said = "" if reason is None else f" {str(reason)[:1].upper()}{str(reason)[1:]}."
    return phrase(f"{route[:1].upper()}{route[1:]}. ", tail, said)


def _keys(source: Source) -> tuple[Key, ...]:
    robot = source.need("details.robot.diameter_mm", 1, "mm")
    lengths = phrase(
        source.need("details.robot.proximal_length_mm", 0, "mm"), " + ", source.need("details.robot.distal_length_mm", 0, "mm")
    )
    made = [
        Key("Tip error", phrase(source.need("metrics.tip_error_mm", PLACES, "mm")), phrase("distance of the tip to the target")),
        *_place_keys(source),
        Key(
            "Robot",
            phrase(robot),
            phrase("two sections of ", lengths, ", each bends up to ", source.need("details.robot.bend_max_deg", 0, "°")),
        ),
        Key(
            "Body to wall",
            phrase(source.need("metrics.body_clearance_min_mm", PLACES, "mm")),
            phrase("least distance of the robot's surface to the wall; below 0 it leans on it"),
        ),
        Key(
            "Track of the tip",
            phrase(source.need("metrics.length_mm", 1, "mm")),
            phrase("way of the tip from the entrance"),
        ),
    ]
    contacts = source.result["details"]["contacts"]
    steps = phrase(f"{len(source.result['details']['steps']) - 1} commands for both sections and the push")
    if contacts["largest_force_mm"] is not None:
        place = ", ".join(printed(value, 1) for value in contacts["largest_force_mm"])
        where = phrase(f"after step {contacts['largest_force_step']} at ({place}) mm; ", steps)
        made.append(Key("Largest contact force", phrase(source.need("details.contacts.largest_force_n", 3, "N")), where))
    elif source.result["planner"]["method"] == "dynamic":
        made.append(Key("Contact", phrase("none"), phrase("at rest after no step; ", steps)))
    else:
        made.append(Key("Contact", phrase("none allowed"), phrase("forces are not computed by kinematics; ", steps)))
    return tuple(made)


def _place_keys(source: Source) -> tuple[Key, ...]:
    """The tightest place and the sharpest bend; in the simulator only the sections are limited: the tip may turn on the spot."""
    keys = place_keys(source)
    if source.result["planner"]["method"] != "dynamic":
        return keys
    return (*(key for key in keys if key.term != "Sharpest bend"), _bend_key(source))


def _bend_key(source: Source) -> Key:
    """The largest bend of a section."""
    angles = [
        (abs(float(step["command"][name])), f"details.steps.{k}.command.{name}", k)
        for k, step in enumerate(source.result["details"]["steps"])
        if step["command"] is not None
        for name in ("phi_proximal_deg", "phi_distal_deg")
    ]
    allowed = source.need("limits.curvature_max_per_mm", 1, "1/mm")
    track = phrase(source.need("metrics.curvature_max_per_mm", 2), " of ", allowed)
    if not angles:
        return Key("Largest bend", phrase("none"), phrase("the tip's track turns with up to ", track))
    _, key, step = max(angles)
    section = "proximal" if "proximal" in key else "distal"
    most = source.need("details.robot.bend_max_deg", 0, "°")
    more = phrase("of ", most, f", {section} section, step {step}; the tip's track turns with up to ", track)
    return Key("Largest bend", phrase(source.need(key, 1, "°")), more)


@dataclass(frozen=True, eq=False)
class _Picture:
    """The airway with what is drawn in it, to stand still and to be turned."""

    mesh: LightMesh
    path: FloatArray
    labels: Sequence[Label]
    view: View
    words: str
    lines: Sequence[tuple[str, FloatArray]] = ()

    def shown(self, *, start: int, ramp: tuple[float, float] | None = None) -> tuple[Markup, Mapping[str, Any]]:
        """The still picture and what the script needs to turn it."""
        still = still_picture(self.mesh, self.path, (), self.labels, self.view, f"{self.words}.", lines=self.lines)
        words = self.words[:1].lower() + self.words[1:]
        return still, turnable(self.mesh, self.view, self.labels, start=start, ramp=ramp, words=words)


def _picture(result: Mapping[str, Any], surface: Surface) -> _Picture:
    details = result["details"]
    path = np.asarray(result["path"]["points_mm"], float)
    labels = [
        Label(np.asarray(details["target"]["point_mm"], float), "Target", "goal", 0),
        Label(path[0], "Start of the tip", "start", 1),
    ]
    labels += [
        Label(np.asarray(stage["goal_mm"], float), stage["name"].removeprefix("along "), "start", 2 + k)
        for k, stage in enumerate(details["stages"][:-1])
        if stage["name"].startswith("along ")
    ]
    if details["target"]["lesion_mm"] is not None:
        labels.append(Label(np.asarray(details["target"]["lesion_mm"], float), "Lesion", "curvature", 1))
    # On a mesh the first point is drawn at the bottom: the far end, so that the trachea is at the top.
    spread = surface.vertices[:: max(1, len(surface.vertices) // 500)]
    view = choose_view(np.vstack([path[-1], spread, path[0]]), str(result["frame"]))
    words = "The wall of the airway with the track of the robot's tip and the sub-goals of its stages"
    return _Picture(light_mesh(surface), path, labels, view, words)


def _charts(source: Source) -> tuple[Drawing, ...]:
    result = source.result
    made = []
    steps = result["details"]["steps"]
    limit = float(result["details"]["robot"]["bend_max_deg"])
    rows: list[tuple[str, str, str, list[float], float | None, str]] = [
        ("Front disc to the wall", "mm, by step; below 0 it collides", "clearance", _of(steps, "disc_clearance_mm"), 0.0, ""),
        ("Body to the wall", "mm, by step, robot's radius taken off", "clearance", _of(steps, "body_clearance_mm"), 0.0, ""),
    ]
    for name, key in (("Proximal bend", "phi_proximal_deg"), ("Distal bend", "phi_distal_deg")):
        values = [0.0 if step["command"] is None else float(step["command"][key]) for step in steps]
        rows.append((name, "degrees, by step", "curvature", values, limit, f"largest {limit:.0f}°"))
    if result["planner"]["method"] == "dynamic":
        forces = [max((float(force) for force in step["forces_n"]), default=0.0) for step in steps]
        rows.append(("Contact force", "N, by step, the largest while it rests", "clearance", forces, None, ""))
    for title, unit, kind, values, level, words in rows:
        spec = Steps(
            kind=kind,
            values=np.asarray(values),
            limit=level,
            limit_label=words or "contact",
            label=f"{title}, {unit}: from {values[0]:.2f} to {values[-1]:.2f}",
            full=True,
        )
        made.append(Drawing(title, in_all_widths(partial(step_chart, spec)), unit))
    return tuple(made)


def _of(steps: Sequence[Mapping[str, Any]], key: str) -> list[float]:
    return [float(step[key]) for step in steps]


def _cells(source: Source, key: str, *names: tuple[str, int]) -> tuple[Phrase, ...]:
    return tuple(or_dash(source.figure(f"{key}.{name}", digits)) for name, digits in names)


def _stages(source: Source) -> Table:
    names = (("samples", 0), ("pushes", 0), ("collided", 0), ("sphere_radius_mm", 2), ("seconds", 2))
    stages = source.result["details"]["stages"]
    rows = tuple((phrase(stage["name"]), *_cells(source, f"details.stages.{k}", *names)) for k, stage in enumerate(stages))
    tree, steps = source.result["details"]["tree"], source.result["details"]["steps"]
    line = (
        "Each stage draws samples in the sphere about its sub-goal; the first one is the sub-goal itself. "
        f"{len(steps) - 1} commands, {tree['samples']} samples and {tree['poses']} poses in all."
    )
    head = ("Stage", "Samples", "Pushes", "Collided", "Sphere, mm", "Time, s")
    return Table("stages", "Stages", line, head, rows)


def _route(source: Source) -> Table:
    route = source.result["details"]["route"]
    names = (("generation", 0), ("diameter_mm", 1), ("length_mm", 1), ("turn_deg", 0), ("confidence", 2))
    rows = tuple((phrase(part["name"]), *_cells(source, f"details.route.{k}", *names)) for k, part in enumerate(route))
    head = ("Branch", "Generation", "Diameter, mm", "Length, mm", "Turn, °", "Confidence of the name")
    line = "Branches on the way, named by their geometry; diameters are medians of inscribed spheres."
    return Table("route", "Route", line, head, rows)


def _steps(source: Source) -> Table:
    steps = source.result["details"]["steps"]
    angles = ("phi_proximal_deg", "theta_proximal_deg", "phi_distal_deg", "theta_distal_deg")
    rows = []
    for k, step in enumerate(steps):
        if step["command"] is None:
            command: tuple[Phrase, ...] = (DASH,) * 5
        else:
            command = _cells(source, f"details.steps.{k}.command", *((name, 1) for name in angles), ("push_mm", 2))
        rest = _cells(source, f"details.steps.{k}", ("disc_clearance_mm", 2), ("body_clearance_mm", 2))
        rows.append((phrase(f"{k}"), *command, *rest, phrase(str(step["stage"]))))
    head = ("Step", "φ prox., °", "θ prox., °", "φ dist., °", "θ dist., °", "Push, mm", "Disc, mm", "Body, mm", "Stage")
    line = "What the drive does: bend φ in the plane θ for each section, then the push. The same numbers are in actuation.csv."
    return Table("steps", "Actuation", line, head, tuple(rows))
