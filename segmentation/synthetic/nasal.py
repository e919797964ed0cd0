"""A head CT made by calculation, with the nasal scene that a perfect front end would find in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from segmentation.anatomy.nasal.scene import SIDES, STRUCTURES, EntryRegion, NasalScene, Tissue
from segmentation.arrays import BoolArray, FloatArray
from segmentation.synthetic import head
from segmentation.synthetic.scanner import ScannerSettings, scan
from segmentation.synthetic.shapes import Canvas
from segmentation.volume import Volume

SEED = 4711


@dataclass(frozen=True, kw_only=True)
class NasalPhantomSettings:
    """Grid and shape of the generated head.

    Attributes
    ----------
    spacing : (slice, row, column) distances, mm
    lower, upper : (x, y, z), mm
        LPS corners of the scanned box; the head spans -70 to 70, -82 to 100 and below -45 to 85.
    deviation : float, mm
        How far the septum bulges to the patient's left in its lower middle third; 0 is straight.
    give : (sideways, upwards), mm
        How far the skin of the nostril gives way [1]_.
    scanner : ScannerSettings

    References
    ----------
    .. [1] Multi-constraint path planning (Chinese patent text, 2021), paragraph 82: d_r = d_u = 1 cm.
    """

    spacing: tuple[float, float, float] = (1.0, 1.0, 1.0)
    lower: tuple[float, float, float] = (-76.0, -92.0, -45.0)
    upper: tuple[float, float, float] = (76.0, 104.0, 90.0)
    deviation: float = 0.0
    give: tuple[float, float] = (10.0, 10.0)
    scanner: ScannerSettings = field(default_factory=ScannerSettings)


@dataclass(frozen=True, eq=False, kw_only=True)
class NasalPhantom:
    """A generated head CT and its truth.

    Attributes
    ----------
    volume : Volume
        HU with blur, noise and streaks.
    scene : NasalScene
        Exact: a voxel belongs to the solid that holds its centre.
    lesions : mapping of side to (3,) float array, mm
        In the bone between sphenoid sinus and optic nerve.
    airway : (slices, rows, columns) bool array
        Air inside the head: nose, sphenoid sinus, nasopharynx, maxillary sinuses.
    bone : (slices, rows, columns) bool array
    skin : (slices, rows, columns) bool array
        Tissue voxels that touch the air outside the head by a face.
    cores : mapping of structure to bool array
        The bone inside septum and turbinates that shrinking mucosa ends at.
    """

    volume: Volume
    scene: NasalScene
    lesions: Mapping[str, FloatArray]
    airway: BoolArray
    bone: BoolArray
    skin: BoolArray
    cores: Mapping[str, BoolArray]


def nasal_phantom(settings: NasalPhantomSettings | None = None, *, seed: int = SEED) -> NasalPhantom:
    """Calculate the scan and its truth; anatomy is fixed by the settings, noise by the seed."""
    settings = settings or NasalPhantomSettings()
    z, y, x = (
        np.asarray(np.arange(first, last, step) + 0.5 * step)
        for first, last, step in zip(settings.lower[::-1], settings.upper[::-1], settings.spacing, strict=True)
    )
    canvas = Canvas(x, y, z, np.full((len(z), len(y), len(x)), head.AIR))
    built = head.Head(canvas, deviation=settings.deviation)
    image = scan(canvas.hu, settings.spacing, settings.scanner, rng=np.random.default_rng(seed))
    index_to_lps = np.eye(4)
    # [slice, row, column] run along z, y, x.
    index_to_lps[:3, :3] = np.diag(settings.spacing[::-1])[:, ::-1]
    index_to_lps[:3, 3] = x[0], y[0], z[0]
    volume = Volume(np.clip(np.rint(image), -1024, 3071).astype(np.int16), index_to_lps)
    outside = (built.tissue == Tissue.AIR) & ~built.hull
    scene = NasalScene(
        volume=volume,
        tissue=built.tissue,
        structures={name: built.masks[name] for name in STRUCTURES},
        entries={side: _entry(side, volume, settings.give) for side in SIDES},
        confidence=dict.fromkeys(STRUCTURES, 1.0),
        origin=dict.fromkeys(STRUCTURES, "mask"),
        midline=np.array([1.0, 0.0, 0.0, 0.0]),
    )
    lesion = np.array(head.LESION)
    return NasalPhantom(
        volume=volume,
        scene=scene,
        lesions={"left": lesion, "right": lesion * [-1.0, 1.0, 1.0]},
        airway=(built.tissue == Tissue.AIR) & ~outside,
        bone=built.tissue == Tissue.BONE,
        skin=(built.tissue != Tissue.AIR) & _touching(outside),
        cores={name.removesuffix("_core"): mask for name, mask in built.masks.items() if name.endswith("_core")},
    )


def nostril_segment(side: str, x: float) -> FloatArray:
    """Front and rear edge of the nostril in the sagittal plane at |x|: (2, 3) mm, LPS."""
    sign = 1.0 if side == "left" else -1.0
    return np.array([[sign * x, *head.front_edge(x)], [sign * x, *head.rear_edge(x)]])


def _touching(mask: BoolArray) -> BoolArray:
    """Voxels with a face neighbour in the mask."""
    near = np.zeros_like(mask)
    for axis in range(3):
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        near[tuple(low)] |= mask[tuple(high)]
        near[tuple(high)] |= mask[tuple(low)]
    return near


def _entry(side: str, volume: Volume, give: tuple[float, float]) -> EntryRegion:
    """The nostril's voxels from its closed form, and the region widened by the skin's give."""
    sign = 1.0 if side == "left" else -1.0
    nostril = np.zeros(volume.voxels.shape, dtype=bool)
    for column in range(volume.voxels.shape[2]):
        x = sign * float(volume.to_lps([0.0, 0.0, column])[0])
        if head.SEPTUM_HALF < x < float(head.inner_width(x, head.rim(x))):
            front, rear = volume.to_index(nostril_segment(side, x))
            steps = int(np.ceil(4.0 * np.abs(rear - front).max())) + 1
            line = np.rint(np.linspace(front, rear, steps)).astype(int)
            nostril[line[:, 0], line[:, 1], column] = True
    widened = nostril.copy()
    for shift in range(1, round(give[0] / volume.spacing[2]) + 1):
        moved = np.zeros_like(nostril)
        if sign > 0.0:
            moved[:, :, shift:] = nostril[:, :, :-shift]
        else:
            moved[:, :, :-shift] = nostril[:, :, shift:]
        widened |= moved
    sideways = widened.copy()
    for shift in range(1, round(give[1] / volume.spacing[0]) + 1):
        widened[shift:] |= sideways[:-shift]
    return EntryRegion(side=side, nostril=nostril, widened=widened, confidence=1.0, origin="mask")
