"""Errors of the run folder and its result file."""

from segmentation.errors import TubeplanError


class ResultError(TubeplanError):
    """A result that is not what result.json promises (spec 0.4)."""


class RunFolderError(TubeplanError):
    """A run folder that cannot be written, or a folder that is no run."""
