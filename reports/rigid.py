"""The page of a rigid plan: verdict, CT with labels, entry map, corridor, distances, choices, refusals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports import workspace
from reports.derived import derived_values
from reports.folds import Fold, folds
from reports.numbers import Figure, Phrase, Source, phrase, printed, sentence
from reports.parts import Drawing, Key, PlanPage
from reports.rigid_drawings import LABEL_COLORS, corridor_view, distances_chart, entry_map, goals_chart, label_picture
from reports.rigid_scene import rigid_scene
from reports.svg import in_all_widths
from reports.tables import or_dash
from segmentation.anatomy.nasal import NasalScene
from segmentation.arrays import BoolArray
from segmentation.volume import Volume

WORDS = {"ok": "Feasible", "flagged": "Flagged", "infeasible": "No way in"}
PLANE_NAMES = ("axial", "coronal", "sagittal")


@dataclass(frozen=True)
class Part:
    """One section: drawings, then a table."""

    id: str
    title: str
    line: str
    drawings: tuple[Drawing, ...] = ()
    legend: tuple[tuple[str, str], ...] = ()
    head: tuple[str, ...] = ()
    rows: tuple[tuple[Phrase, ...], ...] = ()
    note: str = ""


@dataclass(frozen=True)
class RigidPage(PlanPage):
    """What the template prints after the head, in its order."""

    still: Markup
    scene: Mapping[str, Any]
    frame: str
    scene_line: str
    ramp: tuple[str, str] | None
    narrowest: float | None
    charts: Mapping[str, Markup]
    units: Mapping[str, str]
    distances: Markup
    legend: tuple[tuple[str, str], ...]
    parts: tuple[Part, ...]
    folds: tuple[Fold, ...]


def make_rigid_page(case_id: str, result: Mapping[str, Any], head: NasalScene) -> RigidPage:
    """Everything that the page shows.

    Parameters
    ----------
    case_id : str
    result : mapping
        The content of result.json.
    head : NasalScene
        As planned with, after shrinkage. Of the CT only planes through the lesion and the way are shown, cut to their
        surroundings; of its surfaces only what lies inside the head.
    """
    source = Source(result, derived_values(result))
    status = str(result["status"])
    side = str(result["details"]["side"])
    parts = (
        _pictures(result, head.volume, head.structures),
        _relief(source),
        _entry(source),
        _corridor(source),
        _choices(source),
        _goals(source),
        _shrinkage(source),
        _labels(source),
    )
    course = workspace.make_course(result["path"] or {}, None, 2)
    tight = 0 if course is None or course.clearance is None else int(course.clearance.argmin())
    ramp = None if course is None else workspace.roominess(course, source.value("limits.clearance_min_mm"))[0]
    picture = rigid_scene(result, head, ramp, tight)
    return RigidPage(
        title=f"{WORDS[status]}: case {case_id}",
        case_id=case_id,
        status=status,
        word=WORDS[status],
        line=f"Endoscope and shaver through the {side} nostril",
        headline=phrase(
            "The coupled instrument reaches the lesion" if status == "ok" else "No way to the lesion for this instrument"
        ),
        lead=_lead(source, status),
        warnings=tuple(sentence(str(text)) for text in result["details"].get("warnings") or ()),
        keys=_keys(source),
        still=picture.still,
        scene=picture.scene,
        frame=str(result["frame"]),
        scene_line=_scene_line(result),
        ramp=None if ramp is None else (printed(ramp[0], 1), printed(ramp[1], 1)),
        narrowest=None if course is None else float(course.arc[tight]),
        charts={} if course is None else workspace.profiles(course, source, {}, kinds=("clearance",)),
        units={"clearance": "mm from the instrument's surface to the nearest structure, by place of the tip"},
        distances=Markup("") if course is None else in_all_widths(partial(distances_chart, result)),
        legend=_scene_legend(result, head),
        parts=tuple(part for part in parts if part is not None),
        folds=folds(source, ()),
    )


def _lead(source: Source, status: str) -> Phrase:
    if status != "ok":
        return phrase(sentence(str(source.result["reason"])))
    least = source.need("metrics.clearance_min_mm", 2, "mm", strong=True)
    proved = source.need("certificate.clearance_lower_bound_mm", 2, "mm")
    feasible, starts = source.need("details.entry.counts.feasible", 0), source.need("details.entry.counts.starts", 0)
    return phrase(
        "Along the best path endoscope and shaver pass every named structure at ", least, " or more; ", proved,
        " are proved for the whole sweep. It can begin at ", feasible, " of ", starts, " places of the entry region.",
    )  # fmt: skip


def _keys(source: Source) -> tuple[Key, ...]:
    diameters = phrase(
        "⌀ ", source.need("details.instrument.scope_diameter_mm", 1), " and ",
        source.need("details.instrument.shaver_diameter_mm", 1, "mm"),
    )  # fmt: skip
    apart = phrase(
        source.need("details.instrument.offset_mm", 1, "mm"), " apart, tip ",
        source.need("details.instrument.setback_mm", 1, "mm"), " ahead",
    )  # fmt: skip
    made = [Key("Endoscope and shaver", diameters, apart)]
    length = source.figure("metrics.length_mm", 1, "mm")
    if length is not None:
        bends = len(source.result["details"]["nodes"]) - 1
        made.append(
            Key("Length", phrase(length), phrase("straight" if bends == 0 else f"{bends} bend{'s' if bends > 1 else ''}"))
        )
        made.append(
            Key(
                "Least distance",
                phrase(source.need("metrics.clearance_min_mm", 2, "mm")),
                phrase(
                    "instrument's surface to the ",
                    *_nearest(source),
                    ", ",
                    source.need("limits.clearance_min_mm", 1, "mm"),
                    " asked",
                ),
            )
        )
    else:
        asked = source.need("limits.clearance_min_mm", 1, "mm")
        made.append(Key("Least distance", phrase("none"), phrase("between instrument and structures, ", asked, " asked")))
    made.append(
        Key(
            "Entry",
            phrase(source.need("details.entry.counts.feasible", 0), " of ", source.need("details.entry.counts.starts", 0)),
            phrase("voxels feasible"),
        )
    )
    return tuple(made)


def _nearest(source: Source) -> tuple[str | Figure, ...]:
    """The structure that the instrument comes nearest to and where its tip is then, as words."""
    told = source.result["details"].get("structure_distances_mm") or {}
    clearance = source.result["path"]["clearance_mm"]
    k = int(np.argmin(clearance)) if clearance else 0
    least = [(float(values[k]), name) for name, values in told.items() if values[k] is not None]
    if not least or not clearance:
        return ("nearest structure",)
    return (min(least)[1].replace("_", " "), " with the tip at ", source.need(f"path.s_mm.{k}", 1, "mm"))


def _legend(names: list[str]) -> tuple[tuple[str, str], ...]:
    return tuple((name.replace("_", " "), LABEL_COLORS[name]) for name in names if name in LABEL_COLORS)


def _pictures(result: Mapping[str, Any], volume: Volume, structures: Mapping[str, BoolArray]) -> Part:
    details, path = result["details"], result["path"]
    goal = np.array(details["goal_mm"], float)
    places = [("At the lesion", goal)]
    if path is not None:
        points = np.array(path["points_mm"], float)
        places.append(("Half-way", points[len(points) // 2]))
    drawings = tuple(
        Drawing(f"{where}, {plane}", label_picture(volume, structures, place, plane, None if path is None else path["points_mm"]))
        for where, place in places
        for plane in PLANE_NAMES
    )
    return Part(
        id="labels-on-ct",
        title="Labels on the CT",
        line="Planes through the lesion and the middle of the way; the cross marks the place, the line the path. The left of the "
        "patient is on the right.",
        drawings=drawings,
        legend=_legend(list(structures)),
    )


def _entry(source: Source) -> Part:
    entry = source.result["details"]["entry"]
    names = entry["structures"]
    rows = []
    totals = np.array(entry["refused"], int).sum(axis=0) if len(entry["refused"]) else np.zeros(len(names), int)
    for k, name in enumerate(names):
        key = f"details.entry.counts.blocked_by_{name.replace(' ', '_')}"
        if source.value(key) or totals[k]:
            rows.append((phrase(name.replace("_", " ")), phrase(source.need(key, 0)), phrase(str(int(totals[k])))))
    goal = np.array(source.result["details"]["goal_mm"], float)
    return Part(
        id="entry",
        title="Entry region",
        line="Seen from in front of the nose along the way to the lesion; each square is a voxel of the entry region. "
        "Green: a path begins there. Other colours: no path, and what blocks the straight push.",
        drawings=(Drawing("Feasible, and why not", entry_map(entry, goal, str(source.result["details"]["side"]))),),
        legend=(("feasible", "var(--holds)"), *_legend(list(names))),
        head=("Structure", "Infeasible voxels whose straight push it blocks", "Tries it refused in all"),
        rows=tuple(rows),
    )


def _relief(source: Source) -> Part | None:
    """Without a way: what would open one."""
    tried = source.result["details"].get("relief")
    if not tried:
        return None
    rows = []
    for k, row in enumerate(tried):
        key = f"details.relief.{k}"
        against = ", ".join(
            f"{name.replace('_', ' ')} {count}" for name, count in sorted(row["against"].items(), key=lambda item: -item[1])
        )
        rows.append(
            (
                phrase(str(row["change"] or "as planned")),
                source.need(f"{key}.straight_starts", 0),
                source.need(f"{key}.free", 0),
                phrase(against or "nothing"),
            )
        )
    return Part(
        id="what-would-help",
        title="What would open a way",
        line="The same lesion with one thing changed at a time, then with changes together. Brain and orbits stay. "
        "A start counts when a straight push from it is free; with free directions and no such start, a path would need bends.",
        head=("Change", "Starts with a straight way", "Free directions at the lesion", "Directions blocked, without roll, by"),
        rows=tuple((row[0], phrase(row[1]), phrase(row[2]), row[3]) for row in rows),
        note="Whether tissue may be removed, or another instrument is at hand, is the surgeon's to judge.",
    )


def _corridor(source: Source) -> Part | None:
    details = source.result["details"]
    if source.result["path"] is None:
        return None
    rows = []
    for k in range(len(details["nodes"])):
        key = f"details.nodes.{k}"
        tip = phrase(*(p for j in range(3) for p in (", " if j else "", source.figure(f"{key}.tip_mm.{j}", 1))))
        angles = (source.need(f"{key}.{name}_deg", 1) for name in ("alpha", "beta", "gamma"))
        rows.append((phrase("lesion" if k == len(details["nodes"]) - 1 else f"node {k + 1}"), tip, *(phrase(a) for a in angles)))
    return Part(
        id="corridor",
        title="Instrument and corridor",
        line="The instrument at each node, drawn to scale: endoscope above, shaver with its tip on the path.",
        drawings=(
            Drawing("From the side: y to the right, z upwards", corridor_view(source.result, (1, 2), (1.0, 1.0))),
            Drawing("From above: x to the right, y upwards (backwards)", corridor_view(source.result, (0, 1), (1.0, 1.0))),
        ),
        head=("At", "Tip (x, y, z), mm", "α, °", "β (roll), °", "γ, °"),
        rows=tuple(rows),
        note="α and γ are the angles of the text: of +y to the shaver's projections on the planes xOy and yOz.",
    )  # fmt: skip


def _scene_line(result: Mapping[str, Any]) -> str:
    drawn = "Nasal cavity as glass, structures to keep clear of in their colours, every voxel of the entry region."
    if result["path"] is None:
        return drawn
    return drawn + (
        " The instrument stands with its tip at the cursor: drag along the charts. The line from the endoscope is its direction "
        "of view; the ring marks where the distance is least. Shafts are cut outside the nose."
    )


def _scene_legend(result: Mapping[str, Any], head: NasalScene) -> tuple[tuple[str, str], ...]:
    counts = result["details"]["entry"]["counts"]
    groups = (
        ("start with a path", counts["feasible"], "var(--holds)"),
        ("start without", counts["starts"] - counts["feasible"], "var(--ink-3)"),
    )
    tools = (("endoscope", "var(--run-4)"), ("shaver", "var(--ink-3)")) if result["path"] is not None else ()
    starts = tuple((f"{name} ({count})", color) for name, count, color in groups if count)
    return (*_legend(list(head.structures)), *starts, *tools)


def _choices(source: Source) -> Part | None:
    details = source.result["details"]
    if not details.get("best"):
        return None
    rows = []
    for choice in details["best"].values():
        key = f"details.candidates.{choice['path']}"
        bends = len(details["candidates"][choice["path"]]["nodes_mm"]) - 2
        cells = [
            or_dash(source.figure(f"{key}.{name}", digits))
            for name, digits in (
                ("brain_mm", 2), ("orbit_mm", 2), ("septum_mm", 2), ("turbinate_mm", 2), ("length_mm", 1), ("tissue_voxels", 0),
                ("roll_deg", 1), ("score", 3),
            )
        ]  # fmt: skip
        rows.append((phrase(str(choice["name"])), *cells, phrase(str(bends))))
    return Part(
        id="choices",
        title="Four best paths",
        line="Each is the best in its own goal; ties are settled by the weighted sum of the rest.",
        head=(
            "Path",
            "Brain, mm",
            "Orbit, mm",
            "Septum, mm",
            "Turbinate, mm",
            "Length, mm",
            "Tissue, voxels",
            "Roll, °",
            "F",
            "Bends",
        ),
        rows=tuple(rows),
        note="F is the weighted sum of the goals on 0 (best of all paths) to 1 (worst). Weights: "
        + ", ".join(f"{name} {value:.3g}" for name, value in details["weights"].items())
        + ". Tissue counts soft-tissue and bone voxels inside the channel between start and lesion.",
    )


def _goals(source: Source) -> Part | None:
    details = source.result["details"]
    rows = details.get("candidates") or ()
    if len(rows) < 2:
        return None
    kept = sum(row["pareto"] for row in rows)
    return Part(
        id="pareto",
        title="Pareto set",
        line=f"All {len(rows)} ranked paths, each a line through its goals (0, below: the best of all). {kept} of them, dark, "
        "are beaten by no other in every goal; the four best are drawn bold.",
        drawings=(Drawing("Goals of every path, normalised", goals_chart(details)),),
    )


def _shrinkage(source: Source) -> Part:
    rows = []
    for k, row in enumerate(source.result["details"]["shrinkage"]):
        key = f"details.shrinkage.{k}"
        name = f"{100 * row['amount']:.0f} %" + (" (planned)" if row["planned"] else "")
        verdict = "feasible" if row["feasible_starts"] else "no way in"
        cells = (source.need(f"{key}.{n}", d) for n, d in (("feasible_starts", 0), ("septum_mm", 2), ("turbinate_mm", 2)))
        rows.append((phrase(name), phrase(verdict), *(phrase(cell) for cell in cells)))
    return Part(
        id="shrinkage",
        title="Shrinkage of the mucosa",
        line="Verdict with the mucosa as it is, half and fully shrunk; displacement is the greatest of the simulation.",
        head=("Shrunk", "Verdict", "Feasible voxels", "Septum moved, mm", "Turbinate moved, mm"),
        rows=tuple(rows),
    )


def _labels(source: Source) -> Part:
    rows = []
    for k, row in enumerate(source.result["details"]["labels"]):
        key = f"details.labels.{k}"
        volume, trust = source.need(f"{key}.volume_ml", 2), source.need(f"{key}.confidence", 2)
        rows.append((phrase(row["name"].replace("_", " ")), phrase(row["origin"]), phrase(trust), phrase(volume)))
    return Part(
        id="structures",
        title="Structures",
        line="Proposed from the CT, or brought as a mask, seed or box. Look at the pictures before you trust a proposal.",
        head=("Structure", "Origin", "Confidence, 0 to 1", "Volume, ml"),
        rows=tuple(rows),
        note="A structure can be replaced by --mask NAME=FILE and corrected by --seed or --box.",
    )


__all__ = ["RigidPage", "make_rigid_page"]
