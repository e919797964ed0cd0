"""Files of a DICOM folder: which ones count, and parsing one without trusting it.

Rules: regular files only (no link, no pipe), never a DICOMDIR; a file that looks
like DICOM and cannot be read is a refusal, never a skip; deflated files are
inflated no further than their own header asks for.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import stat
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import pydicom
from pydicom.dataset import Dataset
from pydicom.errors import BytesLengthException, InvalidDicomError
from pydicom.filereader import read_dataset
from pydicom.uid import DeflatedExplicitVRLittleEndian

from segmentation.errors import SeriesError

MAX_FILES = 20_000
MAX_HEADER_BYTES = 16 << 20
"""Most a header may inflate to; real CT headers are below 100 KB, enhanced ones below 10 MB."""

UNREADABLE = (
    InvalidDicomError,
    BytesLengthException,
    OSError,
    EOFError,
    ValueError,
    KeyError,
    AttributeError,
    TypeError,
    IndexError,
    struct.error,
    NotImplementedError,
    RecursionError,
    OverflowError,
    MemoryError,
    zlib.error,
)
"""What the parser raises on damaged bytes (found by mutating real headers)."""

_SUFFIXES = frozenset({".dcm", ".dicom", ".ima", ".dic", ".dc3"})
_APPLE_DOUBLE = b"\x00\x05\x16\x07"


# Bytes before the pixel data (all of a deflated file) and their SHA-256.
Head = tuple[int, str]


@dataclass(frozen=True)
class DicomFile:
    """One regular file with a DICOM preamble.

    Attributes
    ----------
    path : Path
    name : str
        Path below the folder, with forward slashes: what messages print.
    size : int, bytes
    """

    path: Path
    name: str
    size: int


@dataclass(frozen=True)
class Listing:
    """What lies in a folder.

    Attributes
    ----------
    files : tuple of DicomFile
        In order of name.
    ignored : int
        Files that are no DICOM (texts, pictures, DICOMDIR).
    faults : tuple of str
        Files that make the folder untrustworthy.
    """

    files: tuple[DicomFile, ...]
    ignored: int
    faults: tuple[str, ...]


def list_folder(path: Path) -> Listing:
    """List a folder with its subfolders, or a single file.

    Raises
    ------
    SeriesError
        If there is nothing to read, or more than `MAX_FILES` files.
    """
    root = path if path.is_dir() else path.parent
    files: list[DicomFile] = []
    strangers: list[tuple[str, bytes]] = []
    faults: list[str] = []
    ignored = 0
    for count, entry in enumerate(_walk(path)):
        if count >= MAX_FILES:
            raise SeriesError(f"{path.name}: holds more than {MAX_FILES} files; name the folder of one study")
        # A name may hold terminal escapes.
        name = "".join(letter if letter.isprintable() else "?" for letter in entry.relative_to(root).as_posix())
        status = entry.lstat()
        if not stat.S_ISREG(status.st_mode):
            kind = "a symbolic link" if stat.S_ISLNK(status.st_mode) else "no regular file"
            faults.append(f"{name} is {kind}; only regular files are read, put the file itself in its place or remove it")
        elif entry.name.upper() == "DICOMDIR":
            ignored += 1
        else:
            with _open(entry) as stream:
                head = stream.read(132)
            if head[128:] == b"DICM":
                files.append(DicomFile(entry, name, status.st_size))
            else:
                strangers.append((name, head))
    slice_suffixes = {_suffix(file.name) for file in files} | _SUFFIXES
    for name, head in strangers:
        if _looks_damaged(name, head, slice_suffixes):
            faults.append(f"{name} looks like DICOM but has no DICOM preamble; restore or remove it, it may be a slice")
        else:
            ignored += 1
    return Listing(tuple(files), ignored, tuple(faults))


def parse(stream: BinaryIO, *, pixels: bool) -> Dataset:
    """Parse one DICOM file, with or without its pixel data.

    A deflated file comes back inflated.

    Raises
    ------
    SeriesError
        If the bytes are no readable DICOM, or inflate to more than they promise. The
        message does not name the file; the caller does.
    """
    try:
        return _parse(stream, pixels=pixels)
    except UNREADABLE as error:
        raise SeriesError(f"looks like DICOM but cannot be read ({type(error).__name__}); export it again") from error


def _parse(stream: BinaryIO, *, pixels: bool) -> Dataset:
    stream.seek(0)
    if stream.read(132)[128:] != b"DICM":
        raise InvalidDicomError("no preamble")
    meta = read_dataset(stream, False, True, stop_when=lambda tag, _vr, _length: tag.group != 2)
    syntax = meta.get("TransferSyntaxUID")
    if not syntax:
        raise InvalidDicomError("no transfer syntax")
    if syntax != DeflatedExplicitVRLittleEndian:
        stream.seek(0)
        return pydicom.dcmread(stream, stop_before_pixels=not pixels)
    return _parse_deflated(stream.read(), meta, pixels=pixels)


def _parse_deflated(packed: bytes, meta: Dataset, *, pixels: bool) -> Dataset:
    head, _ = _inflate(packed, MAX_HEADER_BYTES)
    dataset = _read_explicit(head, pixels=False)
    if pixels:
        wanted = int(dataset.Rows) * int(dataset.Columns) * int(dataset.get("NumberOfFrames") or 1) * 2
        data, whole = _inflate(packed, min(wanted, 1 << 31) + (1 << 20))
        if not whole:
            raise SeriesError(f"inflates to more than the {wanted} bytes its header promises; the file is damaged or hostile")
        dataset = _read_explicit(data, pixels=True)
    dataset.file_meta = pydicom.dataset.FileMetaDataset(meta)
    return dataset


def _inflate(packed: bytes, limit: int) -> tuple[bytes, bool]:
    """At most `limit` inflated bytes, and whether that was all."""
    inflater = zlib.decompressobj(-zlib.MAX_WBITS)
    data = inflater.decompress(packed, limit)
    return data, inflater.eof or not inflater.decompress(inflater.unconsumed_tail, 1)


def _read_explicit(data: bytes, *, pixels: bool) -> Dataset:
    stop = None if pixels else (lambda tag, _vr, _length: tag >= 0x7FE00008)
    return read_dataset(io.BytesIO(data), False, True, stop_when=stop)


def _walk(path: Path) -> Iterator[Path]:
    if not path.is_dir():
        yield path
        return
    for folder, subfolders, names in os.walk(path, followlinks=False):
        subfolders.sort()
        linked = [name for name in subfolders if (Path(folder) / name).is_symlink()]
        for name in sorted(names + linked):
            yield Path(folder) / name


def _open(path: Path) -> BinaryIO:
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        return os.fdopen(os.open(path, flags), "rb")
    except OSError as error:
        raise SeriesError(f"{path.name} cannot be opened ({error.strerror}); check its permissions") from error


def _suffix(name: str) -> str:
    """Suffix in lower case; numbered ones, as in ``CT.1.3.12.573``, count as none."""
    suffix = Path(name).suffix.lower()
    return "" if suffix[1:].isdigit() else suffix


def _looks_damaged(name: str, head: bytes, slice_suffixes: set[str]) -> bool:
    if head.startswith(_APPLE_DOUBLE):
        return False
    if head[:2] in (b"\x02\x00", b"\x08\x00") and len(head) > 8 and head[3] == 0 and head[2] <= 0x18:
        return True
    if _suffix(name) in _SUFFIXES:
        return True
    hidden = Path(name).name.startswith(".")
    is_text = bool(head) and all(byte >= 0x20 or byte in b"\t\r\n\f" for byte in head)
    return _suffix(name) in slice_suffixes and not hidden and not is_text


def read_bytes(file: DicomFile) -> bytes:
    """The whole file.

    Raises
    ------
    SeriesError
        If it cannot be opened or its size changed since it was listed.
    """
    with _open(file.path) as stream:
        data = stream.read()
    if len(data) != file.size:
        raise SeriesError(f"{file.name} changed while the folder was read; wait until the export is complete")
    return data


def read_header(file: DicomFile) -> Dataset:
    """The header of one file, without pixel data.

    Raises
    ------
    SeriesError
        If it cannot be read.
    """
    with _open(file.path) as stream:
        return parse(stream, pixels=False)


def read_head(file: DicomFile) -> tuple[Dataset, Head]:
    """The header of one file as `read_header` has it, and the mark by which it is known again.

    Raises
    ------
    SeriesError
        If it cannot be read.
    """
    with _open(file.path) as stream:
        dataset = parse(stream, pixels=False)
        size = stream.tell()
        stream.seek(0)
        return dataset, head_of(stream.read(size), size)


def head_of(data: bytes, size: int) -> Head:
    """Mark of the first `size` bytes of a file."""
    return size, hashlib.sha256(data[:size]).hexdigest()


@contextmanager
def quiet_parser() -> Iterator[None]:
    """Keep pydicom's and the decoders' remarks from being shown or logged while files are read.

    They quote header values, so one could print a patient's name; what matters of them
    comes as an error of ours.
    """
    loggers = [logging.getLogger(name) for name in ("pydicom", "pylibjpeg", "openjpeg")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
