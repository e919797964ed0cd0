"""CT images from files: a DICOM folder, NIfTI or MetaImage, to one `CtImage`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from segmentation.dicom import (
    Progress,
    geometry_facts,
    inspect_folder,
    padding_facts,
    read_series,
    require_hounsfield,
    settle_fill,
)
from segmentation.errors import VolumeError
from segmentation.padding import Padding
from segmentation.volume import Volume
from segmentation.volume_files import VOLUME_SUFFIXES, read_volume_file

_ARCHIVES = (".zip", ".tar", ".tgz", ".tar.gz", ".tar.xz", ".tar.bz2", ".7z", ".rar")


@dataclass(frozen=True, eq=False)
class CtImage:
    """A CT and what may be printed about it.

    Attributes
    ----------
    volume : Volume
    facts : mapping of str to str
        Label to printed value in reading order, from an allow-list; nothing identifies a
        patient.
    warnings : tuple of str
        What a reviewer should know of how the image was read.
    inputs : tuple of (str, str)
        Name and SHA-256 of each input. A DICOM series is one entry: the SHA-256 over the
        sorted SHA-256 of its files.
    padding : Padding
        Voxels outside what was scanned, which read as air. They matter where a lumen or a way comes near them.
    """

    volume: Volume
    facts: Mapping[str, str]
    warnings: tuple[str, ...]
    inputs: tuple[tuple[str, str], ...]
    padding: Padding

    def __post_init__(self) -> None:
        object.__setattr__(self, "facts", MappingProxyType(dict(self.facts)))


def read_ct(path: Path, *, series: str | None = None, progress: Progress | None = None) -> CtImage:
    """Read a CT.

    Parameters
    ----------
    path : Path
        A DICOM folder (or one multi-frame DICOM file), ``.nii``, ``.nii.gz``, ``.mha`` or ``.mhd``.
    series : str, optional
        Which DICOM series, where there are several: its number in the listing, its
        SeriesNumber or its SeriesInstanceUID.
    progress : callable, optional
        Called with slices read and slices in all (DICOM only).

    Raises
    ------
    SeriesError
        If a DICOM folder does not hold one trustworthy series of that name.
    VolumeError
        If the file is of no kind that is read, or is no plausible CT volume.
    """
    if is_volume_file(path):
        if series is not None:
            raise VolumeError(f"{path.name}: a volume file holds one image; leave out --series {series}")
        return _read_volume_file(path)
    _require_dicom(path)
    read = read_series(path, series=series, progress=progress)
    name = f"DICOM series, {read.files} {'file' if read.files == 1 else 'files'}"
    return CtImage(read.volume, read.facts, read.warnings, ((name, read.digest),), read.padding)


def inspect_path(path: Path, *, pixels: bool = False, progress: Progress | None = None) -> dict[str, Any]:
    """Describe a DICOM folder or a volume file as plain data, faults included, without identifiers.

    Parameters
    ----------
    path : Path
    pixels : bool
        Also look at the values of a DICOM folder; those of a volume file are always looked at.
    progress : callable, optional
        Called with headers read and files in all (DICOM only).

    Returns
    -------
    dict
        See `segmentation.dicom.inspect_folder`; for a volume file ``kind`` "volume", ``name``,
        ``usable``, ``facts``, ``geometry``, ``faults``, ``warnings``.

    Raises
    ------
    VolumeError
        If the path does not exist or is of no kind that is read.
    """
    if not is_volume_file(path):
        _require_dicom(path)
        return inspect_folder(path, pixels=pixels, progress=progress)
    report: dict[str, Any] = {"kind": "volume", "name": path.name, "usable": True, "facts": {}, "geometry": None}
    try:
        image = _read_volume_file(path)
    except VolumeError as error:
        return report | {"usable": False, "faults": [str(error).removeprefix(f"{path.name}: ")], "warnings": []}
    volume = image.volume
    geometry = {
        "shape": list(volume.voxels.shape),
        "spacing_mm": volume.spacing.tolist(),
        "index_to_lps": volume.index_to_lps.tolist(),
    }
    return report | {"facts": dict(image.facts), "geometry": geometry, "faults": [], "warnings": list(image.warnings)}


def require_image(path: Path) -> None:
    """Refuse a path that `read_ct` cannot begin to read, before anything else of a case is looked at.

    Raises
    ------
    VolumeError
        If the path does not exist or is of no kind that is read.
    """
    if not (is_volume_file(path) and path.is_file()):
        _require_dicom(path)


def is_volume_file(path: Path) -> bool:
    """Whether the name is that of a NIfTI or MetaImage file."""
    return not path.is_dir() and path.name.lower().endswith(VOLUME_SUFFIXES)


def _require_dicom(path: Path) -> None:
    """Let folders and single DICOM files pass, and say of anything else what it is."""
    if path.is_dir():
        return
    if not path.is_file():
        raise VolumeError(f"{path.name}: there is no such file or folder; check the path")
    if path.name.lower().endswith(_ARCHIVES):
        raise VolumeError(f"{path.name}: is an archive; unpack it first and name the folder it brings")
    if path.name.upper() == "DICOMDIR":
        raise VolumeError(f"{path.name}: is only a directory of images; name the folder it lies in")
    with path.open("rb") as stream:
        if stream.read(132)[128:] != b"DICM":
            kinds = ", ".join(VOLUME_SUFFIXES)
            raise VolumeError(
                f"{path.name}: is neither DICOM nor a volume file ({kinds}); name a folder of DICOM slices or such a file"
            )


def _read_volume_file(path: Path) -> CtImage:
    read = read_volume_file(path)
    warnings = [f"{read.clipped} voxels beyond the range -32768 to 32767 HU were clipped to it"] if read.clipped else []
    filled = settle_fill(read.voxels)
    require_hounsfield(read.voxels, path.name)
    facts = {
        "Modality": "not stated, taken as CT",
        **geometry_facts(read.index_to_lps, read.voxels.shape),
        "HU range": f"{read.voxels.min()} to {read.voxels.max()} HU",
        **padding_facts(0, filled.count),
    }
    return CtImage(Volume(read.voxels, read.index_to_lps), facts, tuple(warnings), read.inputs, filled)
