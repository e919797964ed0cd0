"""Pictures of the CT: a reduced copy along the path for the page's script, and static cuts."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from reports.wall import packed
from segmentation.arrays import FloatArray
from segmentation.volume import Volume

FIELD_MM = 44.0  # side of a square cut
REACH_MM = 32.0  # half the diagonal of a cut and a little: the CT kept around the path
VOXELS_KEPT = 900_000  # about half a megabyte in the file
LEVELS = 250
COARSE = 4  # the kept part is found on blocks of this many voxels


@dataclass(frozen=True)
class Window:
    """Grey levels of one named preset, HU."""

    name: str
    label: str
    centre: float
    width: float


LUNG = Window("lung", "Lung", -600.0, 1500.0)
SOFT = Window("soft", "Soft tissue", 40.0, 400.0)
UROGRAPHY = Window("urography", "Urography", 150.0, 700.0)
VESSEL = Window("vessel", "Vessel", 200.0, 700.0)
BONE = Window("bone", "Bone", 400.0, 1800.0)
PRESETS: dict[str, tuple[Window, ...]] = {
    "airway": (LUNG, SOFT),
    "urinary": (UROGRAPHY, SOFT),
    "vessel": (VESSEL, SOFT),
    "nasal": (Window("nasal", "Sinus", 0.0, 2000.0), BONE),
}


def windows_for(anatomy: str | None, lumen_hu: float) -> tuple[Window, ...]:
    """The presets of a named anatomy; without a name, those that suit the grey value in the lumen.

    Examples
    --------
    >>> [w.name for w in windows_for(None, -930.0)]
    ['lung', 'soft']
    """
    known = PRESETS.get(anatomy or "")
    if known is not None:
        return known
    if lumen_hu < -300.0:
        return PRESETS["airway"]
    return (Window("contrast", "Contrast-filled lumen", 200.0, 700.0), SOFT) if lumen_hu > 120.0 else (SOFT, BONE)


@dataclass(frozen=True, eq=False)
class ReducedVolume:
    """The CT near the path on a grid along the patient axes; level 0 stands for "not kept"."""

    levels: NDArray[np.uint8]  # (x, y, z)
    low: FloatArray
    step: float
    hu0: float
    hu_step: float

    def packed(self) -> dict[str, Any]:
        """For the page's script."""
        return {
            "shape": list(self.levels.shape),
            "low": [round(float(v), 4) for v in self.low],
            "step": round(self.step, 4),
            "hu0": round(self.hu0, 4),
            "hu_step": round(self.hu_step, 6),
            "levels": packed(self.levels, "u1"),
        }


def reduce_volume(volume: Volume, points: FloatArray, windows: Sequence[Window]) -> ReducedVolume:
    """The CT within `REACH_MM` of the path, at about 1 mm and `LEVELS` grey levels.

    Parameters
    ----------
    points : (n, 3) float array, mm, LPS
        The path.
    windows : sequence of Window
        Grey levels beyond all of them are clamped.
    """
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    kept_mm3 = np.pi * REACH_MM**2 * (length + 4.0 / 3.0 * REACH_MM)
    step = float(np.clip((kept_mm3 / VOXELS_KEPT) ** (1.0 / 3.0), max(0.5, float(volume.spacing.min())), 2.5))
    low = points.min(axis=0) - REACH_MM
    blocks = np.ceil((points.max(axis=0) + REACH_MM - low) / (step * COARSE)).astype(int)
    centres = [low[a] + (np.arange(blocks[a]) * COARSE + (COARSE - 1) / 2) * step for a in range(3)]
    grid = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    distance, _ = cKDTree(points[::4]).query(grid.reshape(-1, 3), distance_upper_bound=REACH_MM + 0.87 * COARSE * step)
    kept = np.isfinite(distance).reshape(blocks)
    for axis in range(3):
        kept = np.repeat(kept, COARSE, axis=axis)
    where = np.argwhere(kept)
    index = _index_of_grid(volume, low, step, where)
    hu = map_coordinates(volume.voxels, index, output=np.float32, order=1, mode="constant", cval=-32768.0)
    inside = np.all([(row >= -0.5) & (row <= size - 0.5) for row, size in zip(index, volume.voxels.shape, strict=True)], axis=0)
    bottom = min(w.centre - w.width / 2 for w in windows)
    hu_step = (max(w.centre + w.width / 2 for w in windows) - bottom) / (LEVELS - 1)
    level = np.clip(np.round((hu - bottom) / hu_step), 0, LEVELS - 1) + 1
    levels = np.zeros(kept.shape, np.uint8)
    levels[kept] = np.where(inside, level, 0).astype(np.uint8)
    return ReducedVolume(levels, low, step, bottom - hu_step, hu_step)


def _index_of_grid(volume: Volume, low: FloatArray, step: float, where: NDArray[np.int64]) -> NDArray[np.float32]:
    """Indices [slice, row, column] as rows, (3, n), of grid places; single precision is a thousandth of a voxel."""
    linear = (volume.lps_to_index[:3, :3] * step).astype(np.float32)
    offset = volume.to_index(low).astype(np.float32)
    columns = where.T.astype(np.float32)
    out = np.empty_like(columns)
    for k in range(3):
        out[k] = columns[0] * linear[k, 0] + columns[1] * linear[k, 1] + columns[2] * linear[k, 2] + offset[k]
    return out


def cut(
    volume: Volume,
    origin: FloatArray,
    right: FloatArray,
    down: FloatArray,
    window: Window,
    *,
    pixels: int = 150,
    field: float = FIELD_MM,
) -> NDArray[np.uint8]:
    """A square cut through the CT centred on `origin`, (pixels, pixels) grey values; black outside the image."""
    at = ((np.arange(pixels) + 0.5) / pixels - 0.5) * field
    places = origin + at[:, None, None] * down + at[None, :, None] * right
    return _grey(volume, places, window)


def straightened(
    volume: Volume, points: FloatArray, across: FloatArray, half: float, window: Window, *, rows: int = 90
) -> NDArray[np.uint8]:
    """The CT along the path, straightened: rows from `half` mm along `across` down to the other side, one column per point."""
    offset = (0.5 - (np.arange(rows) + 0.5) / rows) * 2.0 * half
    return _grey(volume, points[None] + offset[:, None, None] * across[None], window)


def _grey(volume: Volume, places: FloatArray, window: Window) -> NDArray[np.uint8]:
    index = np.moveaxis(volume.to_index(places), -1, 0)
    hu = map_coordinates(volume.voxels, index, output=np.float32, order=1, mode="constant", cval=-32768.0)
    return np.clip((hu - (window.centre - window.width / 2)) / window.width * 255.0, 0, 255).astype(np.uint8)


def png(picture: NDArray[np.uint8]) -> str:
    """A PNG as a ``data:`` address: (h, w) grey or (h, w, 4) red, green, blue, opacity."""
    height, width = picture.shape[:2]
    raw = np.ascontiguousarray(picture).reshape(height, -1).astype(np.int16)
    filtered = np.zeros((height, raw.shape[1] + 1), np.uint8)
    filtered[:, 0] = 2  # each row as its difference to the row above
    filtered[:, 1:] = np.diff(raw, axis=0, prepend=0).astype(np.uint8)

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    colour = 0 if picture.ndim == 2 else 6
    header = struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)
    parts = (
        b"\x89PNG\r\n\x1a\n",
        chunk(b"IHDR", header),
        chunk(b"IDAT", zlib.compress(filtered.tobytes(), 7)),
        chunk(b"IEND", b""),
    )
    return "data:image/png;base64," + base64.b64encode(b"".join(parts)).decode("ascii")
