"""One finished run, as recording and report see it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from segmentation.mesh import Surface
from segmentation.region_growing import Region
from segmentation.volume import Volume
from tubeplan_viz.endoluminal import Film


@dataclass(frozen=True, eq=False, kw_only=True)
class Review:
    """Everything a reviewer may be shown of one run.

    Attributes
    ----------
    case_id : str
        The case's own name; never a patient's.
    result : mapping
        The content of result.json, complete.
    surface : Surface or None
    volume : Volume or None
        The CT, when the case came from one.
    region : Region or None
        The grown lumen, when the case came from a CT.
    facts : mapping of str to str
        Image and surface facts as label and printed value, in reading order, identifiers left out.
    first, last : mapping of str to list of float
        Profiles of iteration 0 and of the planned path: ``s_mm``, ``points_mm``,
        ``curvature_per_mm``, ``clearance_mm``.
    film : Film or None
        Pictures from the tip along the path.
    """

    case_id: str
    result: Mapping[str, Any]
    surface: Surface | None
    volume: Volume | None
    region: Region | None
    facts: Mapping[str, str] = field(default_factory=dict)
    first: Mapping[str, Any] = field(default_factory=dict)
    last: Mapping[str, Any] = field(default_factory=dict)
    film: Film | None = None
