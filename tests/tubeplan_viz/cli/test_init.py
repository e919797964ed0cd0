"""`tubeplan init`: the file it writes is accepted as it is, and says why it chose what it chose."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from segmentation.anatomy.guess import guess_anatomy
from segmentation.errors import CaseError, RegionError
from segmentation.volume import Volume
from tubeplan_viz.cases.tube import read_case
from tubeplan_viz.initial_case import find_instrument, write_case
from tubeplan_viz.instruments import Instrument, read_catalogue

SHARED = Path(__file__).parents[4] / "shared" / "data"


@pytest.fixture
def tube(tmp_path: Path) -> Path:
    from segmentation.mesh_files import write_ply
    from tubeplan_viz.bench.models import straight_tube

    path = tmp_path / "tube.ply"
    write_ply(straight_tube(radius=3.0, length=40.0).surface, path)
    return path


def test_a_mesh_becomes_a_case_that_run_accepts_as_it_is(tubeplan: Callable, tube: Path, tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    assert tubeplan("init", tube, "-o", file, "-q").status == 0
    case = read_case(file)
    assert case.input.mesh == tube
    assert (case.planner.start, case.planner.goal) == ("E1", "E2")
    outcome = tubeplan("run", file, "-o", tmp_path / "run", "-q", "--no-recording", "--no-report")
    assert outcome.status == 0, outcome.err
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    # From end to end of a tube of 40 mm.
    assert result["metrics"]["length_mm"] == pytest.approx(40.0, abs=1.0)


def test_the_end_points_written_down_are_those_that_endpoints_lists(tubeplan: Callable, tube: Path, tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    tubeplan("init", tube, "-o", file, "-q")
    listed = tubeplan("endpoints", tube, "--json").document["endpoints"]
    rows = [line.split() for line in file.read_text().splitlines() if line.startswith("#   E")]
    assert [row[1] for row in rows] == [tip["label"] for tip in listed]
    for row, tip in zip(rows, listed, strict=True):
        assert np.allclose([float(v) for v in row[2:5]], tip["point_mm"], atol=0.051)  # printed to 0.1 mm


def test_options_are_taken_over_and_the_path_starts_from_the_file(tubeplan: Callable, tube: Path, tmp_path: Path) -> None:
    (tmp_path / "cases").mkdir()
    file = tmp_path / "cases" / "case.toml"
    given = (
        "--start",
        "E2",
        "--clearance-min",
        "0.75",
        "--method",
        "optimal",
        "--scans",
        "nodes,extrema",
        "--case-id",
        'tube "1"',
    )
    assert tubeplan("init", tube, "-o", file, "-q", *given).status == 0
    table = tomllib.loads(file.read_text())
    assert table["input"]["mesh"] == "../tube.ply"
    assert table["input"]["case_id"] == 'tube "1"'
    assert (table["planner"]["start"], table["planner"]["goal"]) == ("E2", "E1")
    assert table["planner"]["method"] == "optimal"
    assert table["limits"]["clearance_min"] == 0.75
    assert table["tube"] == {"scans": ["nodes", "extrema"]}
    assert read_case(file).input.mesh == tube


def test_an_instrument_gives_the_limits(tubeplan: Callable, tube: Path, tmp_path: Path) -> None:
    catalogue = tmp_path / "own.toml"
    catalogue.write_text(
        '[[instrument]]\nname = "Test scope, 6 Fr"\nkind = "scope"\nouter_diameter_mm = 2.0\nbend_radius_min_mm = 10.0\n'
    )
    file = tmp_path / "case.toml"
    assert tubeplan("init", tube, "-o", file, "-q", "--instrument", "6 fr", "--catalogue", catalogue).status == 0
    limits = read_case(file).limits
    assert (limits.curvature_max, limits.clearance_min) == (pytest.approx(0.1), pytest.approx(1.0))
    assert "Test scope, 6 Fr" in file.read_text()


def test_a_whole_name_is_meant_even_where_a_longer_one_holds_it() -> None:
    short, long = (
        Instrument(name=name, kind="scope", outer_diameter_mm=2.0, bend_radius_min_mm=8.0)
        for name in ("scope 6 Fr", "scope 6 Fr long")
    )
    assert find_instrument("Scope 6 Fr", [long, short]) is short
    with pytest.raises(CaseError, match="'6 Fr' fits more than one instrument; expected one of: scope 6 Fr long; scope 6 Fr"):
        find_instrument("6 Fr", [long, short])


def test_an_instrument_must_be_one() -> None:
    instruments = read_catalogue()
    assert find_instrument(instruments[0].name.upper(), instruments) is instruments[0]
    with pytest.raises(CaseError, match="'warp drive' is no instrument of the catalogue; expected one of"):
        find_instrument("warp drive", instruments)
    with pytest.raises(CaseError, match="fits more than one instrument"):
        find_instrument("Fr", instruments)


def test_an_existing_file_is_kept_without_force(tubeplan: Callable, tube: Path, tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    file.write_text("# mine\n")
    refused = tubeplan("init", tube, "-o", file, "-q")
    assert refused.status == 2
    assert "exists already" in refused.err
    assert file.read_text() == "# mine\n"
    assert tubeplan("init", tube, "-o", file, "-q", "--force").status == 0
    assert "[planner]" in file.read_text()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["case.toml", "tube.ply"]


def test_a_file_that_comes_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "case.toml"
    file.write_text("# came first\n")
    with pytest.raises(CaseError, match="exists already"):
        write_case("[input]\n", file)
    assert file.read_text() == "# came first\n"
    with pytest.raises(CaseError, match="is a folder"):
        write_case("[input]\n", tmp_path, force=True)
    with pytest.raises(CaseError, match="cannot be written"):
        write_case("[input]\n", tmp_path / "nowhere" / "case.toml")


def test_an_input_without_a_lumen_leaves_no_file(tubeplan: Callable, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for source in ("empty", "nowhere.stl"):
        outcome = tubeplan("init", tmp_path / source, "-o", tmp_path / "case.toml", "-q")
        assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert [entry.name for entry in tmp_path.iterdir()] == ["empty"]


def test_an_image_of_nothing_is_not_guessed() -> None:
    water = Volume(np.zeros((40, 40, 40), np.int16), np.array([[0, 0, 1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]]))
    with pytest.raises(RegionError, match=r"no trachea .* no contrast-filled collecting system .* --anatomy") as caught:
        guess_anatomy(water)
    assert "\n" not in str(caught.value)


def test_a_generated_urography_is_told_by_its_collecting_system(tmp_path: Path, tubeplan: Callable) -> None:
    from segmentation.synthetic import write_demo_series

    write_demo_series(tmp_path / "ct")
    outcome = tubeplan("init", tmp_path / "ct", "-o", tmp_path / "case.toml", "-q")
    assert outcome.status == 0, outcome.err
    text = (tmp_path / "case.toml").read_text()
    assert 'anatomy = "urinary"  # a contrast-filled collecting system was found' in text
    assert read_case(tmp_path / "case.toml").input.anatomy == "urinary"


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/data is absent")
def test_a_real_chest_is_told_by_its_trachea(tmp_path: Path, tubeplan: Callable) -> None:
    source = SHARED / "elastix_right_lung" / "3DCT_lung.mha"
    outcome = tubeplan("init", source, "-o", tmp_path / "case.toml", "-q")
    assert outcome.status == 0, outcome.err
    text = (tmp_path / "case.toml").read_text()
    assert 'anatomy = "airway"  # a trachea was found at' in text
