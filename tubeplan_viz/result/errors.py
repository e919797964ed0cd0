"""Errors of the run folder and its result file."""

from segmentation.errors import TubeplanError


class ResultError(TubeplanError):
    """A result that does not hold to the schema of result.json."""


class RunFolderError(TubeplanError):
    """A run folder that cannot be written, or a folder that is no run."""
