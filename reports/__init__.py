"""Results to HTML: one self-contained page per run."""

from reports.derived import DERIVED, derived_values
from reports.render import ReportError, render_report, write_report

__all__ = ["DERIVED", "ReportError", "derived_values", "render_report", "write_report"]
