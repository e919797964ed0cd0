"""Results to HTML: one self-contained page per run, and one for runs side by side."""

from reports.derived import DERIVED, derived_values
from reports.render import ReportError, render_comparison, render_report, write_comparison, write_report

__all__ = [
    "DERIVED",
    "ReportError",
    "derived_values",
    "render_comparison",
    "render_report",
    "write_comparison",
    "write_report",
]
