"""What is read once, one fold each: numbers behind the charts, proof, ends, settings, time, provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from reports.numbers import Figure, Phrase, Source, phrase
from reports.tables import DASH, or_dash
from reports.words import part_at

PLACES_LISTED = 25
HANDLED_DETAILS = {
    "surface",
    "growth",
    "endpoints",
    "centerline_radius_min",
    "features_before",
    "parts",
    "start_label",
    "goal_label",
    "warnings",
    "anatomy",
    "instrument",
    "matrix",
    "case_id",
    "closed_ends",
    "hu_min",
    "hu_max",
    "image",
    "feature_scans",
}


@dataclass(frozen=True)
class Fact:
    """A term and its value; `code` prints it in the fixed-width face."""

    term: str
    value: Phrase
    code: bool = False


@dataclass(frozen=True)
class Bar:
    """One stage of the run with its share of the longest."""

    name: str
    percent: float
    value: Phrase


@dataclass(frozen=True)
class Fold:
    """A part of the details that opens on demand; `figures` says how many columns, from the left, hold numbers."""

    title: str
    hint: Phrase
    facts: tuple[Fact, ...] = ()
    bars: tuple[Bar, ...] = ()
    head: tuple[str, ...] = ()
    rows: tuple[tuple[Phrase, ...], ...] = ()
    figures: int = 0


def numbers_behind(source: Source, parts: Sequence[Mapping[str, Any]]) -> Fold | None:
    """The charts as a table: places evenly along the path, and every worst place."""
    path = source.result.get("path") or {}
    arc = np.asarray(path.get("s_mm") or [], float)
    if len(arc) < 2:
        return None
    wanted = [
        *np.linspace(0.0, arc[-1], PLACES_LISTED),
        *(flag["worst_at_mm"] for flag in source.result.get("flagged_intervals") or []),
    ]
    wanted += [
        value
        for key in ("derived:clearance_min_at_mm", "derived:curvature_max_at_mm")
        if (value := source.value(key)) is not None
    ]
    rows = [
        (
            phrase(source.need(f"path.s_mm.{k}", 1)),
            or_dash(source.figure(f"path.clearance_mm.{k}", 3)),
            or_dash(source.figure(f"path.curvature_per_mm.{k}", 4)),
            phrase(part_at(parts, float(arc[k]))),
        )
        for k in sorted({int(np.abs(arc - at).argmin()) for at in wanted})
    ]
    head = ("Arc length, mm", "Clearance, mm", "Curvature, 1/mm", "Part")
    if not parts:
        head, rows = head[:3], [row[:3] for row in rows]  # type: ignore[misc,assignment]
    return Fold(
        "Numbers behind the charts", phrase("clearance and curvature along the path"), head=head, rows=tuple(rows), figures=3
    )


def folds(source: Source, parts: Sequence[Mapping[str, Any]]) -> tuple[Fold, ...]:
    """Everything that is read once: proof, numbers, ends, settings, time, provenance."""
    made = (
        numbers_behind(source, parts),
        _proof(source),
        _ends(source),
        _own_details(source),
        _settings(source),
        _time(source),
        _provenance(source),
    )
    return tuple(fold for fold in made if fold is not None)


def _proof(source: Source) -> Fold | None:
    certificate = source.result.get("certificate") or {}
    if not certificate:
        return None
    facts = [Fact("Limits proved", phrase("yes, for every point of the path" if certificate.get("holds") else "no"))]
    if (bound := source.figure("certificate.clearance_lower_bound_mm", 4, "mm")) is not None:
        facts.append(Fact("Clearance", phrase("at least ", bound, " everywhere")))
    if (bound := source.figure("certificate.curvature_upper_bound_per_mm", 5, "1/mm")) is not None:
        facts.append(Fact("Curvature", phrase("at most ", bound, " everywhere")))
    if certificate.get("method"):
        facts.append(Fact("Method", phrase(str(certificate["method"]))))
    return Fold("Proof", phrase("bounds that hold between the samples"), tuple(facts))


def _point(source: Source, key: str) -> Phrase:
    figures = [source.figure(f"{key}.{axis}", 1) for axis in range(3)]
    return phrase(*(part for k, figure in enumerate(figures) for part in ((", " if k else ""), figure))) if all(figures) else DASH


def _ends(source: Source) -> Fold | None:
    details = source.result.get("details") or {}
    facts = []
    for k, end in enumerate(details.get("endpoints") or []):
        key = f"details.endpoints.{k}"
        sure = source.figure(f"{key}.confidence", 2)
        radius = source.figure(f"{key}.radius_mm", 1, "mm")
        value = phrase(_point(source, f"{key}.point_mm"), "\u00a0mm")
        value = phrase(value, *((", radius ", radius) if radius else ()), *((", confidence ", sure) if sure else ()))
        facts.append(Fact(str(end.get("label", f"End {k + 1}")), value))
    for k, cap in enumerate((details.get("surface") or {}).get("caps") or []):
        key = f"details.surface.caps.{k}"
        area = source.figure(f"{key}.area_mm2", 1, "mm²")
        value = phrase(
            str(cap.get("origin", "")), " at ", _point(source, f"{key}.center_mm"), "\u00a0mm", *((", ", area) if area else ())
        )
        facts.append(Fact(f"Cap {cap.get('label', k + 1)}", phrase(value, ", not counted as wall")))
    if details.get("closed_ends"):
        facts.append(Fact("Caps", phrase("counted as wall")))
    return Fold("Ends of the lumen", phrase("end points proposed, and caps that are not wall"), tuple(facts)) if facts else None


def _own_details(source: Source) -> Fold | None:
    """Single figures and words that a planner adds of its own."""
    facts = []
    for name, value in (source.result.get("details") or {}).items():
        label = name.replace("_", " ")
        if name in HANDLED_DETAILS or isinstance(value, bool) or value is None:
            continue
        if isinstance(value, (int, float)):
            facts.append(
                Fact(label[:1].upper() + label[1:], phrase(source.need(f"details.{name}", 0 if isinstance(value, int) else 4)))
            )
        elif isinstance(value, str):
            facts.append(Fact(label[:1].upper() + label[1:], phrase(value)))
    return Fold("Planner's own figures", phrase("as the planner reports them"), tuple(facts)) if facts else None


def _settings(source: Source) -> Fold | None:
    settings = (source.result.get("provenance") or {}).get("settings") or {}
    flat = list(_flatten(settings, ""))
    facts = tuple(Fact(name, phrase(value), code=True) for name, value in flat)
    planner = source.result.get("planner") or {}
    about = tuple(
        Fact(word, phrase(str(planner[key])), code=True)
        for key, word in (("name", "planner"), ("method", "method"), ("version", "version"))
        if planner.get(key)
    )
    return Fold("Settings", phrase("every default resolved, as in case.toml"), about + facts) if about + facts else None


def _flatten(value: Any, name: str) -> list[tuple[str, str]]:
    if isinstance(value, Mapping):
        return [pair for key, inner in value.items() for pair in _flatten(inner, f"{name}.{key}" if name else str(key))]
    if isinstance(value, (list, tuple)) and any(isinstance(item, Mapping) for item in value):
        return [pair for k, item in enumerate(value) for pair in _flatten(item, f"{name} {k + 1}")]
    if isinstance(value, (list, tuple)):
        return [(name, ", ".join(_plain(item) for item in value))]
    return [(name, _plain(value))]


def _plain(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value).replace("-", "\u2212", 1) if isinstance(value, (int, float)) and value < 0 else str(value)


def _time(source: Source) -> Fold | None:
    timings = source.result.get("timings_s") or {}
    total = source.figure("derived:time_s", 2, "s")
    if not timings or total is None:
        return None
    longest = max(*timings.values(), 1e-9) if len(timings) > 1 else max(next(iter(timings.values())), 1e-9)
    bars = tuple(
        Bar(
            name.replace("_", " "),
            round(100.0 * seconds / longest, 1),
            phrase(Figure(f"timings_s.{name}", seconds, 2 if seconds >= 0.01 else 4, "s")),
        )
        for name, seconds in timings.items()
    )
    return Fold("Time", phrase(total, " in all"), bars=bars)


def _provenance(source: Source) -> Fold | None:
    provenance = source.result.get("provenance") or {}
    if not provenance:
        return None
    facts = [Fact("Software", phrase(f"{provenance.get('software', 'tubeplan')} {provenance.get('version', '')}".strip()))]
    if provenance.get("platform"):
        facts.append(Fact("Platform", phrase(str(provenance["platform"]))))
    if provenance.get("created_utc"):
        facts.append(
            Fact(
                "Made", phrase(f"{provenance['created_utc']}".replace("T", " ").replace("+00:00", "").removesuffix("Z") + " UTC")
            )
        )
    facts += [
        Fact("Input", phrase(f"{item.get('name', '')}, SHA-256 {item.get('sha256', '')}"), code=True)
        for item in provenance.get("inputs") or []
    ]
    padding = ((source.result.get("details") or {}).get("image") or {}).get("Padding")
    if padding:
        facts.append(Fact("Padding", phrase(str(padding))))
    facts.append(Fact("Frame", phrase("patient LPS, mm" if source.result.get("frame") == "LPS" else "axes of the mesh file, mm")))
    if provenance.get("rng_seed") is not None:
        facts.append(Fact("Random seed", phrase(str(provenance["rng_seed"]))))
    facts.append(Fact("Identifiers", phrase("kept on request" if provenance.get("identifiers_kept") else "none kept")))
    return Fold("Provenance", phrase("software, inputs, frame"), tuple(facts))
