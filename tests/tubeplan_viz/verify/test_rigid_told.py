"""A number of a rigid run that is altered alone is refused, though no page and no other file tells it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK as sitk

from segmentation.synthetic.nasal import NasalPhantomSettings, nasal_phantom
from tubeplan_viz.pipeline import RunOptions
from tubeplan_viz.planners import make_case, run_case
from tubeplan_viz.verify import rigid as own_checks
from tubeplan_viz.verify import verify_run
from tubeplan_viz.verify.rigid_head import OwnHead, own_head

THICK = """
[[endoscope]]
name = "thick"
diameter_mm = 6.0
length_mm = 175.0
working_distance_mm = 10.0
view_angle_deg = 30.0
[[shaver]]
name = "thick"
diameter_mm = 5.0
length_mm = 110.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calculated head as a file, and a catalogue with nothing that fits into it."""
    made = tmp_path_factory.mktemp("rigid")
    volume = nasal_phantom(NasalPhantomSettings(spacing=(2.0, 2.0, 2.0))).volume
    image = sitk.GetImageFromArray(np.array(volume.voxels))
    image.SetSpacing([float(v) for v in volume.spacing[::-1]])
    image.SetOrigin([float(v) for v in volume.index_to_lps[:3, 3]])
    sitk.WriteImage(image, str(made / "head.nii.gz"))
    (made / "thick.toml").write_text(THICK)
    return made


def planned(folder: Path, name: str, **own: Any) -> Path:
    """The folder of a run with straight pushes only, without page and recording."""
    rigid = {"side": "left", "lesion": [11.6, 3.0, 27.0], "nodes": 0, **own}
    case = make_case({"input": {"ct": str(folder / "head.nii.gz")}, "planner": {"name": "rigid"}, "rigid": rigid})
    run_case(case, folder / name, RunOptions(recording=False, report=False))
    return folder / name


@pytest.fixture(scope="module")
def way(folder: Path) -> Path:
    """A run with a path."""
    return planned(folder, "way")


@pytest.fixture(scope="module")
def none(folder: Path) -> Path:
    """A run without a path."""
    return planned(folder, "none", catalogue=str(folder / "thick.toml"), offset_mm=6.5)


@pytest.fixture
def labelled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The labels of a head are made once for all runs on it: no alteration here reaches the CT."""
    monkeypatch.setattr(own_checks, "own_head", labels_of)


Altered = Callable[..., set[str]]
HEADS: dict[str, OwnHead] = {}


def labels_of(folder: Path, case: Mapping[str, Any], amounts: Iterable[float]) -> OwnHead:
    key = json.dumps([case["input"]["ct"], case["rigid"]["lesion"], case["rigid"]["side"], sorted(amounts)])
    if key not in HEADS:
        HEADS[key] = own_head(folder, case, amounts)
    return HEADS[key]


@pytest.fixture
def altered(plant: Callable[..., None]) -> Altered:
    """Names of the checks that do not hold when one value of result.json is changed."""

    def found(run: Path, place: str, change: Callable[[Any], Any] | None = None) -> set[str]:
        planted = run.parent / f"{run.name}-altered"  # beside the run, so that the way to the CT is the same
        shutil.rmtree(planted, ignore_errors=True)
        shutil.copytree(run, planted)
        document = json.loads((run / "result.json").read_text())
        plant(document, place, change)
        (planted / "result.json").write_text(json.dumps(document))
        return {check.name for check in verify_run(planted).faults}

    return found


@pytest.mark.usefixtures("labelled_once")
def test_runs_with_and_without_a_path_hold(way: Path, none: Path) -> None:
    assert [check.name for check in verify_run(way).faults] == []
    assert [check.name for check in verify_run(none).faults] == []


@pytest.mark.usefixtures("labelled_once")
@pytest.mark.parametrize(
    ("place", "check"),
    [
        ("metrics.clearance_min_mm", "metrics: of the path"),
        ("metrics.clearance_mean_mm", "metrics: of the path"),
        ("metrics.tip_error_mm", "metrics: of the path"),
        ("certificate.holds", "certificate: as proved"),
        ("certificate.clearance_lower_bound_mm", "certificate: as proved"),
        ("feature_points.1.s_mm", "nodes: kinds and places"),
        ("details.instrument.shaver_diameter_mm", "instrument"),
        ("details.instrument.scope_length_mm", "instrument"),
        ("details.instrument.view_angle_deg", "instrument"),
        ("details.weights.brain", "weights"),
        ("details.labels.1.volume_ml", "labels"),
        ("details.labels.0.confidence", "labels"),
        ("details.lesion.origin", "lesion: place and origin"),
        ("details.shrinkage.2.turbinate_mm", "shrinkage"),
        ("details.shrinkage.2.feasible_starts", "entry: counts"),
        ("details.shrinkage.0.feasible_starts", "shrinkage: feasible starts"),
        ("details.entry.points_mm.100.2", "entry: voxels"),
        ("details.entry.counts.feasible", "entry: counts"),
        ("details.entry.feasible.3", "entry: verdicts"),
        ("details.entry.refused.30.1", "entry: counts"),
        ("details.candidates.40.start", "candidates"),
        ("details.candidates.40.roll_deg", "candidates"),
        ("details.candidates.40.brain_mm", "ranking"),
        ("details.candidates.40.length_mm", "candidates"),
        ("details.best.length.path", "ranking"),
        ("details.nodes.0.alpha_deg", "nodes: directions"),
        ("details.nodes.0.up.2", "nodes: directions"),
        ("details.structure_distances_mm.brain.200", "distances: of every structure"),
        ("details.structure_distances_mm.orbit_left.50", "distances: of every structure"),
        ("details.worst.place_mm.1", "worst place"),
        ("details.worst.distance_mm", "worst place"),
        ("details.image.Matrix", "image"),
        ("provenance.inputs.0.sha256", "inputs"),
    ],
)
def test_one_altered_value_of_a_run_with_a_path_is_named(way: Path, altered: Altered, place: str, check: str) -> None:
    change = (lambda text: "0" * 64) if place.endswith("sha256") else None
    assert check in altered(way, place, change)


@pytest.mark.usefixtures("labelled_once")
@pytest.mark.parametrize(
    ("place", "change", "check"),
    [
        ("reason", lambda text: text.replace("turbinate left", "brain", 1), "reason"),
        ("reason", lambda text: text.replace("from any of ", "from any of 1"), "reason"),
        ("details.entry.blocked_by.7", lambda k: k - 1 if k else k + 1, "entry: counts"),
        ("details.entry.blocked_at_mm.7.0", lambda x: x + 5.0, "entry: what blocks"),
        ("details.relief.0.straight_starts", None, "what would open a way"),
        ("details.shrinkage.2.septum_mm", None, "shrinkage"),
        ("provenance.settings.rigid.offset_mm", None, "settings"),
        ("details.instrument.offset_mm", None, "instrument"),
    ],
)
def test_one_altered_value_of_a_run_without_a_path_is_named(
    none: Path, altered: Altered, place: str, change: Callable[[Any], Any] | None, check: str
) -> None:
    assert check in altered(none, place, change)


@pytest.mark.usefixtures("labelled_once")
def test_a_distance_that_is_a_twentieth_of_a_millimetre_too_large_is_refused(way: Path, altered: Altered) -> None:
    document = json.loads((way / "result.json").read_text())
    values = document["details"]["structure_distances_mm"]["turbinate_left"]
    near = int(np.argmin(values))
    # The points of voxels of 2 mm leave 0.1 mm open downwards and nothing upwards.
    found = altered(way, f"details.structure_distances_mm.turbinate_left.{near}", lambda value: value + 0.05)
    assert {"distances: of every structure", "path: clearance"} <= found


@pytest.mark.usefixtures("labelled_once")
@pytest.mark.parametrize(
    ("column", "check"), [(5, "path.csv: tangents"), (9, "path.csv: same numbers"), (8, "path.csv: tangents")]
)
def test_one_altered_cell_of_the_table_is_named(way: Path, column: int, check: str) -> None:
    planted = way.parent / "table-altered"
    shutil.rmtree(planted, ignore_errors=True)
    shutil.copytree(way, planted)
    rows = (way / "path.csv").read_text().splitlines()
    cells = rows[40].split(",")
    cells[column] = repr(float(cells[column]) + 0.01)
    rows[40] = ",".join(cells)
    (planted / "path.csv").write_text("\n".join(rows) + "\n")
    assert check in {fault.name for fault in verify_run(planted).faults}
