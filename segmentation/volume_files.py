"""NIfTI and MetaImage files to voxels and affine, by SimpleITK, checked where it is lenient.

SimpleITK reads a NIfTI file that is cut as if the rest were 0, and NaN as 0; both are
looked for here before it reads the voxels.
"""

from __future__ import annotations

import gzip
import hashlib
import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from segmentation.arrays import FloatArray, VoxelArray
from segmentation.errors import VolumeError

VOLUME_SUFFIXES = (".nii", ".nii.gz", ".mha", ".mhd")
_MIN_SPACING, _MAX_SPACING = 0.05, 5.0
_MAX_VOXELS = 1 << 30
_PIXEL_TYPES = ("Int16", "UInt16", "Int32", "UInt32", "Float32", "Float64")
_LABEL_TYPES = ("Int8", "UInt8")
_FLOAT_CODES = {16: "f4", 64: "f8"}
"""NIfTI datatype codes of floating-point voxels."""
_CHUNK = 1 << 22
_SAME_FRAME_MM = 0.1
"""How far apart qform and sform may place a corner: a hundred times what their 32-bit numbers lose."""


@dataclass(frozen=True, eq=False)
class VolumeFile:
    """What a volume file holds, values not yet judged.

    Attributes
    ----------
    voxels : (slices, rows, columns) int16 array
        Writable; rounded to whole numbers and clipped to int16.
    index_to_lps : (4, 4) float array, mm
    clipped : int
        Voxels that were beyond int16.
    inputs : tuple of (str, str)
        Name and SHA-256 of each file read.
    """

    voxels: VoxelArray
    index_to_lps: FloatArray
    clipped: int
    inputs: tuple[tuple[str, str], ...]


def read_volume_file(path: Path, *, labels: bool = False) -> VolumeFile:
    """Read a NIfTI or MetaImage file.

    Besides the result, the file's own voxels are in memory until they are converted.

    Parameters
    ----------
    path : Path
        Its suffix is one of `VOLUME_SUFFIXES`.
    labels : bool
        Whether the file holds labels, for which 8 bits are enough.

    Raises
    ------
    VolumeError
        If the file is missing, cut or damaged, no single three-dimensional grey image of
        at least 16 bits (8 for labels), or its geometry is missing, skewed or implausible.
    """
    if not path.is_file():
        raise VolumeError(f"{path.name}: there is no such file; check the path")
    is_nifti = path.name.lower().endswith((".nii", ".nii.gz"))
    files = [path] if is_nifti else [path, *_data_files(path)]
    # Imported where it is used: it takes 90 MB, which reading DICOM does without.
    import SimpleITK as sitk

    # What is odd is told below in one sentence; ITK's own warnings name files by their whole path.
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    reader.SetImageIO("NiftiImageIO" if is_nifti else "MetaImageIO")
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise VolumeError(f"{path.name}: its header cannot be read, or its axes are not perpendicular; save it again") from error
    _check_header(reader, path.name, labels=labels)
    index_to_lps = _affine(reader, path.name)
    if is_nifti:
        _check_nifti(path)
    try:
        image = reader.Execute()
    except RuntimeError as error:
        raise VolumeError(f"{path.name}: its voxels cannot be read, it is cut or damaged; copy or save it again") from error
    voxels, clipped = _to_int16(image, path.name)
    return VolumeFile(voxels, index_to_lps, clipped, tuple((file.name, _sha256(file)) for file in files))


def _check_nifti(path: Path) -> None:
    """Walk through the whole file once: all voxels must be there, and finite.

    Raises
    ------
    VolumeError
        If they are not.
    """
    opener = cast(Callable[[Path, str], IO[bytes]], gzip.open if path.name.lower().endswith(".gz") else open)
    try:
        with opener(path, "rb") as stream:
            head = stream.read(540)
            order, code, offset, wanted = _nifti_layout(head, path.name)
            _check_two_frames(head, order, path.name)
            stream.seek(offset)
            missing = wanted
            while missing and (chunk := stream.read(min(missing, _CHUNK))):
                missing -= len(chunk)
                whole = chunk[: len(chunk) // 8 * 8]
                if code in _FLOAT_CODES and not np.isfinite(np.frombuffer(whole, order + _FLOAT_CODES[code])).all():
                    raise VolumeError(
                        f"{path.name}: holds values that are not finite numbers; fill them with -1024 and save it again"
                    )
            if missing:
                raise VolumeError(f"{path.name}: ends {missing} bytes before its last voxel; it is cut, copy or save it again")
            if len(stream.read(_CHUNK)) == _CHUNK:
                raise VolumeError(f"{path.name}: holds far more bytes than its header promises; save it again")
    except (OSError, EOFError, zlib.error) as error:
        raise VolumeError(f"{path.name}: cannot be unpacked to its end, it is cut or damaged; copy or save it again") from error


def _nifti_layout(head: bytes, name: str) -> tuple[str, int, int, int]:
    """Byte order, datatype code, offset of the first voxel and bytes of all voxels (NIfTI-1 and -2)."""
    for order in "<>":
        size = int.from_bytes(head[:4], "little" if order == "<" else "big")
        if size == 348 and head[344:347] == b"n+1":
            dims = np.frombuffer(head, order + "i2", 8, 40)
            code, bits = (int(value) for value in np.frombuffer(head, order + "i2", 2, 70))
            offset = float(np.frombuffer(head, order + "f4", 1, 108)[0])
        elif size == 540 and head[4:7] == b"n+2" and len(head) == 540:
            dims = np.frombuffer(head, order + "i8", 8, 16)
            code, bits = (int(value) for value in np.frombuffer(head, order + "i2", 2, 12))
            offset = float(np.frombuffer(head, order + "i8", 1, 168)[0])
        else:
            continue
        if 0 < dims[0] <= 7 and offset.is_integer() and 348 <= offset < 1 << 28:
            voxels = math.prod(int(value) for value in dims[1 : 1 + int(dims[0])])
            return order, code, int(offset), voxels * bits // 8
    raise VolumeError(f"{name}: is no single-file NIfTI image; save it again as .nii or .nii.gz")


def _check_two_frames(head: bytes, order: str, name: str) -> None:
    """Refuse a header whose qform and sform place the image differently: readers disagree about which of them holds.

    The quaternion's matrix is that of the format's definition [1]_.

    References
    ----------
    .. [1] https://nifti.nimh.nih.gov/nifti-1/documentation/nifti1fields/nifti1fields_pages/quatern.html
    """
    second = head[344:347] != b"n+1"
    real, whole, code = (order + "f8", order + "i8", order + "i4") if second else (order + "f4", order + "i2", order + "i2")
    places = (16, 104, 344, 352, 400) if second else (40, 76, 252, 256, 280)
    at = dict(zip(("dim", "pixdim", "code", "q", "s"), places, strict=True))
    if not all(np.frombuffer(head, code, 2, at["code"]) > 0):
        return
    pixdim = np.frombuffer(head, real, 8, at["pixdim"]).astype(float)
    b, c, d, *shift = np.frombuffer(head, real, 6, at["q"]).astype(float)
    a = math.sqrt(max(1.0 - b * b - c * c - d * d, 0.0))
    turn = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    sides = pixdim[1:4] * np.array([1.0, 1.0, -1.0 if pixdim[0] < 0.0 else 1.0])
    by_q = np.column_stack([turn * sides, shift])
    by_s = np.frombuffer(head, real, 12, at["s"]).astype(float).reshape(3, 4)
    last = np.maximum(np.frombuffer(head, whole, 3, at["dim"] + np.dtype(whole).itemsize).astype(float) - 1.0, 0.0)
    corners = np.array([[*(last * pick), 1.0] for pick in np.ndindex(2, 2, 2)])
    apart = float(np.linalg.norm(corners @ (by_q - by_s).T, axis=1).max())
    if not apart <= _SAME_FRAME_MM:
        raise VolumeError(
            f"{name}: says twice how it lies in the patient, and its qform and sform are up to {apart:.4g} mm apart; "
            "convert the CT again, or take the wrong one out (code 0)"
        )


def _check_metaimage(fields: Mapping[bytes, bytes], name: str) -> None:
    """Refuse a MetaImage header that leaves out what SimpleITK would take as 1 mm, as straight or as the origin."""
    for what, keys in (
        ("how large its voxels are", (b"ElementSpacing", b"ElementSize")),
        ("which way its axes run", (b"TransformMatrix", b"Rotation", b"Orientation")),
        ("where its first voxel lies", (b"Offset", b"Position", b"Origin")),
    ):
        if not any(key in fields for key in keys):
            raise VolumeError(f"{name}: does not say {what} ({keys[0].decode()} is missing); convert the CT again")


def _data_files(path: Path) -> list[Path]:
    """The voxel file a MetaImage header names; none when the voxels follow the header.

    Raises
    ------
    VolumeError
        If it is not one plain file in the header's own folder, or the header leaves its geometry out.
    """
    with path.open("rb") as stream:
        header = stream.read(1 << 16)
    fields: dict[bytes, bytes] = {}
    for line in header.splitlines():
        key, _, value = line.partition(b"=")
        fields.setdefault(key.strip(), value.strip())
        if key.strip() == b"ElementDataFile":
            break  # voxels may follow
    if b"ElementDataFile" not in fields:
        raise VolumeError(f"{path.name}: names no ElementDataFile in its header; save it again")
    _check_metaimage(fields, path.name)
    name = fields[b"ElementDataFile"].decode("utf-8", "replace")
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


def _check_header(reader: Any, name: str, *, labels: bool) -> None:
    size = reader.GetSize()
    if reader.GetDimension() != 3:
        raise VolumeError(f"{name}: has {reader.GetDimension()} dimensions, expected 3; save one volume of it")
    if reader.GetNumberOfComponents() != 1:
        raise VolumeError(f"{name}: has {reader.GetNumberOfComponents()} values per voxel, expected 1; this is no CT")
    import SimpleITK as sitk

    known = _PIXEL_TYPES + _LABEL_TYPES if labels else _PIXEL_TYPES
    if reader.GetPixelID() not in [getattr(sitk, f"sitk{kind}") for kind in known]:
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


def _to_int16(image: Any, name: str) -> tuple[VoxelArray, int]:
    """Voxels as int16, slice by slice, so that no second full copy is made; how many were clipped."""
    import SimpleITK as sitk

    source = sitk.GetArrayViewFromImage(image)
    voxels = np.empty(source.shape, dtype=np.int16)
    clipped = 0
    for plane, out in zip(source, voxels, strict=True):
        values = plane
        if plane.dtype.kind == "f":
            if not np.isfinite(plane).all():
                raise VolumeError(f"{name}: holds values that are not finite numbers; fill them with -1024 and save it again")
            values = np.rint(plane)
        clipped += int(np.count_nonzero((values < -32768) | (values > 32767)))
        out[...] = np.clip(values, -32768, 32767)
    return voxels, clipped


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
