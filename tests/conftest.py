"""Fixtures that all tests share."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator
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


# Files that take long, the longest first. A worker is given whole files: begun last, one of these would leave the other
# worker with nothing to do.
LONG = (
    "tubeplan_viz/cli/test_commands.py",
    "cohort/test_cohort_run.py",
    "tubeplan_viz/test_real_data.py",
    "reports/test_every_run.py",
    "tubeplan_viz/needle/test_real_ct.py",
    "tubeplan_viz/rigid/test_rigid_planner.py",
    "tubeplan_viz/bronchoscope/test_way.py",
    "cohort/test_cohort_cluster.py",
    "tubeplan_viz/cli/test_export.py",
    "tubeplan_viz/instruments/test_matrix.py",
    "tubeplan_viz/verify/test_verified_measures.py",
    "reports/test_browser.py",
    "reports/test_accessibility.py",
    "tubeplan_viz/recording/test_viewing.py",
    "tubeplan_viz/tube/test_no_path.py",
    "tubeplan_viz/verify/test_planted_faults.py",
    "tubeplan_viz/pipeline/test_needle_outcomes.py",
    "tubeplan_viz/measures/test_collecting_system.py",
    "tubeplan_viz/pipeline/test_needle.py",
    "segmentation/test_lumen_real.py",
    "tubeplan_viz/cli/test_signals.py",
    "tubeplan_viz/bronchoscope/test_sequence.py",
    "segmentation/synthetic/test_urography.py",
    "tubeplan_viz/needle/test_planar.py",
    "reports/test_page.py",
    "recorded/test_recorded.py",
    "tubeplan_viz/cli/test_view.py",
    "tubeplan_viz/cli/test_privacy.py",
    "tubeplan_viz/recording/test_pictures.py",
    "tubeplan_viz/cli/test_init.py",
    "tubeplan_viz/bronchoscope/dynamics/test_simulator.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put tests of `LONG` first, in its order; all others stay as they are."""
    here = Path(__file__).parent
    gone = [name for name in LONG if not (here / name).exists()]
    if gone:
        raise pytest.UsageError(f"tests/conftest.py names files that are gone: {', '.join(gone)}; take them out of LONG")
    place = {here / name: number for number, name in enumerate(LONG)}
    items.sort(key=lambda item: place.get(item.path, len(LONG)))


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
def plant() -> Callable[..., None]:
    """Of tests/altering.py: one value of a document changed in place."""
    plant: Callable[..., None] = _helper("altering").plant
    return plant


@pytest.fixture(scope="session")
def numbers_shown() -> ModuleType:
    """tests/numbers_shown.py."""
    return _helper("numbers_shown")


@pytest.fixture(scope="session")
def slicer_schema() -> dict[str, Any]:
    """The schema of tests/slicer_markups.py."""
    return dict(_helper("slicer_markups").MARKUPS)


@pytest.fixture(scope="session")
def needle_past_a_circle() -> Callable[[float, float], str]:
    """Case file of a needle in the plane whose target lies 90 mm ahead, and a circle (center ahead, radius, mm) in its way."""
    return lambda ahead, radius: (
        '[planner]\nname = "needle2d"\n[needle2d]\ntarget = [0, 90]\ndegree_max = 2\n'
        f'[[obstacles]]\nkind = "circle"\ncenter = [0, {ahead:g}]\nradius_mm = {radius:g}\n'
    )


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


# What is drawn beyond the sheet or cut off by its box, and headings of tables that leave no words.
LOST = """() => {
  const found = [];
  const told = (one) => [...one.childNodes].some((part) => part.className !== 'unseen' && part.textContent.trim());
  for (const fold of document.querySelectorAll('details')) fold.open = true;  // as the page itself does before it prints
  for (const one of document.body.querySelectorAll('*')) {
    if (one.closest('svg, .unseen')) continue;
    const box = one.getBoundingClientRect(), name = `${one.tagName.toLowerCase()}.${one.className}`;
    if (!box.width || !box.height) continue;
    if (box.right > innerWidth + 1 || box.left < -1) found.push(`${name} reaches beyond the sheet`);
    else if (one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).overflowX !== 'visible') found.push(`${name} cuts`);
  }
  for (const one of document.querySelectorAll('thead th'))
    if (told(one) && !one.innerText.trim()) found.push(`the heading ${one.textContent} is lost`);
  return found.slice(0, 5);
}"""


@pytest.fixture(scope="session")
def lost_in_print() -> Callable[[Any], list[str]]:
    """What a sheet of A4 would lack of an open page, where it is left; the width is that between the margins."""

    def found(page: Any) -> list[str]:
        page.set_viewport_size({"width": 711, "height": 1000})
        page.emulate_media(media="print", color_scheme="light")
        page.wait_for_timeout(100)
        return list(page.evaluate(LOST))

    return found
