"""The tubeplan command: one module per command."""
