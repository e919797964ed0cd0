"""The reformation and the views from the tip in the recording, read back."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from segmentation.volume import Volume
from tubeplan_viz.endoluminal import FilmSettings, make_film
from tubeplan_viz.plan import Limits
from tubeplan_viz.recording import Recording
from tubeplan_viz.recording.anatomy import grey
from tubeplan_viz.recording.plans import Track
from tubeplan_viz.recording.reformation import HALF_MM, PIXEL_MM, straightened
from tubeplan_viz.recording.slices import Slicer


def dark_line_volume(line: np.ndarray) -> Volume:
    """Soft tissue with air within 2.5 mm of a line, 1 mm voxels."""
    low = line.min(axis=0) - 22.0
    size = np.ceil((line.max(axis=0) + 22.0 - low)[::-1]).astype(int)
    matrix = np.array([[0, 0, 1.0, low[0]], [0, 1.0, 0, low[1]], [1.0, 0, 0, low[2]], [0, 0, 0, 1.0]])
    index = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1)
    places = index @ matrix[:3, :3].T + matrix[:3, 3]
    away = np.min([np.linalg.norm(places - point, axis=-1) for point in line[::8]], axis=0)
    return Volume(np.where(away < 2.5, -1000, 60).astype(np.int16), matrix)


def test_the_path_lies_in_the_middle_row_and_the_wall_at_its_distance() -> None:
    s = np.arange(0.0, 60.0, 0.25)
    line = np.column_stack([12.0 * (1 - np.cos(s / 12.0)), 12.0 * np.sin(s / 12.0), 0.2 * s])
    slicer = Slicer(dark_line_volume(line), None)
    rows = round(2 * HALF_MM / PIXEL_MM)
    inner = line[40:-40]
    picture = straightened(slicer, inner, np.tile([0.0, 0.0, 1.0], (len(inner), 1)), rows)
    air, tissue = (int(grey(np.array([hu], np.float32), slicer.window)[0]) for hu in (-1000, 60))
    assert (picture[rows // 2 - 1 : rows // 2 + 1] == air).all()
    outside = picture[rows // 2 + round(4.5 / PIXEL_MM)]
    assert (outside == tissue).all()  # 4.5 mm away, beyond the 2.5 mm of air and a voxel
    assert tissue > air


def test_pictures_from_the_tip_stand_on_the_arc_length_timeline(bent_tube: Any, tmp_path: Path) -> None:
    plan = bent_tube.plan(Limits(curvature_max=0.2, clearance_min=1.0))
    profile = plan.profile
    film = make_film(
        bent_tube.surface, profile.arc_length, profile.points, profile.clearance, settings=FilmSettings(size=48, step=10.0)
    )
    path = tmp_path / "recording.rrd"
    with Recording.open(
        path, case_id="c", limits=plan.limits, planner="tube", method="feature_iteration", frame="mesh"
    ) as recording:
        recording.log_surface(bent_tube.surface)
        recording.log_film(film)
    times: dict[str, dict[int, bytes]] = {"arc_length": {}, "iteration": {}}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == "/case/film":
            batch = chunk.to_record_batch()
            (timeline,) = chunk.timeline_names
            ticks = batch.column(timeline).cast("int64").to_pylist()
            for name in batch.schema.names:
                if name.endswith("EncodedImage:blob"):
                    cells = zip(ticks, batch.column(name), strict=True)
                    times[timeline] |= {tick: bytes(cell.as_py()[0]) for tick, cell in cells if cell.is_valid}
    shown = times["arc_length"]
    assert sorted(shown) == [int(still.arc_length * 10) for still in film.stills]
    assert shown[0] == film.stills[0].jpeg
    assert times["iteration"] == {0: film.stills[0].jpeg}  # the view is not empty where the recording opens
    assert Image.open(io.BytesIO(shown[0])).size == (48, 48)


def test_a_track_of_one_point_has_no_reformation() -> None:
    track = Track(arc_length=np.array([0.0, 0.1]), points=np.zeros((2, 3)), curvature=np.zeros(2), clearance=np.ones(2))
    from tubeplan_viz.recording.reformation import log_reformation

    class Refusing:
        def log(self, *_: Any, **__: Any) -> None:
            pytest.fail("nothing is to be logged")

    log_reformation(Refusing(), None, track, (), Limits(curvature_max=0.1, clearance_min=1.0))  # type: ignore[arg-type]
