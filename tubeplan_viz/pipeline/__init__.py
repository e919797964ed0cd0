"""The one way through: case -> volume -> surface -> plan -> outputs."""

from tubeplan_viz.pipeline.lumen import Lumen, growth_details, load_lumen, segmentation_settings
from tubeplan_viz.pipeline.progress import Notify, Stopwatch, silent
from tubeplan_viz.pipeline.run import run_case, surface_details
from tubeplan_viz.pipeline.segment import segment_case
from tubeplan_viz.pipeline.tree import Tree, endpoint_details, grow_tree, pose_case, resolve_end

__all__ = [
    "Lumen",
    "Notify",
    "Stopwatch",
    "Tree",
    "endpoint_details",
    "grow_tree",
    "growth_details",
    "load_lumen",
    "pose_case",
    "resolve_end",
    "run_case",
    "segment_case",
    "segmentation_settings",
    "silent",
    "surface_details",
]
