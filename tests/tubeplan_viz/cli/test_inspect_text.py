"""`tubeplan inspect` prints what it found to the letter."""

from __future__ import annotations

from pathlib import Path

import pytest

from tubeplan_viz.cli.app import status_of


def test_square_brackets_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    advice = "pip install 'tubeplan[compressed]' brings it"
    monkeypatch.setattr(
        "tubeplan_viz.cli.inspect.inspect_path", lambda path, **_: {"kind": "dicom", "faults": [advice], "series": []}
    )
    assert status_of(["inspect", str(tmp_path)]) == 0
    assert advice in capsys.readouterr().out
