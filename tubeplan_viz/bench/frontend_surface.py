"""Surfaces of the front end against closed forms: error of smoothing and decimation on a bent tube, beside usual ways."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from segmentation.isosurface import isosurface, signed_volume
from segmentation.leak import LeakRule
from segmentation.mesh import Surface
from segmentation.region_growing import GrowthSettings, Region, grow
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.surface_smoothing import edges
from segmentation.volume import Volume
from tubeplan_viz.bench.frontend_volumes import AIR, TISSUE, BentTube, bent_tube
from tubeplan_viz.bench.rows import Row, under

# Voxels of a thin-slice CT and of a coarse one, mm; the tube's radius is 3 mm.
VOXELS = (0.7, 1.2)
# Shares of a voxel: what a straight edge between two grey values gets right, with the staircase left over.
MEAN_MAX, LARGEST_MAX = 0.05, 0.25
VOLUME_CHANGE = 0.1
# Decimated to a quarter the facets themselves stand off a round wall.
DECIMATED_MEAN_MAX = 0.1
MEASURED_BEFORE = "VTK windowed sinc on a stair mesh, measured before"
VTK_ERROR = 0.025


def surface_error_rows() -> list[Row]:
    """Distances of the wall's vertices to the exact wall, and volume, for two voxel sizes; usual ways on the mask beside."""
    rows: list[Row] = []
    for voxel in VOXELS:
        rows += tube_rows(bent_tube(voxel), voxel)
    return rows


def tube_rows(tube: BentTube, voxel: float) -> list[Row]:
    """Rows of one tube."""
    case = f"bent tube of radius {tube.radius:g} mm, voxels of {voxel:g} mm"
    third = np.cross(tube.normal, tube.start)
    middle = tube.center + tube.bend * (np.cos(0.5 * tube.angle) * tube.start + np.sin(0.5 * tube.angle) * third)
    index = np.round(tube.volume.to_index(middle)).astype(int)
    half = 0.5 * (AIR + TISSUE)
    rule = LeakRule(volume_min=0.1, volume_max=100.0, jump=10.0)
    region = grow(
        tube.volume,
        (int(index[0]), int(index[1]), int(index[2])),
        GrowthSettings(hu_min=-1024.0, hu_max=half, varied=None, leak=rule),
    )
    raw = isosurface(tube.volume, region)
    surface = lumen_surface(tube.volume, region, SurfaceSettings()).surface
    few = lumen_surface(tube.volume, region, SurfaceSettings(faces_max=len(surface.faces) // 4)).surface
    gap, few_gap = np.abs(tube.distance(surface.vertices)), np.abs(tube.distance(few.vertices))
    change = 100.0 * (signed_volume(surface.vertices, surface.faces) / signed_volume(raw.vertices, raw.faces) - 1.0)
    rows = [
        Row(
            case=case,
            figure="wall error mm, mean",
            ours=float(gap.mean()),
            reference=VTK_ERROR,
            source=MEASURED_BEFORE,
            target=f"under {MEAN_MAX:g} voxels",
            holds=bool(gap.mean() < MEAN_MAX * voxel),
        ),
        Row(
            case=case,
            figure="wall error mm, largest",
            ours=float(gap.max()),
            target=f"under {LARGEST_MAX:g} voxels",
            holds=bool(gap.max() < LARGEST_MAX * voxel),
        ),
        under(case, "volume changed by smoothing %", abs(change), VOLUME_CHANGE),
        closed_row(case, surface),
        closed_row(f"{case}, a quarter of the faces", few),
        Row(
            case=f"{case}, a quarter of the faces",
            figure="wall error mm, mean",
            ours=float(few_gap.mean()),
            target=f"under {DECIMATED_MEAN_MAX:g} voxels",
            holds=bool(few_gap.mean() < DECIMATED_MEAN_MAX * voxel),
        ),
    ]
    for name, points in usual_ways(tube.volume, region).items():
        error = np.abs(tube.distance(points))
        figures = (("wall error mm, mean", gap.mean(), error.mean()), ("wall error mm, largest", gap.max(), error.max()))
        for figure, mine, theirs in figures:
            rows.append(Row(case=case, figure=figure, ours=float(mine), reference=float(theirs), source=f"{name}, this run"))
    return rows


def usual_ways(volume: Volume, region: Region) -> dict[str, FloatArray]:
    """Vertices that marching cubes of the mask and a smoothing filter give, (n, 3) mm each; only what is installed."""
    cubes = import_module("skimage.measure").marching_cubes
    vertices, faces, _, _ = cubes(np.pad(region.mask, 1).astype(np.float32), 0.5)
    points = volume.to_lps(vertices - 1.0 + np.array(region.lower))
    trimesh = import_module("trimesh")
    made: dict[str, FloatArray] = {}
    filters: dict[str, Callable[[object], object]] = {
        "mask and trimesh Taubin": trimesh.smoothing.filter_taubin,
        "mask and trimesh Humphrey": trimesh.smoothing.filter_humphrey,
    }
    for name, smooth in filters.items():
        mesh = trimesh.Trimesh(points, faces, process=False)
        smooth(mesh)
        made[name] = np.asarray(mesh.vertices, dtype=np.float64)
    if find_spec("vtkmodules") is not None:
        made["mask and VTK windowed sinc"] = windowed_sinc(points, faces)
    return made


def windowed_sinc(points: FloatArray, faces: IntArray) -> FloatArray:
    """VTK's windowed sinc filter of 20 rounds at its pass band of 0.1, as 3D Slicer smooths segments, (n, 3) mm."""
    core, data = import_module("vtkmodules.vtkFiltersCore"), import_module("vtkmodules.vtkCommonDataModel")
    common, support = import_module("vtkmodules.vtkCommonCore"), import_module("vtkmodules.util.numpy_support")
    places, cells = common.vtkPoints(), data.vtkCellArray()
    places.SetData(support.numpy_to_vtk(np.ascontiguousarray(points)))
    offsets = np.arange(0, 3 * len(faces) + 1, 3, dtype=np.int64)
    cells.SetData(
        support.numpy_to_vtkIdTypeArray(offsets, deep=True),
        support.numpy_to_vtkIdTypeArray(np.ascontiguousarray(faces, dtype=np.int64).ravel(), deep=True),
    )
    mesh = data.vtkPolyData()
    mesh.SetPoints(places)
    mesh.SetPolys(cells)
    smooth = core.vtkWindowedSincPolyDataFilter()
    smooth.SetInputData(mesh)
    smooth.SetNumberOfIterations(20)
    smooth.SetPassBand(0.1)
    smooth.NormalizeCoordinatesOn()
    smooth.Update()
    return np.asarray(support.vtk_to_numpy(smooth.GetOutput().GetPoints().GetData()), dtype=np.float64)


def closed_row(case: str, surface: Surface) -> Row:
    """Whether every edge has exactly two faces that walk it in opposite directions."""
    loose = loose_edges(surface.faces)
    return Row(case=case, figure="edges without exactly two faces", ours=loose, target="0", holds=loose == 0)


def loose_edges(faces: IntArray) -> int:
    """Edges that are not walked once in each direction."""
    walks = edges(faces)
    size = int(walks.max()) + 1
    forth, count = np.unique(walks[:, 0] * size + walks[:, 1], return_counts=True)
    back = walks[:, 1] * size + walks[:, 0]
    return int(np.count_nonzero((count > 1) | ~np.isin(forth, back)))
