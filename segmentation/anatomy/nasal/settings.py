"""What the nasal front end is told."""

from __future__ import annotations

from dataclasses import dataclass

from segmentation.errors import CaseError


@dataclass(frozen=True, kw_only=True)
class NasalSettings:
    """Limits of the tissue classes and the give of the skin.

    Attributes
    ----------
    air_max : float, HU
        Voxels up to here are air: about halfway between air and soft tissue.
    bone_min : float, HU
        Voxels from here on are bone; the thin bones of nose and orbit share their voxels with air.
    give : (sideways, upwards), mm
        How far the skin of the nostril gives way: 1 cm in the source's experiments (paragraph 82).
    """

    air_max: float = -400.0
    bone_min: float = 200.0
    give: tuple[float, float] = (10.0, 10.0)

    def __post_init__(self) -> None:
        if not -1024.0 < self.air_max < self.bone_min:
            raise CaseError(
                f"air ends at {self.air_max:g} HU and bone begins at {self.bone_min:g} HU; "
                "expected -1024 < end of air < beginning of bone"
            )
        if min(self.give) < 0.0 or max(self.give) > 30.0:
            raise CaseError(f"the skin's give is {self.give[0]:g} and {self.give[1]:g} mm, expected 0 to 30 mm")
