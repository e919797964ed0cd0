"""Faults planted in a run folder, and what the verifier says to them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tubeplan_viz.verify import verify_run

Change = Callable[[dict[str, Any]], None]


@pytest.fixture
def found_in(tmp_path: Path) -> Callable[[Path, Change], set[str]]:
    """Names of the checks that fail for a copy of a run folder whose result.json was changed."""

    def found(folder: Path, change: Change) -> set[str]:
        copy = tmp_path / "copy"
        shutil.copytree(folder, copy)
        document = json.loads((copy / "result.json").read_text(encoding="utf-8"))
        change(document)
        (copy / "result.json").write_text(json.dumps(document), encoding="utf-8")
        return {check.name for check in verify_run(copy).faults}

    return found
