"""Middle lines of lumens with inscribed radii, their branches and their tips."""

from tubeplan_viz.centerline.line import Centerline

__all__ = ["Centerline"]
