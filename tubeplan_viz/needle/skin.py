"""The skin around an entry: the border of air and tissue of a CT as a height over the plane across the needle's direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from segmentation.arrays import BoolArray, FloatArray, frozen_array
from segmentation.errors import CaseError
from segmentation.volume import Volume
from tubeplan_viz.needle.kinematics import Pose

TISSUE_HU = -300.0  # half way between air and fat, rounded towards fat: partial volume draws the border inwards
REACH_MM = 40.0  # how far along the direction the skin is looked for
STEP_MM = 1.0  # between heights
ALONG_MM = 0.25  # between samples along the direction


@dataclass(frozen=True, eq=False)
class Skin:
    """Heights of the skin on a grid across a direction.

    Attributes
    ----------
    heights : (m, m) float array, mm
        How far along the direction the skin lies, `STEP_MM` apart, the entry in the middle.
    """

    heights: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "heights", frozen_array(self.heights, (None, None), "heights"))

    def depth(self, offset: FloatArray) -> FloatArray:
        """How far along the direction, mm, the skin lies at (..., 2) mm across it, interpolated."""
        place = offset / STEP_MM + 0.5 * (len(self.heights) - 1)
        found = ndimage.map_coordinates(self.heights, np.moveaxis(place, -1, 0).reshape(2, -1), order=1, mode="nearest")
        return np.asarray(found).reshape(offset.shape[:-1])


def body_of(volume: Volume) -> BoolArray:
    """Voxels of the body: the largest connected part from `TISSUE_HU` on, with the air that each slice encloses.

    A table and clothes are parts of their own where air lies between them and the skin.
    """
    tissue = np.asarray(volume.voxels) >= TISSUE_HU
    labels, count = ndimage.label(tissue)
    if count == 0:
        raise CaseError(f"the CT has no tissue from {TISSUE_HU:g} HU on; expected a body, whose skin is looked for")
    body = labels == 1 + int(np.bincount(labels.ravel())[1:].argmax())
    return np.array([ndimage.binary_fill_holes(plane) for plane in body])


def skin_at(volume: Volume, pose: Pose, radius: float) -> tuple[Pose, Skin]:
    """The pose moved along its direction onto the skin, and the skin within `radius` mm across it.

    Parameters
    ----------
    volume : Volume
        A CT, HU.
    pose : Pose
        Near the skin, pointing into the body.
    radius : float, mm

    Raises
    ------
    CaseError
        If there is no skin within `REACH_MM` along the direction.
    """
    half = int(np.ceil(radius / STEP_MM)) + 2
    near = cropped(volume, pose.position, REACH_MM + half * STEP_MM)
    body = body_of(near).astype(np.float32)

    def crossings(start: Pose) -> FloatArray:
        across = STEP_MM * np.arange(-half, half + 1)
        grid = np.stack(np.meshgrid(across, across, indexing="ij"), axis=-1)
        along = np.arange(-REACH_MM, REACH_MM + ALONG_MM, ALONG_MM)
        places = (start.position + grid @ start.frame[:, :2].T)[:, :, None] + along[:, None] * start.tangent
        index = near.to_index(places.reshape(-1, 3)).T
        inside = ndimage.map_coordinates(body, index, order=1, mode="nearest").reshape(*grid.shape[:2], -1)
        return entered(inside, along)

    middle = crossings(pose)[half, half]
    if not np.isfinite(middle):
        raise CaseError(
            f"there is no skin within {REACH_MM:g} mm of the entry ({', '.join(f'{v:g}' for v in pose.position)}) mm along its "
            "direction; expected an entry near the skin and a direction into the body"
        )
    placed = Pose(pose.position + middle * pose.tangent, pose.frame)
    heights = crossings(placed)
    holes = ~np.isfinite(heights)
    nearest = ndimage.distance_transform_edt(holes, return_distances=False, return_indices=True)
    return placed, Skin(heights[tuple(nearest)])


def entered(inside: FloatArray, along: FloatArray) -> FloatArray:
    """Where along each line, (..., k) shares of the body, it goes from air into the body, nearest to 0; infinite if nowhere."""
    before, after = inside[..., :-1], inside[..., 1:]
    enters = (before < 0.5) & (after >= 0.5)
    share = (0.5 - before) / np.where(enters, after - before, 1.0)
    places = np.where(enters, along[:-1] + share * (along[1] - along[0]), np.inf)
    return np.asarray(np.take_along_axis(places, np.abs(places).argmin(axis=-1)[..., None], axis=-1)[..., 0])


def cropped(volume: Volume, place: FloatArray, reach: float) -> Volume:
    """The slices within `reach` mm of a place, whole: what is body is told from whole slices."""
    corners = place + reach * np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    slices = volume.to_index(corners)[:, 0]
    low = int(np.clip(np.floor(slices.min()), 0, volume.voxels.shape[0] - 1))
    high = int(np.clip(np.ceil(slices.max()) + 1, low + 1, volume.voxels.shape[0]))
    return volume.crop([low, 0, 0], [high, *volume.voxels.shape[1:]])
