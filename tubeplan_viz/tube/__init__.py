"""Curvature- and clearance-constrained paths inside a curved tube (Dai et al. 2024)."""

from tubeplan_viz.tube.features import FeatureSettings
from tubeplan_viz.tube.optimal import OptimalSettings, Passage, optimise
from tubeplan_viz.tube.planner import METHODS, TubeProblem, TubeSettings, conclude, pose_problem, tube_rounds, tube_steps
from tubeplan_viz.tube.refine import RefineSettings

__all__ = [
    "METHODS",
    "FeatureSettings",
    "OptimalSettings",
    "Passage",
    "RefineSettings",
    "TubeProblem",
    "TubeSettings",
    "conclude",
    "optimise",
    "pose_problem",
    "tube_rounds",
    "tube_steps",
]
