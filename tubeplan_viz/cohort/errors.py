"""What can be wrong with a cohort as a whole."""

from __future__ import annotations

from segmentation.errors import CaseError, TubeplanError


class ManifestError(CaseError):
    """A manifest of which nothing may be run: every fault of it, each with its line and case."""


class CohortError(TubeplanError):
    """A cohort's folder, journal or cluster that cannot be used."""


class CohortInterrupted(TubeplanError):
    """Ctrl-C, or a request to terminate, while cases were running (exit status 130)."""
