"""What makes a finished case run again: its own settings, the content of its inputs, the version; nothing else."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tubeplan_viz.cohort import state
from tubeplan_viz.cohort.inputs import Digests
from tubeplan_viz.cohort.manifest import read_manifest


def keys(manifest: Path) -> dict[str, str]:
    """Keys of the cases of a manifest that have an input."""
    cases = [case for case in read_manifest(manifest).cases if case.id != "damaged"]
    return {case.id: state.case_key(case, manifest.parent / "out" / case.id, Digests()) for case in cases}


def changed(manifest: Path, before: dict[str, str]) -> set[str]:
    """Cases whose key is another than before."""
    after = keys(manifest)
    return {name for name in before if after[name] != before[name]}


def test_the_key_of_a_case_is_its_settings_its_inputs_content_and_the_version(
    cohort_files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifest, mesh = cohort_files / "cohort.toml", cohort_files / "meshes" / "neck.ply"
    before = keys(manifest)
    os.utime(mesh, (0, 0))  # another date is no other content
    assert changed(manifest, before) == set()
    mesh.write_bytes(mesh.read_bytes() + b"\n")
    assert changed(manifest, before) == {"neck"}
    before = keys(manifest)
    text = manifest.read_text(encoding="utf-8")
    manifest.write_text(text.replace("curvature_max = 0.125", "curvature_max = 0.126"), encoding="utf-8")
    assert changed(manifest, before) == {"neck"}  # the others state their own
    before = keys(manifest)
    monkeypatch.setattr(state, "__version__", "0.0.9")
    assert changed(manifest, before) == set(before)
