"""Padding of a CT: a fact, and a warning only where the lumen meets it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.pipeline import segment_case

FILL = -3024


def tube_ct(file: Path, *, padded_columns: int) -> Path:
    """A straight dark tube of radius 5 mm with some noise, and padding in the last columns of all slices."""
    rng = np.random.default_rng(4)
    _, y, x = np.meshgrid(np.arange(80), np.arange(41), np.arange(41), indexing="ij")
    hu = np.where(np.hypot(y - 20, x - 20) <= 5.0, -980.0, 40.0) + rng.normal(0.0, 5.0, size=x.shape)
    voxels = np.rint(hu).astype(np.int16)
    voxels[:, :, 41 - padded_columns :] = FILL
    sitk.WriteImage(sitk.GetImageFromArray(voxels), str(file))
    return file


@pytest.mark.parametrize(("columns", "warned"), [(3, False), (18, True)], ids=["in the corner", "through the tube"])
def test_padding_is_a_warning_only_where_it_touches_the_lumen(columns: int, warned: bool, tmp_path: Path) -> None:
    ct = tube_ct(tmp_path / "tube.mha", padded_columns=columns)
    # Between -1000 HU and tissue: padding, which reads -1024, stays out.
    case = InputCase(ct=ct, seed_point=(20.0, 20.0, 40.0), hu_min=-1010.0, hu_max=-500.0)
    summary = segment_case(case, tmp_path / "run")
    assert summary["facts"]["Padding"].startswith(f"{80 * 41 * columns} voxels")
    told = [text for text in summary["warnings"] if "outside what was scanned" in text]
    assert bool(told) == warned
    if warned:
        # Column 23 is the first of padding; rows 16 to 24 of the tube end there in every slice.
        assert told[0].startswith(f"{80 * 9} voxels in the lumen or at its wall")
    assert not any("padding" in text.lower() for text in summary["warnings"])
