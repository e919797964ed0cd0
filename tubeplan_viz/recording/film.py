"""The pictures from the tip on the arc-length timeline, each with the camera that saw it."""

from __future__ import annotations

import numpy as np
import rerun as rr

from tubeplan_viz.endoluminal import Film, Still
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.sink import Sink

FRUSTUM_MM = 6.0


def log_film(sink: Sink, film: Film) -> None:
    """Camera and picture at each place of the film; the first also while iterations are shown, so that the view is not empty."""
    sink.at(at.ITERATION, 0)
    log_still(sink, film.stills[0], film.size)
    for still in film.stills:
        sink.at(at.ARC_LENGTH, int(still.arc_length * at.TICKS_PER_MM))
        log_still(sink, still, film.size)


def log_still(sink: Sink, still: Still, size: int) -> None:
    """One camera with its picture, at the current time."""
    camera = still.camera
    # A pinhole's axes in rerun: x right, y down, z forward.
    turn = np.column_stack([camera.right, -camera.up, camera.forward])
    eye = rr.Pinhole(
        focal_length=0.5 * size / float(np.tan(0.5 * camera.field_of_view)),
        width=size,
        height=size,
        image_plane_distance=FRUSTUM_MM,
        line_width=0.3,
        color=at.HERE,
    )
    sink.log(at.FILM, rr.Transform3D(translation=camera.position, mat3x3=turn), eye)
    sink.log(at.FILM, rr.EncodedImage(contents=still.jpeg, media_type="image/jpeg"))
