"""The part of the page in which scene, charts and CT share one cursor, and the two critical places."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from markupsafe import Markup

from reports.figures import Profile, Steps, growth_chart, profile_chart, step_chart, strip_chart
from reports.numbers import Source, printed
from reports.slices import Window, png, straightened
from reports.svg import LEFT, RIGHT, Axis, Width, frame, in_all_widths, path_axis, tag
from reports.wall import rims, sideways_frames
from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from segmentation.volume import Volume

STRIP_PIECES = 125


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
    names = {"clearance": "clearance short", "curvature": "bend too sharp"}
    told = [f"{names[f['kind']]} from {printed(f['from_mm'], 1)} to {printed(f['to_mm'], 1)} mm" for f in flags[:10]]
    words = f"The whole path, {printed(length, 1)} mm. {'; '.join(told) or 'No stretch is flagged'}."
    return in_all_widths(lambda width: strip_chart(length, shares, flags, parts, words, width))


def profiles(
    course: Course,
    source: Source,
    first: Mapping[str, Any],
    *,
    kinds: Sequence[str] = ("clearance", "curvature"),
    free: Sequence[str] = (),
) -> dict[str, Markup]:
    """The charts of clearance and curvature over arc length, those of `kinds` that apply; the last kind has the axis.

    Those of `free` are drawn without their limit, which is so far off that the curve beside it would be flat.
    """
    flags = source.result.get("flagged_intervals") or []
    before_arc = np.asarray(first["s_mm"], float) if first.get("s_mm") else None
    charts: dict[str, Markup] = {}
    asked, allowed = source.value("limits.clearance_min_mm"), source.value("limits.curvature_max_per_mm")
    for kind, values, limit in (("clearance", course.clearance, asked), ("curvature", course.curvature, allowed)):
        if values is None or kind not in kinds:
            continue
        limit = None if kind in free else limit
        mine = [flag for flag in flags if flag["kind"] == kind]
        before = first.get(f"{kind}_{'mm' if kind == 'clearance' else 'per_mm'}")
        made = _profile(kind, course.arc, values, limit, mine)
        spec = Profile(
            kind=kind,
            arc=course.arc,
            values=values,
            limit=limit,
            flags=mine,
            with_axis=kind == kinds[-1],
            **made,
            before_arc=before_arc if before else None,
            before=np.asarray(before, float) if before else None,
        )
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
            kind=kind,
            values=np.asarray(values, float),
            limit=limit,
            limit_label="" if limit is None else limit_words.format(printed(limit, digits)),
            label=f"{title} over {len(values) - 1} iterations: from {printed(values[0], 4)} to {printed(values[-1], 4)}",
        )
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
        return frame(width, (width.plot, 11), f"Flagged stretches: {len(flags) or 'none'}", bars)

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


def make_course(path: Mapping[str, Any], surface: Surface | None, places: int) -> Course | None:
    """The path of a result as arrays; None where there is none to draw."""
    points = np.asarray(path.get("points_mm") or [], float).reshape(-1, 3)
    if len(points) < 2:
        return None
    clearance = np.asarray(path["clearance_mm"], float) if path.get("clearance_mm") else None
    chosen = np.unique(np.linspace(0, len(points) - 1, min(places, len(points))).round().astype(int))
    tangent, normal, binormal = (axis[chosen] for axis in sideways_frames(points))
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
