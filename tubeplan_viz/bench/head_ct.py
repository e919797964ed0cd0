"""A real head CT for benchmarks and tests: the example of Debian's package invesalius-examples, converted where it lies.

The package is GPL-2 and the face is recognisable, so neither the file nor a picture of its surface belongs in the
project; `.ci/run` installs the package and it is read in place.

An .inv3 file is a tar.gz with main.plist (shape, spacing x y z, orientation 1 for axial) and matrix.dat (int16, slice by
slice). It states neither left and right nor an origin. InVesalius writes each axial DICOM slice with its rows reversed and
its columns as they are (invesalius/data/imagedata_utils.py, dcm2memmap), slices sorted from below upwards. The head rests
on its back on a table that shows below it, so that the DICOM axes were those of a supine patient, head first: columns run
to the patient's left. A head is too symmetric for the anatomy to confirm it; the side is an assumption, and no test rests
on it.
"""

from __future__ import annotations

import plistlib
import tarfile
from pathlib import Path

import numpy as np

from segmentation.errors import SeriesError
from segmentation.volume import Volume

CRANIUM = Path("/usr/share/doc/invesalius-examples/examples/Cranium.inv3")


def read_head_ct() -> Volume:
    """The head as a volume in LPS; the origin is the centre of the first voxel."""
    with tarfile.open(CRANIUM) as archive:
        parts = {Path(member.name).name: member for member in archive.getmembers() if member.isfile()}

        def read(name: str) -> bytes:
            stream = archive.extractfile(parts[name])
            assert stream is not None
            return stream.read()

        head = plistlib.loads(read("main.plist"))
        matrix = head["matrix"]
        if head["orientation"] != 1:
            raise SeriesError(f"{CRANIUM.name}: orientation {head['orientation']}, expected 1, axial slices")
        stored = np.frombuffer(read(matrix["filename"]), matrix["dtype"]).reshape(matrix["shape"])
    index_to_lps = np.eye(4)
    # [slice, row, column] run along z, y, x once the rows are put back into their DICOM order, front to back.
    index_to_lps[:3, :3] = np.diag(head["spacing"])[:, ::-1]
    return Volume(np.ascontiguousarray(stored[:, ::-1]), index_to_lps)
