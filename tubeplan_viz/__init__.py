"""From the surface of a lumen to plans, proofs and recordings."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("tubeplan")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0.0.0"

__all__ = ["__version__"]
