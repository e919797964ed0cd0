"""What one kind of anatomy brings to growing: limits, leak rule, shape rule, smoothing."""

from __future__ import annotations

from dataclasses import dataclass, field

from segmentation.leak import LeakRule
from segmentation.tube_shape import TubeRule

Limit = float | str | None


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Defaults for one kind of lumen.

    Attributes
    ----------
    name : str
    lumen : {"dark", "bright", "any"}
    hu_min, hu_max : float or "auto" or None, HU
        None: must be given by the user.
    loosest : float or None, HU
        Where the search for an automatic limit ends.
    leak : LeakRule
    tube : TubeRule
    half_maximum : bool
        Whether the wall of the grown region is moved to half maximum when the limit was automatic.
    noise_max : float, HU
        With more noise around the seed than this the image is smoothed first.
    smoothing : float, mm
        Standard deviation of the Gaussian used then.
    """

    name: str
    lumen: str
    hu_min: Limit
    hu_max: Limit
    loosest: float | None
    leak: LeakRule
    tube: TubeRule = field(default_factory=TubeRule)
    half_maximum: bool = False
    noise_max: float = 25.0
    smoothing: float = 0.9
