"""The page of a cohort: from cohort.json to what the page prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from reports.cohort_charts import KINDS, cohort_charts
from reports.folds import Fact, Fold
from reports.numbers import Figure, Phrase, Source, phrase, sentence
from reports.parts import Drawing
from tubeplan_viz.result import digits_apart

# Status of a case -> icon, word on the page, and how the sentence at the top counts it.
STATUS = {
    "ok": ("yes", "Holds", "hold"),
    "flagged": ("flag", "Flagged", "flagged"),
    "infeasible": ("no", "No path", "without a path"),
    "time_limit": ("no", "Time limit", "not done in time"),
    "bad_input": ("no", "Bad input", "with bad input"),
    "died": ("no", "Died", "died"),
    "fault": ("no", "Fault", "met a fault of the program"),
}
PAGE_STATUS = {0: "ok", 3: "flagged"}
# More rows than fit on a screen scroll below their heading.
ROWS_AT_ONCE = 25


@dataclass(frozen=True)
class Column:
    """One column: `kind` is its class; a page on a phone leaves those out that have `wide`."""

    name: str
    kind: str = ""


@dataclass(frozen=True)
class Cell:
    """What stands in a column, and its class."""

    text: Phrase
    kind: str = ""


@dataclass(frozen=True)
class CaseRow:
    """One case as printed; `rank` puts the gravest last."""

    id: str
    link: str
    status: str
    icon: str
    word: str
    rank: int
    planner: str
    method: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Reason:
    """Cases that ended for the same reason, up to the numbers in it; `cases` are ids with links, if they have a page."""

    icon: str
    status: str
    word: str
    count: Figure
    text: str
    more: str
    cases: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class CohortPage:
    """What the template prints, in its order."""

    title: str
    case_id: str
    status: str
    heading: str
    lead: Phrase
    warnings: tuple[str, ...]
    tally: tuple[tuple[str, str, str, Figure], ...]
    charts: tuple[Drawing, ...]
    planners: tuple[str, ...]
    columns: tuple[Column, ...]
    rows: tuple[CaseRow, ...]
    legend: tuple[tuple[str, str], ...]
    tall: bool
    reasons: tuple[Reason, ...]
    folds: tuple[Fold, ...]
    document: Mapping[str, Any]


def make_cohort_page(document: Mapping[str, Any]) -> CohortPage:
    """Everything that the page of one cohort shows; `document` is the content of cohort.json."""
    source = Source(document)
    cases, counts = document["cases"], document["counts"]
    present = [status for status in STATUS if counts[status]]
    total, held = len(cases), counts["ok"]
    said = [f"{counts[status]} {STATUS[status][2]}" for status in present if status != "ok"]
    checked = [case["verification"] for case in cases if case["verification"] is not None]
    if checked:
        said.append(f"{sum(one['holds'] for one in checked)} of {len(checked)} runs verified by other means")
    name = str(document["provenance"]["manifest"]["name"])
    plural = "case" if total == 1 else "cases"
    return CohortPage(
        title=f"Cohort: {name}",
        case_id=name,
        status=PAGE_STATUS.get(document["exit_status"], "infeasible"),
        heading=f"{'All' if held == total and total > 1 else f'{held} of'} {total} {plural} hold{'s' if total == 1 else ''}",
        lead=phrase(sentence("; ".join(said)) if said else "Every path keeps its limits.", *_worst(source)),
        warnings=_warnings(document),
        tally=tuple((STATUS[s][0], s, STATUS[s][1], source.need(f"counts.{s}", 0)) for s in present),
        charts=cohort_charts(cases),
        planners=tuple(dict.fromkeys(str(case["planner"]) for case in cases)),
        columns=_columns(document),
        rows=tuple(_row(source, k) for k in range(total)),
        legend=_legend(present),
        tall=total > ROWS_AT_ONCE,
        reasons=tuple(_reason(source, k) for k in range(len(document["reasons"]))),
        folds=(_provenance(document),),
        document=document,
    )


def _worst(source: Source) -> tuple[str | Figure, ...]:
    """The least margin of all cases, and whose it is."""
    margins = [(case["margin_mm"], k) for k, case in enumerate(source.result["cases"]) if case["margin_mm"] is not None]
    if not margins:
        return ()
    k = min(margins)[1]
    return (" Worst margin of all: ", _margin(source, k), f" in {source.result['cases'][k]['id']}.")


def _margin(source: Source, k: int) -> Figure:
    """The margin of one case with as many decimals as tell it from none."""
    key = f"cases.{k}.margin_mm"
    return source.need(key, digits_apart(source.need(key, 2).value, 0.0, 2), "mm", signed=True)


def _legend(present: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Class and word of each colour that the charts can have."""
    runs = [(KINDS[status][0], KINDS[status][1]) for status in present if status in KINDS]
    return (*runs, *([("other", "no verdict")] if any(status not in KINDS for status in present) else []))


def _warnings(document: Mapping[str, Any]) -> tuple[str, ...]:
    others = document["others"]
    if not others:
        return ()
    word = "folder is" if len(others) == 1 else "folders are"
    return (f"{len(others)} run {word} here that the manifest does not name, and not counted: {', '.join(others)}.",)


def _columns(document: Mapping[str, Any]) -> tuple[Column, ...]:
    made = [Column("Worst margin", "num"), Column("Clearance, limit", "num wide"), Column("Curvature, limit", "num wide")]
    made += [Column("Length", "num wide"), Column("Time", "num wide"), Column("Memory", "num wide")]
    return (*made, *([Column("Verified", "wide")] if _verified(document) else []))


def _verified(document: Mapping[str, Any]) -> bool:
    return any(case["verification"] is not None for case in document["cases"])


def _row(source: Source, k: int) -> CaseRow:
    case, key = source.result["cases"][k], f"cases.{k}"
    icon, word, _ = STATUS[case["status"]]
    margin = None if case["margin_mm"] is None else _margin(source, k)
    memory = source.figure(f"{key}.peak_memory_mb", 0, "MB")
    cells = [
        Cell(
            phrase(margin) if margin else phrase("–"),
            "num" + (" bad-clearance" if margin and margin.value < 0.0 and icon != "yes" else ""),
        ),
        Cell(_limited(source, f"{key}.metrics.clearance_min_mm", f"{key}.limits.clearance_min_mm", 2, "mm"), "num wide"),
        Cell(
            _limited(source, f"{key}.metrics.curvature_max_per_mm", f"{key}.limits.curvature_max_per_mm", 4, "1/mm"), "num wide"
        ),
        Cell(phrase(source.figure(f"{key}.metrics.length_mm", 1, "mm") or "–"), "num wide"),
        Cell(phrase(source.figure(f"{key}.wall_s", 1, "s") or "–"), "num wide"),
        Cell(phrase(memory or "–"), "num wide"),
    ]
    if _verified(source.result):
        checked = case["verification"]
        failed = [] if checked is None else [str(check["name"]) for check in checked["failed"]]
        text = "–" if checked is None else "holds" if checked["holds"] else f"fails: {', '.join(failed)}"
        cells.append(Cell(phrase(text), "wide" + (" bad-curvature" if failed else "")))
    return CaseRow(
        id=str(case["id"]),
        link=_link(case),
        status=str(case["status"]),
        icon=icon,
        word=word,
        rank=list(STATUS).index(case["status"]),
        planner=str(case["planner"]),
        method=str(case["method"]),
        cells=tuple(cells),
    )


def _link(case: Mapping[str, Any]) -> str:
    """The page of a case, beside this one; nothing where it has none."""
    return f"{case['folder']}/report.html" if case["folder"] is not None and case["has_report"] else ""


def _limited(source: Source, key: str, limit_key: str, digits: int, unit: str) -> Phrase:
    """A figure with its limit behind it, with as many decimals as tell them apart."""
    value, limit = source.value(key), source.value(limit_key)
    if value is None:
        return phrase("–")
    if limit is not None:
        digits = digits_apart(value, limit, digits)
    return phrase(source.need(key, digits), ", ", source.figure(limit_key, digits) or "no limit", f" {unit}")


def _reason(source: Source, k: int) -> Reason:
    found = source.result["reasons"][k]
    by_id = {case["id"]: case for case in source.result["cases"]}
    icon, word, _ = STATUS[found["status"]]
    alike = len(found["cases"]) > 1 and not found["same"]
    return Reason(
        icon=icon,
        status=str(found["status"]),
        word=word,
        count=source.need(f"reasons.{k}.count", 0),
        text=_told(str(found["reason"])),
        more=f"as {found['cases'][0]} says it; the others differ in their numbers" if alike else "",
        cases=tuple((str(one), _link(by_id[one])) for one in found["cases"]),
    )


def _told(reason: str) -> str:
    """A reason as a sentence; a file's name at its beginning keeps its letters."""
    text = sentence(reason)
    return reason[:1] + text[1:] if reason.partition(" ")[0].endswith(":") else text


def _provenance(document: Mapping[str, Any]) -> Fold:
    made, last = document["provenance"], document["pass"]
    facts = (
        Fact("Software", phrase(f"{made['software']} {made['version']}")),
        Fact("Platform", phrase(str(made["platform"]))),
        Fact("Made", phrase(str(made["created_utc"]).replace("T", " ").removesuffix("Z") + " UTC")),
        Fact("Manifest", phrase(f"{made['manifest']['name']}, SHA-256 {made['manifest']['sha256']}"), code=True),
        Fact("Seed of the cohort", phrase("none was given" if made["rng_seed"] is None else str(made["rng_seed"]))),
        Fact("Last call", phrase(f"{last['done']} cases done, {last['kept']} kept from before, on {_where(last)}")),
    )
    return Fold("Provenance", phrase("software, manifest, seed"), facts)


def _where(last: Mapping[str, Any]) -> str:
    return "a cluster" if last["cluster"] else "this machine"
