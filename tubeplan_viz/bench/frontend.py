"""tubeplan bench frontend: CT to region to surface, beside the peers that are installed, on the same volumes in one run."""

# Strategy: each way runs in a process of its own, the same task on the same voxels, and is timed in processor
# seconds, the best of a few runs. Peers get their task ready made (the limits known, the image smoothed, the field finished);
# ours is what the project does, checks included. A peer that is not installed has no rows.

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray
from segmentation.images import read_ct
from segmentation.isosurface import lumen_field
from segmentation.lumen import PRESETS, SegmentationSettings, segment_lumen
from segmentation.region_growing import GrowthSettings, Region, grow
from segmentation.smoothing import HU_HIGHEST, HU_LOWEST, STEPS_PER_HU, GrowingVoxels
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.volume import Volume
from tubeplan_viz.bench.frontend_cases import MANY, ORDINARY, REAL, SMALL, CtCase, generated_chest, generated_urography, real_ct
from tubeplan_viz.bench.frontend_surface import closed_row, surface_error_rows
from tubeplan_viz.bench.frontend_volumes import LUNG_AT
from tubeplan_viz.bench.frontend_worker import OURS, UNNOTICED, Trial, against, equal, installed, tried
from tubeplan_viz.bench.rows import Row, under
from tubeplan_viz.pipeline import Notify

# Growing by the least peer is a threshold and one pass in C; ours looks for the region's box first.
GROWING = 1.5
# The search is one rising flood: it must beat a flood for every limit by far.
SEARCHING = 0.2
# Ours reads every header for a gate first and checks pixels for damage, and takes checksums; a loop does not. It may always
# take these seconds for each slice.
READING, READING_SLICE = 3.0, 0.005
# Ours fills voids, makes the field that the peers are given, and brings its triangles into the patient's axes. VTK's flying edges
# are several times as quick as any marching cubes, and take half a gigabyte to install: shown, not aimed at.
TRIANGLES = 4.0
CUBES = "scikit-image marching cubes"
# MB that no laptop feels.
UNFELT = 20.0
LUNG_LIMIT, WHOLE_IMAGE = -700.0, 1e6  # HU, ml
FLOOD = "scikit-image flood"


def frontend(*, quick: bool, notify: Notify) -> list[Row]:
    """Reading, growing, the leak search, surfaces and the whole, for generated and real CT.

    Parameters
    ----------
    quick : bool
        A small generated chest and the surfaces against closed forms only.
    notify : Notify
    """
    notify("surfaces against closed forms", 0, 0)
    rows = surface_error_rows()
    if quick:
        with generated_chest(SMALL, 3.0, 350.0) as case:
            return [*rows, *case_rows(case, notify)]
    with generated_chest(ORDINARY, 6.0, 500.0) as case:
        rows += case_rows(case, notify)
    with generated_urography() as case:
        rows += case_rows(case, notify)
    for name in REAL:
        at_hand: AbstractContextManager[CtCase | None] = real_ct(name)
        with at_hand as found:
            if found is None:
                rows.append(
                    Row(case=name, figure="at hand", ours=0.0, source="skipped: no ../shared/data beside the source tree")
                )
            else:
                rows += case_rows(found, notify)
    with generated_chest(MANY, 12.0, 800.0) as case:
        notify(f"{case.name}, whole", 0, 0)
        with TemporaryDirectory() as place:
            rows += whole_rows(case, Path(place))
    return rows


def case_rows(case: CtCase, notify: Notify) -> list[Row]:
    """All rows of one CT."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        notify(f"{case.name}, whole", 0, 0)
        rows = whole_rows(case, folder)
        notify(f"{case.name}, reading", 0, 0)
        rows += reading_rows(case, folder)
        volume = read_ct(case.path).volume
        region = segment_lumen(volume, SegmentationSettings(anatomy=case.anatomy))
        notify(f"{case.name}, growing", 0, 0)
        rows += lumen_rows(case, volume, region, folder)
        if case.told is not None:
            (number, row, column), limit, voxels = case.told
            # Described from below upwards; a series may be held the other way round.
            seed = (number if volume.index_to_lps[2, 0] > 0 else len(volume.voxels) - 1 - number, row, column)
            found = grow(volume, seed, fixed(case, -1024.0, limit, 0.0)).mask.sum()
            figure = f"voxels up to {limit:g} HU from the described seed"
            rows.append(equal(case.name, figure, float(found), float(voxels), "SOURCE.md, found with scipy label"))
        if case.chest is not None:
            lower, upper = np.array(region.lower), np.array(region.lower) + region.mask.shape
            true = case.chest.lumen(volume, tuple(lower), tuple(upper))
            rows.append(dice_row(case.name, true, region.mask))
            notify(f"{case.name}, lungs", 0, 0)
            settings = fixed(case, -1024.0, LUNG_LIMIT, 0.0)
            settings = replace(settings, leak=replace(settings.leak, volume_max=WHOLE_IMAGE))
            rows += wide_rows(f"{case.name}, a lung", volume, nearest(volume, LUNG_AT), settings, folder)
    return rows


def dice_row(name: str, true: BoolArray, mask: BoolArray) -> Row:
    """Dice of a mask with the true lumen; half of its outermost voxels may be missing (partial volume)."""
    count = float(true.sum())
    missing = 0.5 * (count - float(ndimage.binary_erosion(true).sum()))
    least = (count - missing) / (count - 0.5 * missing)
    dice = 2.0 * float((true & mask).sum()) / (count + float(mask.sum()))
    target = f"over {least:.3f}: half a voxel all round"
    return Row(case=name, figure="Dice with the true lumen", ours=dice, target=target, holds=dice > least)


def whole_rows(case: CtCase, folder: Path) -> list[Row]:
    """Time and memory of the whole front end, from files to the closed wall, in one process."""
    trial = tried("whole", OURS, folder, {"ct": str(case.path), "anatomy": case.anatomy})
    stages = trial.found["stages"]  # (3, 2): processor and wall seconds
    name = f"{case.name}, whole"
    rows = [
        Row(case=name, figure=f"{stage}, CPU s", ours=float(stages[k, 0]))
        for k, stage in enumerate(("read", "region", "surface"))
    ]
    return [
        *rows,
        under(name, "files to closed wall, CPU s", trial.seconds, case.seconds),
        Row(case=name, figure="files to closed wall, s on the clock", ours=trial.clock),
        under(name, "peak memory MB", trial.peak, case.memory),
        Row(case=name, figure="of it the CT itself, MB", ours=2.0 * float(trial.found["voxels"]) / 2**20),
    ]


def reading_rows(case: CtCase, folder: Path) -> list[Row]:
    """Time and memory of reading, and whether the values are those of the peers; DICOM only."""
    if not case.path.is_dir():
        return []
    trials = {method: tried("read", method, folder, {"ct": str(case.path)}) for method in installed("read")}
    ours = trials.pop(OURS)
    name, slices = f"{case.name}, reading", len(list(case.path.iterdir()))
    alike = sum(str(trial.found["digest"]) == str(ours.found["digest"]) for trial in trials.values())
    return [
        *against(
            name,
            "CPU s",
            ours.seconds,
            {peer: trial.seconds for peer, trial in trials.items()},
            times=READING,
            floor=READING_SLICE * slices,
        ),
        *against(
            name,
            "MB beyond the modules",
            ours.extra,
            {peer: trial.extra for peer, trial in trials.items()},
            times=1.5,
            floor=UNFELT,
        ),
        equal(name, "peers with the same HU in every voxel", float(alike), float(len(trials)), "from -1024 HU on, this run"),
    ]


def fixed(case: CtCase, low: float, high: float, smoothing: float) -> GrowthSettings:
    """Growing between two limits with the leak rule of the case's anatomy."""
    return GrowthSettings(hu_min=low, hu_max=high, varied=None, leak=PRESETS[case.anatomy].leak, smoothing=smoothing)


def lumen_rows(case: CtCase, volume: Volume, region: Region, folder: Path) -> list[Row]:
    """Growing at the limits that the search chose, the search itself, and the surface of the region."""
    assert region.curve is not None
    grown = fixed(case, region.hu_min, region.hu_max, region.smoothing)
    name = f"{case.name}, lumen"
    rows, least = growing_rows(name, volume, region.seed, grown, folder, peers=installed("grow")[1:])
    searching = replace(fixed(case, *search_limits(case, region.curve.varied), region.smoothing), varied=region.curve.varied)
    save(volume, folder)
    found = tried("grow", OURS, folder, given_growth(region.seed, searching))
    limits = len(region.curve.limits)
    reference = limits * least
    rows += [
        Row(
            case=name,
            figure=f"search through {limits} limits, CPU s",
            ours=found.seconds,
            reference=reference,
            source=f"{limits} floods by the least peer",
            target=f"at most {SEARCHING:g} times them, or {UNNOTICED:g}",
            holds=found.seconds <= max(SEARCHING * reference, UNNOTICED),
        ),
        Row(case=name, figure="search, MB beyond the CT", ours=found.extra),
    ]
    return [*rows, *surface_rows(name, volume, grow(volume, region.seed, grown), folder)]


def search_limits(case: CtCase, varied: str) -> tuple[float, float]:
    """The limits between which the preset searches."""
    loosest = PRESETS[case.anatomy].loosest
    assert loosest is not None
    return (-1024.0, loosest) if varied == "hu_max" else (loosest, 3071.0)


def wide_rows(name: str, volume: Volume, seed: tuple[int, int, int], settings: GrowthSettings, folder: Path) -> list[Row]:
    """The same for a region of a large share of the image, which no planner takes."""
    rows, _ = growing_rows(name, volume, seed, settings, folder, peers=installed("grow")[1:])
    return [*rows, *triangle_rows(name, volume, grow(volume, seed, settings), folder)]


def growing_rows(
    name: str,
    volume: Volume,
    seed: tuple[int, int, int],
    settings: GrowthSettings,
    folder: Path,
    *,
    peers: Sequence[str],
) -> tuple[list[Row], float]:
    """Growing between two limits beside the peers, and what one flood of the least takes, s."""
    save(volume, folder)
    told = given_growth(seed, settings)
    ours = tried("grow", OURS, folder, told)
    # An end of the range is no limit for ours: what lies beyond it reads as the end.
    open_ends = {"hu_min": -32768.0 if settings.hu_min <= HU_LOWEST else settings.hu_min}
    open_ends |= {"hu_max": 32767.0 if settings.hu_max >= HU_HIGHEST else settings.hu_max}
    trials = {method: tried("grow", method, folder, told | open_ends) for method in peers}
    least = min(trial.seconds for trial in trials.values())
    if settings.smoothing > 0:
        # What a flood alone takes, on the smoothed image.
        smooth = GrowingVoxels(volume=volume, smoothing=settings.smoothing)
        first, second, third = (slice(0, n) for n in smooth.shape)
        np.save(folder / "voxels.npy", smooth[first, second, third])
        eighths = {key: float(np.floor(STEPS_PER_HU * told[key])) for key in ("hu_min", "hu_max")}
        least = tried("grow", FLOOD, folder, told | eighths | {"smoothing": 0.0}).seconds
    reference = trials[FLOOD].mask
    mask = whole(ours, reference.shape)
    union = int((mask | reference).sum())
    title = f"{name}, {int(reference.sum())} voxels"
    rows = [
        *against(
            title,
            "growing, CPU s",
            ours.seconds,
            {peer: trial.seconds for peer, trial in trials.items()},
            times=GROWING,
            floor=UNNOTICED,
        ),
        *against(
            title,
            "growing, MB beyond the CT",
            ours.extra,
            {peer: trial.extra for peer, trial in trials.items()},
            times=1.0,
            floor=UNFELT,
        ),
        equal(title, "Jaccard with the reference flood", int((mask & reference).sum()) / union, 1.0, f"{FLOOD}, this run"),
    ]
    return rows, least


def whole(trial: Trial, shape: tuple[int, ...]) -> BoolArray:
    """The mask that growing found in its box, in the whole image."""
    mask, lower = trial.mask, trial.found["lower"]
    found = np.zeros(shape, dtype=bool)
    found[tuple(slice(int(a), int(a) + n) for a, n in zip(lower, mask.shape, strict=True))] = mask
    return found


def surface_rows(name: str, volume: Volume, region: Region, folder: Path) -> list[Row]:
    """Triangles of a region beside the peers, the whole surface, and whether it is closed."""
    rows = triangle_rows(name, volume, region, folder)
    made = lumen_surface(volume, region, SurfaceSettings())
    title = f"{name}, {len(made.surface.faces)} triangles"
    return [
        *rows,
        Row(case=title, figure="deviation from the CT mm, mean", ours=made.deviation.mean),
        closed_row(title, made.surface),
    ]


def triangle_rows(name: str, volume: Volume, region: Region, folder: Path) -> list[Row]:
    """Triangles of a region before any smoothing, beside the peers."""
    save(volume, folder)
    np.savez(
        folder / "region.npz",
        mask=region.mask,
        lower=region.lower,
        seed=region.seed,
        hu_min=region.hu_min,
        hu_max=region.hu_max,
        smoothing=region.smoothing,
    )
    field, _ = lumen_field(volume, region)
    np.save(folder / "field.npy", np.pad(field, 1, mode="constant", constant_values=-1.0).astype(np.float32))
    trials = {method: tried("surface", method, folder, {}) for method in installed("surface")}
    ours = trials.pop(OURS)
    title = f"{name}, {int(ours.found['faces'])} triangles"
    aimed = against(title, "triangles, CPU s", ours.seconds, {CUBES: trials[CUBES].seconds}, times=TRIANGLES, floor=UNNOTICED)
    return [
        *aimed,
        *(
            Row(case=title, figure="triangles, CPU s", ours=ours.seconds, reference=trial.seconds, source=f"{peer}, this run")
            for peer, trial in trials.items()
            if peer != CUBES
        ),
    ]


def nearest(volume: Volume, point: tuple[float, float, float]) -> tuple[int, int, int]:
    """Index of the voxel nearest to an LPS point."""
    first, second, third = (int(i) for i in np.round(volume.to_index(point)))
    return first, second, third


def save(volume: Volume, folder: Path) -> None:
    """The volume for the ways."""
    np.save(folder / "voxels.npy", volume.voxels)
    np.save(folder / "matrix.npy", volume.index_to_lps)


def given_growth(seed: tuple[int, int, int], settings: GrowthSettings) -> dict[str, Any]:
    """Growing as plain data."""
    return {
        "seed": [int(i) for i in seed],
        "hu_min": settings.hu_min,
        "hu_max": settings.hu_max,
        "varied": settings.varied,
        "leak": asdict(settings.leak),
        "smoothing": settings.smoothing,
    }
