"""What lies in a DICOM folder, as plain data for people and programs: no identifiers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.dicom.decode import INSTALL, SYNTAXES, missing_modules
from segmentation.dicom.facts import geometry_facts, series_facts
from segmentation.dicom.gate import header_faults, header_warnings, order_faults
from segmentation.dicom.geometry import Stack, build_stack
from segmentation.dicom.headers import SliceHeader
from segmentation.dicom.reader import drop_identical, read_admitted
from segmentation.dicom.series import Progress, Scan, SeriesInfo, scan_headers
from segmentation.errors import TubeplanError


def inspect_folder(path: Path, *, pixels: bool = False, progress: Progress | None = None) -> dict[str, Any]:
    """Describe every series in a folder and all faults that would stop it from being read.

    Parameters
    ----------
    path : Path
    pixels : bool
        Also decode the CT series that pass the header checks and look for damaged slices
        and values that are no HU.
    progress : callable, optional
        Called with the number of headers read and of files.

    Returns
    -------
    dict
        ``kind`` ("dicom"), ``files``, ``ignored_files``, ``faults`` of the folder, ``pixels_checked``
        and ``series``, a list of dicts: ``number`` (for ``--series``), ``series_number``, ``kind``,
        ``usable``, ``images``, ``facts``, ``geometry`` (null where there is none),
        ``transfer_syntax``, ``faults``, ``warnings``. Every value is JSON's.
    """
    scan = scan_headers(path, progress=progress)
    series = [_describe(info, scan, pixels=pixels) for info in scan.series]
    return {
        "kind": "dicom",
        "name": path.resolve().name,
        "files": len({header.file for info in scan.series for header in info.headers}),
        "ignored_files": scan.ignored,
        "pixels_checked": pixels,
        "faults": list(scan.faults) if scan.series or scan.faults else ["holds no DICOM image"],
        "series": series,
    }


def _describe(info: SeriesInfo, scan: Scan, *, pixels: bool) -> dict[str, Any]:
    geometry, facts = None, series_facts(info.headers)
    faults: list[str] = []
    warnings: list[str] = []
    syntax = _syntax(info.headers)
    if info.kind == "CT":
        faults, warnings, ordered, stack = _gate(info.headers)
        if stack is not None:
            shape = (len(ordered), *ordered[0].matrix)
            facts |= geometry_facts(stack.index_to_lps, shape)
            geometry = _geometry(stack, shape)
        if not syntax["installed"]:
            faults.append(
                f"its decoder is not installed; {syntax['install']} brings it" if syntax["install"] else "its coding is not read"
            )
        if pixels and stack is not None and not faults:
            try:
                read = read_admitted(ordered, stack)
                warnings += read.warnings
                facts |= read.facts
            except TubeplanError as error:
                faults.append(str(error))
    return {
        "number": info.number,
        "series_number": info.series_number,
        "kind": info.kind,
        "usable": info.kind == "CT" and not faults and not scan.faults,
        "images": len(info.headers),
        "matrix": [info.headers[0].columns, info.headers[0].rows],
        "facts": facts,
        "geometry": geometry,
        "transfer_syntax": syntax,
        "faults": faults,
        "warnings": warnings,
    }


def _gate(headers: Sequence[SliceHeader]) -> tuple[list[str], list[str], tuple[SliceHeader, ...], Stack | None]:
    """All faults and warnings; slices in order and their stack where the geometry holds."""
    faults: list[str] = []
    slices, stack = tuple(headers), None
    doubled = 0
    try:
        slices, doubled = drop_identical(headers)
    except TubeplanError as error:
        faults.append(str(error))
    faults += header_faults(slices)
    try:
        stack = build_stack(slices)
    except TubeplanError as error:
        faults.append(str(error))
    else:
        slices = tuple(slices[k] for k in stack.order)
        faults += order_faults(slices)
    warnings = [f"{doubled} byte-identical copies of slices were left out"] if doubled else []
    return faults, [*warnings, *header_warnings(slices)], slices, stack


def _geometry(stack: Stack, shape: tuple[int, int, int]) -> dict[str, Any]:
    matrix = stack.index_to_lps
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    corners = np.array([matrix @ [k, j, i, 1] for k in (0, shape[0] - 1) for j in (0, shape[1] - 1) for i in (0, shape[2] - 1)])
    return {
        "shape": list(shape),
        "spacing_mm": [float(value) for value in spacing],
        "index_to_lps": matrix.tolist(),
        "bounds_lps_mm": [corners[:, :3].min(axis=0).tolist(), corners[:, :3].max(axis=0).tolist()],
        "residual_mm": stack.residual,
    }


def _syntax(headers: Sequence[SliceHeader]) -> dict[str, Any]:
    """The coding of the series; where several are mixed, the first one that cannot be read goes before the others."""
    codings = [SYNTAXES.get(uid) for uid in sorted({header.syntax for header in headers})]
    syntax = next((coding for coding in codings if coding is None or missing_modules(coding)), codings[0])
    if syntax is None:
        return {
            "name": "not a CT image coding that is read",
            "compressed": None,
            "decoder": None,
            "installed": False,
            "install": None,
        }
    installed = not missing_modules(syntax)
    return {
        "name": syntax.name,
        "compressed": bool(syntax.family),
        "decoder": syntax.plugin or "pydicom",
        "installed": installed,
        "install": None if installed else INSTALL,
    }
