"""Checks a finished plan by other means than those that made it; imports no planner."""
