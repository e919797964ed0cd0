"""Mesh files of model tubes, and the command line in process and as a real process."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydicom import dcmread

from segmentation.dicom.write import write_series
from segmentation.mesh_files import write_ply
from segmentation.volume import Volume
from tubeplan_viz.bench.models import narrow_neck, straight_tube, variant_2
from tubeplan_viz.cli.app import status_of

# Planted into a series; none of it may come out again.
IDENTITY = {
    "PatientName": "Zebrowska^Quilla",
    "PatientID": "QX-77-4191",
    "PatientBirthDate": "19470203",
    "InstitutionName": "Sanatorium Wolkenstein",
    "ReferringPhysicianName": "Krautheimer^Ottokar",
    "StudyDate": "20191224",
    "AccessionNumber": "ACC8842717",
}


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    status: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """Standard output as JSON."""
        return json.loads(self.out)


@pytest.fixture
def tubeplan(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """The command line in this process."""

    def call(*arguments: object) -> Outcome:
        capsys.readouterr()
        status = status_of([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Outcome(status, captured.out, captured.err)

    return call


def script() -> str:
    """The installed command of this environment."""
    found = shutil.which("tubeplan", path=str(Path(sys.executable).parent))
    assert found is not None, "tubeplan is not installed in this environment; install the project first"
    return found


@pytest.fixture(scope="session")
def command() -> str:
    """Path of the installed command."""
    return script()


@pytest.fixture(scope="session")
def process() -> Callable[..., Outcome]:
    """The command line as a process of its own."""

    def call(*arguments: object, cwd: Path | None = None) -> Outcome:
        done = subprocess.run([script(), *map(str, arguments)], capture_output=True, text=True, cwd=cwd, timeout=300, check=False)
        return Outcome(done.returncode, done.stdout, done.stderr)

    return call


@pytest.fixture(scope="session")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with neck.ply, tube.ply (both along +y, 40 mm, radius 3 mm) and variant.ply."""
    folder = tmp_path_factory.mktemp("meshes")
    for name, model in (("neck", narrow_neck()), ("tube", straight_tube()), ("variant", variant_2())):
        write_ply(model.surface, folder / f"{name}.ply")
    return folder


@pytest.fixture(scope="session")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A DICOM series of a bright tube of radius 4 mm along z through tissue, with a made-up patient's identity."""
    z, y, x = np.meshgrid(np.arange(48.0), np.arange(40.0), np.arange(44.0), indexing="ij")
    # One HU step per tenth of a millimetre at the wall, as partial volume would make it.
    depth = 4.0 - np.hypot(x - 21.0 - 2.0 * np.sin(z / 12.0), y - 19.0)
    voxels = np.clip(40.0 + 260.0 * np.clip(depth + 0.5, 0.0, 1.0), -1024, 3071).astype(np.int16)
    index_to_lps = np.array([[0.0, 0, 1, -20], [0, 1, 0, -15], [1, 0, 0, 100], [0, 0, 0, 1]])
    folder = tmp_path_factory.mktemp("patient") / "series"
    write_series(Volume(voxels, index_to_lps), folder, seed=1)
    for file in folder.iterdir():
        dataset = dcmread(file)
        for keyword, value in IDENTITY.items():
            setattr(dataset, keyword, value)
        dataset.save_as(file)
    return folder


@pytest.fixture(scope="session")
def identity() -> dict[str, str]:
    """What was planted into the series."""
    return dict(IDENTITY)
