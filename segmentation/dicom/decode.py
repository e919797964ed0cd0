"""Stored pixel values of one slice, by a decoder that is named, never guessed."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.encaps import get_frame
from pydicom.pixels import get_decoder

from segmentation.dicom.files import UNREADABLE
from segmentation.dicom.headers import SliceHeader
from segmentation.dicom.streams import check_stream
from segmentation.errors import SeriesError

StoredArray = NDArray[np.int16] | NDArray[np.uint16]

INSTALL = "pip install 'tubeplan[compressed]'"


@dataclass(frozen=True)
class Syntax:
    """How one transfer syntax is decoded.

    Attributes
    ----------
    name : str
        As printed.
    plugin : str
        pydicom's name of the decoder; empty for uncompressed data.
    modules : tuple of str
        Import names that must be installed.
    family : str
        Which stream check applies; empty for uncompressed data.
    lossy : bool
        Whether the syntax may lose values.
    """

    name: str
    plugin: str = ""
    modules: tuple[str, ...] = ()
    family: str = ""
    lossy: bool = False


_OPENJPEG = ("pylibjpeg", "openjpeg")

SYNTAXES = {
    "1.2.840.10008.1.2": Syntax("Implicit VR Little Endian"),
    "1.2.840.10008.1.2.1": Syntax("Explicit VR Little Endian"),
    "1.2.840.10008.1.2.1.99": Syntax("Deflated Explicit VR Little Endian"),
    "1.2.840.10008.1.2.2": Syntax("Explicit VR Big Endian"),
    "1.2.840.10008.1.2.5": Syntax("RLE Lossless", "pydicom", (), "rle"),
    "1.2.840.10008.1.2.4.51": Syntax("JPEG Extended", "gdcm", ("gdcm",), "jpeg", True),
    "1.2.840.10008.1.2.4.57": Syntax("JPEG Lossless", "gdcm", ("gdcm",), "jpeg"),
    "1.2.840.10008.1.2.4.70": Syntax("JPEG Lossless SV1", "gdcm", ("gdcm",), "jpeg"),
    "1.2.840.10008.1.2.4.80": Syntax("JPEG-LS Lossless", "pyjpegls", ("jpeg_ls",), "jpeg"),
    "1.2.840.10008.1.2.4.81": Syntax("JPEG-LS Near-lossless", "pyjpegls", ("jpeg_ls",), "jpeg", True),
    "1.2.840.10008.1.2.4.90": Syntax("JPEG 2000 Lossless", "pylibjpeg", _OPENJPEG, "jpeg2000"),
    "1.2.840.10008.1.2.4.91": Syntax("JPEG 2000", "pylibjpeg", _OPENJPEG, "jpeg2000", True),
    "1.2.840.10008.1.2.4.201": Syntax("HTJ2K Lossless", "pylibjpeg", _OPENJPEG, "jpeg2000"),
    "1.2.840.10008.1.2.4.202": Syntax("HTJ2K Lossless RPCL", "pylibjpeg", _OPENJPEG, "jpeg2000"),
    "1.2.840.10008.1.2.4.203": Syntax("HTJ2K", "pylibjpeg", _OPENJPEG, "jpeg2000", True),
}
"""Transfer syntaxes that are read. pylibjpeg-libjpeg is left out on purpose: it returns
partial pictures from truncated files."""


def find_module(name: str) -> bool:
    """Whether a module can be imported."""
    return importlib.util.find_spec(name) is not None


def missing_modules(syntax: Syntax) -> tuple[str, ...]:
    """Modules the syntax needs that are not installed."""
    return tuple(name for name in syntax.modules if not find_module(name))


def require_decoder(uid: str) -> Syntax:
    """The decoder for a transfer syntax.

    Raises
    ------
    SeriesError
        If the syntax is not one that is read, or its packages are missing. The message
        lacks the folder.
    """
    syntax = SYNTAXES.get(uid)
    if syntax is None:
        raise SeriesError(
            f"the images have transfer syntax {uid or 'none'}, which is no CT image coding that is read; export them uncompressed"
        )
    if missing_modules(syntax):
        raise SeriesError(f"the images are compressed as {syntax.name} and its decoder is not installed; {INSTALL} brings it")
    return syntax


def decode_slice(dataset: Dataset, header: SliceHeader) -> StoredArray:
    """Stored values of one slice, as written, before rescaling.

    Parameters
    ----------
    dataset : Dataset
        The parsed file with its pixel data.
    header : SliceHeader
        The slice, as admitted by the gate.

    Returns
    -------
    (rows, columns) int16 or uint16 array

    Raises
    ------
    SeriesError
        If the pixel data are missing, cut, or not the size the header promises. The
        message does not name the slice; the caller does.
    """
    syntax = require_decoder(header.syntax)
    rows, columns = header.matrix
    data = dataset.get("PixelData")
    if not data:
        raise SeriesError("has no pixel data; export it again")
    index = header.frame or 0
    if not syntax.family:
        wanted = rows * columns * header.frames * 2
        if len(data) not in (wanted, wanted + wanted % 2):
            raise SeriesError(
                f"has {len(data)} bytes of pixels, expected {wanted} for {header.frames} x {rows} rows x {columns} columns; "
                "it is cut or its header is wrong, export it again"
            )
    options: dict[str, Any] = {"decoding_plugin": syntax.plugin} if syntax.plugin else {}
    try:
        if syntax.family:
            frame = get_frame(data, index, number_of_frames=header.frames)
            check_stream(frame, family=syntax.family, rows=rows, columns=columns)
        stored, _ = get_decoder(header.syntax).as_array(dataset, index=index, raw=True, **options)
    except (*UNREADABLE, RuntimeError) as error:
        raise SeriesError(
            f"has pixel data that do not decode as {syntax.name} ({type(error).__name__}); export it again"
        ) from error
    if stored.shape != (rows, columns) or stored.dtype.kind not in "iu" or stored.dtype.itemsize != 2:
        raise SeriesError(
            f"decodes to {stored.shape} values of {stored.dtype}, expected {rows} x {columns} of 16 bits; export it again"
        )
    result: StoredArray = stored
    return result
