"""One generated head and its proposed scene for all tests of the nasal front end."""

from __future__ import annotations

import pytest

from segmentation.anatomy.nasal import NasalScene, propose_scene
from segmentation.synthetic.nasal import NasalPhantom, nasal_phantom


@pytest.fixture(scope="session")
def phantom() -> NasalPhantom:
    return nasal_phantom()


@pytest.fixture(scope="session")
def proposed(phantom: NasalPhantom) -> NasalScene:
    return propose_scene(phantom.volume)
