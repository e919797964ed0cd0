"""The path for other programs: a table, and 3D Slicer markups."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.plan import PathProfile

CSV_COLUMNS = ("s_mm", "x_mm", "y_mm", "z_mm", "tx", "ty", "tz", "curvature_per_mm", "torsion_per_mm", "clearance_mm")

# Slicer reads and validates markups files against this address.
MARKUPS_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#"
)
# Slicer draws a spline through the control points; at most this far from the path, and at most this far apart.
CHORD_ERROR_MM = 0.02
CONTROL_SPACING_MM = 5.0
PATH_COLOR = [0.10, 0.55, 0.95]
FLAG_COLORS = {"clearance": [0.88, 0.54, 0.0], "curvature": [0.78, 0.25, 0.04]}


def path_csv(profile: PathProfile) -> str:
    """The sampled path as comma-separated text with one header line.

    Numbers are in their shortest form that reads back to the same double. The
    tangent (tx, ty, tz) is a unit vector towards the goal.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    table = np.column_stack(
        [profile.arc_length, profile.points, profile.tangents, profile.curvature, profile.torsion, profile.clearance]
    )
    writer.writerows([[repr(number) for number in row] for row in table.tolist()])
    return text.getvalue()


def slicer_markups(result: Mapping[str, Any]) -> dict[str, Any]:
    """The path as an open curve and its features as points, one markups document for 3D Slicer.

    Parameters
    ----------
    result : mapping
        Content of result.json, with a path.

    Returns
    -------
    dict
        Markups schema 1.0.3 [1]_, coordinate system LPS, mm. A case in the axes of a mesh file is
        written with the mesh's own numbers, which Slicer takes for LPS in mesh.ply too, and says so in the curve's name.

    References
    ----------
    .. [1] https://slicer.readthedocs.io/en/latest/developer_guide/modules/markups.html#markups-json-file-format-mrk-json
    """
    points = np.asarray(result["path"]["points_mm"], dtype=float)
    kept = curve_controls(points)
    frame = "LPS" if result["frame"] == "LPS" else "mesh frame, not patient axes"
    s = result["path"]["s_mm"]
    curve = [_control(f"s {s[index]:.1f} mm", index + 1, points[index].tolist()) for index in kept.tolist()]
    features = [
        _control(f"{feature['kind']} {feature['s_mm']:.1f} mm", index + 1, feature["point_mm"])
        for index, feature in enumerate(result["feature_points"] or [])
    ]
    markups = [
        _markup("Curve", f"path ({frame})", curve, color=PATH_COLOR, labels=False, measurements=_measurements(result, kept))
    ]
    if features:
        markups.append(_markup("Fiducial", f"features ({frame})", features, color=[0.95, 0.75, 0.10], labels=True))
    return {"@schema": MARKUPS_SCHEMA, "markups": markups}


def flag_markups(result: Mapping[str, Any]) -> dict[str, Any]:
    """The flagged stretches as points for 3D Slicer: one list for each limit, a point where each stretch is worst.

    Parameters
    ----------
    result : mapping
        Content of result.json, with a path and at least one flagged interval.

    Returns
    -------
    dict
        Markups schema 1.0.3; each point's description says the stretch, the worst value and the limit, and the list's
        measurement ``worst`` holds the worst values as numbers.
    """
    s, points = np.asarray(result["path"]["s_mm"]), np.asarray(result["path"]["points_mm"])
    markups = []
    for kind, color in FLAG_COLORS.items():
        flags = [flag for flag in result["flagged_intervals"] if flag["kind"] == kind]
        unit, key = ("mm", "clearance_min_mm") if kind == "clearance" else ("1/mm", "curvature_max_per_mm")
        controls = []
        for number, flag in enumerate(flags, start=1):
            place = [float(np.interp(flag["worst_at_mm"], s, points[:, k])) for k in range(3)]
            control = _control(f"{kind} {flag['worst']:.3g} {unit} at {flag['worst_at_mm']:.1f} mm", number, place)
            stretch = f"from {flag['from_mm']!r} to {flag['to_mm']!r} mm, worst {flag['worst']!r} {unit}"
            controls.append(
                control | {"description": f"{stretch} at {flag['worst_at_mm']!r} mm, limit {result['limits'][key]!r}"}
            )
        if flags:
            worst = _measurement("worst", None, unit, f"Worst {kind} of each stretch", [flag["worst"] for flag in flags])
            markups.append(_markup("Fiducial", f"flagged {kind}", controls, color=color, labels=True, measurements=[worst]))
    return {"@schema": MARKUPS_SCHEMA, "markups": markups}


def _measurements(result: Mapping[str, Any], kept: IntArray) -> list[dict[str, Any]]:
    """Key figures of the path, and its curvature and clearance at the control points."""
    metrics, path = result["metrics"], result["path"]
    figures = (
        ("path length", "length_mm", "mm", "Length of the path"),
        ("path curvature max", "curvature_max_per_mm", "1/mm", "Largest curvature"),
        ("path curvature mean", "curvature_mean_per_mm", "1/mm", "Mean curvature over arc length"),
        ("path clearance min", "clearance_min_mm", "mm", "Least distance from the path to the wall"),
        ("path clearance mean", "clearance_mean_mm", "mm", "Mean distance from the path to the wall over arc length"),
    )
    made = [_measurement(name, metrics[key], unit, text) for name, key, unit, text in figures if metrics[key] is not None]
    for name, key, unit in (("path curvature", "curvature_per_mm", "1/mm"), ("path clearance", "clearance_mm", "mm")):
        if path[key] is not None:
            values = [path[key][index] for index in kept.tolist()]
            made.append(_measurement(name, None, unit, f"{name.capitalize()} at each control point", values))
    return made


def _measurement(
    name: str, value: float | None, units: str, description: str, values: Sequence[float] | None = None
) -> dict[str, Any]:
    # The names differ from 3D Slicer's own (length, curvature mean), which it works out again from the drawn curve.
    made: dict[str, Any] = {"name": name, "enabled": True, "units": units, "description": description, "printFormat": "%.4g %s"}
    if value is not None:
        made["value"] = value
    if values is not None:
        made["controlPointValues"] = list(values)
    return made


def curve_controls(points: FloatArray) -> IntArray:
    """Indices of the samples that carry the path, ends included, in order.

    Chosen so that no sample is more than 0.02 mm from the chord between its neighbours in the
    choice (Douglas-Peucker [1]_), nor two of them more than 5 mm of samples apart.

    References
    ----------
    .. [1] Douglas, D. H. and Peucker, T. K. (1973). Algorithms for the reduction of the number of
       points required to represent a digitized line. Cartographica, 10(2), 112-122.
    """
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    kept = {0, len(points) - 1}
    pending = [(0, len(points) - 1)]
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        chord = points[last] - points[first]
        inside = points[first + 1 : last] - points[first]
        share = np.clip(inside @ chord / max(float(chord @ chord), 1e-30), 0.0, 1.0)
        off = np.linalg.norm(inside - share[:, None] * chord, axis=1)
        if off.max() > CHORD_ERROR_MM:
            middle = first + 1 + int(off.argmax())
        elif along[last] - along[first] > CONTROL_SPACING_MM:
            middle = int(np.clip(np.searchsorted(along, 0.5 * (along[first] + along[last])), first + 1, last - 1))
        else:
            continue
        kept.add(middle)
        pending += [(first, middle), (middle, last)]
    return np.array(sorted(kept), dtype=np.int64)


def _control(label: str, number: int, position: list[float]) -> dict[str, Any]:
    return {
        "id": str(number),
        "label": label,
        "description": "",
        "associatedNodeID": "",
        "position": position,
        "orientation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "selected": True,
        "locked": True,
        "visibility": True,
        "positionStatus": "defined",
    }


def _markup(
    kind: str,
    name: str,
    controls: list[dict[str, Any]],
    *,
    color: list[float],
    labels: bool,
    measurements: list[dict[str, Any]] | None = None,
) -> dict[str, Any]:
    return {
        "type": kind,
        "name": name,
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "fixedNumberOfControlPoints": True,
        "labelFormat": "%N-%d",
        "controlPoints": controls,
        "measurements": measurements or [],
        "display": {
            "visibility": True,
            "opacity": 1.0,
            "color": color,
            "selectedColor": color,
            "propertiesLabelVisibility": False,
            "pointLabelsVisibility": labels,
            "glyphType": "Sphere3D",
            "glyphSize": 1.0,
            "useGlyphScale": False,
            "lineThickness": 0.4,
        },
    }
