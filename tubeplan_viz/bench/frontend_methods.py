"""The ways from files to voxels, from voxels to a region and from a region to triangles that are compared.

Run as a process of its own, ``python -P frontend_methods.py STEP METHOD FOLDER OUT``, it imports only what one method
needs, so that the memory of one is not counted with another, goes its way `RUNS` times and writes the result, the
CPU seconds of each run and the peak memory.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from segmentation.arrays import BoolArray, IntArray, VoxelArray
from tubeplan_viz.memory import peak_memory

if TYPE_CHECKING:
    from segmentation.region_growing import GrowthSettings, Region
    from segmentation.volume import Volume

RUNS = {"read": 2, "grow": 3, "surface": 2, "whole": 1}
OURS = "tubeplan"
Result = dict[str, Any]
Way = Callable[[Path, dict[str, Any]], Callable[[], Result]]


def read_ours(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """The project's own reader, its gate and checksums included."""
    from segmentation.images import read_ct

    def run() -> Result:
        volume = read_ct(Path(given["ct"])).volume
        # Slices from below upwards, as the peers have them.
        return {"digest": digest(volume.voxels if volume.index_to_lps[2, 0] > 0 else volume.voxels[::-1])}

    return run


def read_simpleitk(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """SimpleITK's series reader (GDCM)."""
    sitk = import_module("SimpleITK")

    def run() -> Result:
        reader = sitk.ImageSeriesReader()
        reader.SetFileNames(reader.GetGDCMSeriesFileNames(given["ct"]))
        return {"digest": digest(sitk.GetArrayFromImage(reader.Execute()).astype(np.int16))}

    return run


def read_pydicom(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """The loop that most scripts have: parse, sort by position, rescale."""
    pydicom = import_module("pydicom")

    def run() -> Result:
        slices = [pydicom.dcmread(file) for file in sorted(Path(given["ct"]).iterdir()) if file.is_file()]
        slices.sort(key=lambda each: float(each.ImagePositionPatient[2]))
        voxels = np.empty((len(slices), slices[0].Rows, slices[0].Columns), dtype=np.int16)
        for out, each in zip(voxels, slices, strict=True):
            out[...] = each.pixel_array * float(each.RescaleSlope) + float(each.RescaleIntercept)
        return {"digest": digest(voxels)}

    return run


def digest(voxels: VoxelArray) -> str:
    """Of the HU from -1024 on: what lies below is padding, and is written as it comes by the peers."""
    return hashlib.sha256(np.maximum(voxels, -1024).tobytes()).hexdigest()


def loaded(folder: Path) -> VoxelArray:
    """The volume's voxels."""
    return np.asarray(np.load(folder / "voxels.npy"))


def grow_ours(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """The project's growing at fixed limits, or with the search where one limit is automatic."""
    from segmentation.region_growing import grow
    from segmentation.volume import Volume

    volume = Volume(loaded(folder), np.load(folder / "matrix.npy"))
    settings = growth(given)

    def run() -> Result:
        region = grow(volume, tuple(given["seed"]), settings)
        return {"mask": region.mask, "lower": np.array(region.lower), "hu_min": region.hu_min, "hu_max": region.hu_max}

    return run


def growth(given: dict[str, Any]) -> GrowthSettings:
    """Settings of a case; `varied` is null for fixed limits."""
    from segmentation.leak import LeakRule
    from segmentation.region_growing import GrowthSettings

    rule = LeakRule(**given["leak"])
    return GrowthSettings(
        hu_min=given["hu_min"], hu_max=given["hu_max"], varied=given["varied"], leak=rule, smoothing=given["smoothing"]
    )


def grower(flood: Callable[[VoxelArray, tuple[int, int, int], float, float], BoolArray]) -> Way:
    """A peer's growing between two limits, to the mask of the whole volume; smoothed by scipy first where ours smooths."""

    def way(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
        voxels = loaded(folder)
        seed, low, high = tuple(given["seed"]), given["hu_min"], given["hu_max"]
        if given["smoothing"] == 0:
            return lambda: {"mask": flood(voxels, seed, low, high)}
        sigmas = given["smoothing"] / np.linalg.norm(np.load(folder / "matrix.npy")[:3, :3], axis=0)

        def run() -> Result:
            # In eighths of a HU, as ours; the same Gaussian, over the whole volume.
            smooth = np.clip(voxels, -1024, 3071) * np.int16(8)
            import_module("scipy.ndimage").gaussian_filter(smooth, sigmas, output=smooth, mode="nearest", truncate=3.0)
            return {"mask": flood(smooth, seed, np.floor(8.0 * low), np.floor(8.0 * high))}

        return run

    return way


def flood_skimage(voxels: VoxelArray, seed: tuple[int, int, int], low: float, high: float) -> BoolArray:
    """scikit-image: flood of the thresholded volume."""
    flood = import_module("skimage.segmentation").flood
    return np.asarray(flood((voxels >= low) & (voxels <= high), seed, connectivity=1))


def flood_scipy(voxels: VoxelArray, seed: tuple[int, int, int], low: float, high: float) -> BoolArray:
    """scipy: all parts labelled, the seed's taken."""
    labels, _ = import_module("scipy.ndimage").label((voxels >= low) & (voxels <= high))
    return np.asarray(labels == labels[seed])


def flood_cc3d(voxels: VoxelArray, seed: tuple[int, int, int], low: float, high: float) -> BoolArray:
    """connected-components-3d: all parts labelled, the seed's taken."""
    labels = import_module("cc3d").connected_components((voxels >= low) & (voxels <= high), connectivity=6)
    return np.asarray(labels == labels[seed])


def flood_simpleitk(voxels: VoxelArray, seed: tuple[int, int, int], low: float, high: float) -> BoolArray:
    """SimpleITK: ConnectedThreshold."""
    sitk = import_module("SimpleITK")
    image = sitk.ConnectedThreshold(sitk.GetImageFromArray(voxels), [tuple(int(i) for i in seed[::-1])], low, high)
    return np.asarray(sitk.GetArrayFromImage(image) > 0)


def given_region(folder: Path) -> tuple[Volume, Region]:
    """The volume and the region that was grown in it."""
    from segmentation.region_growing import Region
    from segmentation.volume import Volume

    with np.load(folder / "region.npz") as found:
        region = Region(
            mask=found["mask"],
            lower=triple(found["lower"]),
            seed=triple(found["seed"]),
            hu_min=float(found["hu_min"]),
            hu_max=float(found["hu_max"]),
            volume_ml=0.0,
            border={},
            smoothing=float(found["smoothing"]),
        )
    return Volume(loaded(folder), np.load(folder / "matrix.npy")), region


def triple(numbers: IntArray) -> tuple[int, int, int]:
    """Three whole numbers as Python has them."""
    first, second, third = (int(number) for number in numbers)
    return first, second, third


def surface_ours(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """Field and triangles of the region."""
    from segmentation.isosurface import isosurface
    from segmentation.region_growing import Region

    volume, region = given_region(folder)

    def run() -> Result:
        # A region keeps what was worked out of it: another one for each run.
        fresh = Region(**{name: getattr(region, name) for name in region.__dataclass_fields__})
        return {"faces": len(isosurface(volume, fresh).faces)}

    return run


def surface_skimage(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """scikit-image's marching cubes (Lewiner) of the finished field."""
    cubes = import_module("skimage.measure").marching_cubes
    field = np.load(folder / "field.npy")
    return lambda: {"faces": len(cubes(field, 0.0)[1])}


def surface_vtk(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """VTK's flying edges of the finished field, on one thread as its wheels have it."""
    core, support = import_module("vtkmodules.vtkFiltersCore"), import_module("vtkmodules.util.numpy_support")
    data = import_module("vtkmodules.vtkCommonDataModel")
    field = np.load(folder / "field.npy")

    def run() -> Result:
        image = data.vtkImageData()
        image.SetDimensions(*field.shape[::-1])
        image.GetPointData().SetScalars(support.numpy_to_vtk(field.ravel()))
        made = core.vtkFlyingEdges3D()
        made.SetInputData(image)
        made.SetValue(0, 0.0)
        made.ComputeNormalsOff()
        made.Update()
        return {"faces": int(made.GetOutput().GetNumberOfPolys())}

    return run


def whole_ours(folder: Path, given: dict[str, Any]) -> Callable[[], Result]:
    """From files to the smoothed, closed surface, with the seconds of each stage."""
    from segmentation.images import read_ct
    from segmentation.lumen import SegmentationSettings, segment_lumen
    from segmentation.surface import SurfaceSettings, lumen_surface

    def run() -> Result:
        times = [(time.process_time(), time.perf_counter())]
        image = read_ct(Path(given["ct"]))
        times.append((time.process_time(), time.perf_counter()))
        region = segment_lumen(image.volume, SegmentationSettings(anatomy=given["anatomy"]))
        times.append((time.process_time(), time.perf_counter()))
        made = lumen_surface(image.volume, region, SurfaceSettings())
        times.append((time.process_time(), time.perf_counter()))
        return {
            "stages": np.diff(np.array(times), axis=0),
            "faces": made.surface.faces,
            "volume_ml": region.volume_ml,
            "deviation": made.deviation.mean,
            "voxels": image.volume.voxels.size,
        }

    return run


WAYS: dict[str, dict[str, Way]] = {
    "read": {OURS: read_ours, "SimpleITK series reader": read_simpleitk, "pydicom loop": read_pydicom},
    "grow": {
        OURS: grow_ours,
        "scikit-image flood": grower(flood_skimage),
        "scipy label": grower(flood_scipy),
        "SimpleITK ConnectedThreshold": grower(flood_simpleitk),
        "cc3d": grower(flood_cc3d),
    },
    "surface": {
        OURS: surface_ours,
        "scikit-image marching cubes": surface_skimage,
        "VTK flying edges": surface_vtk,
    },
    "whole": {OURS: whole_ours},
}
# Modules that a way needs beyond the project's own.
NEEDS = {"cc3d": "cc3d", "VTK flying edges": "vtkmodules"}


def main(step: str, method: str, folder: str, out: str) -> None:
    """Go one way and write what it found and took."""
    place = Path(folder)
    run = WAYS[step][method](place, json.loads((place / "given.json").read_text()))
    loaded_peak, seconds, walls = peak_memory(), [], []
    found: Result = {}
    for _ in range(RUNS[step]):
        begun, clock = time.process_time(), time.perf_counter()
        found = run()
        seconds.append(time.process_time() - begun)
        walls.append(time.perf_counter() - clock)
    peak = peak_memory()
    if "mask" in found:
        found |= {"mask": np.packbits(found["mask"]), "shape": np.array(found["mask"].shape)}
    np.savez(out, seconds=seconds, walls=walls, peak=peak, loaded=loaded_peak, **found)


if __name__ == "__main__":
    main(*sys.argv[1:])
