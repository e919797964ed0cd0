"""Clinical measures of generated kidneys against their construction: anatomies, slice thicknesses, noise.

Strategy: two collecting systems are straight, so that angle, width and length follow from their plans in closed form.
The third is the curved one of the demonstration: its axes and radii are known, and where its infundibula leave the
pelvis is found on the exact lumen by its distances to the wall. All are scanned in the generated abdomen and measured through
their CTs, by the same settings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from skimage import measure

from segmentation.arrays import FloatArray
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.synthetic import PLAIN, SECOND, CollectingSystem, UrographySettings, straight_urography, urography
from segmentation.synthetic.collecting_system import PAPILLA_AHEAD, PAPILLA_RADIUS, collecting_system
from segmentation.synthetic.urography_straight import CalyxTruth, InfundibulumTruth, degrees_between
from segmentation.volume import Volume
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.cases.measures import MeasureCase
from tubeplan_viz.measures import Lumen, UrinaryMeasures
from tubeplan_viz.pipeline import grow_tree
from tubeplan_viz.pipeline.measures import measured_urinary

ANGLE_DEG, LENGTH_MM, WIDTH_MM = 2.0, 0.5, 0.3
SLICES_MM = (1.0, 0.8, 0.6)
NOISE_HU = 50.0
ANATOMIES = ("plain", "second", "curved")
# The field of view: one kidney and 40 mm of its ureter.
LOW, SIZE, PIXEL_MM = (6.0, -24.0, -64.0), (96.0, 84.0, 122.0), 0.75
PLATEAU, LEVEL_MM, GRID_MM = 0.85, 40.0, 0.4


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """A generated kidney: its measures as the product finds them, and as it was built."""

    lumen: Lumen
    measures: UrinaryMeasures
    truth: tuple[InfundibulumTruth, ...]

    def value(self, key: str, of: str) -> float:
        """The only measure of a kind for a part; NaN where it was not computable."""
        (found,) = [one for one in self.measures.measures if one.key == key and one.of == of]
        return np.nan if found.value is None else found.value

    def errors(self) -> dict[tuple[str, str], float]:
        """How far each measure is off, by figure and part: degrees or mm."""
        marks = self.measures.drawing.points
        bottoms = {name.removeprefix("bottom of "): point for name, point in marks.items() if name.startswith("bottom of ")}
        off = {}
        for infundibulum in self.truth:
            homes = set()
            for calyx in infundibulum.calyces:
                label = min(bottoms, key=lambda name: float(np.linalg.norm(bottoms[name] - calyx.bottom)))
                of = next(one.of for one in self.measures.measures if one.of.startswith(f"calyx {label}, "))
                off["length", calyx.name] = self.value("infundibular_length_mm", of) - calyx.length
                homes.add(of.partition(", ")[2])
            of = f"{min(homes)} infundibulum" if len(homes) == 1 else ""
            named = {"angle": infundibulum.angle_deg, "coronal angle": infundibulum.coronal_deg, "width": infundibulum.width}
            keys = ("infundibulopelvic_angle_deg", "infundibulopelvic_angle_coronal_deg", "infundibular_width_mm")
            for (figure, true), key in zip(named.items(), keys, strict=True):
                off[figure, infundibulum.name] = self.value(key, of) - true if of else np.nan
        return off


def measures(*, quick: bool = False, notify: Callable[[str, int, int], None] | None = None) -> list[Row]:
    """Largest error of each measure on each generated kidney; `quick` leaves out the slices between the extremes."""
    cases = [
        (anatomy, slice_mm, noise)
        for anatomy in ANATOMIES
        for slice_mm in (SLICES_MM[::2] if quick else SLICES_MM)
        for noise in (False, True)
    ]
    rows: list[Row] = []
    for number, (anatomy, slice_mm, noise) in enumerate(cases):
        if notify is not None:
            notify("measures", number, len(cases))
        case = f"{anatomy}, {slice_mm:g} mm slices{f', +-{NOISE_HU:g} HU' if noise else ''}"
        rows += error_rows(case, measured(anatomy, slice_mm, noise=noise).errors())
    return rows


def error_rows(case: str, off: dict[tuple[str, str], float]) -> Iterator[Row]:
    """The largest error of each figure against its limit."""
    for figure, limit in (("angle", ANGLE_DEG), ("coronal angle", ANGLE_DEG), ("length", LENGTH_MM), ("width", WIDTH_MM)):
        unit = "degrees" if "angle" in figure else "mm"
        mine = {part: value for (kind, part), value in off.items() if kind == figure}
        part = max(mine, key=lambda name: np.inf if np.isnan(mine[name]) else abs(mine[name]))
        yield Row(
            case=case,
            figure=f"{figure} error of {len(mine)} parts, largest ({part}) {unit}",
            ours=mine[part],
            source="the construction",
            target=f"at most {limit:g} {unit}",
            holds=bool(abs(mine[part]) <= limit),
        )


def measured(anatomy: str, slice_mm: float, *, noise: bool) -> Measured:
    """Scan, segment and measure one generated kidney."""
    settings = kidney_view(slice_mm)
    if anatomy == "curved":
        made = urography(settings=settings)
        volume, truth = made.volume, curved_truth()
    else:
        plan, seed = (PLAIN, 11) if anatomy == "plain" else (SECOND, 77)
        volume, system = straight_urography(plan, seed=seed, right=anatomy == "second", settings=settings)
        truth = system.infundibula
    if noise:
        volume = noisy(volume)
    region = segment_lumen(volume, SegmentationSettings(anatomy="urinary"))
    tree = grow_tree(lumen_surface(volume, region, SurfaceSettings()).surface)
    lumen, found = measured_urinary(tree, MeasureCase(), volume)
    if lumen is None or found is None:
        raise ValueError(f"the {anatomy} kidney has no branches")
    return Measured(lumen=lumen, measures=found, truth=truth)


def kidney_view(slice_mm: float) -> UrographySettings:
    """A scan of one kidney alone."""
    spacing = (slice_mm, PIXEL_MM, PIXEL_MM)
    slices, rows, columns = (int(np.ceil(size / step)) for size, step in zip(SIZE[::-1], spacing, strict=True))
    return UrographySettings(shape=(slices, rows, columns), spacing=spacing, first_voxel=LOW)


def noisy(volume: Volume) -> Volume:
    """The volume with up to `NOISE_HU` more or less in every voxel, evenly distributed."""
    noise = np.random.default_rng(1).uniform(-NOISE_HU, NOISE_HU, volume.voxels.shape)
    return Volume(np.clip(np.rint(volume.voxels + noise), -1024, 3071).astype(np.int16), volume.index_to_lps)


@cache
def curved_truth() -> tuple[InfundibulumTruth, ...]:
    """The measures of the demonstration's exact lumen; it is the same in every scan."""
    system = collecting_system(LOW[2])
    branches = {branch.name: branch for branch in system.branches}
    trunk = branches["ureter and pelvis"]
    centers, radii = pelvis_balls(system)
    middle = centers.mean(axis=0)
    away = np.linalg.norm(trunk.points - middle, axis=1)
    down = trunk.points[np.flatnonzero(away >= LEVEL_MM)[-1]] - middle  # points are 1 mm apart: 0.1 degrees
    flat = np.array([1.0, 0.0, 1.0])
    found = []
    for name in ("upper", "middle", "lower"):
        branch = branches[name]
        level = (np.linalg.norm(branch.points[:, None] - centers, axis=2) - radii).min(axis=1)
        k = int(np.flatnonzero(level <= 0.0)[-1])
        lip = branch.points[k] + level[k] / (level[k] - level[k + 1]) * (branch.points[k + 1] - branch.points[k])
        line = np.vstack([lip, branch.points[k + 1 :]])
        axis = np.linalg.svd(line - line.mean(axis=0))[2][0]
        axis = axis if axis @ (line[-1] - line[0]) > 0 else -axis
        calyces = []
        for calyx in system.branches:
            if calyx.name.startswith(f"{name} "):
                heading = calyx.points[-1] - calyx.points[-3]
                bottom = calyx.points[-1] + (PAPILLA_AHEAD - PAPILLA_RADIUS) * heading / np.linalg.norm(heading)
                calyces.append(CalyxTruth(name=calyx.name, bottom=bottom, length=float(np.linalg.norm(bottom - lip))))
        found.append(
            InfundibulumTruth(
                name=name,
                angle_deg=degrees_between(down, axis),
                coronal_deg=degrees_between(down * flat, axis * flat),
                width=2.0 * float(branch.radii[k:].min()),
                lip=lip,
                calyces=tuple(calyces),
            )
        )
    return tuple(found)


def pelvis_balls(system: CollectingSystem) -> tuple[FloatArray, FloatArray]:
    """Balls of the exact pelvis that are nearly as large as its largest: centres (k, 3) and radii (k,), mm.

    The wall is where the clearance of the construction is zero, interpolated between places `GRID_MM` apart: to the nearest
    corner of it the distance is too long by GRID_MM^2 / 4 r at most, 0.01 mm.
    """
    low, high = np.array([34.0, 10.0, -18.0]), np.array([58.0, 32.0, 10.0])
    grid = np.stack(np.meshgrid(*(np.arange(a, b, GRID_MM) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1)
    clearance = system.clearance(grid.reshape(-1, 3)).reshape(grid.shape[:-1])
    corners = measure.marching_cubes(clearance, 0.0, spacing=(GRID_MM,) * 3)[0] + low
    inside = clearance > 0.0
    deep = np.zeros(grid.shape[:-1])
    deep[inside] = cKDTree(corners).query(grid[inside])[0]
    labels, _ = ndimage.label(deep >= PLATEAU * deep.max())
    kept = labels == labels.flat[deep.argmax()]
    return grid[kept], deep[kept]
