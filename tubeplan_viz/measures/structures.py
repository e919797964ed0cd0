"""Distance of the path to structures given as masks."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from segmentation.volume import Volume
from tubeplan_viz.measures.measure import Measure, lacking

KEYS = ("structure_distance_min_mm", "structure_distance_min_at_mm", "structure_distance_mean_mm")


def structure_measures(name: str, mask: Volume, s: FloatArray, points: FloatArray) -> list[Measure]:
    """Least and mean distance of a path to the voxels of a mask.

    Parameters
    ----------
    name : str
    mask : Volume
        Voxels above 0 belong to the structure.
    s : (n,) float array, mm
    points : (n, 3) float array, mm, LPS
    """
    if not (np.asarray(mask.voxels) > 0).any():
        return lacking("the mask is empty", *KEYS, of=name)
    distance = mask_distance(mask, points)
    k = int(distance.argmin())
    values = (float(distance[k]), float(s[k]), float(np.trapezoid(distance, s) / s[-1]))
    return [Measure(key=key, of=name, value=value) for key, value in zip(KEYS, values, strict=True)]


def mask_distance(mask: Volume, points: FloatArray) -> FloatArray:
    """Distance of points to the union of a mask's voxels as boxes, (n,) mm; 0 inside. Exact for axes at right angles."""
    inside = np.asarray(mask.voxels) > 0
    rim = inside & ~ndimage.binary_erosion(inside)
    index = np.argwhere(rim)
    # In units of mm along the axes of the grid a voxel is a box, and distances are as in space.
    spacing = np.asarray(mask.spacing)
    centers = index * spacing
    sites = mask.to_index(points) * spacing
    tree = cKDTree(centers)
    nearest = tree.query(sites)[0]
    half = 0.5 * spacing
    # The nearest box has its centre at most half a diagonal farther than the nearest centre.
    candidates = tree.query_ball_point(sites, nearest + float(np.linalg.norm(half)))
    out = np.empty(len(points))
    for k, group in enumerate(candidates):
        beyond = np.maximum(np.abs(centers[group] - sites[k]) - half, 0.0)
        out[k] = np.linalg.norm(beyond, axis=1).min()
    voxel = np.round(mask.to_index(points)).astype(int)
    in_image = np.all((voxel >= 0) & (voxel < np.array(inside.shape)), axis=1)
    held = np.zeros(len(points), dtype=bool)
    held[in_image] = inside[tuple(voxel[in_image].T)]
    return np.where(held, 0.0, out)
