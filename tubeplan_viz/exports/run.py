"""One run folder to files of other programs, all of them or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from segmentation.dicom import DerivedWords, write_encapsulated_stl, write_segmentation
from segmentation.errors import CaseError
from segmentation.mask_file import write_slicer_segmentation
from segmentation.mesh_exports import glb_bytes, stl_bytes
from tubeplan_viz.exports.scene import scene_parts
from tubeplan_viz.exports.source import ExportError, ExportSource, LackingError
from tubeplan_viz.exports.tables import TABLES
from tubeplan_viz.interrupts import check_interrupted
from tubeplan_viz.pipeline import Notify, silent
from tubeplan_viz.recording import write_single_file
from tubeplan_viz.result import RESULT, RunFolder, file_sha256, flag_markups, slicer_markups

MARKER = "export.json"
EXPORT_FILES = (
    MARKER,
    "path.mrk.json",
    "flags.mrk.json",
    "lumen.seg.nrrd",
    "lumen-seg.dcm",
    "lumen-stl.dcm",
    "lumen.stl",
    "scene.glb",
    "path.csv",
    *TABLES,
    "viewer.html",
)
USE = "research use, not for clinical decisions"

__all__ = ["EXPORT_FILES", "FORMATS", "ExportError", "export_run"]


class Export:
    """One export under way: where it comes from, where it goes, what it had to leave out."""

    def __init__(self, source: ExportSource, folder: RunFolder, words: DerivedWords) -> None:
        self.source, self.folder, self.words = source, folder, words
        self.notes: list[str] = []

    def slicer(self) -> None:
        """Markups of path, features and flags, and the mask as a segmentation."""
        result = self.source.result
        if result["path"] is not None:
            self.folder.write_json("path.mrk.json", slicer_markups(result))
        if result["flagged_intervals"]:
            self.folder.write_json("flags.mrk.json", flag_markups(result))
        with noting_lacks(self.notes):
            grown = self.source.grown
            path = self.folder.path("lumen.seg.nrrd")
            write_slicer_segmentation(grown.mask, grown.volume, path, name=f"lumen, {self.source.anatomy}")

    def seg(self) -> None:
        """The mask as DICOM SEG."""
        dicom, grown = self.source.dicom, self.source.grown
        path = self.folder.path("lumen-seg.dcm")
        write_segmentation(grown.mask, dicom, path, series=self.source.input.series, words=self.words)

    def stl(self) -> None:
        """The surface as STL, and encapsulated in DICOM where it came from a DICOM CT."""
        self.folder.write_bytes("lumen.stl", stl_bytes(self.source.surface))
        with noting_lacks(self.notes):
            dicom, _ = self.source.dicom, self.source.grown  # the CT must be the run's own
            path = self.folder.path("lumen-stl.dcm")
            write_encapsulated_stl(self.source.surface, dicom, path, series=self.source.input.series, words=self.words)

    def gltf(self) -> None:
        """Wall, path and flags as one glTF scene."""
        surface = self.source.surface if (self.source.folder / "mesh.ply").is_file() else None
        parts = scene_parts(self.source.result, surface)
        if not parts:
            raise LackingError(f"{self.source.name}: the run has neither mesh nor path, so there is no scene to export")
        self.folder.write_bytes("scene.glb", glb_bytes(parts))

    def csv(self) -> None:
        """Every list of the result as a table."""
        if (self.source.folder / "path.csv").is_file():
            self.folder.write_bytes("path.csv", (self.source.folder / "path.csv").read_bytes())
        for name, make in TABLES.items():
            self.folder.write_text(name, make(self.source.result))

    def single_file(self) -> None:
        """The recording and the viewer in one HTML file."""
        recording = self.source.folder / "recording.rrd"
        if not recording.is_file():
            raise LackingError(f"{self.source.name}: holds no recording.rrd (it was made with --no-recording), expected one")
        write_single_file(recording, self.folder.path("viewer.html"), title=self.source.case_id)


@contextmanager
def noting_lacks(notes: list[str]) -> Iterator[None]:
    """A part that this kind of run does not have becomes a note, each once."""
    try:
        yield
    except LackingError as fault:
        if str(fault) not in notes:
            notes.append(str(fault))


FORMATS: dict[str, Callable[[Export], None]] = {
    "slicer": Export.slicer,
    "seg": Export.seg,
    "stl": Export.stl,
    "gltf": Export.gltf,
    "csv": Export.csv,
    "single-file": Export.single_file,
}


def export_run(
    run: Path,
    target: Path,
    formats: Sequence[str],
    *,
    keep_identifiers: bool = False,
    force: bool = False,
    notify: Notify = silent,
) -> dict[str, Any]:
    """Write a run for other programs into a folder of its own.

    Parameters
    ----------
    run : Path
        A run folder whose files are unchanged.
    target : Path
        The folder to appear; refused if it exists, unless `force` is set.
    formats : sequence of str
        Names of `FORMATS`, or "all": every one that this run can give.
    keep_identifiers : bool
        Copy the patient's and the study's attributes into the DICOM files.
    notify : Notify

    Returns
    -------
    dict
        What export.json holds: the run, the files with their digests, and notes on what was left out.

    Raises
    ------
    CaseError
        If a format is not known.
    ExportError
        If the run or its CT is not what it was, or a format asked for by name cannot be given.
    """
    everything = list(formats) == ["all"]
    wanted = list(FORMATS) if everything else list(dict.fromkeys(formats))
    unknown = [name for name in wanted if name not in FORMATS]
    if unknown or not wanted:
        raise CaseError(f"--to names {', '.join(unknown) or 'nothing'}, expected all or some of {', '.join(FORMATS)}")
    with RunFolder(target, force=force, files=EXPORT_FILES) as folder:
        source = ExportSource(run, notify)
        words = DerivedWords(case_id=source.case_id, anatomy=source.anatomy, keep_identifiers=keep_identifiers)
        export = Export(source, folder, words)
        for name in wanted:
            check_interrupted()
            notify(name, 0, 0)
            if everything:
                with noting_lacks(export.notes):
                    FORMATS[name](export)
            else:
                FORMATS[name](export)
        provenance = source.result["provenance"]
        names = sorted(entry.name for entry in folder.path(MARKER).parent.iterdir())
        document: dict[str, Any] = {
            "provenance": {"software": provenance["software"], "version": provenance["version"]},
            "use": USE,
            "run": {"name": source.name, "case_id": source.case_id, "result_sha256": file_sha256(run / RESULT)},
            "frame": source.result["frame"],
            "identifiers_kept": keep_identifiers,
            "files": [{"name": name, "sha256": file_sha256(folder.path(name))} for name in names],
            "notes": export.notes,
        }
        folder.write_json(MARKER, document)
        folder.appear()
    return document
