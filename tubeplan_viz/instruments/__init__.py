"""Flexible instruments: their catalogue, their rigid tips, and which of them reaches which target."""

from tubeplan_viz.instruments.catalogue import CatalogueError, Instrument, make_catalogue, read_catalogue
from tubeplan_viz.instruments.document import MatrixError, matrix_schema, validate_matrix
from tubeplan_viz.instruments.matrix import Matrix, find_targets, instrument_matrix
from tubeplan_viz.instruments.proof import SharpBend
from tubeplan_viz.instruments.reach import ReachSettings
from tubeplan_viz.instruments.tip import TipClearance, tip_clearance
from tubeplan_viz.instruments.verdict import Cell, Target, Verdict, Witness, apart

__all__ = [
    "CatalogueError",
    "Cell",
    "Instrument",
    "Matrix",
    "MatrixError",
    "ReachSettings",
    "SharpBend",
    "Target",
    "TipClearance",
    "Verdict",
    "Witness",
    "apart",
    "find_targets",
    "instrument_matrix",
    "make_catalogue",
    "matrix_schema",
    "read_catalogue",
    "tip_clearance",
    "validate_matrix",
]
