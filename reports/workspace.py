"""The part of the page in which scene, charts and CT share one cursor, and the two critical places."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.figures import (
    LEFT,
    RIGHT,
    WIDTHS,
    Axis,
    Profile,
    Steps,
    Width,
    frame,
    growth_chart,
    in_all_widths,
    path_axis,
    profile_chart,
    step_chart,
    strip_chart,
    tag,
)
from reports.numbers import Phrase, Source, phrase, printed
from reports.slices import FIELD_MM, Window, cut, png, straightened
from reports.wall import parallel_frames, rims
from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from segmentation.volume import Volume

STRIP_PIECES = 125
PLANES = (
    ("axial", "Axial", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("R", "L", "A", "P")),
    ("coronal", "Coronal", (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), ("R", "L", "S", "I")),
    ("sagittal", "Sagittal", (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), ("A", "P", "S", "I")),
)


@dataclass(frozen=True, eq=False)
class Course:
    """The planned path and the wall around it, as arrays.

    Attributes
    ----------
    arc, curvature, clearance : (n,) float array
    points : (n, 3) float array, mm
    places : (k,) int array
        Indices at which `rims` and the frames are given.
    rims : (k, d) float array or None, mm
        Distance to the wall in each direction across the path.
    normal, binormal : (k, 3) float array
    """

    arc: FloatArray
    points: FloatArray
    curvature: FloatArray
    clearance: FloatArray | None
    places: Any
    rims: FloatArray | None
    normal: FloatArray
    binormal: FloatArray

    def index_at(self, arc_length: float) -> int:
        """The sample nearest to an arc length."""
        return int(np.abs(self.arc - arc_length).argmin())

    def place_at(self, index: int) -> int:
        """The place with wall and frame nearest to a sample."""
        return int(np.abs(self.places - index).argmin())


def roominess(course: Course, limit: float | None) -> tuple[tuple[float, float], FloatArray]:
    """Clearance drawn as tight and as roomy, mm, and the share between them at each sample."""
    assert course.clearance is not None  # callers ask only where there is a wall
    tight = limit if limit else float(course.clearance.min())
    roomy = tight + max(0.7 * tight, 0.3 * float(np.median(course.clearance)), 0.2)
    return (tight, roomy), np.clip((course.clearance - tight) / (roomy - tight), 0.0, 1.0)


def strip(course: Course, source: Source, parts: Sequence[Mapping[str, Any]]) -> Markup:
    """The whole path as one bar."""
    flags = source.result.get("flagged_intervals") or []
    length = float(course.arc[-1])
    middle = (np.arange(STRIP_PIECES) + 0.5) * length / STRIP_PIECES
    if course.clearance is None:
        shares = np.full(STRIP_PIECES, 0.5)
    else:
        shares = np.interp(middle, course.arc, roominess(course, source.value("limits.clearance_min_mm"))[1])
    words = f"The whole path, {printed(length, 1)} mm. " + (
        "; ".join(
            f"{'clearance short' if f['kind'] == 'clearance' else 'bend too sharp'} from {printed(f['from_mm'], 1)} to {printed(f['to_mm'], 1)} mm"
            for f in flags[:10]
        )
        or "No stretch is flagged"
    )
    return in_all_widths(lambda width: strip_chart(length, shares, flags, parts, words, width))


def profiles(course: Course, source: Source, first: Mapping[str, Any]) -> dict[str, Markup]:
    """The charts of clearance and curvature over arc length, those that apply."""
    flags = source.result.get("flagged_intervals") or []
    before_arc = np.asarray(first["s_mm"], float) if first.get("s_mm") else None
    charts: dict[str, Markup] = {}
    asked, allowed = source.value("limits.clearance_min_mm"), source.value("limits.curvature_max_per_mm")
    for kind, values, limit in (("clearance", course.clearance, asked), ("curvature", course.curvature, allowed)):
        if values is None:
            continue
        mine = [flag for flag in flags if flag["kind"] == kind]
        before = first.get(f"{kind}_{'mm' if kind == 'clearance' else 'per_mm'}")
        made = _profile(kind, course.arc, values, limit, mine)
        spec = Profile(
            kind=kind, arc=course.arc, values=values, limit=limit, flags=mine, with_axis=kind == "curvature", **made,
            before_arc=before_arc if before else None, before=np.asarray(before, float) if before else None,
        )  # fmt: skip
        charts[kind] = in_all_widths(partial(profile_chart, spec))
    return charts


def _profile(
    kind: str, arc: FloatArray, values: FloatArray, limit: float | None, flags: Sequence[Mapping[str, Any]]
) -> dict[str, str]:
    """Label, limit and worst place of one chart in words."""
    index = int(values.argmin() if kind == "clearance" else values.argmax())
    value, at = float(values[index]), float(arc[index])
    where = "; ".join(f"{printed(f['from_mm'], 1)} to {printed(f['to_mm'], 1)} mm" for f in flags[:10])
    if kind == "clearance":
        label = f"Clearance over arc length. Least {printed(value, 2)} mm at {printed(at, 1)} mm."
        limit_label = short = "" if limit is None else f"least {printed(limit, 2)} mm"
        worst = min((f["worst"] for f in flags), default=value)
        worst_label = f"{printed(worst, 2)} mm"
    else:
        label = f"Curvature over arc length. Largest {printed(value, 4)} 1/mm at {printed(at, 1)} mm."
        limit_label = "" if limit is None else f"at most {printed(limit, 3)} 1/mm (radius {printed(1 / limit, 1)} mm)"
        short = limit_label.partition(" (")[0]
        worst = max((f["worst"] for f in flags), default=value)
        worst_label = f"radius {printed(1 / worst, 1)} mm" if worst > 0 else ""
    state = f" The limit is broken from {where}." if flags else " The limit holds all along." if limit is not None else ""
    return {"label": label + state, "limit_label": limit_label, "short_limit_label": short, "worst_label": worst_label}


def steps(source: Source) -> dict[str, Markup]:
    """Worst curvature and clearance after each iteration; nothing where there was only one."""
    states = source.result.get("iterations") or []
    charts: dict[str, Markup] = {}
    words = {
        "curvature": ("curvature_max_per_mm", "limits.curvature_max_per_mm", "Largest curvature", "at most {} 1/mm", 3),
        "clearance": ("clearance_min_mm", "limits.clearance_min_mm", "Least clearance", "least {} mm", 2),
    }
    for kind, (name, limit_key, title, limit_words, digits) in words.items():
        values = [state.get(name) for state in states]
        if len(values) < 2 or any(value is None for value in values):
            continue
        limit = source.value(limit_key)
        spec = Steps(
            kind=kind, values=np.asarray(values, float), limit=limit,
            limit_label="" if limit is None else limit_words.format(printed(limit, digits)),
            label=f"{title} over {len(values) - 1} iterations: from {printed(values[0], 4)} to {printed(values[-1], 4)}",
        )  # fmt: skip
        charts[kind] = in_all_widths(partial(step_chart, spec))
    return charts


def growth(limits: FloatArray, volumes: FloatArray, chosen: float, leak: float | None, varied: str) -> Markup:
    """Grown volume against the varied limit."""
    side = "upper" if varied == "hu_max" else "lower"
    end = f"it leaks at {printed(leak, 0)} HU" if leak is not None else "no leak was met"
    words = f"Grown volume against the {side} HU limit; {printed(chosen, 0)} HU was chosen, {end}."
    return in_all_widths(lambda width: growth_chart(limits, volumes, chosen, leak, words, width))


@dataclass(frozen=True)
class Straight:
    """The path straightened: CT if there is one, wall, clearance asked for.

    `half` is the height shown to either side in mm; `lines` are drawn in a box of `length` by ``2 * half``.
    """

    length: float
    half: float
    picture: str
    lines: Markup
    above: Markup
    below: Markup
    ticks: tuple[tuple[float, str], ...]


def straight(course: Course, source: Source, volume: Volume | None, window: Window | None) -> Straight | None:
    """The curved reformation; None where neither wall nor CT is known."""
    if course.rims is None:
        return None
    length = float(course.arc[-1])
    roomy = 1.3 * float(np.quantile(course.rims, 0.85))
    half = float(np.clip(max(0.08 * length, roomy), 2.0, 22.0))
    at = course.arc[course.places]
    picture = ""
    if volume is not None and window is not None:
        columns = np.linspace(0, len(course.places) - 1, 420).round().astype(int)
        picture = png(straightened(volume, course.points[course.places][columns], course.normal[columns], half, window))
    opposite = course.rims.shape[1] // 2
    lines = [_across(at, course.rims[:, 0], half, "wall-line"), _across(at, -course.rims[:, opposite], half, "wall-line")]
    asked = source.value("limits.clearance_min_mm")
    if asked:
        lines += [tag("path", class_="asked-line", d=f"M0 {half + sign * asked:.3f}H{length:.3f}") for sign in (-1.0, 1.0)]
    flags = source.result.get("flagged_intervals") or []

    def above(width: Width) -> Markup:
        x = Axis(0.0, length, LEFT, width.plot - RIGHT)
        bars = [
            tag(
                "rect",
                class_=f"flag-solid {f['kind']}",
                x=x(f["from_mm"]),
                width=max(3.0, x(f["to_mm"]) - x(f["from_mm"])),
                y=1 if f["kind"] == "clearance" else 6,
                height=4,
                rx=1,
            )
            for f in flags
        ]
        return frame(width, (width.plot, 11), "Flagged stretches", bars)

    def below(width: Width) -> Markup:
        return frame(
            width,
            (width.plot, 20),
            "Arc length in mm",
            path_axis(length, Axis(0.0, length, LEFT, width.plot - RIGHT), 1, width.plot - LEFT - RIGHT),
        )

    tick = 10.0 if half > 11 else 5.0 if half > 5.5 else 2.0
    ticks = tuple((50.0 - 50.0 * v / half, printed(v, 0)) for v in (tick, 0.0, -tick))
    return Straight(length, half, picture, Markup("").join(lines), in_all_widths(above), in_all_widths(below), ticks)


def _across(at: FloatArray, values: FloatArray, half: float, name: str) -> Markup:
    heights = half - np.clip(values, -1.2 * half, 1.2 * half)
    return tag("path", class_=name, d="M" + "L".join(f"{a:.2f} {b:.3f}" for a, b in zip(at, heights, strict=True)))


@dataclass(frozen=True)
class Thumbnail:
    """One static cut at a critical place, ready to print."""

    name: str
    picture: Markup


@dataclass(frozen=True)
class Place:
    """A critical place with its cuts."""

    title: str
    where: Phrase
    go: float
    field: str
    cuts: tuple[Thumbnail, ...]


def critical_places(course: Course, source: Source, volume: Volume | None, window: Window | None) -> tuple[Place, ...]:
    """The tightest place and the sharpest bend, each across the path and, where there is a CT, in three planes."""
    found: list[tuple[str, int, Phrase]] = []
    if course.clearance is not None and (least := source.figure("metrics.clearance_min_mm", 2, "mm")) is not None:
        index = int(course.clearance.argmin())
        found.append(
            ("Tightest place", index, phrase("at ", source.need("derived:clearance_min_at_mm", 1, "mm"), ", clearance ", least))
        )
    if (radius := source.figure("derived:bend_radius_mm", 1, "mm")) is not None:
        index = int(course.curvature.argmax())
        found.append(
            ("Sharpest bend", index, phrase("at ", source.need("derived:curvature_max_at_mm", 1, "mm"), ", radius ", radius))
        )
    asked = source.value("limits.clearance_min_mm")
    return tuple(
        Place(title, where, float(course.arc[index]), printed(cut_field(course, course.place_at(index)), 0), _cuts(course, index, volume, window, asked))
        for title, index, where in found
    )


def cut_field(course: Course, place: int) -> float:
    """Side of the static cuts in mm: the lumen with its surroundings, not lost in them."""
    return FIELD_MM if course.rims is None else float(np.clip(np.ceil(11.0 * np.median(course.rims[place]) / 2) * 2, 20.0, FIELD_MM))


def _cuts(course: Course, index: int, volume: Volume | None, window: Window | None, asked: float | None) -> tuple[Thumbnail, ...]:
    place = course.place_at(index)
    origin, normal, down = course.points[index], course.normal[place], -course.binormal[place]
    tight = course.clearance is not None and asked is not None and float(course.clearance[index]) < asked
    circle = tag("circle", class_="asked bad" if tight else "asked", r=f"{asked:.3f}") if asked else Markup("")
    wall = Markup("")
    field = cut_field(course, place)
    if course.rims is not None:
        angle = 2.0 * np.pi * np.arange(course.rims.shape[1]) / course.rims.shape[1]
        rim = course.rims[place]
        wall = tag(
            "path",
            class_="rim",
            d="M" + "L".join(f"{r * np.cos(a):.2f} {-r * np.sin(a):.2f}" for r, a in zip(rim, angle, strict=True)) + "Z",
        )
    across = Thumbnail("Across", _picture(volume, window, origin, normal, down, [wall, circle], "Cut across the path", field, ()))
    if volume is None or window is None:
        return (across,) if course.rims is not None else ()
    near = course.points[max(0, index - 80) : index + 81] - origin
    cuts = [across]
    for _, name, right_axis, down_axis, letters in PLANES:
        right, below = np.array(right_axis), np.array(down_axis)
        line = tag(
            "path",
            class_="path-line",
            d="M" + "L".join(f"{a:.2f} {b:.2f}" for a, b in zip(near @ right, near @ below, strict=True)),
        )
        cuts.append(
            Thumbnail(name, _picture(volume, window, origin, right, below, [line, circle], f"CT, {name.lower()}", field, letters))
        )
    return tuple(cuts)


def _picture(
    volume: Volume | None, window: Window | None, origin: FloatArray, right: FloatArray, down: FloatArray,
    overlay: Sequence[Markup], words: str, field: float, letters: Sequence[str],
) -> Markup:  # fmt: skip
    half = field / 2
    parts = []
    if volume is not None and window is not None:
        grey = png(cut(volume, origin, right, down, window, field=field))
        parts.append(Markup('<image x="{}" y="{}" width="{}" height="{}" href="{}"/>').format(-half, -half, field, field, grey))
    parts += overlay
    parts.append(tag("circle", class_="here", r=f"{field / 90:.2f}"))
    spots = ((-0.94, 0.03, "start"), (0.94, 0.03, "end"), (0.0, -0.86, "middle"), (0.0, 0.94, "middle"))
    for letter, (x, y, anchor) in zip(letters, spots, strict=False):
        parts.append(
            tag("text", letter, class_="side", x=x * half, y=y * half, text_anchor=anchor)
        )
    kind = "cut" if volume is not None else "cut no-ct"
    return Markup('<svg class="{}" viewBox="{} {} {} {}" role="img" aria-label="{}">{}</svg>').format(
        kind, -half, -half, field, field, words, Markup("").join(parts)
    )


def make_course(path: Mapping[str, Any], surface: Surface | None, places: int) -> Course | None:
    """The path of a result as arrays; None where there is none to draw."""
    points = np.asarray(path.get("points_mm") or [], float).reshape(-1, 3)
    if len(points) < 2:
        return None
    clearance = np.asarray(path["clearance_mm"], float) if path.get("clearance_mm") else None
    chosen = np.unique(np.linspace(0, len(points) - 1, min(places, len(points))).round().astype(int))
    tangent, normal, binormal = (axis[chosen] for axis in parallel_frames(points))
    return Course(
        arc=np.asarray(path["s_mm"], float),
        points=points,
        curvature=np.asarray(path["curvature_per_mm"], float),
        clearance=clearance,
        places=chosen,
        rims=rims(surface, points[chosen], tangent, normal, binormal) if surface is not None else None,
        normal=normal,
        binormal=binormal,
    )


__all__ = [
    "WIDTHS",
    "Course",
    "Place",
    "Straight",
    "critical_places",
    "growth",
    "make_course",
    "profiles",
    "roominess",
    "steps",
    "straight",
    "strip",
]
