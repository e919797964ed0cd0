"""How a recording opens: the views, what each shows, and from where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.plan import FlagKind, Limits
from tubeplan_viz.recording import entities as at
from tubeplan_viz.recording.slices import FIELD_MM, PIXEL_MM

FIELD_OF_VIEW = np.deg2rad(55.0)
PLAY_FPS = 20.0
# Of the wall about a path, as a share of the path's extent, this much is in the first view.
SURROUNDINGS = 0.45
BACKGROUND = (18, 20, 24)
SCENE_NAME = "3D (research use, not for clinical decisions)"


@dataclass(frozen=True, kw_only=True)
class Contents:
    """What a recording holds and so what its layout must show."""

    limits: Limits
    frame: str
    has_ct: bool = False
    middle_slice: int = 0
    has_growth: bool = False
    has_camera: bool = False
    has_film: bool = False
    has_reformation: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Viewpoint:
    """Eye of the 3D view: position and target in mm, and the direction that is up on the screen, each (3,)."""

    position: FloatArray
    target: FloatArray
    up: FloatArray


def viewpoint(points: FloatArray, frame: str, radius: float = 0.0, wall: FloatArray | None = None) -> Viewpoint:
    """An eye that sees the whole of the points with their bends spread out.

    The eye looks across the plane that fits the points best, from the patient's
    front where there is a choice; superior is up unless the eye looks along it, and
    then anterior is.

    Parameters
    ----------
    points : (n, 3) float array, mm
    frame : {"LPS", "mesh"}
    radius : float, mm
        Room to leave around the points.
    wall : (k, 3) float array, mm, optional
        Points of the wall; those near them, by the share `SURROUNDINGS` of their extent, are seen too: what the path leads
        into is not cut off, a lung about one short branch is.
    """
    seen = points if wall is None else np.concatenate([points, surroundings(points, wall)])
    target = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    reach = float(np.linalg.norm(seen - target, axis=1).max()) + radius
    _, spread, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    front = np.array([0.25, -1.0, 0.2]) if frame == "LPS" else np.array([0.35, -1.0, 0.45])
    # A path that hardly leaves one line has no plane worth facing.
    away = axes[2] if spread[1] > 0.03 * spread[0] else front
    away = away if away @ front >= 0.0 else -away
    away = away / np.linalg.norm(away) + 0.25 * front / np.linalg.norm(front)
    away /= np.linalg.norm(away)
    up = np.array([0.0, 0.0, 1.0]) if abs(away[2]) < 0.8 else np.array([0.0, -1.0 if frame == "LPS" else 1.0, 0.0])
    return Viewpoint(position=target + away * 1.02 * reach / np.sin(0.5 * FIELD_OF_VIEW), target=target, up=up)


def surroundings(points: FloatArray, wall: FloatArray) -> FloatArray:
    """Points of the wall within a `SURROUNDINGS` share of the points' extent of one of them, (k, 3) mm."""
    extent = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    gap = cKDTree(points).query(wall, distance_upper_bound=SURROUNDINGS * extent)[0]
    return np.asarray(wall[np.isfinite(gap)])


def blueprint(contents: Contents, eye: Viewpoint | None) -> rrb.Blueprint:
    """The layout: 3D and CT planes on the left, plots and words on the right, open at the last iteration."""
    scene = scene_view(
        SCENE_NAME,
        eye,
        contents=["$origin/**", f"- {at.CT}/**", f"- {at.WALK_CAMERA}/**", f"- {at.FILM}/**"],
        overrides={at.INSCRIBED: rrb.EntityBehavior(visible=False)},
    )
    tabs: list[rrb.View | rrb.Container] = [scene]
    if contents.has_camera:
        tabs.append(
            rrb.Spatial3DView(
                origin=at.CASE,
                name="From inside (timeline arc_length)",
                contents=[
                    f"{at.CASE}/anatomy/**",
                    f"{at.CASE}/path/**",
                    at.WALK,
                    at.WALK_CAMERA,
                    f"- {at.CAPS}/labels",
                ],
                background=rrb.Background(color=BACKGROUND),
                line_grid=False,
                eye_controls=rrb.EyeControls3D(tracking_entity=at.WALK_CAMERA),
                overrides={at.WALL: rr.Mesh3D.from_fields(albedo_factor=(*at.WALL_COLOR, 255))},
            )
        )
    if contents.has_ct:
        # Columns to the right and rows down, as the scanner drew them.
        slices = rrb.TensorSliceSelection(
            width=2, height=1, indices=[rr.TensorDimensionIndexSelection(dimension=0, index=contents.middle_slice)], slider=[0]
        )
        mapping = rrb.TensorScalarMapping(colormap="grayscale", mag_filter="linear")
        tabs.append(
            rrb.TensorView(
                origin=at.VOLUME,
                name="CT voxels",
                slice_selection=slices,
                scalar_mapping=mapping,
                view_fit="FillKeepAspectRatio",
            )
        )
    space: rrb.View | rrb.Container = rrb.Tabs(*tabs, active_tab=0) if len(tabs) > 1 else scene
    row: list[rrb.View | rrb.Container] = []
    if contents.has_ct:
        pixels = FIELD_MM / PIXEL_MM
        bounds = rrb.VisualBounds2D(x_range=(0.0, pixels), y_range=(0.0, pixels))
        row += [
            rrb.Spatial2DView(origin=f"{at.CT}/{plane}", name=f"CT, {plane}", background=(0, 0, 0), visual_bounds=bounds)
            for plane in at.PLANES
        ]
    if contents.has_film:
        row.append(rrb.Spatial2DView(origin=at.FILM, name="From the tip (timeline arc_length)", background=(0, 0, 0)))
    if row:
        below: list[rrb.View | rrb.Container] = [rrb.Horizontal(*row)]
        if contents.has_reformation:
            below.append(
                rrb.Spatial2DView(
                    origin=at.REFORMATION,
                    name="CT straightened along the path, two planes; lines: clearance asked for",
                    background=(0, 0, 0),
                )
            )
        space = rrb.Vertical(space, *below, row_shares=[7, 3] if len(below) == 1 else [6, 2.8, 2.2])
    limits = contents.limits
    plots = [
        bars_view(FlagKind.CLEARANCE, limits.clearance_min),
        bars_view(FlagKind.CURVATURE, limits.curvature_max),
        rrb.Tabs(
            # The name tells the colours: a legend would hide the last iterations, which matter most.
            _series(at.CONVERGENCE, "Convergence, 1 = limit: curvature (red), clearance (orange)", legend=False),
            _series(at.COUNTS, "Features", legend=True),
            active_tab=0,
        ),
    ]
    words: list[rrb.View | rrb.Container] = [
        rrb.TextDocumentView(origin=at.SUMMARY, name="Summary"),
        rrb.TextLogView(origin=at.DECISIONS, name="Decisions"),
    ]
    if contents.has_growth:
        words.append(
            rrb.BarChartView(
                origin=at.GROWTH,
                name="Grown volume, ml over HU limit (chosen green, leak red)",
                plot_legend=rrb.PlotLegend(visible=False),
            )
        )
    return folded(
        rrb.Horizontal(
            space,
            rrb.Vertical(*plots, rrb.Tabs(*words, active_tab=0), row_shares=[3, 3, 2.5, 4.2]),
            column_shares=[5, 4],
        ),
        timeline=at.ITERATION,
        fps=PLAY_FPS,
        play_state="following",
    )


def scene_view(
    name: str,
    eye: Viewpoint | None,
    *,
    origin: str = at.CASE,
    contents: Sequence[str] = ("$origin/**",),
    overrides: Mapping[str, Any] | None = None,
) -> rrb.Spatial3DView:
    """A 3D view as every recording has it: dark, without a grid, turned about what there is to see."""
    controls = None
    if eye is not None:
        controls = rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=eye.up)
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        contents=list(contents),
        background=rrb.Background(color=BACKGROUND),
        line_grid=False,
        eye_controls=controls,
        overrides=overrides,
    )


def folded(layout: rrb.Container, **time: Any) -> rrb.Blueprint:
    """A layout whose panels are folded away, so that the views have the window; `time` goes to the time panel."""
    return rrb.Blueprint(
        layout,
        rrb.TopPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", **time),
        auto_views=False,
        auto_layout=False,
    )


def bars_view(kind: FlagKind, limit: float) -> rrb.BarChartView:
    """The plot of one quantity over arc length; its name tells units and limit."""
    unit = "mm" if kind is FlagKind.CLEARANCE else "1/mm"
    name = f"{kind.value.capitalize()}, {unit} over arc length in mm (limit {limit:g})"
    return rrb.BarChartView(origin=f"{at.PROFILE}/{kind.value}", name=name, plot_legend=rrb.PlotLegend(visible=False))


def _series(origin: str, name: str, *, legend: bool) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=legend), axis_y=rrb.ScalarAxis(zoom_lock=False)
    )


def scene_axes(frame: str) -> rr.ViewCoordinates:
    """Names of the axes: LPS for a patient; a mesh file's own axes are shown with z up."""
    return rr.ViewCoordinates.LBU if frame == "LPS" else rr.ViewCoordinates.RIGHT_HAND_Z_UP
