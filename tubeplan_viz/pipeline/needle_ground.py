"""What a needle goes through: obstacles of the case file, of mesh files and of label volumes, the CT and its skin."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray
from segmentation.errors import CaseError
from segmentation.images import CtImage, read_ct
from segmentation.mesh_files import read_surface
from segmentation.volume import Volume
from segmentation.volume_files import read_volume_file
from tubeplan_viz.cases.needle import NeedleCase
from tubeplan_viz.cases.needle_rows import ObstacleCase
from tubeplan_viz.needle.bodies import Capsule, MaskObstacle, MeshObstacle, Obstacle, Polygon, Sphere
from tubeplan_viz.needle.kinematics import insertion_pose
from tubeplan_viz.needle.obstacles import Scene
from tubeplan_viz.needle.skin import skin_at
from tubeplan_viz.needle.spatial import SpatialProblem

CORRIDOR_MM = 60.0  # how far around the straight way a label volume is searched for obstacles
UNSEEN_MM = 5.0  # how near padding may come to the box of entry and target without a word about it
Reader = Callable[[Path, str | None], CtImage]


@dataclass(frozen=True, eq=False, kw_only=True)
class Ground:
    """What was read for a case.

    Attributes
    ----------
    scene : Scene
    volume : Volume or None
        The case's CT, for pictures and the skin.
    inputs : tuple of (str, str)
        Names of the files with their digests.
    warnings : tuple of str
    facts : mapping of str to str
        Of the CT, label to printed value.
    """

    scene: Scene
    volume: Volume | None = None
    inputs: tuple[tuple[str, str], ...] = ()
    warnings: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)


def space(place: tuple[float, ...]) -> FloatArray:
    """A place in space: (y, z) of the plane is (0, y, z)."""
    return np.array(place if len(place) == 3 else (0.0, *place), dtype=float)


def load_ground(case: NeedleCase) -> Ground:
    """The obstacles and the CT of a case; a CT that several of them name is read once."""
    bodies: list[Obstacle] = []
    inputs: list[tuple[str, str]] = []
    warnings: list[str] = []
    images: dict[tuple[Path, str | None], CtImage] = {}

    def image_of(path: Path, series: str | None) -> CtImage:
        if (path, series) not in images:
            images[path, series] = read_ct(path, series=series)
            inputs.extend(images[path, series].inputs)
            warnings.extend(images[path, series].warnings)
        return images[path, series]

    image = image_of(case.ct, case.series) if case.ct is not None else None
    if image is not None:
        warnings.extend(unseen_way(case, image))
    for body in case.obstacles:
        bodies.append(made_obstacle(body, case, inputs, warnings, image_of))
    return Ground(
        scene=Scene(tuple(bodies)),
        volume=None if image is None else image.volume,
        inputs=tuple(inputs),
        warnings=tuple(warnings),
        facts={} if image is None else image.facts,
    )


def unseen_way(case: NeedleCase, image: CtImage) -> tuple[str, ...]:
    """What to know of a CT that was not scanned everywhere around the straight way; padding elsewhere is no matter."""
    volume = image.volume
    index = volume.to_index(np.array([space(case.entry), space(case.target)]))
    margin = UNSEEN_MM / volume.spacing
    low = np.clip(np.floor(index.min(axis=0) - margin), 0, volume.voxels.shape).astype(int)
    high = np.clip(np.ceil(index.max(axis=0) + margin) + 1, low, volume.voxels.shape).astype(int)
    first, second, third = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    count = image.padding.count_within((first, second, third))
    if not count:
        return ()
    return (
        f"{count} voxels within {UNSEEN_MM:g} mm of the box of entry and target lie outside what was scanned and read as air: "
        "what is there is unknown",
    )


def spatial_problem(case: NeedleCase, ground: Ground) -> SpatialProblem:
    """The case posed; its entry moved onto the skin where the case says so.

    Raises
    ------
    CaseError
        If there is no skin at the entry, or entry or target are too near to an obstacle.
    """
    pose, skin = insertion_pose(case.entry, case.direction), None
    if case.skin:
        assert ground.volume is not None  # the case was checked to have a CT
        pose, skin = skin_at(ground.volume, pose, case.needle.entry_radius)
    problem = SpatialProblem(pose, np.array(case.target), ground.scene, case.needle, skin=skin)
    problem.check_places()
    return problem


def made_obstacle(
    body: ObstacleCase, case: NeedleCase, inputs: list[tuple[str, str]], warnings: list[str], image_of: Reader
) -> Obstacle:
    """One obstacle as planners use it."""
    if body.kind in ("circle", "sphere"):
        assert body.center is not None
        assert body.radius_mm is not None
        return Sphere(space(body.center), body.radius_mm, body.kind)
    if body.kind == "capsule":
        assert body.points is not None
        assert body.radius_mm is not None
        return Capsule(np.array(body.points), body.radius_mm)
    if body.kind == "polygon":
        assert body.points is not None
        return Polygon(np.array(body.points))
    assert body.file is not None
    if body.kind == "mesh":
        given = read_surface(body.file)
        inputs.extend(given.inputs)
        warnings.extend(given.warnings)
        return MeshObstacle(given.surface)
    if body.hu_min is not None:
        return MaskObstacle(around(grown(image_of(body.file, body.series).volume, body), case))
    labels = read_volume_file(body.file)
    inputs.extend(labels.inputs)
    return MaskObstacle(around(Volume(labels.voxels, labels.index_to_lps), case))


def grown(volume: Volume, body: ObstacleCase) -> Volume:
    """The voxels of a CT within the HU of an obstacle, and connected to its seed where it has one, as a label volume.

    Raises
    ------
    CaseError
        If the seed lies outside the CT or its HU are not among them.
    """
    voxels = np.asarray(volume.voxels)
    lowest = -np.inf if body.hu_min is None else body.hu_min
    chosen: BoolArray = voxels >= lowest
    if body.hu_max is not None:
        chosen &= voxels <= body.hu_max
    if body.seed_point is not None:
        seed = tuple(np.round(volume.to_index(body.seed_point)).astype(int))
        where = ", ".join(f"{v:g}" for v in body.seed_point)
        if not volume.contains(body.seed_point):
            raise CaseError(f"the seed ({where}) mm of an obstacle lies outside the CT")
        if not chosen[seed]:
            most = "" if body.hu_max is None else f" to {body.hu_max:g}"
            raise CaseError(f"the seed ({where}) mm of an obstacle has {voxels[seed]} HU, expected {lowest:g}{most}")
        labels, _ = ndimage.label(chosen, structure=np.ones((3, 3, 3)))
        chosen = labels == labels[seed]
    return Volume(chosen.astype(np.int16), volume.index_to_lps)


def around(mask: Volume, case: NeedleCase) -> Volume:
    """The part of a label volume within `CORRIDOR_MM` of the box of entry and target.

    Raises
    ------
    CaseError
        If entry or target lie outside the volume.
    """
    ends = np.array([space(case.entry), space(case.target)])
    index = mask.to_index(ends)
    for name, place in zip(("entry", "target"), ends, strict=True):
        if not mask.contains(place):
            raise CaseError("the {} ({:g}, {:g}, {:g}) mm lies outside the label volume of an obstacle".format(name, *place))
    margin = np.ceil(CORRIDOR_MM / np.asarray(mask.spacing))
    low = np.maximum(np.floor(index.min(axis=0) - margin), 0).astype(int)
    high = np.minimum(np.ceil(index.max(axis=0) + margin) + 1, mask.voxels.shape).astype(int)
    return mask.crop(low, high)
