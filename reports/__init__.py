"""Results to HTML: one self-contained page per run, one for runs side by side, one for instruments and targets."""

from reports.derived import DERIVED, derived_values
from reports.needle_ct import Surroundings
from reports.render import (
    ReportError,
    render_bronchoscope,
    render_cohort,
    render_comparison,
    render_matrix,
    render_needle,
    render_reach,
    render_report,
    render_rigid,
    write_page,
)

__all__ = [
    "DERIVED",
    "ReportError",
    "Surroundings",
    "derived_values",
    "render_bronchoscope",
    "render_cohort",
    "render_comparison",
    "render_matrix",
    "render_needle",
    "render_reach",
    "render_report",
    "render_rigid",
    "write_page",
]
