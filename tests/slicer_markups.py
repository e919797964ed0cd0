"""The fields of 3D Slicer's markups files as a JSON Schema of our own, written from its published schema 1.0.3.

Types, lengths, ranges and allowed words are Slicer's; it also allows further fields, which are refused here, since
a field that it does not know would be read by nobody.
"""

from __future__ import annotations

from typing import Any

GLYPHS_2D = ["Vertex", "Dash", "Cross", "ThickCross", "Triangle", "Square", "Circle", "Diamond"]
GLYPHS_2D += ["Arrow", "ThickArrow", "HookedArrow", "StarBurst"]
GLYPHS = [*(f"{name}2D" for name in GLYPHS_2D), "Sphere3D", "Diamond3D"]


def _numbers(count: int, **limits: float) -> dict[str, Any]:
    return {"type": "array", "minItems": count, "maxItems": count, "items": {"type": "number", **limits}}


def _fields(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": False, "properties": properties}


TEXT, SWITCH, COLOR = {"type": "string"}, {"type": "boolean"}, _numbers(3, minimum=0.0, maximum=1.0)
LENGTH = {"type": "number", "minimum": 0.0}
CONTROL_POINT = _fields(
    id=TEXT,
    label=TEXT,
    description=TEXT,
    associatedNodeID=TEXT,
    position=_numbers(3),
    orientation=_numbers(9),
    selected=SWITCH,
    locked=SWITCH,
    visibility=SWITCH,
    positionStatus={"enum": ["undefined", "preview", "defined"]},
)
MEASUREMENT = _fields(
    name=TEXT,
    enabled=SWITCH,
    value={"type": "number"},
    units=TEXT,
    description=TEXT,
    printFormat=TEXT,
    controlPointValues={"type": "array", "items": {"type": "number"}},
)
DISPLAY = _fields(
    visibility=SWITCH,
    opacity={"type": "number", "minimum": 0.0, "maximum": 1.0},
    color=COLOR,
    selectedColor=COLOR,
    propertiesLabelVisibility=SWITCH,
    pointLabelsVisibility=SWITCH,
    glyphType={"enum": GLYPHS},
    glyphSize=LENGTH,
    useGlyphScale=SWITCH,
    lineThickness=LENGTH,
)
MARKUP = _fields(
    type={"enum": ["Fiducial", "Line", "Angle", "Curve", "ClosedCurve", "Plane", "ROI"]},
    name=TEXT,
    coordinateSystem={"enum": ["LPS", "RAS"]},
    coordinateUnits={"enum": ["mm", "um"]},
    locked=SWITCH,
    fixedNumberOfControlPoints=SWITCH,
    labelFormat=TEXT,
    controlPoints={"type": "array", "minItems": 1, "items": CONTROL_POINT},
    measurements={"type": "array", "items": MEASUREMENT},
    display=DISPLAY,
) | {"required": ["type"]}
MARKUPS = {
    "type": "object",
    "required": ["@schema", "markups"],
    "properties": {
        "@schema": {"type": "string", "pattern": r"markups-schema-v1\.0\.3\.json#$"},
        "markups": {"type": "array", "minItems": 1, "items": MARKUP},
    },
}
