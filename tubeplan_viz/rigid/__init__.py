"""Rigid instruments through the nose: coupled endoscope and shaver, reverse tangent-point search, ranking (patent text, 2021)."""

from tubeplan_viz.rigid.entry import BORDER, entry_border, entry_points
from tubeplan_viz.rigid.instrument import Bodies, CoupledInstrument, pose_angles, posed, swept, up_of
from tubeplan_viz.rigid.judge import Judge
from tubeplan_viz.rigid.planner import Problem, RigidPlan, make_problem, path_goals, plan_rigid, refined, structure_distances
from tubeplan_viz.rigid.ranking import BEST, GOALS, Ranking, Weights, rank
from tubeplan_viz.rigid.relief import Relief, reliefs
from tubeplan_viz.rigid.search_state import RigidPath, SearchResult, SearchSettings
from tubeplan_viz.rigid.tangent_search import search

__all__ = [
    "BEST",
    "BORDER",
    "GOALS",
    "Bodies",
    "CoupledInstrument",
    "Judge",
    "Problem",
    "Ranking",
    "Relief",
    "RigidPath",
    "RigidPlan",
    "SearchResult",
    "SearchSettings",
    "Weights",
    "entry_border",
    "entry_points",
    "make_problem",
    "path_goals",
    "plan_rigid",
    "pose_angles",
    "posed",
    "rank",
    "refined",
    "reliefs",
    "search",
    "structure_distances",
    "swept",
    "up_of",
]
