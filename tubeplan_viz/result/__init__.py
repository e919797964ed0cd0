"""result.json and its schema, the run folder, exports, and the run as recording and report see it."""

from tubeplan_viz.result.comparison import COMPARISON_FILES, STRAIGHT_MM, ComparedRun, Comparison, compare_runs, read_runs
from tubeplan_viz.result.digits import digits_apart
from tubeplan_viz.result.document import Provenance, assemble_result, build_result, plain, result_text
from tubeplan_viz.result.errors import ResultError, RunFolderError
from tubeplan_viz.result.exports import CSV_COLUMNS, flag_markups, path_csv, slicer_markups
from tubeplan_viz.result.folder import RESULT, RunFolder, file_sha256, is_run, not_a_run, read_result
from tubeplan_viz.result.places import kept_until, part_words, place_words, worst_at
from tubeplan_viz.result.review import Review
from tubeplan_viz.result.schema import check_schema, result_schema, shipped_schema, validate_result
from tubeplan_viz.result.whole import write_whole

__all__ = [
    "COMPARISON_FILES",
    "CSV_COLUMNS",
    "RESULT",
    "STRAIGHT_MM",
    "ComparedRun",
    "Comparison",
    "Provenance",
    "ResultError",
    "Review",
    "RunFolder",
    "RunFolderError",
    "assemble_result",
    "build_result",
    "check_schema",
    "compare_runs",
    "digits_apart",
    "file_sha256",
    "flag_markups",
    "is_run",
    "kept_until",
    "not_a_run",
    "part_words",
    "path_csv",
    "place_words",
    "plain",
    "read_result",
    "read_runs",
    "result_schema",
    "result_text",
    "shipped_schema",
    "slicer_markups",
    "validate_result",
    "worst_at",
    "write_whole",
]
