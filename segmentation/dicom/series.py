"""Which series lie in a folder, and choosing the one to read."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from segmentation.dicom.files import DicomFile, list_folder, quiet_parser, read_head
from segmentation.dicom.headers import SliceHeader, slice_headers
from segmentation.errors import SeriesError

Progress = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class SeriesInfo:
    """One series as its headers describe it; nothing in the printed form identifies a patient.

    Attributes
    ----------
    number : int
        Place in the listing, from 1.
    series_number : int or None
        The scanner's own SeriesNumber.
    uid : str
        SeriesInstanceUID; empty where the headers were stripped of it.
    kind : {"CT", "localizer", "not CT"}
    headers : tuple of SliceHeader
        One per slice, in order of file name.
    """

    number: int
    series_number: int | None
    uid: str = field(repr=False)
    kind: str
    headers: tuple[SliceHeader, ...] = field(repr=False)

    def __str__(self) -> str:
        first = self.headers[0]
        what = first.modality or "no modality"
        size = f"{len(self.headers)} images {first.columns} x {first.rows}" if first.rows else f"{len(self.headers)} objects"
        extra = [f"kernel {printable(first.kernel)}"] if first.kernel else []
        extra += [f"SeriesNumber {self.series_number}"] if self.series_number is not None else []
        extra += [self.kind] if self.kind != "CT" else []
        return f"{self.number}: {', '.join([what, size, *extra])}"


@dataclass(frozen=True)
class Scan:
    """Everything a header-only look at a folder brings.

    Attributes
    ----------
    series : tuple of SeriesInfo
    ignored : int
        Files that are no DICOM.
    faults : tuple of str
        Files that cannot be trusted; they belong to no series.
    """

    series: tuple[SeriesInfo, ...]
    ignored: int
    faults: tuple[str, ...]


def scan_folder(path: Path, *, progress: Progress | None = None) -> tuple[SeriesInfo, ...]:
    """List the series in a folder and its subfolders from the headers alone.

    Parameters
    ----------
    path : Path
        A folder, or one multi-frame file.
    progress : callable, optional
        Called with the number of headers read and of files.

    Returns
    -------
    tuple of SeriesInfo
        In order of SeriesNumber.

    Raises
    ------
    SeriesError
        If a file looks like DICOM and cannot be read, is a link or no regular file, or if
        there is no DICOM at all.
    """
    path = path.resolve()  # so that "." has a name
    scan = scan_headers(path, progress=progress)
    if scan.faults:
        raise SeriesError(f"{path.name}: {join_faults(scan.faults)}")
    if not scan.series:
        raise SeriesError(f"{path.name}: holds no DICOM image ({scan.ignored} other files); name the folder of a CT series")
    return scan.series


def scan_headers(path: Path, *, progress: Progress | None = None) -> Scan:
    """As `scan_folder`, but faulty files are listed instead of raised.

    Raises
    ------
    SeriesError
        If there are too many files.
    """
    listing = list_folder(path)
    headers: list[SliceHeader] = []
    faults = list(listing.faults)
    with quiet_parser():
        for done, file in enumerate(listing.files, start=1):
            try:
                headers += _headers_of(file)
            except SeriesError as error:
                faults.append(str(error))
            if progress is not None:
                progress(done, len(listing.files))
    return Scan(_group(headers), listing.ignored, tuple(faults))


def choose_series(series: Sequence[SeriesInfo], name: str | None, folder: str) -> tuple[SeriesInfo, tuple[str, ...]]:
    """The series to read, and a warning for each one left out.

    Parameters
    ----------
    name : str or None
        ``"2"`` (place in the listing, or SeriesNumber where no place matches), a
        SeriesInstanceUID, or unmistakably ``"line:2"`` or ``"number:5"``. ``None`` takes
        the only CT series that is no localizer.

    Raises
    ------
    SeriesError
        If none or several fit.
    """
    listing = "; ".join(str(entry) for entry in series)
    if name is None:
        fitting = [entry for entry in series if entry.kind == "CT"]
        if not fitting:
            raise SeriesError(f"{folder}: holds no CT image series, only {listing}; name the folder of a CT series")
        if len(fitting) > 1:
            raise SeriesError(
                f"{folder}: holds {len(fitting)} CT series; name one of them as in --series {fitting[0].number} from {listing}"
            )
        left_out = tuple(f"series {entry} was left out" for entry in series if entry is not fitting[0])
        return fitting[0], left_out
    fitting = _matching(series, name.strip())
    if not fitting:
        raise SeriesError(f"{folder}: no series is called {name}; there are {listing}")
    if len(fitting) > 1:
        raise SeriesError(
            f"{folder}: {name} is the place in the listing of one series and the SeriesNumber of another; "
            f"say line:N or number:N, from {listing}"
        )
    if fitting[0].kind != "CT":
        raise SeriesError(f"{folder}: series {fitting[0]} holds no CT slices; name a CT series from {listing}")
    return fitting[0], ()


def join_faults(faults: Sequence[str]) -> str:
    """The first fault, and how many more there are."""
    more = len(faults) - 1
    return faults[0] + (f" ({more} more {'fault' if more == 1 else 'faults'}: tubeplan inspect lists all)" if more else "")


def printable(text: str, limit: int = 40) -> str:
    """A header's free text with everything but plain printable ASCII dropped, shortened."""
    return "".join(letter for letter in text if " " <= letter <= "~" and letter not in "<>&\"'`")[:limit].strip()


def _headers_of(file: DicomFile) -> tuple[SliceHeader, ...]:
    try:
        dataset, head = read_head(file)
    except SeriesError as error:
        raise SeriesError(f"{file.name} {error}") from error
    return slice_headers(dataset, file, head=head)


def _matching(series: Sequence[SeriesInfo], name: str) -> list[SeriesInfo]:
    kind, _, rest = name.partition(":")
    by_uid = [entry for entry in series if entry.uid and entry.uid == name]
    by_line = [entry for entry in series if str(entry.number) == (rest if kind == "line" else name)]
    by_number = [entry for entry in series if str(entry.series_number) == (rest if kind == "number" else name)]
    if by_uid:
        return by_uid
    return by_line + [entry for entry in by_number if entry not in by_line]


def _group(headers: Sequence[SliceHeader]) -> tuple[SeriesInfo, ...]:
    groups: dict[Hashable, list[SliceHeader]] = defaultdict(list)
    for header in headers:
        groups[_key(header)].append(header)
    ordered = sorted(
        groups.values(),
        key=lambda group: (_kind(group[0]) != "CT", group[0].series_number or 0, group[0].file.name),
    )
    return tuple(
        SeriesInfo(
            number=number,
            series_number=group[0].series_number,
            uid=group[0].series,
            kind=_kind(group[0]),
            headers=tuple(group),
        )
        for number, group in enumerate(ordered, start=1)
    )


def _key(header: SliceHeader) -> Hashable:
    """What makes one series: its UID; where that was stripped, all that one reconstruction has in common."""
    if header.series:
        return header.series, header.is_localizer
    orientation = tuple(round(value, 2) for value in header.orientation or ())
    return (
        header.study,
        header.frame_of_reference,
        header.series_number,
        header.modality,
        header.is_ct,
        header.kernel,
        header.rows,
        header.columns,
        orientation,
        header.is_localizer,
    )


def _kind(header: SliceHeader) -> str:
    if header.is_localizer:
        return "localizer"
    return "CT" if header.is_ct else "not CT"
