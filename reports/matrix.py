"""The page of instruments against targets: from matrix.json to what the page prints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.folds import Fact, Fold
from reports.numbers import Figure, Phrase, Source, phrase, printed, sentence
from reports.still import Label, choose_view, still_picture
from reports.wall import light_mesh
from segmentation.mesh import Surface
from tubeplan_viz.result import digits_apart, part_words

ICONS = {"feasible": "yes", "flagged": "flag", "impossible": "no"}
WORDS = {"feasible": "Holds", "flagged": "Flagged", "impossible": "Impossible"}
TITLES = {"ok": "Every instrument reaches every target", "infeasible": "No instrument reaches any target"}
CEILING_PLACES = {"start": "at the start itself", "goal": "at the target itself"}
# Both columns of labels beside the still picture hold so many.
MOST_LABELS = 30
# A way left to the target of so many mm is told without decimals.
LONG_WAY = 100.0
PARTS = {"shaft": "", "tip": "rigid tip", "ceiling": "at most", "bend": "bend too sharp"}


@dataclass(frozen=True)
class CellView:
    """One cell as printed: sign, margin, and a line below it."""

    verdict: str
    icon: str
    word: str
    margin: Figure | None
    more: Phrase
    reason: str


@dataclass(frozen=True)
class RowView:
    """One instrument with its cells."""

    name: str
    about: Phrase
    reached: int
    cells: tuple[CellView, ...]


@dataclass(frozen=True)
class Hindrance:
    """What stands in the way of one instrument at one target."""

    verdict: str
    icon: str
    instrument: str
    target: str
    reason: str


@dataclass(frozen=True)
class TargetView:
    """One target as printed."""

    label: str
    name: str
    position: Phrase
    way: Phrase
    ceiling: Phrase
    place: str
    widest: str


@dataclass(frozen=True)
class MatrixPage:
    """What the template prints, in its order."""

    title: str
    heading: str
    lead: Phrase
    case_id: str
    frame: str
    status: str
    counts: tuple[tuple[str, str, Figure], ...]
    warnings: tuple[str, ...]
    labels: tuple[tuple[str, str], ...]
    rows: tuple[RowView, ...]
    rule: str
    still: Markup
    targets: tuple[TargetView, ...]
    hindrances: tuple[Hindrance, ...]
    folds: tuple[Fold, ...]
    document: Mapping[str, Any]


def make_matrix_page(document: Mapping[str, Any], surface: Surface) -> MatrixPage:
    """Everything that the page of one matrix shows; `document` is the content of matrix.json."""
    source = Source(document)
    labels = tuple((str(target["label"]), part_words(target["label"], target["name"])) for target in document["targets"])
    rows = tuple(_row(source, i) for i in range(len(document["instruments"])))
    counts = document["counts"]
    total = sum(counts.values())
    best = max(rows, key=lambda row: row.reached)
    heading = TITLES.get(str(document["status"]), f"{counts['feasible']} of {total} combinations hold")
    said: list[str] = [f"{len(rows)} instruments against {len(labels)} targets"]
    if 0 < best.reached < len(labels):
        said.append(f"most targets are reached by {best.name}: {best.reached} of {len(labels)}")
    elif best.reached == len(labels):
        all_there = [i for i, row in enumerate(rows) if row.reached == len(labels)]
        thickest = max(all_there, key=lambda i: float(document["instruments"][i]["outer_diameter_mm"]))
        said.append(f"{len(all_there)} of them {'reaches' if len(all_there) == 1 else 'reach'} every target")
        if len(all_there) > 1:
            said[-1] += f", the thickest of these is {rows[thickest].name}"
    return MatrixPage(
        title=f"Instruments: case {document['case_id']}",
        heading=heading,
        lead=phrase("; ".join(said) + "."),
        case_id=str(document["case_id"]),
        frame=str(document["frame"]),
        status=str(document["status"]),
        counts=tuple((ICONS[name], WORDS[name], source.need(f"counts.{name}", 0)) for name in ICONS),
        warnings=tuple(sentence(str(text)) for text in document["warnings"]),
        labels=labels,
        rows=rows,
        rule=str(document["rule"]),
        still=_still(document, surface),
        targets=tuple(_target(source, rows, j) for j in range(len(labels))),
        hindrances=_hindrances(document),
        folds=(_catalogue(source), _provenance(document)),
        document={key: document[key] for key in document if key != "paths"},
    )


def _row(source: Source, i: int) -> RowView:
    document = source.result
    cells = tuple(_cell(source, i, j) for j in range(len(document["targets"])))
    key = f"instruments.{i}"
    return RowView(
        name=str(document["instruments"][i]["name"]),
        about=phrase(
            "⌀ ",
            source.need(f"{key}.outer_diameter_mm", 2, "mm"),
            ", bend ≥ ",
            source.need(f"{key}.bend_radius_min_mm", 1, "mm"),
            ", tip ",
            source.need(f"{key}.rigid_tip_mm", 0, "mm"),
        ),
        reached=sum(cell.verdict == "feasible" for cell in cells),
        cells=cells,
    )


def _cell(source: Source, i: int, j: int) -> CellView:
    cell, key = source.result["cells"][i][j], f"cells.{i}.{j}"
    bend = source.figure(f"{key}.bend_radius_mm", 1, "mm")
    part = PARTS.get(cell["margin_of"] or "", "")
    if bend is not None and bend.value < 1000.0:
        more = phrase("bend ", bend, f", {part}" if part else "")
    else:
        more = phrase(part or ("straight" if bend is not None else "no path"))
    short = source.value(f"{key}.short_mm")
    if short is not None:
        more = phrase(source.need(f"{key}.short_mm", 1 if short < LONG_WAY else 0, "mm"), " short")
    elif cell["verdict"] != "feasible" and source.result["paths"][j]:
        more = phrase("not past the start")
    return CellView(
        verdict=cell["verdict"],
        icon=ICONS[cell["verdict"]],
        word=WORDS[cell["verdict"]],
        margin=_margin(source, f"{key}.margin_mm"),
        more=more,
        reason=str(cell["reason"]),
    )


def _margin(source: Source, key: str) -> Figure | None:
    """A margin with as many decimals as tell it from none: what does not fit never shows 0.00."""
    value = source.value(key)
    return None if value is None else source.need(key, digits_apart(value, 0.0, 2), "mm", signed=True)


def _target(source: Source, rows: tuple[RowView, ...], j: int) -> TargetView:
    key = f"targets.{j}"
    target = source.result["targets"][j]
    position = phrase(*(part for k in range(3) for part in ((", " if k else ""), source.need(f"{key}.point_mm.{k}", 1))))
    way = source.figure(f"{key}.way_mm", 1, "mm")
    diameters = source.result["instruments"]
    reached = [i for i, row in enumerate(rows) if row.cells[j].verdict == "feasible"]
    widest = max(reached, key=lambda i: diameters[i]["outer_diameter_mm"], default=None)
    return TargetView(
        label=str(target["label"]),
        name=part_words(target["label"], target["name"]),
        position=position,
        way=phrase(way) if way is not None else phrase("not joined to the start"),
        ceiling=phrase(source.need(f"{key}.ceiling_mm", 2, "mm")),
        place={"start": "at the start", "goal": "at the target"}.get(target["ceiling_end"] or "", "on the way"),
        widest="none" if widest is None else str(diameters[widest]["name"]),
    )


def _hindrances(document: Mapping[str, Any]) -> tuple[Hindrance, ...]:
    """Flagged cells one by one; what proves a target out of reach once, with all instruments that it keeps out."""
    flagged, narrow, sharp, other = [], [], [], []
    for j, target in enumerate(document["targets"]):
        label = " ".join(filter(None, (target["label"], part_words(target["label"], target["name"]))))
        too_thick, too_stiff = [], dict[int, list[Mapping[str, Any]]]()
        for one, row in zip(document["instruments"], document["cells"], strict=True):
            cell = row[j]
            said = Hindrance(cell["verdict"], ICONS[cell["verdict"]], str(one["name"]), label, str(cell["reason"]))
            if cell["verdict"] == "flagged":
                flagged.append(said)
            elif cell["bend"] is not None:
                too_stiff.setdefault(cell["bend"], []).append(one)
            elif cell["verdict"] == "impossible" and one["outer_diameter_mm"] > 2.0 * target["ceiling_mm"]:
                too_thick.append(one)
            elif cell["verdict"] == "impossible":
                other.append(said)
        if too_thick:
            place = CEILING_PLACES.get(target["ceiling_end"] or "", "on every way there")
            left, needed = _apart(target["ceiling_mm"], too_thick)
            why = f"{place} the lumen leaves {left} mm at most, at {_point(target['ceiling_point_mm'])}"
            narrow.append(_kept_out(too_thick, label, why, needed, "thicker"))
        for number, kept_out in too_stiff.items():
            bend = document["bends"][j][number]
            left, needed = _apart(bend["clearance_upper_bound_mm"], kept_out)
            why = (
                f"the bend at {_point(bend['point_mm'])} leaves {left} mm at most "
                f"at a bend radius of {printed(1.0 / bend['curvature_max_per_mm'], 1)} mm or more"
            )
            sharp.append(_kept_out(kept_out, label, why, needed, "more"))
    return (*flagged, *sharp, *narrow, *other)


def _thinnest(instruments: list[Mapping[str, Any]]) -> Mapping[str, Any]:
    return min(instruments, key=lambda one: float(one["outer_diameter_mm"]))


def _apart(left: float, kept_out: list[Mapping[str, Any]]) -> tuple[str, str]:
    """The clearance that is left and the radius of the thinnest that needs more, mm, with decimals that tell them apart."""
    needed = 0.5 * float(_thinnest(kept_out)["outer_diameter_mm"])
    digits = digits_apart(left, needed, 2)
    return printed(left, digits), printed(needed, digits)


def _kept_out(instruments: list[Mapping[str, Any]], label: str, why: str, needed: str, others: str) -> Hindrance:
    """All instruments that one proof keeps from a target, by the name of the thinnest."""
    names = str(_thinnest(instruments)["name"]) + (f" and {len(instruments) - 1} {others}" if len(instruments) > 1 else "")
    required = f"{needed} mm{' or more' if len(instruments) > 1 else ''} are required"
    return Hindrance("impossible", ICONS["impossible"], names, label, f"proved: {why}; {required}")


def _point(point: list[float]) -> str:
    return f"({', '.join(printed(v, 1) for v in point)}) mm"


def _still(document: Mapping[str, Any], surface: Surface) -> Markup:
    """The tree with the paths of the instrument that reaches most, and the targets by name."""
    labels = [Label(np.asarray(document["start_mm"], float), "Start", "start", 0)]
    reached = [sum(row[j]["verdict"] == "feasible" for row in document["cells"]) for j in range(len(document["targets"]))]
    for j, target in enumerate(document["targets"]):
        text = f"{target['label']}: {reached[j]} of {len(document['cells'])}"
        labels.append(Label(np.asarray(target["point_mm"], float), text, "goal" if reached[j] else "clearance", 1 + j))
    lines = []
    for j, paths in enumerate(document["paths"]):
        shown = next((row[j]["path"] for row in document["cells"] if row[j]["path"] is not None), None)
        if shown is not None:
            lines.append(("still-path", np.asarray(paths[shown]["points_mm"], float)))
    mesh = light_mesh(surface)
    targets = np.mean([target["point_mm"] for target in document["targets"]], axis=0)
    view = choose_view(np.vstack([document["start_mm"], mesh.vertices, targets]), str(document["frame"]))
    words = f"The wall of the lumen with the start, {len(document['targets'])} targets and a path to each that has one."
    return still_picture(mesh, np.empty((0, 3)), (), tuple(labels), view, words, lines=tuple(lines), most=MOST_LABELS)


def _catalogue(source: Source) -> Fold:
    rows = []
    for i, one in enumerate(source.result["instruments"]):
        key = f"instruments.{i}"
        rows.append(
            (
                phrase(source.need(f"{key}.outer_diameter_mm", 2)),
                phrase(source.need(f"{key}.bend_radius_min_mm", 1)),
                phrase(source.need(f"{key}.rigid_tip_mm", 1)),
                phrase(source.need(f"{key}.working_length_mm", 0)),
                phrase(str(one["name"])),
                phrase(str(one["source"]) or "no source given"),
            )
        )
    head = ("Diameter, mm", "Bend radius, mm", "Rigid tip, mm", "Length, mm", "Instrument", "Source")
    return Fold("Catalogue", phrase("values of the instruments and where they come from"), head=head, rows=tuple(rows), figures=4)


def _provenance(document: Mapping[str, Any]) -> Fold:
    provenance = document["provenance"]
    facts = [
        Fact("Software", phrase(f"{provenance['software']} {provenance['version']}")),
        Fact("Platform", phrase(str(provenance["platform"]))),
        Fact("Made", phrase(str(provenance["created_utc"]).replace("T", " ").removesuffix("Z") + " UTC")),
        Fact("Method", phrase(str(document["method"])), code=True),
        Fact("Used up before the start", phrase(f"{document['before_start_mm']:g} mm")),
        *(Fact("Input", phrase(f"{item['name']}, SHA-256 {item['sha256']}"), code=True) for item in provenance["inputs"]),
        Fact("Frame", phrase("patient LPS, mm" if document["frame"] == "LPS" else "axes of the mesh file, mm")),
    ]
    return Fold("Provenance", phrase("software, inputs, frame"), tuple(facts))


__all__ = ["MatrixPage", "make_matrix_page"]
