"""Where the path stands: frame, unit, ends asked for, and what mesh.ply is made of."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.mesh_file import MeshFile
from tubeplan_viz.verify.verification import Check

UNITS = {"metres": 1000.0, "centimetres": 10.0, "inches": 25.4, "micrometres": 0.001}
# A lumen that instruments enter: from a vessel's stretch of 2 mm to a whole body.
SIZE_MM = (2.0, 3000.0)
BOX_MARGIN_MM = 1.0  # a path may begin a little outside a cap
END_MM = 1e-6  # the path's ends are the points asked for, not points near them
FLAT_MM = 0.05 + 1e-6  # a flat end's vertices lie within 0.05 mm of its plane; rounding of the file's coordinates
AREA = 1e-6  # relative: the same double-precision sum in another order


def check_frame(result: Mapping[str, Any], mesh: MeshFile, markups: Mapping[str, Any] | None) -> Iterator[Check]:
    """One frame and one unit in all files."""
    frame, found, unit = result["frame"], mesh.comment("frame"), mesh.comment("unit")
    names = [str(markup.get("name", "")) for markup in markups["markups"]] if markups else []
    systems = {str(markup.get("coordinateSystem")) for markup in markups["markups"]} if markups else {"LPS"}
    units = {str(markup.get("coordinateUnits")) for markup in markups["markups"]} if markups else {"mm"}
    told = all(("mesh frame" in name) == (frame == "mesh") for name in names)
    yield Check(
        name="frame",
        ok=found == frame and systems == {"LPS"} and told,
        found=f"result.json {frame}, mesh.ply {found or 'none'}, path.mrk.json {', '.join(sorted(systems))} named "
        f"{'; '.join(names) or 'nothing'}",
        expected=f"{frame} in all; path.mrk.json in LPS, with 'mesh frame' in its names only for a mesh file's axes",
        text="All files of the run name the same frame.",
    )
    yield Check(
        name="unit: named",
        ok=unit == "mm" and units == {"mm"},
        found=f"mesh.ply {unit or 'none'}, path.mrk.json {', '.join(sorted(units))}",
        expected="mm in both",
        text="All files of the run name mm as their unit.",
    )


def check_unit(result: Mapping[str, Any], mesh: MeshFile, spline_points: FloatArray) -> Iterator[Check]:
    """Sizes that fit each other and a body; a wrong unit is named."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = float(np.linalg.norm(high - low))
    guess = next(
        (f"; in {name} it would be {size * factor:.4g} mm" for name, factor in UNITS.items() if _plausible(size * factor)), ""
    )
    yield Check(
        name="unit: size of the mesh",
        ok=_plausible(size),
        found=f"{size:.4g} mm across{'' if _plausible(size) else guess}",
        expected=f"{SIZE_MM[0]:g} to {SIZE_MM[1]:g} mm",
        text="The mesh has the size of a body part.",
    )
    for name, points in (("path", np.array(result["path"]["points_mm"], dtype=float)), ("spline", spline_points)):
        fits = _in_box(points, low, high)
        unit = next((word for word, factor in UNITS.items() if not fits and _in_box(points * factor, low, high)), None)
        if fits:
            text = f"The {name} lies in the box of the mesh."
        elif unit:
            text = f"The {name} does not fit the box of the mesh, but would if its numbers were {unit}: wrong unit, expected mm."
        else:
            text = f"The {name} does not fit the box of the mesh: it is in another frame."
        yield Check(
            name=f"unit: {name}",
            ok=fits,
            found=f"{_corner(points.min(axis=0))} to {_corner(points.max(axis=0))} mm",
            expected=f"within {_corner(low)} to {_corner(high)} mm",
            text=text,
        )


def _plausible(size: float) -> bool:
    return SIZE_MM[0] <= size <= SIZE_MM[1]


def _in_box(points: FloatArray, low: FloatArray, high: FloatArray) -> bool:
    inside = bool(np.all(points >= low - BOX_MARGIN_MM) and np.all(points <= high + BOX_MARGIN_MM))
    # Everything near the origin fits a box that holds the origin: a path in metres would pass.
    return inside and bool(np.ptp(points, axis=0).max() >= 0.01 * (high - low).max())


def _corner(point: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in point) + ")"


def check_surface(result: Mapping[str, Any], mesh: MeshFile) -> Iterator[Check]:
    """mesh.ply is closed and made up as details.surface says."""
    yield Check(
        name="mesh: closed",
        ok=mesh.open_edges == 0,
        found=f"{mesh.open_edges} edges that do not join two faces",
        expected="0",
        text="Every edge of mesh.ply joins two faces of like orientation, so that inside and outside are defined.",
    )
    surface = result["details"].get("surface")
    if surface is None:
        yield Check(
            name="mesh: caps",
            ok=False,
            found="no details.surface in result.json",
            expected="wall_faces, faces and caps",
            text="Without it wall and end caps cannot be told apart, and clearance cannot be checked.",
        )
        return
    caps, faults = surface["caps"], []
    expected = surface["wall_faces"]
    for cap in caps:
        first, count = cap["first_face"], cap["faces"]
        if first != expected or first + count > len(mesh.faces):
            faults.append(f"{cap['label']} begins at face {first} instead of {expected}")
            break
        expected += count
        corners = mesh.vertices[mesh.faces[first : first + count]]
        area = 0.5 * float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum())
        off = np.abs((corners.reshape(-1, 3) - cap["center_mm"]) @ np.array(cap["normal"], dtype=float)).max()
        if cap["origin"] == "flat end" and off > FLAT_MM:
            faults.append(f"{cap['label']} is called a flat end and is {off:.3g} mm off its plane")
        if abs(area - cap["area_mm2"]) > AREA * max(area, 1.0):
            faults.append(f"{cap['label']} has {area:.4f} mm^2 instead of {cap['area_mm2']:.4f}")
    if not faults and (expected != len(mesh.faces) or surface["faces"] != len(mesh.faces)):
        faults.append(f"{expected} faces are accounted for, {surface['faces']} stated")
    yield Check(
        name="mesh: caps",
        ok=not faults,
        found="; ".join(faults) or f"{surface['wall_faces']} wall faces, {len(caps)} caps",
        expected=f"all {len(mesh.faces)} faces of mesh.ply, caps with their areas",
        text="mesh.ply is made up of wall and caps as details.surface says, and what is called a flat end is flat.",
    )


def check_ends(result: Mapping[str, Any], case: Mapping[str, Any] | None) -> Iterator[Check]:
    """The path begins and ends at the points that were asked for."""
    points = np.array(result["path"]["points_mm"], dtype=float)
    for name, end in (("start", points[0]), ("goal", points[-1])):
        sources = {
            "case.toml": _asked(case, name, result),
            "the settings": _asked(result["provenance"]["settings"], name, result),
        }
        known = {source: place for source, place in sources.items() if place is not None}
        if not known:
            yield Check(
                name=f"ends: {name}",
                ok=False,
                found=f"no {name} in case.toml or the settings",
                expected="a point, or the label or name of one of details.endpoints",
                text=f"Whether the path has the {name} asked for cannot be checked.",
            )
            continue
        tip = result["metrics"]["tip_error_mm"] or 0.0
        slack = END_MM + (tip if name == "goal" else 0.0)
        off = {source: float(np.linalg.norm(place - end)) for source, place in known.items()}
        source = max(off, key=lambda key: off[key])
        yield Check(
            name=f"ends: {name}",
            ok=off[source] <= slack,
            found=f"{_corner(end)} mm, {off[source]:.3g} mm off",
            expected=f"{_corner(known[source])} mm in {source}",
            text=f"The path has the {name} that was asked for.",
        )


def check_limits(result: Mapping[str, Any], case: Mapping[str, Any] | None) -> Iterator[Check]:
    """The limits that the path is judged by are those that were asked for."""
    stated = result["limits"]
    names = {"curvature_max": "curvature_max_per_mm", "clearance_min": "clearance_min_mm"}
    differ = []
    for source, tables in (("case.toml", case), ("the settings", result["provenance"]["settings"])):
        asked = (tables or {}).get("limits") or {}
        differ += [f"{asked[name]} in {source}" for name, key in names.items() if name in asked and asked[name] != stated[key]]
    yield Check(
        name="limits",
        ok=not differ,
        found=f"curvature {stated['curvature_max_per_mm']:g} 1/mm, clearance {stated['clearance_min_mm']:g} mm",
        expected="; ".join(differ) or "as in case.toml and the settings",
        text="The limits of result.json are those that were asked for.",
    )


def _asked(case: Mapping[str, Any] | None, name: str, result: Mapping[str, Any]) -> FloatArray | None:
    """The point asked for: coordinates, or an end point's label or name, at the top of the case or in one of its tables."""
    if case is None:
        return None
    tables = [case, *(value for value in case.values() if isinstance(value, Mapping))]
    value = next((table[name] for table in tables if table.get(name) is not None), None)
    if isinstance(value, str):
        value = _meant(value.strip(), result["details"].get("endpoints") or [])
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        return None
    return np.array(value, dtype=float)


def _meant(words: str, endpoints: Sequence[Mapping[str, Any]]) -> Any:
    """The place of the only end point whose label or whole name the words are, else whose name holds them; None without one."""
    low = words.lower()
    named = [(point["label"].lower(), (point.get("name") or "").lower(), point["point_mm"]) for point in endpoints]
    whole = [place for label, name, place in named if low in (label, name)]
    holding = [place for _, name, place in named if low in name]
    found = whole or holding
    return found[0] if len(found) == 1 else None
