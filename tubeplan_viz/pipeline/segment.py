"""A CT's lumen as mask and mesh, without a plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from segmentation.errors import CaseError
from segmentation.mask_file import write_mask
from segmentation.mesh_files import write_ply
from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.pipeline.lumen import lumen_of_ct
from tubeplan_viz.pipeline.progress import Notify, Stopwatch, silent
from tubeplan_viz.pipeline.tube import surface_details
from tubeplan_viz.result import RunFolder, plain

# The first names the kind of folder.
SEGMENTATION_FILES = ("segmentation.json", "mask.nii.gz", "mesh.ply")


def segment_case(case: InputCase, target: Path, *, force: bool = False, notify: Notify = silent) -> dict[str, Any]:
    """Write mask.nii.gz, mesh.ply and segmentation.json of a CT's lumen into a folder.

    Returns
    -------
    dict
        What segmentation.json holds: facts, warnings, caps, growth curve, digests of the inputs.

    Raises
    ------
    TubeplanError
        If the case has no CT, it cannot be read, or holds no tube; then no folder is left.
    """
    if case.ct is None:
        raise CaseError("segmenting needs a CT; give --ct")
    watch = Stopwatch(notify)
    with RunFolder(target, force=force, files=SEGMENTATION_FILES) as folder:
        lumen = lumen_of_ct(case, watch)
        assert lumen.volume is not None
        assert lumen.region is not None
        with watch.stage("write"):
            write_mask(lumen.region, lumen.volume, folder.path("mask.nii.gz"))
            surface = write_ply(lumen.surface, folder.path("mesh.ply"))
        summary: dict[str, Any] = {
            "provenance": {"software": "tubeplan"},
            "use": "research use, not for clinical decisions",
            "frame": surface.frame,
            "facts": dict(lumen.facts),
            "warnings": list(lumen.warnings),
            "details": plain(lumen.details),
            "surface": plain(surface_details(surface)),
            "inputs": [{"name": name, "sha256": digest} for name, digest in lumen.inputs],
            "timings_s": watch.seconds,
        }
        folder.write_json("segmentation.json", summary)
        folder.appear()
    return summary
