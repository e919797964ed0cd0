"""Errors whose text is meant for the user.

Every message names the thing, the value found, the value expected and what to
do. None of the classes has an ``__init__``: they must survive pickling.
"""


class TubeplanError(Exception):
    """Root of the errors that the command line prints as one sentence (exit status 2)."""


class SeriesError(TubeplanError):
    """A DICOM folder that cannot be turned into one trustworthy volume."""


class VolumeError(TubeplanError):
    """Voxels or geometry that are not a plausible CT volume."""


class RegionError(TubeplanError):
    """A grown region that is no tube: empty, leaked, or without the right shape."""


class SurfaceError(TubeplanError):
    """A mesh that cannot serve as the wall of a lumen."""


class GeometryError(TubeplanError):
    """A curve or point set on which the asked quantity is not defined."""


class CaseError(TubeplanError):
    """A case file, option or point that cannot be used as given."""
