"""Many cases from one manifest: on this machine's processors or a cluster's, resumed where they stopped, summed up."""

from tubeplan_viz.cohort.errors import CohortError, CohortInterrupted, ManifestError
from tubeplan_viz.cohort.manifest import CohortCase, Manifest, read_manifest
from tubeplan_viz.cohort.run import CohortEvent, CohortSettings, run_cohort
from tubeplan_viz.cohort.summary import cohort_schema, validate_cohort
from tubeplan_viz.cohort.tasks import CaseStatus

__all__ = [
    "CaseStatus",
    "CohortCase",
    "CohortError",
    "CohortEvent",
    "CohortInterrupted",
    "CohortSettings",
    "Manifest",
    "ManifestError",
    "cohort_schema",
    "read_manifest",
    "run_cohort",
    "validate_cohort",
]
