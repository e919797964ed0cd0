"""The nose and what lies behind it on a head CT: tissue classes, structures, entry regions, shrinkage, the lesion."""

from segmentation.anatomy.nasal.cavity import inner_air
from segmentation.anatomy.nasal.propose import propose_scene
from segmentation.anatomy.nasal.scene import SIDES, STRUCTURES, EntryRegion, NasalScene, Tissue
from segmentation.anatomy.nasal.settings import NasalSettings
from segmentation.anatomy.nasal.shrink import Shrinkage, shrink
from segmentation.anatomy.nasal.target import Lesion, given_lesion, propose_lesion, require_entry, require_tissue

__all__ = [
    "SIDES",
    "STRUCTURES",
    "EntryRegion",
    "Lesion",
    "NasalScene",
    "NasalSettings",
    "Shrinkage",
    "Tissue",
    "given_lesion",
    "inner_air",
    "propose_lesion",
    "propose_scene",
    "require_entry",
    "require_tissue",
    "shrink",
]
