"""Checks a finished plan by other means than those that made it; imports no planner."""

from tubeplan_viz.verify.run import check_path, verify_run
from tubeplan_viz.verify.verification import Check, Verification

__all__ = ["Check", "Verification", "check_path", "verify_run"]
