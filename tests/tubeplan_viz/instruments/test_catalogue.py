"""The catalogue: what ships, and what is refused in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.instruments import CatalogueError, Instrument, make_catalogue, read_catalogue
from tubeplan_viz.instruments.rigid_catalogue import read_rigid_catalogue

ENTRY = {"name": "scope", "kind": "ureteroscope", "outer_diameter_mm": 2.4, "bend_radius_min_mm": 8.0}


def test_the_shipped_catalogue_is_read_and_says_where_its_values_come_from() -> None:
    instruments = read_catalogue()
    assert len(instruments) == 10
    assert {"catheter", "ureteroscope", "bronchoscope"} <= {one.kind for one in instruments}
    assert all("typical" in one.source or "generic" in one.source for one in instruments)


def test_limits_are_half_the_diameter_and_the_reciprocal_bend_radius() -> None:
    limits = make_catalogue({"instrument": [ENTRY]})[0].limits
    assert limits.clearance_min == 1.2
    assert limits.curvature_max == 0.125


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bend": 3.0}, r"mine\.toml: instrument 1 \(scope\): unknown key 'bend'"),
        ({"outer_diameter_mm": "2.4"}, r"instrument 1 \(scope\): outer_diameter_mm is '2.4', expected a number in mm"),
        ({"outer_diameter_mm": 2400.0}, r"instrument 1, 'scope': outer_diameter_mm is 2400, expected 0.1 to 50 mm"),
        ({"rigid_tip_mm": -1.0}, r"rigid_tip_mm is -1, expected 0 to 500 mm"),
        ({"bend_radius_min_mm": float("nan")}, r"bend_radius_min_mm is nan"),
        ({"working_length_mm": True}, r"working_length_mm is True, expected a number"),
        ({"name": 3}, r"name is 3, expected text"),
        ({"name": " "}, r"empty name"),
    ],
)
def test_a_wrong_entry_is_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(CatalogueError, match=message):
        make_catalogue({"instrument": [{**ENTRY, **change}]}, name="mine.toml")


def test_a_missing_key_an_empty_file_and_a_name_that_stands_twice_are_refused() -> None:
    with pytest.raises(CatalogueError, match="key bend_radius_min_mm is missing"):
        make_catalogue({"instrument": [{k: v for k, v in ENTRY.items() if k != "bend_radius_min_mm"}]})
    with pytest.raises(CatalogueError, match="holds no instrument"):
        make_catalogue({})
    with pytest.raises(CatalogueError, match="unknown table 'instruments'"):
        make_catalogue({"instruments": [ENTRY]})
    with pytest.raises(CatalogueError, match="'scope' stands 2 times"):
        make_catalogue({"instrument": [ENTRY, ENTRY]})


def test_a_file_that_cannot_be_read_is_named_without_its_folder(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match=r"^none\.toml: no such catalogue file$"):
        read_catalogue(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("[[instrument", encoding="utf-8")
    with pytest.raises(CatalogueError, match=r"^bad\.toml: not valid TOML"):
        read_catalogue(tmp_path / "bad.toml")
    (tmp_path / "raw.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CatalogueError, match=r"^raw\.toml: cannot be read \(no utf-8 text\); expected a catalogue"):
        read_catalogue(tmp_path / "raw.toml")


@pytest.mark.parametrize("key", ["diameter_mm", "length_mm"])
@pytest.mark.parametrize("value", ["1" + "0" * 400, "nan", "inf", "true", '"thick"', "[]"])
def test_a_number_of_a_rigid_instrument_that_is_none_is_told(key: str, value: str, tmp_path: Path) -> None:
    endoscope = "[[endoscope]]\nname = 'a'\ndiameter_mm = 4\nlength_mm = 175\nworking_distance_mm = 30\nview_angle_deg = 80\n"
    rows = {"diameter_mm": "4", "length_mm": "130", key: value}
    shaver = "[[shaver]]\nname = 'b'\n" + "".join(f"{name} = {cell}\n" for name, cell in rows.items())
    (tmp_path / "mine.toml").write_text(endoscope + shaver)
    with pytest.raises(CatalogueError, match=rf"^mine\.toml: shaver 1 \(b\): {key} is .*, expected a number$") as raised:
        read_rigid_catalogue(tmp_path / "mine.toml")
    assert len(str(raised.value)) < 200


def test_a_mark_of_the_encoding_at_the_beginning_is_no_fault(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        "[[instrument]]\nname='a'\nkind='b'\nouter_diameter_mm=1\nbend_radius_min_mm=5\n", encoding="utf-8-sig"
    )
    assert [one.name for one in read_catalogue(tmp_path / "mine.toml")] == ["a"]


def test_no_harder_means_no_worse_in_all_four_values() -> None:
    scope = Instrument(**ENTRY, rigid_tip_mm=5.0, working_length_mm=600.0)
    easier = Instrument(
        name="easier", kind="x", outer_diameter_mm=2.0, bend_radius_min_mm=8.0, rigid_tip_mm=4.0, working_length_mm=700.0
    )
    assert easier.is_no_harder_than(scope)
    assert not scope.is_no_harder_than(easier)
    assert scope.is_no_harder_than(scope)
    short = Instrument(name="s", kind="x", outer_diameter_mm=1.0, bend_radius_min_mm=1.0, working_length_mm=100.0)
    assert not short.is_no_harder_than(scope)
