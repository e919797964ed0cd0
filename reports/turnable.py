"""What a page's script needs to turn its picture of the scene: the same keys on every page that has one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from reports.still import Label, View
from reports.svg import LEFT, RIGHT, WIDTHS
from reports.wall import LightMesh
from segmentation.arrays import FloatArray


def turnable(
    mesh: LightMesh | None,
    view: View | None,
    labels: Sequence[Label],
    *,
    start: int,
    ramp: tuple[float, float] | None = None,
    before: FloatArray | None = None,
    body: str = "--wall",
    words: str = "wall of the lumen, planned path, flagged parts",
    aside: View | None = None,
) -> dict[str, Any]:
    """The scene's part of a page as JSON values; null where there is none.

    Parameters
    ----------
    mesh : LightMesh or None
        What is drawn as glass.
    view : View or None
        Where the viewer stands first; without one there is no scene.
    labels : sequence of Label
    start : int
        Sample of the path at which the cursor begins.
    ramp : (float, float) or None
        Clearance drawn as tight and as roomy, mm.
    before : (n, 3) float array or None, mm
        A second path, shown when it is asked for.
    body : str
        Colour of the glass, by its name in the style sheet.
    words : str
        What the scene shows, for those who cannot see it.
    aside : View, optional
        Where the viewer stands for the view from the side; the scene then opens with that one.
    """
    stand = None if view is None else {"toward": rounded(view.toward), "up": rounded(view.up)}
    if stand is not None and aside is not None:
        stand["aside"] = rounded(aside.toward)
    return {
        "pad": [LEFT, RIGHT],
        "plot": {width.name: width.plot for width in WIDTHS},
        "mesh": mesh.packed() if mesh is not None else None,
        "body": body,
        "words": words,
        "ct": None,
        "windows": {},
        "rims": None,
        "view": stand,
        "ramp": list(ramp) if ramp else None,
        "before": [] if before is None else [rounded(point, 2) for point in before[::2]],
        "labels": placed(labels),
        "stretches": [],
        "features": [],
        "parts": [],
        "start": start,
        "film": None,
    }


def placed(labels: Sequence[Label]) -> list[dict[str, Any]]:
    """Labels as JSON values."""
    return [{"point": rounded(label.point, 3), "text": label.text, "kind": label.kind, "rank": label.rank} for label in labels]


def rounded(vector: FloatArray, digits: int = 4) -> list[float]:
    """A vector as short numbers."""
    return [round(float(v), digits) for v in np.asarray(vector, float)]
