"""Names in the 3D view: off the places that they name, so that none lies on another as the recording opens."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from segmentation.arrays import FloatArray
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.blueprint import FIELD_OF_VIEW, Viewpoint
from tubeplan_viz.recording.sink import Sink

# Shares of the first view's height: how far a name stands off its place at least, how much farther at each try, and at most.
OFF, FARTHER, FARTHEST = 0.04, 0.02, 0.4
# What a label takes of it: a line, and a letter across; the viewer has them in pixels.
LINE_SHARE, LETTER_SHARE = 0.04, 0.0105
# More names than these cannot be read at once.
MOST = 24


def log_names(
    sink: Sink, entity: str, places: FloatArray, names: Sequence[str], colors: Sequence[at.Color], eye: Viewpoint, *, static: bool
) -> None:
    """Names on thin lines off their places; too many of them appear on demand, where they belong.

    Parameters
    ----------
    sink : Sink
    entity : str
        Path of the names; the lines are logged below it.
    places : (n, 3) float array, mm
    names, colors : sequences of n
    eye : Viewpoint
        Of the first view.
    static : bool
        Log for all times instead of the present one.
    """
    crowded = len(names) > MOST
    spots = places if crowded else stand_off(places, names, eye)
    sink.log(
        entity,
        rr.Points3D(spots, labels=list(names), colors=list(colors), radii=rr.Radius.ui_points(1.0), show_labels=not crowded),
        static=static,
    )
    if not crowded:
        lines = [np.stack(pair) for pair in zip(places, spots, strict=True)]
        sink.log(f"{entity}/lines", rr.LineStrips3D(lines, colors=list(colors), radii=rr.Radius.ui_points(0.5)), static=static)


def stand_off(tips: FloatArray, names: Sequence[str], eye: Viewpoint) -> FloatArray:
    """Places for names, (n, 3) mm: away from the middle of all tips in the plane of the screen, so far that none lies on another.

    Where even the farthest place is taken, that is it: a crowd of names cannot be told apart in one view.

    Parameters
    ----------
    tips : (n, 3) float array, mm
    names : sequence of str
    eye : Viewpoint
        From which the names must not overlap; from elsewhere they may.
    """
    ahead = eye.target - eye.position
    far = float(np.linalg.norm(ahead))
    right = np.cross(ahead, eye.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead) / far
    height = 2.0 * far * float(np.tan(0.5 * FIELD_OF_VIEW))
    flat = np.column_stack([tips @ right, tips @ up])
    away = flat - flat.mean(axis=0)
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    width = LETTER_SHARE * height * np.array([len(name) + 3 for name in names], float)
    line, placed = LINE_SHARE * height, np.empty((0, 2))
    for k in range(len(tips)):
        off = OFF * height
        while True:
            spot = flat[k] + off * away[k]
            apart = np.abs(placed - spot)
            if off > FARTHEST * height or not np.any((apart[:, 0] < 0.5 * (width[:k] + width[k])) & (apart[:, 1] < line)):
                break
            off += FARTHER * height
        placed = np.vstack([placed, spot])
    moved = placed - flat
    return np.asarray(tips + moved[:, :1] * right + moved[:, 1:] * up)
