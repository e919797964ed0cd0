"""VMTK's centerlines of a mesh, run by a Python that has VMTK: python -P vmtk_peer.py MESH ENDS OUT [RUNS].

VMTK needs another Python than the project may run on, so this file imports neither the project nor anything but
VMTK and NumPy. ENDS holds (k, 3) points, the root first. OUT receives the points of all lines (n, 3), the number of points
of each line, the radii of VMTK's inscribed spheres, the processor seconds of the first and the last run, and the peak
memory in MB.
"""

from __future__ import annotations

import resource
import sys
import time
from importlib import import_module

import numpy as np


def lines_of(mesh: str, ends: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Points (n, 3) in mm and radii (n,) of the raw line from the root to each other end, from the mesh file on."""
    scripts = import_module("vmtk.vmtkscripts")
    reader = scripts.vmtkSurfaceReader()
    reader.InputFileName = mesh
    reader.Execute()
    search = scripts.vmtkCenterlines()
    search.Surface = reader.Surface
    search.SeedSelectorName = "pointlist"
    search.SourcePoints, search.TargetPoints = ends[0].tolist(), ends[1:].ravel().tolist()
    search.AppendEndPoints = 1
    search.Execute()
    made = search.Centerlines
    radii = made.GetPointData().GetArray("MaximumInscribedSphereRadius")
    points, widths = [], []
    for number in range(made.GetNumberOfCells()):
        cell = made.GetCell(number)
        ids = [cell.GetPointId(k) for k in range(cell.GetNumberOfPoints())]
        line = np.array([made.GetPoint(k) for k in ids])
        width = np.array([radii.GetValue(k) for k in ids])
        # VMTK traces from the target back to the source.
        back = np.linalg.norm(line[0] - ends[0]) > np.linalg.norm(line[-1] - ends[0])
        points.append(line[::-1] if back else line)
        widths.append(width[::-1] if back else width)
    return points, widths


def main(mesh: str, ends: str, out: str, runs: str = "2") -> None:
    """Run so many times and write what the last run found and what the first and the last took."""
    sites, seconds = np.load(ends), []
    for _ in range(int(runs)):
        begun = time.process_time()
        points, radii = lines_of(mesh, sites)
        seconds.append(time.process_time() - begun)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    counts = np.array([len(line) for line in points])
    np.savez(
        out,
        points=np.concatenate(points),
        counts=counts,
        radii=np.concatenate(radii),
        cold=seconds[0],
        warm=seconds[-1],
        peak=peak,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
