"""The one way through: case -> volume -> surface -> plan -> outputs."""

from tubeplan_viz.pipeline.bronchoscope import run_bronchoscope
from tubeplan_viz.pipeline.ends import case_end_names, case_tree, find_end, listing, pose_case, resolve_end
from tubeplan_viz.pipeline.lumen import Lumen, growth_details, load_lumen, segmentation_settings
from tubeplan_viz.pipeline.needle import run_needle
from tubeplan_viz.pipeline.options import RunOptions
from tubeplan_viz.pipeline.parts import entered_tree
from tubeplan_viz.pipeline.progress import Notify, Stopwatch, silent
from tubeplan_viz.pipeline.rigid import run_rigid
from tubeplan_viz.pipeline.segment import segment_case
from tubeplan_viz.pipeline.tree import Tree, endpoint_details, grow_tree
from tubeplan_viz.pipeline.tube import run_tube, surface_details

__all__ = [
    "Lumen",
    "Notify",
    "RunOptions",
    "Stopwatch",
    "Tree",
    "case_end_names",
    "case_tree",
    "endpoint_details",
    "entered_tree",
    "find_end",
    "grow_tree",
    "growth_details",
    "listing",
    "load_lumen",
    "pose_case",
    "resolve_end",
    "run_bronchoscope",
    "run_needle",
    "run_rigid",
    "run_tube",
    "segment_case",
    "segmentation_settings",
    "silent",
    "surface_details",
]
