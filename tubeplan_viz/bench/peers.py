"""Peers that run on a Python of their own: where it is found and how it is asked."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import TubeplanError
from tubeplan_viz.bench.alone import run_alone

# VMTK's wheels want a newer Python than the oldest that the project runs on.
CANDIDATES = ("python3.12", "python3.13", "python3.14")
VMTK_RUNS_ON = f"no {', '.join(CANDIDATES)} on the PATH can import it"
SCRIPT = Path(__file__).parent / "vmtk_peer.py"
TIME_LIMIT = 1200.0


@dataclass(frozen=True, eq=False, kw_only=True)
class VmtkLines:
    """What VMTK made of a mesh, and what it took.

    Attributes
    ----------
    lines : tuple of (n, 3) float array, mm
        The raw line from the root to each target.
    cold, warm : float, s
        Processor time of the first and the last run, from the mesh file on.
    peak : float, MB
        Most memory of its process.
    """

    lines: tuple[FloatArray, ...]
    cold: float
    warm: float
    peak: float


@cache
def vmtk_python() -> str | None:
    """A Python that can import VMTK: this one, or the first of `CANDIDATES` on the PATH; None without any."""
    if find_spec("vmtk") is not None:
        return sys.executable
    for name in CANDIDATES:
        found = shutil.which(name)
        if found is not None and subprocess.run([found, "-c", "import vmtk"], capture_output=True, check=False).returncode == 0:
            return found
    return None


def run_vmtk(python: str, mesh: Path, ends: FloatArray, *, runs: int) -> VmtkLines:
    """VMTK's lines of a mesh file from the first of the ends to the others.

    Raises
    ------
    TubeplanError
        If VMTK fails or takes longer than 20 minutes.
    """
    with TemporaryDirectory() as place:
        sites, out = Path(place) / "ends.npy", Path(place) / "out.npz"
        np.save(sites, ends)
        command = [python, "-P", str(SCRIPT), str(mesh), str(sites), str(out), str(runs)]
        ended = run_alone(command, limit=TIME_LIMIT)
        if ended.status is None:
            raise TubeplanError(f"VMTK took more than {TIME_LIMIT:g} s on {mesh.name}; leave it out or give it a smaller mesh")
        if ended.status != 0:
            raise TubeplanError(f"VMTK failed on {mesh.name} with exit status {ended.status}: {ended.reason}")
        with np.load(out) as found:
            lines = np.split(found["points"], np.cumsum(found["counts"])[:-1])
            return VmtkLines(lines=tuple(lines), cold=float(found["cold"]), warm=float(found["warm"]), peak=float(found["peak"]))
