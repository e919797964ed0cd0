"""Flexible needles: kinematics, obstacles, planar forms, swarm, replanning."""
