"""Archives are unpacked below their folder and nowhere else, with and without the standard library's filters."""

from __future__ import annotations

import io
import tarfile
from pathlib import Path

import pytest

from segmentation.archive import unpack


def packed(path: Path, name: str) -> Path:
    with tarfile.open(path, "w:xz") as archive:
        member = tarfile.TarInfo(name)
        member.size = 5
        archive.addfile(member, io.BytesIO(b"voxel"))
    return path


@pytest.mark.parametrize("filters", [True, False])
def test_a_file_lands_in_the_folder_and_none_outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, filters: bool) -> None:
    if not filters:
        monkeypatch.delattr(tarfile, "data_filter", raising=False)
    unpack(packed(tmp_path / "good.tar.xz", "series/0001.dcm"), tmp_path / "in")
    assert (tmp_path / "in" / "series" / "0001.dcm").read_bytes() == b"voxel"
    with pytest.raises(tarfile.TarError):
        unpack(packed(tmp_path / "bad.tar.xz", "../outside.dcm"), tmp_path / "in")
    assert not (tmp_path / "outside.dcm").exists()
