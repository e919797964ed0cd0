"""The page of a reach map: which branches of an airway the robot reaches, and what keeps it out of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.folds import Fold, folds
from reports.numbers import Phrase, Source, phrase, sentence, typeset
from reports.parts import Key, PlanPage, with_article
from reports.still import Label, choose_view, still_picture
from reports.tables import or_dash
from reports.wall import light_mesh
from segmentation.arrays import FloatArray
from segmentation.mesh import Surface

# Verdict of a branch -> icon, word, class of the line beyond what is reached.
VERDICTS = {
    "reached": ("yes", "Reached", "still-path"),
    "diameter": ("no", "Too narrow", "still-flag curvature"),
    "bend": ("flag", "No way found: bend", "still-flag clearance"),
    "collision": ("flag", "No way found: wall", "still-flag clearance"),
}
WORDS = {"ok": "All reached", "flagged": "Partly reached", "infeasible": "None reached"}
UNPROVED = ("bend", "collision")
NAMES_AT_ONCE = 5


@dataclass(frozen=True)
class Column:
    """One column of figures; a page on a phone leaves those out that have `wide`."""

    name: str
    key: str
    digits: int
    wide: bool = False


COLUMNS = (
    Column("Reached, mm", "depth_mm", 1),
    Column("Length, mm", "length_mm", 1),
    Column("⌀, mm", "diameter_mm", 1, wide=True),
    Column("Least ⌀, mm", "least_diameter_mm", 1),
    Column("Turn, °", "turn_deg", 0, wide=True),
    Column("Gen.", "generation", 0, wide=True),
    Column("Sure", "confidence", 2, wide=True),
)


@dataclass(frozen=True)
class BranchRow:
    """One branch as printed; `why` is empty where it is reached."""

    name: str
    icon: str
    word: str
    why: str
    figures: tuple[Phrase, ...]


@dataclass(frozen=True)
class ReachPage(PlanPage):
    """What the template prints after the head, in its order."""

    legend: tuple[tuple[str, str], ...]
    still: Markup
    columns: tuple[Column, ...]
    rows: tuple[BranchRow, ...]
    rule: str
    folds: tuple[Fold, ...]


def make_reach_page(document: Mapping[str, Any], surface: Surface) -> ReachPage:
    """Everything that the page of a reach map shows; `document` is the content of reach.json."""
    source = Source(document)
    counts, branches = document["counts"], document["branches"]
    unproved = sum(counts[name] for name in UNPROVED)
    status = "ok" if counts["reached"] == len(branches) else "flagged" if counts["reached"] else "infeasible"
    return ReachPage(
        title=f"Reach: case {document['case_id']}",
        case_id=str(document["case_id"]),
        status=status,
        word=WORDS[status],
        line=f"Reach map of the bronchoscope robot, {document['method']} plans to every branch",
        headline=phrase(_headline(counts["reached"], len(branches))),
        lead=phrase(_lead(document)),
        warnings=tuple(sentence(str(text)) for text in document["warnings"]),
        keys=_keys(source),
        legend=tuple(
            (kind, words)
            for kind, words, there in (
                ("narrow", "beyond it, proved too narrow", counts["diameter"]),
                ("unproved", "beyond it, no way found", unproved),
            )
            if there
        ),
        still=_still(document, surface),
        columns=COLUMNS,
        rows=tuple(_row(source, k) for k in range(len(branches))),
        rule=str(document["rule"]),
        folds=folds(source, ()),
    )


def _headline(reached: int, total: int) -> str:
    if reached == total:
        return f"The robot reaches {'the branch' if total == 1 else f'all {total} branches'}"
    return f"The robot reaches {reached or 'none'} of {total} branch{'es' if total > 1 else ''}"


def _lead(document: Mapping[str, Any]) -> str:
    """The branches that are not reached, by name, with what keeps the robot out."""
    said = []
    for verdicts, one, many in (
        (("diameter",), "is proved too narrow", "are proved too narrow"),
        (UNPROVED, "is wide enough, but no way was found", "are wide enough, but no way was found"),
    ):
        names = [str(row["name"]) for row in document["branches"] if row["verdict"] in verdicts]
        if names:
            said.append(f"{_listed(names)} {one if len(names) == 1 else many}")
    text = "; ".join(said)
    return f"{text[:1].upper()}{text[1:]}." if text else "A way into every branch was found; none is too narrow."


def _listed(names: Sequence[str]) -> str:
    """Some names in a sentence, and how many more there are."""
    shown, rest = list(names[:NAMES_AT_ONCE]), len(names) - NAMES_AT_ONCE
    if rest > 0:
        return f"{', '.join(shown)} and {rest} more"
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


def _keys(source: Source) -> tuple[Key, ...]:
    """How many are reached, what keeps the robot out by most, and the robot."""
    branches = source.result["branches"]
    ends = [row for row in branches if row["leaf"]]
    tips = sum(row["verdict"] == "reached" for row in ends)
    made = [
        Key(
            "Reached",
            phrase(source.need("counts.reached", 0), f" of {len(branches)}"),
            phrase(f"branches; {tips} of the {len(ends)} outermost ones"),
            "holds" if tips else "never",
        )
    ]
    narrow = [(row["clearance_bound_mm"], k) for k, row in enumerate(branches) if row["verdict"] == "diameter"]
    if narrow:
        k = min(narrow)[1]
        needed = source.need("provenance.settings.limits.clearance_min", 2, "mm")
        where = f", the robot's radius, on the way into {with_article(branches[k]['name'])}"
        left = source.need(f"branches.{k}.clearance_bound_mm", 2, "mm")
        made.append(Key("Least room", phrase(left), phrase("to the wall at most, of ", needed, where), "never"))
    blocked = sum(row["verdict"] in UNPROVED for row in branches)
    if blocked:
        more = phrase("wide enough, yet no plan reached them; that none exists is not proved")
        made.append(Key("No way found", phrase(f"{blocked} of {len(branches)}"), more, "clearance"))
    bend = source.need("robot.bend_max_deg", 0, "°")
    lengths = phrase(source.need("robot.active_length_mm", 0, "mm"), " at the tip bend, each of two sections up to ", bend)
    return (*made, Key("Robot", phrase("⌀\u00a0", source.need("robot.diameter_mm", 1, "mm")), lengths))


def _row(source: Source, k: int) -> BranchRow:
    row = source.result["branches"][k]
    icon, word, _ = VERDICTS[row["verdict"]]
    return BranchRow(
        name=row["name"] + (f" ({row['label']})" if row["label"] else ""),
        icon=icon,
        word=word,
        why=typeset(str(row["reason"] or "")),
        figures=tuple(or_dash(source.figure(f"branches.{k}.{column.key}", column.digits)) for column in COLUMNS),
    )


def _still(document: Mapping[str, Any], surface: Surface) -> Markup:
    """The airway with the ways as far as the tip comes, and by name the branches that end there or are refused."""
    labels, lines = [], []
    for k, row in enumerate(document["branches"]):
        kept_out = row["verdict"] != "reached"
        if kept_out or row["leaf"]:
            place = row["deepest_mm"] if row["deepest_mm"] is not None else row["middle_mm"]
            kind = ("curvature" if row["verdict"] == "diameter" else "clearance") if kept_out else "goal"
            labels.append(Label(np.asarray(place, float), row["name"], kind, k + (0 if kept_out else len(document["branches"]))))
        reached, beyond = parted(np.asarray(row["points_mm"], float), float(row["depth_mm"] or 0.0))
        name = VERDICTS[row["verdict"]][2]
        lines += [(kind, line) for kind, line in (("still-path", reached), (name, beyond)) if len(line) > 1]
    mesh = light_mesh(surface)
    # A mesh says not what is up: the entrance is, as of an airway that hangs from its trachea.
    entrance, tips = lines[0][1][:1], np.mean([line[-1] for _, line in lines], axis=0)
    view = choose_view(np.vstack([tips, mesh.vertices, entrance]), str(document["frame"]))
    refused = [str(row["name"]) for row in document["branches"] if row["verdict"] != "reached"]
    words = "The wall of the airway with the way of the robot's tip into every branch."
    words += f" Not reached: {', '.join(refused)}." if refused else ""
    return still_picture(mesh, np.empty((0, 3)), (), labels, view, words, lines=lines)


def parted(points: FloatArray, depth: float) -> tuple[FloatArray, FloatArray]:
    """A line, (n, 3) mm, up to `depth` mm from its beginning and from there on; either may have one point or none."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = float(np.clip(depth, 0.0, arc[-1]))
    here = np.array([[np.interp(at, arc, axis) for axis in points.T]])
    return np.vstack([points[arc < at], here]), np.vstack([here, points[arc > at]])


__all__ = ["ReachPage", "make_reach_page", "parted"]
