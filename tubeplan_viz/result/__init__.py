"""result.json: its content, its schema, and the run as recording and report see it."""

from tubeplan_viz.result.review import Review

__all__ = ["Review"]
