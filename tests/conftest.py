"""Fixtures that all tests share."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import hypothesis
import pytest

# A test says what must hold, not how fast: a machine that is busy must not fail it.
hypothesis.settings.register_profile("tubeplan", deadline=None)
hypothesis.settings.load_profile("tubeplan")

CHROMIUM = Path("/usr/bin/chromium")
# The scene needs WebGL, which SwiftShader draws without a graphics card.
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Debian's Chromium without a window; one for all tests, since playwright runs once in a process."""
    if not CHROMIUM.exists():
        pytest.skip("chromium is not installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(ARGUMENTS))
        yield chromium
        chromium.close()


def _helper(name: str) -> ModuleType:
    """A module of this folder; `tests` itself must not be on the import path, where it would hide the packages."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def phantoms() -> ModuleType:
    """tests/phantoms.py."""
    return _helper("phantoms")


@pytest.fixture(scope="session")
def numbers_shown() -> ModuleType:
    """tests/numbers_shown.py."""
    return _helper("numbers_shown")


@pytest.fixture(scope="session")
def slicer_schema() -> dict[str, Any]:
    """The schema of tests/slicer_markups.py."""
    return dict(_helper("slicer_markups").MARKUPS)


@pytest.fixture(scope="session")
def head_ct() -> Any:
    """A real head CT as a volume, see tests/head_ct.py; its face is recognisable, no picture of it may be kept."""
    helper = _helper("head_ct")
    if not helper.CRANIUM.exists():
        pytest.skip("Debian's package invesalius-examples is not installed")
    return helper.read_head_ct()


@pytest.fixture(scope="session")
def head_ct_file(head_ct: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as a NIfTI file."""
    import SimpleITK as sitk

    image = sitk.GetImageFromArray(head_ct.voxels)
    image.SetSpacing(head_ct.spacing[::-1].tolist())
    path: Path = tmp_path_factory.mktemp("head") / "head.nii"
    sitk.WriteImage(image, str(path))
    return path
