"""The way through for rigid instruments: head CT -> nasal scene -> shrinkage -> search -> ranked paths -> outputs."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reports import render_rigid, write_page
from segmentation.anatomy.nasal import (
    Lesion,
    NasalScene,
    Shrinkage,
    given_lesion,
    propose_lesion,
    propose_scene,
    require_entry,
    shrink,
)
from segmentation.arrays import BoolArray
from segmentation.errors import CaseError
from segmentation.images import CtImage, read_ct
from segmentation.label_file import read_mask_file
from segmentation.volume import Volume
from tubeplan_viz.cases.rigid import RigidCase, rigid_case_table, rigid_case_text
from tubeplan_viz.pipeline.options import RunOptions
from tubeplan_viz.pipeline.progress import Stopwatch
from tubeplan_viz.pipeline.rigid_result import path_table, rigid_content
from tubeplan_viz.recording.rigid import RigidRecording
from tubeplan_viz.result import Provenance, RunFolder, assemble_result, slicer_markups
from tubeplan_viz.rigid import Problem, RigidPlan, make_problem, plan_rigid

VERDICTS = (0.0, 0.5, 1.0)  # amounts of shrinkage at which a verdict is given, besides the one planned with


@dataclass(frozen=True, eq=False, kw_only=True)
class RigidInput:
    """What a rigid case is planned on.

    Attributes
    ----------
    image : CtImage
    scene : NasalScene
        Before shrinkage.
    lesion : Lesion
    inputs : list of (name, sha256)
    warnings : list of str
    """

    image: CtImage
    scene: NasalScene
    lesion: Lesion
    inputs: list[tuple[str, str]]
    warnings: list[str]


def run_rigid(case: RigidCase, target: Path, options: RunOptions) -> dict[str, Any]:
    """Plan one rigid case and write its run folder; parameters as `tubeplan_viz.planners.run_case`.

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
        given = load_head(case, watch)
        stream = None
        if options.recording:
            name = case.case_id or "case"
            stream = RigidRecording.open(folder.path("recording.rrd"), case_id=name, connect=options.connect, light=options.light)
            given.warnings.extend(stream.warnings)
        with stream or nullcontext():
            with watch.stage("obstacles"):
                shrunk, problems = shrunken_problems(case, given)
            if stream is not None:
                stream.log_scene(problems[case.shrinkage])
            with watch.stage("plan"):
                plan = plan_rigid(problems, case.search, case.weights, amount=case.shrinkage, progress=options.notify)
            with watch.stage("measure"):
                content = rigid_content(case, given.lesion, given.scene, shrunk, plan, given.warnings)
                content["details"]["image"] = dict(given.image.facts)
            provenance = Provenance(inputs=tuple(given.inputs), rng_seed=None, settings=rigid_case_table(case))
            if stream is not None:
                with watch.stage("recording"):
                    stream.finish(plan, assemble_result(content, timings_s=watch.seconds, provenance=provenance))
                    stream.close()
        result = assemble_result(content, timings_s=watch.seconds, provenance=provenance)
        folder.write_text("case.toml", rigid_case_text(case, target))
        if result["path"] is not None:
            folder.write_text("path.csv", path_table(result))
            folder.write_json("path.mrk.json", slicer_markups(result))
        if options.report:
            with watch.stage("report"):
                write_report(case, plan, content, watch, provenance, folder.path("report.html"))
                result = assemble_result(content, timings_s=watch.seconds, provenance=provenance)
        return folder.finish(result)


def write_report(
    case: RigidCase, plan: RigidPlan, content: Mapping[str, Any], watch: Stopwatch, provenance: Provenance, path: Path
) -> None:
    """The page, with the timings up to here."""
    result = assemble_result(content, timings_s=watch.seconds, provenance=provenance)
    write_page(render_rigid(case.case_id or "case", result, plan.problem.scene), path)


def load_head(case: RigidCase, watch: Stopwatch) -> RigidInput:
    """Read the CT, propose or take over its structures, and settle the lesion.

    Raises
    ------
    TubeplanError
        If the CT cannot be read, shows no nose, misses the side, or a mask or the lesion does not fit it.
    """
    with watch.stage("read CT") as progress:
        image = read_ct(case.ct, series=case.series, progress=progress)
    inputs = list(image.inputs)
    masks = {name: read_label(path, image.volume, inputs) for name, path in case.masks.items()}
    with watch.stage("nasal structures") as progress:
        scene = propose_scene(
            image.volume,
            masks=masks,
            seeds=case.seeds,
            boxes={name: np.reshape(corners, (2, 3)) for name, corners in case.boxes.items()},
            progress=lambda name, share: progress(round(100 * share), 100),
        )
        require_entry(scene, case.side)
        lesion = lesion_of(case, scene, inputs)
    warnings = [*image.warnings, *scene.notes]
    if lesion.note:
        warnings.append(lesion.note)
    return RigidInput(image=image, scene=scene, lesion=lesion, inputs=inputs, warnings=warnings)


def read_label(path: Path, volume: Volume, inputs: list[tuple[str, str]]) -> BoolArray:
    """A mask on the CT's grid; its digest is added to the inputs."""
    mask, files = read_mask_file(path, volume)
    inputs.extend(files)
    return mask


def lesion_of(case: RigidCase, scene: NasalScene, inputs: list[tuple[str, str]]) -> Lesion:
    """The lesion as the case gives it, or the proposed medial wall of the optic canal."""
    if case.lesion is not None:
        return given_lesion(scene, case.side, point=case.lesion)
    if case.lesion_mask is not None:
        return given_lesion(scene, case.side, mask=read_label(case.lesion_mask, scene.volume, inputs))
    found = propose_lesion(scene, case.side)
    if found is None:
        raise CaseError(f"the {case.side} optic canal was not found, so no lesion can be proposed; give --lesion X,Y,Z in LPS mm")
    return found


def shrunken_problems(case: RigidCase, given: RigidInput) -> tuple[dict[float, Shrinkage], dict[float, Problem]]:
    """The scene and the planning problem at each amount of shrinkage."""
    amounts = sorted({*VERDICTS, case.shrinkage})
    instrument, _, _ = case.instrument
    shrunk = {amount: shrink(given.scene, amount, case.side) for amount in amounts}
    problems: dict[float, Problem] = {}
    for amount, found in shrunk.items():
        # Of all structures only septum and turbinate differ.
        like = next(iter(problems.values())).obstacles if problems else None
        problems[amount] = make_problem(
            found.scene, case.side, given.lesion.center, instrument=instrument, margin=case.margin, like=like
        )
    return shrunk, problems
