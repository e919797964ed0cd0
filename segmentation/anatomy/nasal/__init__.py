"""The nose and what lies behind it on a head CT: tissue classes, structures, entry regions."""

from segmentation.anatomy.nasal.propose import propose_scene
from segmentation.anatomy.nasal.scene import SIDES, STRUCTURES, EntryRegion, NasalScene, Tissue
from segmentation.anatomy.nasal.settings import NasalSettings

__all__ = ["SIDES", "STRUCTURES", "EntryRegion", "NasalScene", "NasalSettings", "Tissue", "propose_scene"]
