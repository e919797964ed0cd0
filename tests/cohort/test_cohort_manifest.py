"""What a manifest says, and every kind of manifest that is refused before anything runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from segmentation.errors import CaseError
from tubeplan_viz.cli.app import status_of
from tubeplan_viz.cli.options import CASE_OPTIONS
from tubeplan_viz.cohort import CohortCase, ManifestError, read_manifest
from tubeplan_viz.cohort.columns import TABLES, columns_of
from tubeplan_viz.cohort.inputs import Digests, input_paths
from tubeplan_viz.cohort.seeds import case_seed
from tubeplan_viz.cohort.tables import rebased
from tubeplan_viz.planners import PLANNERS, make_case


def cases_of(path: Path, **settings: Any) -> dict[str, CohortCase]:
    return {case.id: case for case in read_manifest(path, **settings).cases}


def test_a_case_is_the_defaults_below_its_file_below_its_own_tables(cohort_files: Path) -> None:
    cases = cases_of(cohort_files / "cohort.toml")
    assert list(cases) == ["neck", "flat", "none", "space", "damaged"]
    assert [case.planner for case in cases.values()] == ["tube", "needle2d", "needle2d", "needle3d", "tube"]
    assert cases["neck"].case.limits.curvature_max == 0.125  # defaults
    assert cases["neck"].case.limits.clearance_min == 1.5  # its own
    assert cases["flat"].case.planar.degree_max == 2  # the file, over the default of 1
    assert cases["flat"].case.planar.radius == 50.0  # its own 0.02 1/mm, over the default
    assert cases["none"].case.obstacles[0].radius_mm == 39.0
    assert [case.case.case_id for name, case in cases.items() if name in ("flat", "space")] == ["flat", "space"]


def test_relative_paths_start_from_the_file_in_which_they_stand(cohort_files: Path) -> None:
    (cohort_files / "files" / "own.toml").write_text('[input]\nmesh = "../meshes/neck.ply"\n', encoding="utf-8")
    manifest = cohort_files / "deeper" / "m.toml"
    manifest.parent.mkdir()
    manifest.write_text(
        '[[cases]]\nid = "a"\ncase = "../files/own.toml"\n[[cases]]\nid = "b"\ninput.mesh = "../meshes/neck.ply"\n', "utf-8"
    )
    wanted = cohort_files.resolve() / "meshes" / "neck.ply"
    assert [input_paths(case.case) for case in cases_of(manifest).values()] == [[wanted], [wanted]]


def test_a_table_gives_the_same_cases_as_the_command_line_would(cohort_files: Path) -> None:
    (cohort_files / "c.csv").write_text(
        "id,planner,case,mesh,start,goal,clearance_min,curvature_max,scans,target,limits.curvature_max,part\n"
        'a,,,meshes/neck.ply,"1,2,3",e2,1.5,0.1,"nodes,extrema",,,12\n'
        "\n"
        'b,needle2d,,,,,,0.02,,"10,90",,\n'
        "c,,files/flat.toml,,,,,,,,0.03,\n",
        encoding="utf-8-sig",
    )
    cases = cases_of(cohort_files / "c.csv")
    tube = cases["a"].case
    assert (tube.planner.start, tube.planner.goal) == ((1.0, 2.0, 3.0), "E2")
    assert (tube.limits.clearance_min, tube.limits.curvature_max) == (1.5, 0.1)
    assert tube.features.scans == ("nodes", "extrema")
    assert tube.input.part == "12"
    assert cases["b"].case.target == (10.0, 90.0)
    assert cases["c"].planner == "needle2d"
    assert cases["c"].case.kappa == pytest.approx(0.03, rel=1e-12)  # kept as its reciprocal


def test_every_option_of_a_tube_is_a_column() -> None:
    for option, (table, key, _, _) in CASE_OPTIONS.items():
        assert columns_of("tube")[option] == ((table, key),), option


@pytest.mark.parametrize("planner", PLANNERS)
def test_every_column_is_a_key_that_the_planner_reads(planner: str) -> None:
    for table, keys in TABLES[planner].items():
        for key in keys:
            tables: dict[str, dict[str, Any]] = {"planner": {"name": planner}}
            tables.setdefault(table, {})[key] = {}
            # A wrong value is complained of as that; a key that nobody reads as an unknown one.
            with pytest.raises(CaseError, match=r"\A(?!.*unknown (key|table))"):
                make_case(tables)


@pytest.mark.parametrize(
    ("planner", "tables"),
    [
        ("tube", {"input": {"mesh": "m.ply"}, "measures": {"stone_masks": "s.nii,t.nii", "structures": "a=u.nii,b=v/w.nii"}}),
        ("tube", {"input": {"ct": "c"}, "measures": {"stone_masks": ["s.nii"], "structures": [{"name": "a", "file": "u.nii"}]}}),
        ("needle3d", {"input": {"ct": "c", "hu_min": 180}, "needle3d": {"target": [0, 0, 9]}}),
        ("needle3d", {"needle3d": {"target": [0, 0, 9]}, "obstacles": [{"kind": "mesh", "file": "m.stl"}]}),
        ("rigid", {"input": {"ct": "c"}, "rigid": {"side": "left", "lesion_mask": "l.nii", "masks": {"brain": "b.nii"}}}),
        ("bronchoscope", {"input": {"mesh": "m.ply"}}),
    ],
)
def test_every_path_of_a_case_is_moved_with_its_file(planner: str, tables: dict[str, Any], tmp_path: Path) -> None:
    tables = {**tables, "planner": {"name": planner}}
    read_there = make_case(tables, folder=tmp_path)
    moved = make_case(rebased(tables, tmp_path))
    assert input_paths(moved) == input_paths(read_there)
    assert all(path.is_absolute() for path in input_paths(moved))


def test_a_seed_hangs_on_the_id_alone_and_gives_way_to_the_cases_own(cohort_files: Path) -> None:
    text = '[defaults.planner]\nrng_seed = 3\nname = "needle3d"\n[defaults.needle3d]\ntarget = [0, 0, 100]\n'
    manifest = cohort_files / "s.toml"
    rows = ['[[cases]]\nid = "a"\n', '[[cases]]\nid = "b"\nplanner.rng_seed = 9\n', '[[cases]]\nid = "c"\n']
    manifest.write_text(text + "".join(rows), encoding="utf-8")
    plain, seeded = cases_of(manifest), cases_of(manifest, rng_seed=1)
    assert [case.case.rng_seed for case in plain.values()] == [3, 9, 3]
    assert seeded["b"].case.rng_seed == 9
    assert seeded["a"].case.rng_seed == case_seed(1, "a") != case_seed(1, "c") == seeded["c"].case.rng_seed
    manifest.write_text(text + "".join(rows[::-1][:2]), encoding="utf-8")  # another order, and one case less
    assert cases_of(manifest, rng_seed=1)["c"].case.rng_seed == seeded["c"].case.rng_seed


def test_all_that_is_wrong_is_said_at_once_and_nothing_is_made(cohort_files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (cohort_files / "bad.toml").write_text(
        '[[cases]]\nid = "a"\ninput.mesh = "no.ply"\n\n[[cases]]\nid = "../b"\n\n[[cases]]\nid = "c"\ncase = "no.toml"\n\n'
        '[[cases]]\nid = "A"\ninput.mesh = "meshes/neck.ply"\nlimits.clearance_min = -1\n',
        encoding="utf-8",
    )
    assert status_of(["batch", str(cohort_files / "bad.toml"), "-o", str(cohort_files / "out")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "tubeplan: bad.toml: 5 faults, nothing was run:"
    assert lines[1:] == [
        "  line 1 (a): no.ply: there is no such file or folder; check the path",
        "  line 5 (../b): id is '../b', expected 1 to 100 letters, digits, points, dashes and underscores, "
        "a letter or digit first and last; it names the run folder, so no patient's name",
        "  line 8 (c): no.toml: no such case file",
        "  line 12 (A): clearance_min is -1 mm, expected 0 to 100 (the instrument's radius)",
        "  line 1 and line 12: the id 'a' stands 2 times; expected each once",
    ]
    assert not (cohort_files / "out").exists()


ROW = '[[cases]]\nid = "a"\ninput.mesh = "meshes/neck.ply"\n'


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("m.toml", "", r"m\.toml: it has no case; expected \[\[cases\]\]"),
        ("m.toml", "[[cases]\n", r"m\.toml: not valid TOML: .*line 1"),
        ("m.toml", "[case]\n", r"m\.toml: unknown table 'case'; expected \[defaults\] and \[\[cases\]\]"),
        ("m.toml", "cases = 3\n", r"m\.toml: cases is no array of tables"),
        ("m.toml", "defaults = 3\n" + ROW, r"m\.toml: defaults is 3, expected tables"),
        ("m.toml", "[defaults.limit]\n" + ROW, r"m\.toml: unknown table \[defaults\.limit\]; expected one of input, limits"),
        ("m.toml", "[[cases]]\ncase = 3\n", r"m\.toml, line 1: id is None, expected 1 to 100 letters"),
        ("m.toml", '\n[[cases]]\nid = "a"\ncase = 3\n', r"m\.toml, line 2 \(a\): case: found 3, expected text"),
        ("m.toml", '\n[[cases]]\nid = "a"\ncase = "\\u0000"\n', r"m\.toml, line 2 \(a\): case: found '\\x00', expected the path"),
        ("m.toml", f'\n[[cases]]\nid = "a"\ncase = "{"é" * 200}"\n', "expected names of at most 255 bytes"),
        ("m.csv", f"id,mesh\na,{'é' * 200}\n", "expected names of at most 255 bytes"),
        ("m.csv", "id,mesh\na,~nobody-of-that-name/a.ply\n", "nobody here has that name"),
        ("m.toml", '[[cases]]\nid = "index.html"\n', r"the name of a file of the cohort"),
        ("m.toml", ROW + "planner = 3\n", r"line 1 \(a\): planner is 3, expected a table"),
        ("m.toml", ROW + 'planner.name = "drill"\n', r"line 1 \(a\): there is no planner 'drill', expected one of tube"),
        ("m.toml", ROW + "limits.clearance = 1\n", r"line 1 \(a\): case \[limits\]: unknown key 'clearance'"),
        ("m.toml", ROW + 'planner.method = "magic"\n', r"line 1 \(a\): the tube planner has no method 'magic'; expected optimal"),
        (
            "m.toml",
            '[[cases]]\nid = "a"\nplanner.name = "rigid"\ninput.ct = "meshes"\nrigid = { side = "left", endoscope = "none" }\n',
            r"line 1 \(a\): .*'none'",
        ),
        ("m.csv", "", r"m\.csv: it has no case"),
        ("m.csv", "id\n", r"m\.csv: it has no case"),
        ("m.csv", "name,mesh\n", r"m\.csv, line 1: there is no column id, which names each case; found name, mesh$"),
        ("m.csv", "id;mesh\n", r"there is no column id, .*; found id;mesh; put commas between cells$"),
        ("m.csv", "id,mesh,mesh\n", r"m\.csv, line 1: the column mesh stands twice"),
        ("m.csv", "id,meshes\n", r"m\.csv, line 1: unknown column 'meshes'; expected id, case, planner, an option"),
        ("m.csv", "id,mesh,start\na,meshes/neck.ply,1,2,3\n", r"line 2: found 5 cells, expected 3 .* put quotes"),
        ("m.csv", 'id,mesh\n"a,b\n', r"m\.csv, line 2: is no CSV \(unexpected end of data\)"),
        ("m.csv", "id,mesh,side\na,meshes/neck.ply,left\n", r"line 2 \(a\): the column side is filled, but tube has none"),
        ("m.csv", "id,mesh,stone,stones\na,meshes/neck.ply,1,1\n", r"the column stones gives stones a second time"),
        ("m.csv", "id,mesh,clearance_min\na,meshes/neck.ply,wide\n", r"clearance_min: found 'wide', expected a finite number"),
        ("m.csv", b"id,mesh\n\xff,b\n", r"m\.csv: is no UTF-8 text; save it as CSV in UTF-8"),
    ],
)
def test_a_bad_manifest_is_one_sentence(cohort_files: Path, name: str, text: str | bytes, told: str) -> None:
    (cohort_files / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ManifestError, match=told) as fault:
        read_manifest(cohort_files / name)
    assert "\n" not in str(fault.value)


def test_of_very_many_faults_the_first_are_told(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("id,mesh,start,goal\n" + "".join(f"c{k},gone.ply,E1,E2\n" for k in range(100)))
    with pytest.raises(ManifestError, match=r"^m\.csv: 100 faults, nothing was run:\n  line 2 \(c0\): gone\.ply") as raised:
        read_manifest(tmp_path / "m.csv")
    assert str(raised.value).endswith("\n  and 70 more")


def test_a_manifest_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match=r"none\.toml: cannot be read \(no such file or directory\); name a TOML or CSV file"):
        read_manifest(tmp_path / "none.toml")


def test_the_digest_of_an_input_is_of_its_content_and_names(tmp_path: Path) -> None:
    folder = tmp_path / "series"
    (folder / "sub").mkdir(parents=True)
    (folder / "a").write_bytes(b"1")
    (folder / "sub" / "b").write_bytes(b"2")
    first = Digests().of(folder)
    os.utime(folder / "a", (1, 1))  # a copy on a cluster has other dates
    assert Digests().of(folder) == first
    (folder / "a").write_bytes(b"3")
    changed = Digests().of(folder)
    (folder / "a").write_bytes(b"1")
    (folder / "sub" / "b").rename(folder / "b")
    assert len({first, changed, Digests().of(folder)}) == 3
    (tmp_path / "v.mhd").write_bytes(b"head")
    (tmp_path / "v.raw").write_bytes(b"1")
    header = Digests().of(tmp_path / "v.mhd")
    (tmp_path / "v.raw").write_bytes(b"2")
    assert Digests().of(tmp_path / "v.mhd") != header
