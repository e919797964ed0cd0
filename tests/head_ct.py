"""A real head CT for tests, read by the benchmark's reader."""

from tubeplan_viz.bench.head_ct import CRANIUM, read_head_ct

__all__ = ["CRANIUM", "read_head_ct"]
