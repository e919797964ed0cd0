"""Any lumen: seed and limits come from the user."""

from __future__ import annotations

from segmentation.anatomy.preset import Preset
from segmentation.leak import LeakRule

GENERIC = Preset(
    name="generic",
    lumen="any",
    hu_min=None,
    hu_max=None,
    loosest=None,
    leak=LeakRule(volume_min=0.5, volume_max=1000.0, jump=10.0),
)
