"""Rigid instruments through the nose: coupled endoscope and shaver, entry region to lesion, every feasible path ranked."""
