"""The head of a rigid case made again from its CT: labels, lesion, shrunken mucosa."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from segmentation.anatomy.nasal import Lesion, NasalScene, Shrinkage, given_lesion, propose_lesion, propose_scene, shrink
from segmentation.arrays import BoolArray
from segmentation.images import read_ct
from segmentation.label_file import read_mask_file


@dataclass(frozen=True, eq=False)
class OwnHead:
    """The head of a case, made again from its CT.

    Attributes
    ----------
    scene : NasalScene
        Before shrinkage.
    shrunk : mapping of a share of the full shrinkage to Shrinkage
    lesion : Lesion or None
        As the case gives it, or as it is proposed.
    amount : float
        The shrinkage planned with.
    inputs : tuple of (name, sha256)
        Of the CT and all masks.
    facts : mapping
        What the CT says of itself.
    notes : tuple of str
        Doubts of reading, labels and lesion.
    """

    scene: NasalScene
    shrunk: Mapping[float, Shrinkage]
    lesion: Lesion | None
    amount: float
    inputs: tuple[tuple[str, str], ...]
    facts: Mapping[str, Any]
    notes: tuple[str, ...]

    @property
    def planned(self) -> NasalScene:
        """With the mucosa as planned."""
        return self.shrunk[self.amount].scene


def own_head(folder: Path, case: Mapping[str, Any], amounts: Iterable[float]) -> OwnHead:
    """The labels of the case, made again from its CT and shrunk to some amounts besides the one planned with."""
    own = case["rigid"]

    def place(name: str) -> Path:
        path = Path(name)
        return path if path.is_absolute() else folder.resolve() / path

    image = read_ct(place(case["input"]["ct"]), series=case["input"].get("series"))
    volume, inputs = image.volume, list(image.inputs)

    def brought(file: str) -> BoolArray:
        mask, read = read_mask_file(place(file), volume)
        inputs.extend(read)
        return mask

    masks = {name: brought(file) for name, file in own.get("masks", {}).items()}
    boxes = {name: np.reshape(box, (2, 3)) for name, box in own.get("boxes", {}).items()}
    scene = propose_scene(volume, masks=masks, seeds=own.get("seeds", {}), boxes=boxes)
    side, planned = own["side"], own["shrinkage_percent"] / 100.0
    if "lesion" in own:
        lesion: Lesion | None = given_lesion(scene, side, point=own["lesion"])
    elif "lesion_mask" in own:
        lesion = given_lesion(scene, side, mask=brought(own["lesion_mask"]))
    else:
        lesion = propose_lesion(scene, side)
    shrunk = {amount: shrink(scene, amount, side) for amount in {planned, *amounts}}
    notes = (*image.warnings, *scene.notes, *((lesion.note,) if lesion is not None and lesion.note else ()))
    return OwnHead(scene, shrunk, lesion, planned, tuple(inputs), image.facts, notes)
