"""What does not change while planning: wall, caps, centerline, CT voxels, the grown volume."""

from __future__ import annotations

from typing import Any

import fast_simplification
import numpy as np
import rerun as rr

from segmentation.arrays import FloatArray, IntArray
from segmentation.mesh import Surface
from segmentation.region_growing import GrowthCurve, Region
from segmentation.volume import Volume
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.sink import Sink

WALL_FACES = 30_000
WALL_FACES_LIGHT = 2_000
VOXEL_BUDGET = 1_200_000
CROP_MARGIN_MM = 12.0
FINE_SPACING_MM = 1.4
INSCRIBED_STEP_MM = 6.0
AIRWAY_HU_MAX = -300.0
LUNG_WINDOW = (-1350.0, 150.0)
CONTRAST_WINDOW = (-160.0, 560.0)


def hu_window(region: Region | None) -> tuple[float, float]:
    """HU shown as black and as white: the lung window around a dark lumen, a contrast window otherwise."""
    return LUNG_WINDOW if region is not None and region.hu_max <= AIRWAY_HU_MAX else CONTRAST_WINDOW


def grey(hu: Any, window: tuple[float, float]) -> Any:
    """HU as uint8 grey values, 0 at and below the window's lower end, 255 at and above its upper."""
    low, high = window
    return np.clip((np.asarray(hu, dtype=np.float32) - low) * (255.0 / (high - low)) + 0.5, 0.0, 255.0).astype(np.uint8)


def log_surface(sink: Sink, surface: Surface, *, light: bool) -> None:
    """Wall, made light for a viewer, and the end caps in a colour of their own."""
    log_wall(sink, surface, light=light)
    caps = surface.faces[surface.face_cap >= 0]
    if len(caps):
        sink.log(at.CAPS, _mesh(*_compact(surface.vertices, caps), (*at.CAP_COLOR, 110)), static=True)
        sink.log(
            f"{at.CAPS}/labels",
            rr.Points3D(
                [cap.center for cap in surface.caps],
                labels=[f"{cap.label} ({cap.origin})" for cap in surface.caps],
                colors=at.CAP_COLOR,
                radii=rr.Radius.ui_points(2.0),
                show_labels=False,
            ),
            static=True,
        )


def log_wall(sink: Sink, surface: Surface, *, entity: str = at.WALL, light: bool = False) -> None:
    """The wall without its caps, with no more triangles than a viewer turns smoothly."""
    budget = WALL_FACES_LIGHT if light else WALL_FACES
    vertices, faces = _compact(surface.vertices, surface.wall_faces)
    if len(faces) > budget:
        points, triangles = fast_simplification.simplify(
            vertices.astype(np.float32), faces.astype(np.int32), target_reduction=1.0 - budget / len(faces)
        )
        vertices, faces = np.asarray(points, dtype=float), np.asarray(triangles, dtype=np.int64)
    sink.log(entity, _mesh(vertices, faces, (*at.WALL_COLOR, 70)), static=True)


def log_centerline(sink: Sink, centerline: Centerline, *, light: bool) -> None:
    """The centerline with its radii, and some of the inscribed spheres, which are hidden until asked for."""
    sink.log(
        at.CENTERLINE,
        rr.LineStrips3D([centerline.points], colors=at.CENTERLINE_COLOR, radii=rr.Radius.ui_points(1.0)),
        rr.AnyValues(radius_mm=centerline.radii),
        static=True,
    )
    if light:
        return
    ticks = np.arange(0.0, centerline.arc_length[-1] + 1e-9, INSCRIBED_STEP_MM)
    chosen = np.unique(np.abs(centerline.arc_length[:, None] - ticks[None, :]).argmin(axis=0))
    sink.log(
        at.INSCRIBED,
        rr.Ellipsoids3D(
            centers=centerline.points[chosen],
            half_sizes=np.repeat(centerline.radii[chosen, None], 3, axis=1),
            colors=[(*at.CENTERLINE_COLOR, 160)],
            line_radii=rr.Radius.ui_points(0.5),
            fill_mode="majorwireframe",
        ),
        static=True,
    )


def log_volume(sink: Sink, volume: Volume, region: Region | None) -> tuple[int, str]:
    """Grey voxels around the lumen at half resolution or less, and the mask.

    Returns
    -------
    int
        The middle slice of what was kept.
    str
        What was kept, in words.
    """
    lower, upper = crop_box(volume, region)
    size = upper - lower
    steps = np.where(volume.spacing < FINE_SPACING_MM, 2, 1)
    while np.prod(size // steps) > VOXEL_BUDGET:
        steps[np.argmin(volume.spacing * steps)] += 1
    steps = np.minimum(steps, size)
    voxels = volume.voxels[tuple(slice(a, b) for a, b in zip(lower, upper, strict=True))]
    window = hu_window(region)
    sink.log(
        at.VOLUME,
        rr.Tensor(grey(_block_mean(voxels, steps), window), dim_names=("slice", "row", "column"), value_range=(0, 255)),
        static=True,
    )
    if region is not None:
        mask = np.zeros(tuple(size), dtype=np.float32)
        start = np.asarray(region.lower) - lower
        mask[tuple(slice(a, a + n) for a, n in zip(start, region.mask.shape, strict=True))] = region.mask
        half = (_block_mean(mask, steps) >= 0.5).astype(np.uint8)
        sink.log(at.MASK, rr.Tensor(half, dim_names=("slice", "row", "column"), value_range=(0, 1)), static=True)
    kept = " x ".join(str(n // s) for n, s in zip(size, steps, strict=True))
    return int(size[0] // steps[0] // 2), (
        f"CT in the recording: {kept} voxels around the lumen, each the mean of {steps[0]} x {steps[1]} x {steps[2]} "
        f"(slice, row, column); grey values from {window[0]:g} to {window[1]:g} HU"
    )


def crop_box(volume: Volume, region: Region | None) -> tuple[IntArray, IntArray]:
    """Lowest and past-the-end index of the part worth showing: the lumen and some margin, or all without a lumen."""
    shape = np.array(volume.voxels.shape)
    if region is None:
        return np.zeros(3, dtype=np.int64), shape
    margin = np.ceil(CROP_MARGIN_MM / volume.spacing).astype(int)
    start = np.asarray(region.lower)
    return np.maximum(start - margin, 0), np.minimum(start + np.array(region.mask.shape) + margin, shape)


def log_growth(sink: Sink, curve: GrowthCurve) -> None:
    """Grown volume against the HU limit; the chosen limit in green, the first that leaks in red."""
    limits, volumes = curve.limits, curve.volumes_ml
    order = np.argsort(limits)
    spacing = np.diff(limits[order], append=limits[order][-1] + (np.ptp(limits) / max(len(limits) - 1, 1) or 1.0))
    widths = np.empty_like(limits)
    widths[order] = spacing * 0.9
    chosen = np.abs(limits - curve.chosen) <= 1e-6
    leak = np.zeros(len(limits), dtype=bool) if curve.leak_limit is None else np.abs(limits - curve.leak_limit) <= 1e-6
    parts = [
        ("0_tried", ~(chosen | leak), at.CENTERLINE_COLOR),
        ("1_chosen", chosen, at.OK),
        ("2_leak", leak & ~chosen, at.LEAK),
    ]
    for name, part, color in parts:
        sink.log(
            f"{at.GROWTH}/{name}",
            rr.BarChart(volumes[part], abscissa=limits[part], widths=widths[part], color=color),
            static=True,
        )
    if curve.leak_point is not None:
        sink.log(
            f"{at.CASE}/anatomy/leak",
            rr.Points3D(
                [curve.leak_point],
                labels=[f"leak begins at {curve.leak_limit:g} HU"],
                show_labels=False,
                colors=at.LEAK,
                radii=rr.Radius.ui_points(4.0),
            ),
            static=True,
        )


def _mesh(vertices: FloatArray, faces: IntArray, color: tuple[int, int, int, int]) -> Any:
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], cross)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, vertex_normals=normals, albedo_factor=color)


def _compact(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """The vertices that the faces use, and the faces renumbered."""
    used, numbers = np.unique(faces, return_inverse=True)
    return vertices[used], numbers.reshape(faces.shape)


def _block_mean(voxels: Any, steps: IntArray) -> Any:
    """Mean over blocks of `steps` voxels; what is left over at the far faces is dropped."""
    size = np.array(voxels.shape) // steps
    trimmed = voxels[tuple(slice(0, n * s) for n, s in zip(size, steps, strict=True))]
    blocks = trimmed.reshape(size[0], steps[0], size[1], steps[1], size[2], steps[2])
    return blocks.mean(axis=(1, 3, 5), dtype=np.float32)
