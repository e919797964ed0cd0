"""Published and measured comparisons, rebuilt: tubeplan bench NAME."""
