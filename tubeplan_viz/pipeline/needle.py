"""The way through for needles: case -> obstacles -> plan -> outputs, into the same run folder as every planner."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

from reports import Surroundings, render_needle, write_page
from tubeplan_viz.cases.needle import NeedleCase, needle_case_table, needle_case_text
from tubeplan_viz.pipeline.needle_details import case_name, content_of, path_table
from tubeplan_viz.pipeline.needle_ground import load_ground, space, spatial_problem
from tubeplan_viz.pipeline.needle_plan import planned_flat, planned_in_space
from tubeplan_viz.pipeline.options import RunOptions
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.recording.needle import NeedleRecording
from tubeplan_viz.result import Provenance, RunFolder, assemble_result, slicer_markups


def run_needle(case: NeedleCase, target: Path, options: RunOptions) -> dict[str, Any]:
    """Plan one needle case and write its run folder; parameters as `tubeplan_viz.planners.run_case`.

    Returns
    -------
    dict
        The content of result.json; status "infeasible" with a reason where there is no path.

    Raises
    ------
    TubeplanError
        If the input is bad; then no folder is left.
    """
    watch = Stopwatch(options.notify)
    with RunFolder(target, force=options.force) as folder:
        with watch.stage("obstacles"):
            ground = load_ground(case)
            warnings = list(ground.warnings)
            problem = None if case.flat else spatial_problem(case, ground)
        stream = None
        if options.recording:
            stream = NeedleRecording.open(
                folder.path("recording.rrd"),
                case_id=case_name(case),
                planner=case.name,
                frame=case.frame,
                connect=options.connect,
                light=options.light,
            )
            warnings.extend(stream.warnings)
        with stream or nullcontext():
            if stream is not None:
                entry = space(case.entry) if problem is None else problem.pose.position
                stream.log_scene(entry, space(case.target), ground.scene, case.safety, ground.volume)
            if problem is None:
                outcome = planned_flat(case, ground.scene, watch)
            else:
                outcome = planned_in_space(case, problem, watch, stream)
            content = content_of(case, ground, outcome, warnings)
            provenance = Provenance(inputs=ground.inputs, rng_seed=case.rng_seed, settings=needle_case_table(case))
            if stream is not None:
                with watch.stage("recording"):
                    stream.finish(assemble_result(content, timings_s=watch.seconds, provenance=provenance))
                    stream.close()
        result = assemble_result(content, timings_s=watch.seconds, provenance=provenance)
        folder.write_text("case.toml", needle_case_text(case, target))
        if result["path"] is not None:
            folder.write_text("path.csv", path_table(result, outcome))
            folder.write_json("path.mrk.json", slicer_markups(result))
        if options.report:
            with watch.stage("report"):
                result = assemble_result(content, timings_s=watch.seconds, provenance=provenance)
                around = Surroundings(ground.volume, ground.scene.body_distances if len(ground.scene) else None)
                write_page(render_needle(case_name(case), result, around), folder.path("report.html"))
        return folder.finish(result)
