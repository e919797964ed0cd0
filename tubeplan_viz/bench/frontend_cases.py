"""The CT series of the front end's benchmark: generated ones written as DICOM, real ones as they come."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from segmentation.archive import unpack
from segmentation.dicom import write_series
from segmentation.synthetic import urography
from tubeplan_viz.bench.anatomies import SHARED
from tubeplan_viz.bench.frontend_volumes import Chest, chest


@dataclass(frozen=True, eq=False, kw_only=True)
class CtCase:
    """One CT on disk.

    Attributes
    ----------
    name : str
    path : Path
        A folder of slices, or a volume file.
    anatomy : str
    seconds, memory : float, s and MB
        Targets for the whole front end: processor time and peak memory of the process.
    chest : Chest or None
        What is known of a generated chest.
    told : (seed, hu_max, voxels) or None
        Growing that the data's own description tells: seed ``[slice, row, column]``, limit, and how many voxels.
    """

    name: str
    path: Path
    anatomy: str
    seconds: float
    memory: float
    chest: Chest | None = None
    told: tuple[tuple[int, int, int], float, int] | None = None


# File or archive in the shared data, targets (SimpleITK, which reads the volume file, takes 90 MB), and what SOURCE.md
# beside it tells (the CMB-CRC one is smoothed by hand there).
REAL: dict[str, tuple[str, float, float, tuple[tuple[int, int, int], float, int] | None]] = {
    "cmb_crc": ("cmb_crc_chest_ct/dicom_original.tar.xz", 3.0, 400.0, None),
    "lungfcp": ("lungfcp_trachea_ct/dicom_cropped.tar.xz", 2.0, 300.0, ((60, 57, 111), -880.0, 31219)),
    "cip_ct64": ("cip_ct64_dicom/dicom.tar.xz", 1.0, 250.0, ((70, 25, 31), -850.0, 232)),
    "elastix": ("elastix_right_lung/3DCT_lung.mha", 1.0, 320.0, ((110, 73, 108), -920.0, 5746)),
}
# Slices and spacing of the generated chests: an ordinary scan, and one with as many thin slices as scanners give.
ORDINARY = ((200, 512, 512), (1.0, 0.7, 0.7))
MANY = ((500, 512, 512), (0.45, 0.7, 0.7))
SMALL = ((64, 160, 160), (3.0, 2.2, 2.2))


@contextmanager
def generated_chest(
    size: tuple[tuple[int, int, int], tuple[float, float, float]], seconds: float, memory: float
) -> Iterator[CtCase]:
    """A generated chest as DICOM."""
    made = chest(*size)
    slices, rows, columns = size[0]
    with TemporaryDirectory() as folder:
        write_series(made.volume, folder)
        yield CtCase(
            name=f"generated chest {columns}x{rows}x{slices}",
            path=Path(folder),
            anatomy="airway",
            seconds=seconds,
            memory=memory,
            chest=made,
        )


@contextmanager
def generated_urography() -> Iterator[CtCase]:
    """The generated urography as DICOM."""
    with TemporaryDirectory() as folder:
        write_series(urography().volume, folder)
        yield CtCase(name="generated urography", path=Path(folder), anatomy="urinary", seconds=3.0, memory=350.0)


@contextmanager
def real_ct(name: str) -> Iterator[CtCase | None]:
    """A real CT, its archive unpacked for as long as it is used; None where the shared data are not beside the source tree."""
    file, seconds, memory, told = REAL[name]
    source = SHARED / file
    if not source.exists():
        yield None
        return
    with TemporaryDirectory() as folder:
        path = source
        if source.name.endswith(".tar.xz"):
            unpack(source, Path(folder))
            path = next(each for each in sorted(Path(folder).rglob("*")) if each.is_file()).parent
        yield CtCase(name=name, path=path, anatomy="airway", seconds=seconds, memory=memory, told=told)
