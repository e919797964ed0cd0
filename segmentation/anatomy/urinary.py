"""Urinary tract filled with contrast medium: a bright lumen that is not bone."""

from __future__ import annotations

from segmentation.anatomy.preset import Preset
from segmentation.errors import RegionError
from segmentation.leak import LeakRule
from segmentation.volume import Volume

URINARY = Preset(
    name="urinary",
    lumen="bright",
    hu_min="auto",
    hu_max=3071.0,
    loosest=150.0,
    leak=LeakRule(volume_min=1.0, volume_max=80.0, jump=8.0),
)


def find_collecting_system(volume: Volume) -> tuple[int, int, int]:
    raise RegionError("no collecting system found; give --seed-point")
