"""Finished runs side by side: one folder with compare.json, report.html and recording.rrd."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from reports import render_comparison, write_page
from tubeplan_viz.recording import record_comparison
from tubeplan_viz.result import COMPARISON_FILES, Comparison, RunFolder, compare_runs, file_sha256, read_runs


def compare_folders(
    folders: Sequence[Path],
    target: Path,
    *,
    force: bool = False,
    recording: bool = True,
    report: bool = True,
    notify: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Comparison:
    """Compare runs and write the folder of their comparison.

    Parameters
    ----------
    folders : sequence of Path
        Two to six run folders; the first is what the others are compared with.
    target : Path
        The folder to appear; refused if it exists, unless `force` is set.
    recording, report : bool
        Whether recording.rrd and report.html are made.
    notify : callable
        Called with the stage, and how many of how many parts of it are done.

    Returns
    -------
    Comparison

    Raises
    ------
    TubeplanError
        If a folder is no run, or the target cannot be made.
    """
    notify("read runs", 0, 0)
    with RunFolder(target, force=force, files=COMPARISON_FILES) as folder:
        comparison = compare_runs(read_runs(folders))
        if recording:
            notify("recording", 0, 0)
            record_comparison(comparison, folder.path("recording.rrd"))
        if report:
            notify("report", 0, 0)
            write_page(render_comparison(comparison), folder.path("report.html"))
        made = [name for name in COMPARISON_FILES[1:] if folder.path(name).exists()]
        outputs = [{"name": name, "sha256": file_sha256(folder.path(name))} for name in made]
        document = comparison.document
        folder.write_json("compare.json", {**document, "provenance": {**document["provenance"], "outputs": outputs}})
        folder.appear()
    return comparison
