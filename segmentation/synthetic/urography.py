"""An excretory-phase CT urography of the left side, calculated, with a known collecting system."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from segmentation.dicom.write import write_series
from segmentation.synthetic.abdomen import AIR, paint_abdomen
from segmentation.synthetic.collecting_system import CollectingSystem, collecting_system
from segmentation.synthetic.scanner import ScannerSettings, scan
from segmentation.synthetic.shapes import Canvas
from segmentation.volume import Volume

SEED = 20241


@dataclass(frozen=True, kw_only=True)
class UrographySettings:
    """Grid of the generated scan: a field of view zoomed to the left kidney.

    Attributes
    ----------
    shape : (slices, rows, columns)
    spacing : (slice, row, column) distances, mm
    first_voxel : (x, y, z), mm
        LPS centre of the first voxel of the first (lowest) slice; the origin is the
        middle of a lumbar vertebral body's front half.
    scanner : ScannerSettings
    """

    shape: tuple[int, int, int] = (136, 224, 256)
    spacing: tuple[float, float, float] = (1.0, 0.75, 0.75)
    first_voxel: tuple[float, float, float] = (-40.0, -78.0, -78.0)
    scanner: ScannerSettings = field(default_factory=ScannerSettings)


@dataclass(frozen=True, eq=False, kw_only=True)
class Urography:
    """A generated scan and its truth."""

    volume: Volume
    truth: CollectingSystem

    @property
    def checksum(self) -> str:
        """SHA-256 of the voxels as little-endian int16, slice by slice from below."""
        return hashlib.sha256(self.volume.voxels.astype("<i2").tobytes()).hexdigest()


def urography(*, seed: int = SEED, settings: UrographySettings | None = None) -> Urography:
    """Calculate the scan; the anatomy's frame and the tree are fixed, textures and noise follow the seed.

    Everything is calculated in double precision, so that the rounding to whole HU comes out the
    same on any machine.
    """
    return calculated(seed, settings or UrographySettings())


# Benchmarks and tests ask for the same scan again and again; it is frozen, and takes 4 s to calculate.
@lru_cache(maxsize=2)
def calculated(seed: int, settings: UrographySettings) -> Urography:
    """The scan of a seed and a grid."""
    canvas = empty_canvas(settings)
    system = collecting_system(lower_border(settings))
    anatomy, quality = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    paint_abdomen(canvas, system, rng=anatomy)
    return Urography(volume=scanned(canvas, settings, rng=quality), truth=system)


def lower_border(settings: UrographySettings) -> float:
    """z of the image's lower face, mm."""
    return settings.first_voxel[2] - 0.5 * settings.spacing[0]


def empty_canvas(settings: UrographySettings) -> Canvas:
    """Air on the grid of a scan."""
    z, y, x = (
        np.asarray(first + step * np.arange(n, dtype=float))
        for first, step, n in zip(settings.first_voxel[::-1], settings.spacing, settings.shape, strict=True)
    )
    return Canvas(x, y, z, np.full(settings.shape, AIR))


def scanned(canvas: Canvas, settings: UrographySettings, *, rng: np.random.Generator) -> Volume:
    """The volume that a scanner makes of a painted canvas."""
    image = scan(canvas.hu, settings.spacing, settings.scanner, rng=rng)
    voxels = np.clip(np.rint(image), -1024, 3071).astype(np.int16)
    index_to_lps = np.eye(4)
    # [slice, row, column] run along z, y, x.
    index_to_lps[:3, :3] = np.diag(settings.spacing[::-1])[:, ::-1]
    index_to_lps[:3, 3] = settings.first_voxel
    return Volume(voxels, index_to_lps)


def write_demo_series(
    folder: str | Path, *, seed: int = SEED, progress: Callable[[int, int], None] | None = None
) -> CollectingSystem:
    """Write the scan as a DICOM series into a new or empty folder and return what is known about it."""
    made = urography(seed=seed)
    write_series(made.volume, folder, seed=seed, progress=progress)
    return made.truth
