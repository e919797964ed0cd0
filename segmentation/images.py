"""CT images from files: a DICOM folder, NIfTI or MetaImage, to one `CtImage`."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import SimpleITK as sitk

from segmentation.arrays import FloatArray
from segmentation.dicom import (
    FILL_HU,
    Progress,
    geometry_facts,
    inspect_folder,
    read_series,
    require_hounsfield,
    settle_fill,
)
from segmentation.errors import VolumeError
from segmentation.volume import Volume

VOLUME_SUFFIXES = (".nii", ".nii.gz", ".mha", ".mhd")
_ARCHIVES = (".zip", ".tar", ".tgz", ".tar.gz", ".tar.xz", ".tar.bz2", ".7z", ".rar")
_MIN_SPACING, _MAX_SPACING = 0.05, 5.0
_MAX_VOXELS = 1 << 30
_PIXEL_TYPES = (sitk.sitkInt16, sitk.sitkUInt16, sitk.sitkInt32, sitk.sitkUInt32, sitk.sitkFloat32, sitk.sitkFloat64)


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
    """

    volume: Volume
    facts: Mapping[str, str]
    warnings: tuple[str, ...]
    inputs: tuple[tuple[str, str], ...]

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
    return CtImage(read.volume, read.facts, read.warnings, ((name, read.digest),))


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
    if not path.is_file():
        raise VolumeError(f"{path.name}: there is no such file; check the path")
    files = [path, *_data_files(path)]
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    reader.SetImageIO("NiftiImageIO" if ".nii" in path.name.lower() else "MetaImageIO")
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise VolumeError(f"{path.name}: its header cannot be read, or its axes are not perpendicular; save it again") from error
    _check_header(reader, path.name)
    index_to_lps = _affine(reader, path.name)
    try:
        image = reader.Execute()
    except RuntimeError as error:
        raise VolumeError(f"{path.name}: its voxels cannot be read, it is cut or damaged; copy or save it again") from error
    voxels, warnings = _to_int16(image, path.name)
    del image
    filled = settle_fill(voxels)
    if filled:
        warnings.append(f"{filled} voxels of fill far below air were set to {FILL_HU} HU")
    require_hounsfield(voxels, path.name)
    facts = {
        "Modality": "not stated, taken as CT",
        **geometry_facts(index_to_lps, voxels.shape),
        "HU range": f"{voxels.min()} to {voxels.max()} HU",
    }
    inputs = tuple((file.name, _sha256(file)) for file in files)
    return CtImage(Volume(voxels, index_to_lps), facts, tuple(warnings), inputs)


def _data_files(path: Path) -> list[Path]:
    """The voxel file a MetaImage header names; none when the voxels follow the header.

    Raises
    ------
    VolumeError
        If it is not one plain file in the header's own folder.
    """
    if ".nii" in path.name.lower():
        return []
    with path.open("rb") as stream:
        header = stream.read(1 << 16)
    values = [line.partition(b"=")[2].strip() for line in header.splitlines() if line.startswith(b"ElementDataFile")]
    if not values:
        raise VolumeError(f"{path.name}: names no ElementDataFile in its header; save it again")
    name = values[0].decode("utf-8", "replace")
    if name == "LOCAL":
        return []
    if name.startswith("LIST") or "%" in name:
        raise VolumeError(f"{path.name}: spreads its voxels over several files; save it as one .mha file")
    data = path.parent / name
    if data.is_symlink() or data.name != name or name in ("", ".", ".."):
        raise VolumeError(
            f"{path.name}: its voxels are to be read from outside of its folder or from a link; put both files side by side"
        )
    if not data.is_file():
        raise VolumeError(f"{path.name}: its voxel file {name} is not there; put both files side by side")
    return [data]


def _check_header(reader: Any, name: str) -> None:
    size = reader.GetSize()
    if reader.GetDimension() != 3:
        raise VolumeError(f"{name}: has {reader.GetDimension()} dimensions, expected 3; save one volume of it")
    if reader.GetNumberOfComponents() != 1:
        raise VolumeError(f"{name}: has {reader.GetNumberOfComponents()} values per voxel, expected 1; this is no CT")
    if reader.GetPixelID() not in _PIXEL_TYPES:
        kind = sitk.GetPixelIDValueAsString(reader.GetPixelID())
        raise VolumeError(f"{name}: has voxels of {kind}, which cannot hold HU; save the CT with 16 bits or more")
    if math.prod(size) > _MAX_VOXELS:
        raise VolumeError(
            f"{name}: has {math.prod(size) / 1e9:.1f} billion voxels, at most {_MAX_VOXELS / 1e9:.1f} are read; crop it"
        )
    if min(size) < 3:
        raise VolumeError(f"{name}: has {size[0]} x {size[1]} x {size[2]} voxels, expected at least 3 along every axis")
    codes = [reader.GetMetaData(key) for key in ("qform_code", "sform_code") if reader.HasMetaDataKey(key)]
    if codes and all(code.strip() in ("", "0") for code in codes):
        raise VolumeError(f"{name}: does not say how it lies in the patient (qform and sform are unset); convert the CT again")


def _affine(reader: Any, name: str) -> FloatArray:
    """(4, 4) mm, LPS, acting on ``[slice, row, column]``; SimpleITK already gives LPS."""
    spacing = np.array(reader.GetSpacing())
    direction = np.array(reader.GetDirection()).reshape(3, 3)
    origin = np.array(reader.GetOrigin())
    if not (np.isfinite(spacing).all() and np.isfinite(direction).all() and np.isfinite(origin).all()):
        raise VolumeError(f"{name}: its spacing, axes or origin are not finite numbers; save it again")
    if not np.all((spacing >= _MIN_SPACING) & (spacing <= _MAX_SPACING)):
        sizes = " x ".join(f"{value:g}" for value in spacing)
        raise VolumeError(f"{name}: has voxels of {sizes} mm, expected {_MIN_SPACING} to {_MAX_SPACING:g} mm; check its units")
    if np.abs(direction.T @ direction - np.eye(3)).max() > 1e-3:
        raise VolumeError(f"{name}: its axes are not perpendicular unit vectors; resample it to a straight grid")
    affine = np.eye(4)
    affine[:3, :3] = (direction * spacing)[:, ::-1] + 0.0  # no negative zeros in print
    affine[:3, 3] = origin
    return affine


def _to_int16(image: Any, name: str) -> tuple[np.ndarray[Any, np.dtype[np.int16]], list[str]]:
    """Voxels in whole HU, slice by slice, so that no second full copy is made."""
    source = sitk.GetArrayViewFromImage(image)
    voxels = np.empty(source.shape, dtype=np.int16)
    clipped = 0
    for plane, out in zip(source, voxels, strict=True):
        if plane.dtype.kind == "f" and not np.isfinite(plane).all():
            raise VolumeError(f"{name}: holds values that are not finite numbers; fill them with -1024 and save it again")
        clipped += int(np.count_nonzero((plane < -32768) | (plane > 32767)))
        out[...] = np.clip(np.rint(plane) if plane.dtype.kind == "f" else plane, -32768, 32767)
    warnings = [f"{clipped} voxels beyond the range -32768 to 32767 HU were clipped to it"] if clipped else []
    return voxels, warnings


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
