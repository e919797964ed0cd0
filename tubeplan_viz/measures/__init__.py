"""Clinical measures of a planned case: path, collecting system, airway, stones, structures, scores."""

from tubeplan_viz.measures.airway import airway_measures
from tubeplan_viz.measures.collecting_system import collecting_system, ureter_root, urinary_parts
from tubeplan_viz.measures.definitions import DEFINITIONS, GROUPS, Definition
from tubeplan_viz.measures.edges import CtSections, PlainSections
from tubeplan_viz.measures.lines import Lumen
from tubeplan_viz.measures.measure import Drawing, Measure, lacking
from tubeplan_viz.measures.parts import Part, nearest_parts, path_parts
from tubeplan_viz.measures.path import path_measures
from tubeplan_viz.measures.scores import Score, ScorePart, StoneFacts, rirs, russ
from tubeplan_viz.measures.stones import stone_facts, stone_measures
from tubeplan_viz.measures.structures import structure_measures
from tubeplan_viz.measures.urinary import UrinaryMeasures, UrinarySettings, urinary_measures

__all__ = [
    "DEFINITIONS",
    "GROUPS",
    "CtSections",
    "Definition",
    "Drawing",
    "Lumen",
    "Measure",
    "Part",
    "PlainSections",
    "Score",
    "ScorePart",
    "StoneFacts",
    "UrinaryMeasures",
    "UrinarySettings",
    "airway_measures",
    "collecting_system",
    "lacking",
    "nearest_parts",
    "path_measures",
    "path_parts",
    "rirs",
    "russ",
    "stone_facts",
    "stone_measures",
    "structure_measures",
    "ureter_root",
    "urinary_measures",
    "urinary_parts",
]
