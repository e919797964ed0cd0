"""Rows of tubeplan bench centerline: curvature at scale of lines with a known least radius, drawn and scanned."""

# Strategy: arcs, helices and double bends have a least radius in closed form. Drawn lines carry the noise of a centerline:
# correlated over about a voxel. Scanned ones go the whole way: a tube about the axis in voxels, blurred and
# noisy as a scanner makes them, grown, meshed and traced as a user's CT is.

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from segmentation.arrays import FloatArray
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.synthetic.scanner import ScannerSettings, scan
from segmentation.volume import Volume
from tubeplan_viz.bench.axes import Axis
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.centerline import curvature_at_scale, trace_centerline, voronoi_graph
from tubeplan_viz.geometry import WallDistance

# Standard deviation and correlation length of a centerline's error in mm: a wall segmented
# from voxels of 0.7 mm is off by 0.1 to 0.2 mm, and the middle averages over a dozen places around it.
NOISE, CORRELATION, SPACING = 0.05, 0.8, 0.5
DRAWN = 5
STRAIGHT = (40.0, 80.0, 150.0)
# Edge of a voxel and radius of the tube, mm; HU of contrast medium in it and of what is around it.
VOXEL, RADIUS, INSIDE, AROUND = 0.7, 2.5, 220.0, 40.0
# The line is read so far from the ends of the tube, where its wall is round, in radii.
OFF_END = 2.0
MEDIAN, P95, LEAST_STRAIGHT = 0.05, 0.10, 500.0


def axis_of(*pieces: tuple[float, float, float]) -> Axis:
    """An axis from the origin, along no axis of the voxels; pieces are (length mm, curvature 1/mm, torsion 1/mm)."""
    return Axis(pieces, np.zeros(3), Rotation.from_rotvec([0.4, 0.7, -0.3]).as_matrix())


def bent_axes() -> list[tuple[Axis, float]]:
    """Arcs of 5 to 100 mm, helices and double bends with their least radius, mm."""
    arcs = [(axis_of((min(1.6 * r, 90.0), 1.0 / r, 0.0)), r) for r in (5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, 70.0, 100.0)]
    helices = [(axis_of((80.0, 1.0 / r, t)), r) for r, t in ((8.0, 0.03), (16.0, 0.03), (30.0, 0.02), (60.0, 0.01))]
    bends = [
        (axis_of((0.5 * np.pi * r, 1.0 / r, 0.0), (0.65 * np.pi * r, -1.0 / (1.3 * r), 0.0)), r)
        for r in (6.0, 8.0, 12.0, 20.0, 40.0)
    ]
    return [*arcs, *helices, *bends]


def drawn(axis: Axis, rng: np.random.Generator) -> FloatArray:
    """Points on an axis with a centerline's noise, (n, 3) mm."""
    s = np.arange(0.0, axis.length, SPACING)
    noise = gaussian_filter1d(rng.normal(0.0, 1.0, (len(s), 3)), CORRELATION / SPACING, axis=0)
    return np.asarray(axis.at(s)[0] + NOISE * noise / noise.std())


def scanned(axis: Axis, radius: float, rng: np.random.Generator) -> FloatArray:
    """The centerline of a scanned tube about an axis, from one place on the axis to another, (n, 3) mm.

    The tube is longer than the axis by its ends, which are not read.
    """
    margin = OFF_END * radius
    first, frame = axis.at(np.array([0.0, axis.length]))
    s = np.linspace(0.0, axis.length, int(np.ceil(axis.length / 0.1)) + 1)
    before = first[0] - np.arange(margin, 0.0, -0.1)[:, None] * frame[0, :, 0]
    after = first[1] + np.arange(0.1, margin, 0.1)[:, None] * frame[1, :, 0]
    points = np.concatenate([before, axis.at(s)[0], after])
    low = points.min(axis=0) - radius - 6.0 * VOXEL
    shape = np.ceil((points.max(axis=0) + radius + 6.0 * VOXEL - low) / VOXEL).astype(int)
    index_to_lps = np.diag([VOXEL, VOXEL, VOXEL, 1.0])
    index_to_lps[:3, 3] = low
    grid = low + VOXEL * np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)
    outside = cKDTree(points).query(grid)[0].reshape(shape) - radius
    hu = AROUND + (INSIDE - AROUND) * np.clip(0.5 - outside / VOXEL, 0.0, 1.0)
    image = scan(hu, (VOXEL, VOXEL, VOXEL), ScannerSettings(), rng=rng)
    volume = Volume(np.rint(image).astype(np.int16), index_to_lps)
    x, y, z = (float(v) for v in points[len(points) // 2])
    settings = SegmentationSettings(anatomy="generic", seed_point=(x, y, z), hu_min=0.5 * (INSIDE + AROUND))
    surface = lumen_surface(volume, segment_lumen(volume, settings), SurfaceSettings()).surface
    wall = WallDistance(surface)
    line = trace_centerline(voronoi_graph(surface, wall), wall, first[0], first[1])
    assert line is not None
    return np.asarray(line.points)


def curvature_rows() -> list[Row]:
    """Least radius of drawn and scanned lines beside the truth."""
    rng = np.random.default_rng(11)
    rows: list[Row] = []
    bent = bent_axes()
    kinds = {
        f"{len(bent)} drawn lines, {DRAWN} times": [(drawn(axis, rng), r) for axis, r in bent for _ in range(DRAWN)],
        f"{len(bent)} scanned tubes": [(scanned(axis, min(RADIUS, 0.4 * r), rng), r) for axis, r in bent],
    }
    for kind, lines in kinds.items():
        errors = [abs(curvature_at_scale(points).least_radius / truth - 1.0) for points, truth in lines]
        case = f"{kind}: arcs of 5 to 100 mm, helices, double bends"
        for figure, value, limit in (("median", np.median(errors), MEDIAN), ("95th percentile", np.quantile(errors, 0.95), P95)):
            rows.append(
                Row(
                    case=case,
                    figure=f"error of the least radius %, {figure}",
                    ours=100.0 * float(value),
                    source="closed form",
                    target=f"under {100.0 * limit:g}",
                    holds=bool(value < limit),
                )
            )
    straight = [axis_of((length, 0.0, 0.0)) for length in STRAIGHT]
    read = chain(
        ((f"drawn line of {axis.length:g} mm", drawn(axis, rng)) for axis in straight),
        ((f"scanned tube of {axis.length:g} mm", scanned(axis, RADIUS, rng)) for axis in straight),
    )
    for name, points in read:
        radius = curvature_at_scale(points).least_radius
        rows.append(
            Row(
                case=f"straight, {name}",
                figure="least radius read mm",
                ours=radius,
                target=f"over {LEAST_STRAIGHT:g}",
                holds=bool(radius > LEAST_STRAIGHT),
            )
        )
    return rows
