"""What an export starts from: the run folder, and the CT it was made of when that is needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from segmentation.arrays import BoolArray
from segmentation.errors import TubeplanError
from segmentation.images import is_volume_file, read_ct
from segmentation.lumen import segment_lumen
from segmentation.mask_file import whole_mask
from segmentation.mesh import Surface
from segmentation.mesh_files import read_ply
from segmentation.volume import Volume
from tubeplan_viz.cases.fields import read_table
from tubeplan_viz.cases.inputs import InputCase, input_case
from tubeplan_viz.pipeline import Notify, segmentation_settings
from tubeplan_viz.result import file_sha256, read_result


class ExportError(TubeplanError):
    """A run that cannot be exported as asked."""


class LackingError(ExportError):
    """What an export needs and this kind of run does not have, like the CT of a run from a mesh."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Grown:
    """The CT of a run and the lumen in it, on the whole grid."""

    volume: Volume
    mask: BoolArray


class ExportSource:
    """A run folder whose files are the run's own; the CT is read when first asked for.

    Parameters
    ----------
    folder : Path
        A run folder.
    notify : Notify
        Told when the CT is read and the lumen grown again.

    Raises
    ------
    RunFolderError, ResultError
        If there is no run in the folder.
    ExportError
        If a file of the run has been changed since.
    """

    def __init__(self, folder: Path, notify: Notify) -> None:
        self.folder = folder
        self.name = folder.resolve().name
        self.result: dict[str, Any] = read_result(folder)
        self._notify = notify
        for entry in self.result["provenance"].get("outputs", []):
            path = folder / entry["name"]
            if not path.is_file():
                raise ExportError(f"{self.name}: {entry['name']} is gone; the run is not whole, plan the case again")
            if file_sha256(path) != entry["sha256"]:
                raise ExportError(
                    f"{self.name}: {entry['name']} was changed after the run; only a run as it was made is exported, "
                    "plan the case again"
                )

    @property
    def case_id(self) -> str:
        """The case's own id."""
        return str(self.result["details"].get("case_id") or "case")

    @property
    def anatomy(self) -> str:
        """What the lumen is; "generic" where the case does not say."""
        return str(self.result["details"].get("anatomy") or "generic")

    @cached_property
    def surface(self) -> Surface:
        """The wall of the lumen.

        Raises
        ------
        LackingError
            If the run has none, as a needle's.
        """
        path = self.folder / "mesh.ply"
        if not path.is_file():
            raise LackingError(f"{self.name}: the run has no mesh.ply, so there is no surface to export")
        return read_ply(path)

    @cached_property
    def input(self) -> InputCase:
        """Table ``[input]`` of the run's case file.

        Raises
        ------
        LackingError
            If the case has no such table, as a needle's.
        """
        table = read_table(self.folder / "case.toml")
        if "input" not in table:
            raise LackingError(f"{self.name}: the case has no [input], so there is neither CT nor lumen to export")
        return input_case(table, folder=self.folder.resolve(), name="case.toml")

    @property
    def ct(self) -> Path:
        """Where the CT lies that the run was made from.

        Raises
        ------
        LackingError
            If the run came from a mesh.
        ExportError
            If the CT is not there any more.
        """
        ct = self.input.ct
        if ct is None:
            raise LackingError(f"{self.name}: the run was made from a mesh, so there is no CT and no mask in it to export")
        if not ct.exists():
            raise ExportError(
                f"{self.name}: the CT {ct.name} is not where case.toml says it was; the run folder does not hold it, "
                "put it back or correct the path ct in case.toml's [input]"
            )
        return ct

    @property
    def dicom(self) -> Path:
        """The CT, where it is DICOM.

        Raises
        ------
        LackingError
            If it is a volume file, to which no DICOM instance can refer.
        """
        if is_volume_file(self.ct):
            raise LackingError(
                f"{self.name}: the CT {self.ct.name} is no DICOM series, so no DICOM instance can lie on it; "
                "--to slicer writes the same for 3D Slicer"
            )
        return self.ct

    @cached_property
    def grown(self) -> Grown:
        """The CT and the lumen grown in it again, which must come out as in the run.

        Raises
        ------
        ExportError
            If the CT is gone or is not the one that the run was made from.
        """
        self._notify("read CT", 0, 0)
        image = read_ct(self.ct, series=self.input.series, progress=lambda done, total: self._notify("read CT", done, total))
        stated = {entry["name"]: entry["sha256"] for entry in self.result["provenance"]["inputs"]}
        for name, digest in image.inputs:
            if stated.get(name) != digest:
                raise ExportError(
                    f"{self.name}: the CT {self.ct.name} is not the one that the run was made from (SHA-256 {digest[:12]}..., "
                    f"expected {stated.get(name, 'another file')[:12]}...); put the right one back, or plan the case again"
                )
        self._notify("grow region", 0, 0)
        region = segment_lumen(image.volume, segmentation_settings(self.input))
        details = self.result["details"]
        if (region.hu_min, region.hu_max) != (details.get("hu_min"), details.get("hu_max")):
            raise ExportError(
                f"{self.name}: the lumen now grows from {region.hu_min:g} to {region.hu_max:g} HU, in the run it did from "
                f"{details.get('hu_min')} to {details.get('hu_max')} HU; the program has changed since, plan the case again"
            )
        return Grown(volume=image.volume, mask=whole_mask(region, image.volume))
