"""Vessels filled with contrast medium: a bright lumen, from a given seed."""

from __future__ import annotations

from segmentation.anatomy.preset import Preset
from segmentation.leak import LeakRule

# No seed is looked for: which vessel is meant cannot be known from the image. 100 HU is
# above unenhanced blood (40 to 60 HU) and soft tissue.
VESSEL = Preset(
    name="vessel",
    lumen="bright",
    hu_min="auto",
    hu_max=3071.0,
    loosest=100.0,
    half_maximum=True,
    leak=LeakRule(volume_min=1.0, volume_max=400.0, jump=20.0),
)
