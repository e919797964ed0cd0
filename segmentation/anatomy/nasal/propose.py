"""A head CT to a nasal scene: tissue, nostrils, septum, turbinates, orbits, brain, each with its confidence.

Strategy: landmarks first (tip of the nose, plane of symmetry), then the nostrils, whose rear edges say where the nasal
cavity begins; brain and septum next, since orbits lie below the one and turbinates beside the other. Structures are looked
for on voxels of about a millimetre; fine scans are averaged for that, and the result is cut to the fine tissue again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from segmentation.anatomy.nasal.brain import find_brain
from segmentation.anatomy.nasal.brought import Brought
from segmentation.anatomy.nasal.entry import Trace, trace_nostrils, widened
from segmentation.anatomy.nasal.landmarks import Coarse, Landmarks
from segmentation.anatomy.nasal.orbit import find_orbits
from segmentation.anatomy.nasal.scene import SIDES, STRUCTURES, EntryRegion, NasalScene, Tissue
from segmentation.anatomy.nasal.septum import find_septum, lower_end
from segmentation.anatomy.nasal.settings import NasalSettings
from segmentation.anatomy.nasal.turbinate import find_turbinates
from segmentation.anatomy.nasal.upright import Upright
from segmentation.arrays import BoolArray, FloatArray
from segmentation.volume import Volume

Progress = Callable[[str, float], None]
Box = tuple[slice, slice, slice]

WORKING = 0.9
"""Edge of the voxels on which structures are looked for, mm; coarser scans are taken as they are."""
# Boxes about the tip of the nose, mm: below, above, in front, behind, to either side.
NOSE_BOX = (30.0, 75.0, 2.0, 115.0, 45.0)
FACE_BOX = (10.0, 80.0, 0.0, 115.0, 65.0)
DOUBT = 0.6
"""A structure of less confidence is named in the notes."""
NOSTRIL_WIDTH, NOSTRIL_LENGTH = (4.0, 16.0), (6.0, 28.0)
"""Sideways, and from front to rear edge, mm: adults, with half as much tolerance."""


def propose_scene(
    volume: Volume,
    settings: NasalSettings | None = None,
    *,
    masks: Mapping[str, BoolArray] | None = None,
    seeds: Mapping[str, ArrayLike] | None = None,
    boxes: Mapping[str, ArrayLike] | None = None,
    progress: Progress | None = None,
) -> NasalScene:
    """Find what a rigid planner needs to know of a head.

    Parameters
    ----------
    volume : Volume
        Head CT with the whole nose, axes within 37 degrees of the patient's.
    settings : NasalSettings, optional
    masks : mapping of name to (slices, rows, columns) bool array, optional
        What the user brings instead of a proposal: names of `STRUCTURES`, or "entry_left", "entry_right".
    seeds : mapping of name to (3,) array_like, LPS mm, optional
        A point in the structure: the proposal that holds it is taken instead of the likeliest.
    boxes : mapping of name to (2, 3) array_like, LPS mm, optional
        Opposite corners: the proposal is cut to the box; where nothing is left, the box's tissue (of an entry: its air) is
        taken.
    progress : callable, optional
        Called with what is looked for and the share done.

    Returns
    -------
    NasalScene
        A structure that was not found is absent and named in the notes.

    Raises
    ------
    VolumeError
        If there is no head or no nose in the image, or its axes lie askew.
    CaseError
        If a mask, seed or box has an unknown name or does not fit the volume.
    """
    settings = settings or NasalSettings()
    work = _Proposal(volume, settings, Brought.read(volume, masks=masks, seeds=seeds, boxes=boxes))
    steps: tuple[tuple[str, Callable[[], None]], ...] = (
        ("nostrils", work.entries),
        ("brain", work.brain),
        ("septum", work.septum),
        ("turbinates", work.turbinates),
        ("orbits", work.orbits),
    )
    for number, (name, step) in enumerate(steps):
        if progress is not None:
            progress(name, number / len(steps))
        step()
    if progress is not None:
        progress("done", 1.0)
    return work.scene()


@dataclass(eq=False)
class _Proposal:
    """A scene in the making; arrays are [up, back, left], on the volume's voxels unless they say `working`."""

    volume: Volume
    settings: NasalSettings
    brought: Brought
    structures: dict[str, BoolArray] = field(default_factory=dict)
    confidence: dict[str, float] = field(default_factory=dict)
    origin: dict[str, str] = field(default_factory=dict)
    regions: dict[str, EntryRegion] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    choana: float | None = None
    front: int = 0

    def __post_init__(self) -> None:
        self.upright = Upright(self.volume)
        self.cells = Coarse.of(self.upright, size=WORKING)
        working = self.upright
        if self.cells.factor != (1, 1, 1):
            matrix = self.upright.index_to_lps.copy()
            matrix[:3, 3] = self.upright.to_lps(0.5 * (np.array(self.cells.factor) - 1.0))
            matrix[:3, :3] *= self.cells.factor
            working = Upright(Volume(np.rint(self.cells.hu).astype(np.int16), matrix))
        self.head = Landmarks(working, air_max=self.settings.air_max, bone_min=self.settings.bone_min)
        self.tissue: NDArray[np.uint8] = np.full(self.upright.voxels.shape, Tissue.SOFT, dtype=np.uint8)
        self.tissue[self.upright.voxels <= self.settings.air_max] = Tissue.AIR
        self.tissue[self.upright.voxels >= self.settings.bone_min] = Tissue.BONE

    def _box(self, reach: tuple[float, float, float, float, float]) -> Box:
        below, above, before, behind, aside = reach
        tip, spacing = self.head.tip, self.head.spacing
        low = np.maximum(tip - np.array([below, before, aside]) / spacing, 0).astype(int)
        high = np.minimum(tip + np.array([above, behind, aside]) / spacing + 1, self.head.upright.voxels.shape).astype(int)
        return slice(low[0], high[0]), slice(low[1], high[1]), slice(low[2], high[2])

    def _fine(self, mask: BoolArray, box: Box | None = None) -> BoolArray:
        """A mask on working voxels, or in a box of them, on the volume's."""
        if box is not None:
            whole = np.zeros(self.head.upright.voxels.shape, dtype=bool)
            whole[box] = mask
            mask = whole
        return mask if self.cells.factor == (1, 1, 1) else self.cells.fine(mask, self.upright.voxels.shape)

    def _working(self, name: str) -> BoolArray:
        """A structure on working voxels: any of a cell's middle voxels."""
        steps = tuple(slice(f // 2, f // 2 + n * f, f) for f, n in zip(self.cells.factor, self.cells.hu.shape, strict=True))
        return self.structures[name][steps]

    def _seed(self, name: str, box: Box) -> FloatArray | None:
        seed = self.brought.seeds.get(name)
        if seed is None:
            return None
        return self.head.upright.to_index(seed) - np.array([side.start for side in box])

    def _side_seeds(self, name: str, box: Box) -> dict[str, FloatArray]:
        seeds = {side: self._seed(f"{name}_{side}", box) for side in SIDES}
        return {side: seed for side, seed in seeds.items() if seed is not None}

    def _take(self, name: str, mask: BoolArray | None, confidence: float, words: str) -> None:
        """Enter a structure as the user wants it; `words` says why the search found none or is in doubt."""
        origin = "seed" if name in self.brought.seeds else "proposed"
        allowed = (
            self.tissue != Tissue.AIR if name in ("septum", "turbinate_left", "turbinate_right") else self.tissue == Tissue.SOFT
        )
        if name in self.brought.masks:
            mask, confidence, origin = self.upright.turn(self.brought.masks[name]), 1.0, "mask"
        else:
            if mask is not None:
                mask = mask & allowed
                # A proposal stands back where an earlier one or a mask of the user's lies.
                brought = (self.upright.turn(self.brought.masks[other]) for other in STRUCTURES if other in self.brought.masks)
                for taken in (*self.structures.values(), *brought):
                    mask = mask & ~taken
            if name in self.brought.boxes:
                inside = self.upright.turn(self.brought.boxes[name])
                cut = inside & allowed if mask is None or not (mask & inside).any() else mask & inside
                mask, confidence, origin = cut, 1.0, "box"
        if mask is None or not mask.any():
            self.notes.append(
                f"{name.replace('_', ' ')}: not found, {words}; it is no obstacle until a mask, seed or box gives it"
            )
            return
        if confidence < DOUBT:
            self.notes.append(f"{name.replace('_', ' ')}: doubtful (confidence {confidence:.2f}), {words}")
        self.structures[name], self.confidence[name], self.origin[name] = mask, float(confidence), origin

    def entries(self) -> None:
        """Trace the nostrils, or take them as given."""
        shape, spacing = self.upright.voxels.shape, self.upright.spacing
        given = [f"entry_{side}" for side in SIDES]
        traced: Trace | None = None
        if not all(name in self.brought.masks for name in given):
            skin = (self.tissue != Tissue.AIR) & self._fine(self._skin_cells())
            tip = np.rint(self.cells.to_fine(self.head.tip)).astype(int)
            traced = trace_nostrils(skin, spacing, tip=tip)
        for side, sign in zip(SIDES, (1, -1), strict=True):
            name = f"entry_{side}"
            mask, origin, confidence = np.zeros(shape, dtype=bool), "traced", 0.0
            if name in self.brought.masks:
                mask, origin, confidence = self.upright.turn(self.brought.masks[name]), "mask", 1.0
            elif traced is not None:
                part = traced.part(self._on_side(traced, sign))
                mask, confidence = part.mask(shape), self._nostril_confidence(part)
                if name in self.brought.boxes:
                    box = self.upright.turn(self.brought.boxes[name])
                    mask = mask & box if (mask & box).any() else box & (self.tissue == Tissue.AIR)
                    origin, confidence = "box", 1.0
            if not mask.any():
                self.notes.append(
                    f"{side} nostril: not found in any sagittal slice near the tip of the nose; give entry_{side} as mask or box"
                )
                continue
            if confidence < DOUBT:
                self.notes.append(f"{side} nostril: doubtful (confidence {confidence:.2f}), its size is unlike a nostril's")
            wide = widened(mask, spacing, outwards=sign, give=self.settings.give)
            self.regions[side] = EntryRegion(
                side=side,
                nostril=self.upright.restore(mask),
                widened=self.upright.restore(wide),
                confidence=confidence,
                origin=origin,
            )
            rear = int(np.flatnonzero(mask.any(axis=(0, 2)))[-1])
            self.front = max(self.front, round(float(self.cells.to_cell(np.array([0, rear, 0]))[1])))
        self.front = self.front or int(self.head.tip[1] + 20.0 / self.head.spacing[1])

    def _skin_cells(self) -> BoolArray:
        """Working voxels near the head's tissue: cuts table and air tubes off."""
        near = self.head.skin.copy()
        near[:, :-1] |= self.head.skin[:, 1:]
        near[:, 1:] |= self.head.skin[:, :-1]
        return near

    def _on_side(self, trace: Trace, sign: int) -> BoolArray:
        """Which traced slices lie on one side of the plane of symmetry; columella slices lie between."""
        if not len(trace.columns):
            return np.zeros(0, dtype=bool)
        places = np.column_stack([0.5 * (trace.front + trace.rear), trace.columns])
        working = self.cells.to_cell(places) * self.head.spacing
        away = sign * (working @ self.head.midline[:3] - self.head.midline[3])
        # The nose may lean: the widest gap between traced slices near the plane is its columella.
        gaps = np.diff(trace.columns)
        if gaps.size and gaps.max() > 1:
            split = int(gaps.argmax())
            left = np.arange(len(trace.columns)) > split
            return left if sign > 0 else ~left
        return np.asarray(away > 0.0)

    def _nostril_confidence(self, part: Trace) -> float:
        if not len(part.columns):
            return 0.0
        spacing = self.upright.spacing
        width = float(np.ptp(part.columns) + 1) * float(spacing[2])
        length = float(np.median(np.linalg.norm((part.rear - part.front) * spacing[:2], axis=1)))
        likely = [
            min(1.0, value / low, high / max(value, 1e-9))
            for value, (low, high) in ((width, NOSTRIL_WIDTH), (length, NOSTRIL_LENGTH))
        ]
        return float(np.prod(likely))

    def brain(self) -> None:
        """Propose the brain."""
        found = None
        if "brain" not in self.brought.masks:
            found = find_brain(self.head, seed=self._seed("brain", (slice(0, None),) * 3))
        words = "no large soft space inside bone"
        if found is not None:
            words = f"{found.enclosed:.0%} of its surface on bone, {found.millilitres:.0f} ml" + (
                ", cut by the image" if found.cut else ""
            )
            if found.cut:
                self.notes.append("brain: the image ends inside of it")
        self._take("brain", None if found is None else self._fine(found.mask), 0.0 if found is None else found.confidence, words)

    def septum(self) -> None:
        """Propose the septum."""
        box = self._box(NOSE_BOX)
        found = None
        if "septum" not in self.brought.masks:
            found = find_septum(
                self.head.upright.voxels[box],
                self.head.hull[box],
                self._across(box),
                self.head.spacing,
                seed=self._seed("septum", box),
            )
        words = "no thin sheet with air on both sides near the midline"
        if found is not None:
            words = f"air on both sides over {found.confidence:.0%} of it"
        self._take(
            "septum", None if found is None else self._fine(found.mask, box), 0.0 if found is None else found.confidence, words
        )
        if "septum" in self.structures:
            up, back = np.nonzero(self._working("septum")[box].any(axis=2))
            if up.size:
                self.choana = lower_end(up, back)[1] if found is None else found.choana

    def turbinates(self) -> None:
        """Propose the inferior turbinates."""
        names = [f"turbinate_{side}" for side in SIDES]
        box = self._box(NOSE_BOX)
        found = {}
        if self.choana is not None and not all(name in self.brought.masks for name in names):
            found = find_turbinates(
                self.head.upright.voxels[box],
                self.head.hull[box],
                self._across(box),
                self.head.spacing,
                septum=self._working("septum")[box],
                choana=self.choana,
                front=self.front - box[1].start,
                seeds=self._side_seeds("turbinate", box),
            )
        for side, name in zip(SIDES, names, strict=True):
            part = found.get(side)
            words = "no septum to start from" if self.choana is None else "no body of tissue beside the airway"
            if part is not None:
                words = f"{part.millilitres:.1f} ml, {part.length:.0f} mm long, {part.bordered:.0%} of its surface against air"
            self._take(
                name, None if part is None else self._fine(part.mask, box), 0.0 if part is None else part.confidence, words
            )

    def orbits(self) -> None:
        """Propose the contents of the orbits."""
        names = [f"orbit_{side}" for side in SIDES]
        box = self._box(FACE_BOX)
        found = {}
        if not all(name in self.brought.masks for name in names):
            found = find_orbits(
                self.head.upright.voxels[box],
                self.head.hull[box],
                self._working("brain")[box] if "brain" in self.structures else None,
                self._across(box),
                self.head.spacing,
                seeds=self._side_seeds("orbit", box),
            )
        sizes = [part.millilitres for part in found.values()]
        alike = min(sizes) / max(sizes) if len(sizes) == 2 else 1.0
        for side, name in zip(SIDES, names, strict=True):
            part = found.get(side)
            words = "no soft space between bone on four sides"
            if part is not None:
                words = f"{part.millilitres:.0f} ml, the smaller side has {alike:.0%} of the larger"
            self._take(
                name,
                None if part is None else self._fine(part.mask, box),
                0.0 if part is None else part.confidence * min(1.0, alike / 0.75),
                words,
            )

    def _across(self, box: Box) -> FloatArray:
        shape = tuple(side.stop - side.start for side in box)
        return self.head.across(shape, tuple(side.start for side in box))

    def scene(self) -> NasalScene:
        """The scene in the volume's own order of axes."""
        upright = self.head.upright
        # Gradient of the signed distance in LPS: the rows of the inverse take LPS to index.
        scaled = self.head.midline[:3] * self.head.spacing
        inverse = np.linalg.inv(upright.index_to_lps)
        normal = scaled @ inverse[:3, :3]
        offset = self.head.midline[3] - float(scaled @ inverse[:3, 3])
        length = float(np.linalg.norm(normal))
        return NasalScene(
            volume=self.volume,
            tissue=self.upright.restore(self.tissue),
            structures={name: self.upright.restore(self.structures[name]) for name in STRUCTURES if name in self.structures},
            entries=self.regions,
            confidence=self.confidence,
            origin=self.origin,
            midline=np.array([*normal, offset]) / length,
            notes=tuple(self.notes),
        )
