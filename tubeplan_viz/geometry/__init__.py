"""Curves, their curvature, and the gap between a curve and the wall."""

from tubeplan_viz.geometry.curve import SplineCurve

__all__ = ["SplineCurve"]
