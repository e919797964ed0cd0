"""The pictures of README.md and gallery.md: made again from generated data by one command.

    python docs/make_pictures.py FOLDER [NAME ...]

Runs go to FOLDER, where those of an earlier call are taken as they are; pictures go to docs/pictures, all or those of
the given names. Needs the extra ``test``, chromium, and for recordings a Vulkan driver (mesa-vulkan-drivers, libvulkan1).
"""

from __future__ import annotations

import io
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from PIL import Image
from playwright.sync_api import Browser, sync_playwright
from rerun.experimental import ViewerClient

from segmentation.mesh_files import write_ply
from segmentation.synthetic import weibel_airway
from segmentation.synthetic.nasal import NasalPhantomSettings, nasal_phantom
from tubeplan_viz.bench.models import narrow_neck
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.recording.viewer_program import quiet_home, viewer_program
from tubeplan_viz.recording.web_viewer import free_ports

HERE = Path(__file__).resolve().parent
PICTURES = HERE / "pictures"
NEEDLE = HERE.parent / "datasets" / "needle" / "scene-1.toml"
WIDE, TALL = 1440, 1000  # of the window, CSS px
SHOWN = 1200  # of the picture, px
COLOURS = 224
CHROMIUM = "/usr/bin/chromium"
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
STILL = 3  # pictures of the viewer in a row that are the same: it has fetched all


@dataclass(frozen=True)
class Picture:
    """One picture: the command that makes the run, and what is seen of its page or recording.

    `top` is the section with which the picture begins, from the top of the page without one; `tall` its height in CSS px.
    """

    run: str
    command: tuple[str, ...]
    top: str = ""
    tall: int = TALL
    page: str = "report.html"


DEMO = ("demo",)
TUBE = ("plan", "tube", "--mesh", "neck.ply", "--start", "E1", "--goal", "E2", "--clearance-min", "2")
ROBOT = ("plan", "bronchoscope", "--mesh", "airway.ply", "--goal", "right apical segment", "--method", "kinematic")
NOSE = ("plan", "rigid", "--ct", "head.nii.gz", "--side", "left", "--lesion", "11.6,3,27", "--nodes", "0")
MATRIX = ("matrix", "--ct", "demo-ct", "--anatomy", "urinary")
REACH = ("reach", "--mesh", "airway.ply", "--diameter", "6")
PICTURE: dict[str, Picture] = {
    "report": Picture("demo", DEMO),
    "recording": Picture("demo", DEMO, page="recording.rrd"),
    "on-the-way": Picture("demo", DEMO, top="walk", tall=430),
    "bronchoscope": Picture("robot", ROBOT),
    "from-the-tip": Picture("robot", ROBOT, top="walk", tall=480),
    "needle3d": Picture("needle", ("run", str(NEEDLE))),
    "rigid": Picture("nose", NOSE),
    "no-path": Picture("no-path", TUBE),
    "matrix": Picture("matrix", MATRIX),
    "reach": Picture("reach", REACH),
    "cohort": Picture("cohort", ("batch", "cohort.toml"), page="index.html"),
}


def cohort() -> str:
    """A manifest of generated cases: needles past a circle that is nearer and nearer, instruments thicker and thicker."""
    parts = []
    for k in range(8):
        parts.append(
            f'[[cases]]\nid = "needle-{k + 1}"\nplanner = {{ name = "needle2d" }}\n'
            f"needle2d = {{ target = [0, 90], safety_mm = {0.5 * k} }}\n"
            'obstacles = [ { kind = "circle", center = [0, 40], radius_mm = 10 } ]\n'
        )
    for k in range(8):
        parts.append(
            f'[[cases]]\nid = "neck-{k + 1}"\ninput = {{ mesh = "neck.ply" }}\n'
            'planner = { name = "tube", method = "feature_iteration", start = "E1", goal = "E2" }\n'
            f"limits = {{ clearance_min = {0.7 + 0.07 * k:.2f} }}\n"
        )
    return "\n".join(parts)


def head(path: Path) -> None:
    """The nasal phantom at 1.5 mm as NIfTI."""
    volume = nasal_phantom(NasalPhantomSettings(spacing=(1.5, 1.5, 1.5))).volume
    image = sitk.GetImageFromArray(np.array(volume.voxels))
    image.SetSpacing(volume.spacing[::-1].tolist())
    image.SetOrigin(volume.index_to_lps[:3, 3].tolist())
    sitk.WriteImage(image, str(path))


INPUTS: dict[str, Callable[[Path], Any]] = {
    "neck.ply": lambda path: write_ply(narrow_neck().surface, path),
    "airway.ply": lambda path: write_ply(weibel_airway(generations=4, voxel=0.8).surface, path),
    "head.nii.gz": head,
    "cohort.toml": lambda path: path.write_text(cohort(), encoding="utf-8"),
}


def made(picture: Picture, folder: Path) -> Path:
    """The run of a picture; inputs are generated, and the demo first where its CT is one of them."""
    run = folder / picture.run
    if run.exists():
        return run
    arguments = []
    for word in (*picture.command, *(("neck.ply",) if picture.run == "cohort" else ())):
        if word in INPUTS and not (folder / word).exists():
            INPUTS[word](folder / word)
        if word == "demo-ct":
            made(PICTURE["report"], folder)
        arguments.append(str(folder / word) if word in INPUTS or word == "demo-ct" else word)
    status = status_of([*arguments[: len(picture.command)], "-o", str(run), "-q"])
    if status not in (0, 3, 4):
        raise SystemExit(f"{picture.run}: the command ended with {status}")
    return run


def seen(browser: Browser, page_file: Path, picture: Picture) -> Image.Image:
    """What a reader sees of a page."""
    context = browser.new_context(viewport={"width": WIDE, "height": TALL}, color_scheme="light", reduced_motion="reduce")
    page = context.new_page()
    page.goto(page_file.as_uri())
    while not page.evaluate("!document.getElementById('tubeplan-scene') || globalThis.tubeplanReady === true"):
        page.wait_for_timeout(50)
    page.wait_for_timeout(500)
    top = page.locator(f"#{picture.top}").evaluate("(one) => one.getBoundingClientRect().top + scrollY") if picture.top else 0
    data = page.screenshot(full_page=True, clip={"x": 0, "y": top, "width": WIDE, "height": picture.tall})
    context.close()
    return Image.open(io.BytesIO(data)).convert("RGB")


@contextmanager
def viewer(recording: Path) -> Iterator[ViewerClient]:
    """The real viewer without a window, with the recording open."""
    with quiet_home() as environment:
        port = free_ports(1)[0]
        options = [
            "--headless",
            "--window-size",
            "1600x1000",
            "--hide-welcome-screen",
            "--bind",
            "127.0.0.1",
            "--port",
            str(port),
        ]
        home = environment["HOME"]
        child = subprocess.Popen(
            [str(viewer_program()), *options, str(recording)],
            env=environment | {"RERUN_APP_ONLY": "true", "XDG_RUNTIME_DIR": home},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield connected(child, f"rerun+http://127.0.0.1:{port}/proxy")
        finally:
            child.terminate()
            child.wait(10)


def connected(child: subprocess.Popen[bytes], address: str) -> ViewerClient:
    """The viewer as soon as it answers and shows its views."""
    for _ in range(300):
        time.sleep(0.2)
        if child.poll() is not None:
            raise SystemExit(f"the viewer ended with {child.returncode}; a Vulkan driver is needed")
        try:
            client = ViewerClient.connect(address)
            state = client.get_state()
        except (ConnectionError, RuntimeError, ValueError):
            continue
        if state.active_recording and not state.loading and state.views:
            return client
    raise SystemExit("the viewer was not ready within a minute")


def recorded(recording: Path) -> Image.Image:
    """The first view of a recording."""
    with viewer(recording) as client:
        time.sleep(2.0)
        last, same = b"", 0
        while same < STILL:
            time.sleep(0.3)
            now = client.take_screenshot()
            same, last = (same + 1 if now == last else 0), now
    return Image.open(io.BytesIO(last)).convert("RGB")


def small(picture: Image.Image, path: Path) -> None:
    """Write a picture scaled down, with few colours, without what varies from run to run."""
    scaled = picture.resize((SHOWN, round(picture.height * SHOWN / picture.width)), Image.Resampling.LANCZOS)
    # By coverage and not by count: a thin line of a colour of its own keeps it.
    few = scaled.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def main(folder: Path, names: list[str]) -> None:
    """Make the named pictures, or all."""
    folder.mkdir(parents=True, exist_ok=True)
    unknown = [name for name in names if name not in PICTURE]
    if unknown:
        raise SystemExit(f"no such picture: {', '.join(unknown)}; there are {', '.join(PICTURE)}")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        for name in names or PICTURE:
            picture = PICTURE[name]
            file = made(picture, folder).resolve() / picture.page
            image = recorded(file) if file.suffix == ".rrd" else seen(browser, file, picture)
            small(image, PICTURES / f"{name}.png")
            print(json.dumps({"picture": name, "kB": (PICTURES / f"{name}.png").stat().st_size // 1024}))
        browser.close()


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), sys.argv[2:])
