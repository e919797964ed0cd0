"""The nose and what lies behind it on a head CT: tissue classes, structures, entry regions."""

from segmentation.anatomy.nasal.scene import SIDES, STRUCTURES, EntryRegion, NasalScene, Tissue

__all__ = ["SIDES", "STRUCTURES", "EntryRegion", "NasalScene", "Tissue"]
