"""tubeplan matrix: folder, table, exit status, and what it refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from reports.numbers import printed
from segmentation.mesh_files import write_ply
from segmentation.synthetic import weibel_airway
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.cli.matrix import margin_words
from tubeplan_viz.instruments import MatrixError, apart, validate_matrix
from tubeplan_viz.recording.matrix import told

CATALOGUE = """
[[instrument]]
name = "thin <b>"
kind = "test"
outer_diameter_mm = 1.0
bend_radius_min_mm = 6.0
rigid_tip_mm = 3.0
[[instrument]]
name = "far too thick"
kind = "test"
outer_diameter_mm = 20.0
bend_radius_min_mm = 6.0
[[instrument]]
name = "stiff"
kind = "test"
outer_diameter_mm = 1.9
bend_radius_min_mm = 24.0
[[instrument]]
name = "stiff and thick"
kind = "test"
outer_diameter_mm = 2.0
bend_radius_min_mm = 30.0
"""


@pytest.fixture(scope="module")
def made(fork: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    place = tmp_path_factory.mktemp("matrix")
    write_ply(fork.surface, place / "fork.ply")
    (place / "mine.toml").write_text(CATALOGUE, encoding="utf-8")
    arguments = ["matrix", "--mesh", str(place / "fork.ply"), "--catalogue", str(place / "mine.toml"), "--goals", "all", "-q"]
    return place, status_of([*arguments, "-o", str(place / "out")])


def test_the_folder_is_whole_and_its_document_follows_the_schema(made: tuple[Path, int]) -> None:
    place, status = made
    assert status == 3
    names = {entry.name for entry in (place / "out").iterdir()}
    assert names == {"matrix.json", "matrix.csv", "report.html", "recording.rrd", "mesh.ply"}
    document = json.loads((place / "out" / "matrix.json").read_text(encoding="utf-8"))
    validate_matrix(document)
    assert [row[0]["verdict"] for row in document["cells"]] == ["feasible", "impossible", "impossible", "impossible"]
    with (place / "out" / "matrix.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * len(document["targets"])
    assert float(rows[0]["margin_mm"]) == pytest.approx(document["cells"][0][0]["margin_mm"], abs=1e-4)  # printed with four
    text = "".join((place / "out" / name).read_text(encoding="utf-8") for name in ("matrix.json", "matrix.csv", "report.html"))
    assert str(place) not in text


def test_the_page_prints_every_margin_and_escapes_names(made: tuple[Path, int]) -> None:
    place, _ = made
    document = json.loads((place / "out" / "matrix.json").read_text(encoding="utf-8"))
    page = (place / "out" / "report.html").read_text(encoding="utf-8")
    for i, row in enumerate(document["cells"]):
        for j, cell in enumerate(row):
            shown = f'data-key="cells.{i}.{j}.margin_mm">{printed(cell["margin_mm"], 2, signed=True)}</data>'
            assert shown in page
    assert "thin <b>" not in page.split("<body")[1].split("<script")[0]
    assert "thin &lt;b&gt;" in page


def test_a_bend_that_keeps_instruments_out_stands_in_document_page_table_and_recording(made: tuple[Path, int]) -> None:
    place, _ = made
    document = json.loads((place / "out" / "matrix.json").read_text(encoding="utf-8"))
    for j, target in enumerate(document["targets"]):
        stiff, thick = document["cells"][2][j], document["cells"][3][j]
        bend = document["bends"][j][stiff["bend"]]
        # The proof for the one serves the other, which is thicker and stiffer.
        assert thick["bend"] == stiff["bend"]
        assert stiff["required_mm"] == 0.95
        assert stiff["available_mm"] == pytest.approx(bend["clearance_upper_bound_mm"])
        assert stiff["margin_mm"] == pytest.approx(stiff["available_mm"] - 0.95)
        assert stiff["margin_point_mm"] == bend["point_mm"]
        said = f"leaves {printed(bend['clearance_upper_bound_mm'], 2)} mm at most at a bend radius of 24.0 mm or more; 0.95 mm"
        assert said in stiff["reason"]
        page = (place / "out" / "report.html").read_text(encoding="utf-8").split("<script")[0]
        assert f"</span>stiff and 1 more</th><td>{target['label']}</td>" in page
        assert said in page
    with (place / "out" / "matrix.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["instrument"] == "stiff"]
    assert {row["margin_of"] for row in rows} == {"bend"}
    assert float(rows[0]["available_mm"]) == pytest.approx(document["cells"][2][0]["available_mm"], abs=1e-4)


def test_targets_bear_the_names_of_their_parts_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ply(weibel_airway(generations=1, voxel=1.0).surface, tmp_path / "airway.ply")
    (tmp_path / "one.toml").write_text("[[instrument]]" + CATALOGUE.split("[[instrument]]")[1], encoding="utf-8")
    call = ["matrix", "--mesh", str(tmp_path / "airway.ply"), "--anatomy", "airway", "--start", "Trachea", "-q"]
    call += ["--catalogue", str(tmp_path / "one.toml")]
    assert status_of([*call, "--goals", "left main,right main", "-o", str(tmp_path / "out")]) == 0
    printed_table = capsys.readouterr().out
    document = json.loads((tmp_path / "out" / "matrix.json").read_text(encoding="utf-8"))
    names = [target["name"] for target in document["targets"]]
    assert names == ["left main bronchus", "right main bronchus"]
    with (tmp_path / "out" / "matrix.csv").open(encoding="utf-8", newline="") as file:
        assert [row["target_name"] for row in csv.DictReader(file)] == names
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8").split("<script")[0]
    recorded = told(document, document["instruments"][0], document["cells"][0])
    for name in names:
        assert f"<small>{name}</small></th>" in page
        assert f"{name}**: holds" in recorded
        assert all(word in printed_table for word in name.split())
    assert status_of([*call, "--goals", "main", "-o", str(tmp_path / "two")]) == 2
    assert "the goal 'main' fits 2 end points, E2 " in capsys.readouterr().err


def test_what_does_not_fit_is_never_told_to_be_as_large_as_what_is_required() -> None:
    assert apart(1.4967, 1.5) == ("1.497", "1.500")
    assert margin_words(-0.003) == " -0.003"
    assert margin_words(0.3) == " +0.30"


def test_a_document_that_contradicts_itself_is_refused(made: tuple[Path, int]) -> None:
    place, _ = made
    document = json.loads((place / "out" / "matrix.json").read_text(encoding="utf-8"))
    document["cells"].pop()
    with pytest.raises(MatrixError, match="3 rows of"):
        validate_matrix(document)
    document["cells"].append([{"verdict": "perhaps"}])
    with pytest.raises(MatrixError, match=r"at cells\.3\.0"):
        validate_matrix(document)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--goals", "E9,E2"], "the lumen has no end point E9"),
        (["--goals", "E1"], "the goal E1 is the start"),
        (["--clearance-min", "1"], "--clearance-min does not apply here"),
        (["--goal", "E2"], "--goal does not apply here"),
        (["--tolerance", "2,2"], "No such option: --tolerance"),
        (["--catalogue", "none.toml"], "none.toml: no such catalogue file"),
        (["--before-start", "-1"], "--before-start is -1, expected 0 to 10000"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(
    made: tuple[Path, int], more: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    place, _ = made
    assert status_of(["matrix", "--mesh", str(place / "fork.ply"), "-q", "-o", str(place / "bad"), *more]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (place / "bad").exists()


def test_nothing_reachable_ends_with_four_and_json_parses(made: tuple[Path, int], capsys: pytest.CaptureFixture[str]) -> None:
    place, _ = made
    (place / "thick.toml").write_text("[[instrument]]" + CATALOGUE.split("[[instrument]]")[2], encoding="utf-8")
    arguments = ["matrix", "--mesh", str(place / "fork.ply"), "--catalogue", str(place / "thick.toml"), "--no-recording"]
    assert status_of([*arguments, "--no-report", "--json", "-o", str(place / "none")]) == 4
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == "infeasible"
    assert told["files"] == ["matrix.csv", "matrix.json", "mesh.ply"]
