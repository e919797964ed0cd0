"""Single files that appear whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tubeplan_viz.result import write_whole


def test_a_file_is_replaced_at_once_and_only_when_asked(tmp_path: Path) -> None:
    path = tmp_path / "case.toml"
    write_whole(path, b"first", replace=False)
    with pytest.raises(FileExistsError, match=r"case\.toml"):
        write_whole(path, b"second", replace=False)
    assert path.read_bytes() == b"first"
    write_whole(path, b"third")
    assert path.read_bytes() == b"third"
    assert [entry.name for entry in tmp_path.iterdir()] == ["case.toml"]


def test_nothing_is_left_and_nothing_lost_where_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "case.toml"
    path.write_bytes(b"first")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"second")
    assert path.read_bytes() == b"first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["case.toml"]
