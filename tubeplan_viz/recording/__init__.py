"""Rerun recordings of planning runs: the only home of rerun."""
