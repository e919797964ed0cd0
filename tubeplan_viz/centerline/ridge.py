"""The exact middle beside a coarse line: in each cross-section the centre of the largest inscribed sphere."""

# Strategy: the Voronoi diagram is drawn from thinned wall samples; here its line is brought
# back to the diagram of the wall itself. In the plane across the line the sphere's centre is where
# the least distance to the wall is greatest. A few probes half-way out find the wall around
# by exact distance to its triangles; the planes that touch it there bound the distance, and are
# exact for round sections. The greatest least distance to them is a concave problem in two
# unknowns, solved for all points at once by Newton steps on a sharpening soft minimum.

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.geometry import WallDistance, across

PROBES = 12
# Share of the radius at which probes stand: off the ridge, where the nearest wall point is single and found fast.
PROBE_SHARE = 0.5
# Sharpness of the soft minimum, in 1/radius; the last is sharp to a thousandth of the radius.
SHARPNESS = (20.0, 80.0, 320.0, 1280.0)
NEWTON_STEPS = 3
# Pull back to where the point was, in 1/radius: decides where the section is flat and its middle a line.
PULL = 0.02


def to_ridge(points: FloatArray, wall: WallDistance, *, radii: FloatArray, reach: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points of a line, moved across it to the middle of the lumen.

    Parameters
    ----------
    points : (n, 3) float array, mm
        Along a line inside the lumen, in order, n >= 2.
    wall : WallDistance
    radii : (n,) float array, mm
        About those of the largest spheres around the points.
    reach : (n,) float array, mm
        Farthest that each point may go; points with a reach of zero cost nothing.

    Returns
    -------
    points : (n, 3) float array, mm
    radii : (n,) float array, mm
        At the new points, by the planes that touch the wall.
    """
    asked = np.flatnonzero(reach > 0.0)
    moved, found = points.copy(), radii.copy()
    if len(asked) == 0:
        return moved, found
    across, sites, scale = normal_planes(points)[asked], points[asked], radii[asked]
    angle = 2.0 * np.pi * np.arange(PROBES) / PROBES
    directions = np.einsum("nij,kj->nki", across, np.column_stack([np.cos(angle), np.sin(angle)]))
    probes = (sites[:, None] + PROBE_SHARE * scale[:, None, None] * directions).reshape(-1, 3)
    distance, _, foot = wall.nearest(probes)
    away = ((probes - foot) / np.maximum(distance, 1e-9)[:, None]).reshape(len(sites), PROBES, 3)
    level = np.einsum("nki,nki->nk", sites[:, None] - foot.reshape(away.shape), away)
    slope = np.einsum("nki,nij->nkj", away, across)
    shift = greatest_least(level, slope, scale)
    length = np.linalg.norm(shift, axis=1)
    shift *= np.minimum(1.0, reach[asked] / np.maximum(length, 1e-12))[:, None]
    moved[asked] += np.einsum("nij,nj->ni", across, shift)
    found[asked] = np.maximum((level + np.einsum("nkj,nj->nk", slope, shift)).min(axis=1), 0.1 * scale)
    return moved, found


def normal_planes(points: FloatArray) -> FloatArray:
    """Two unit vectors across a polyline at each of its points, (n, 3, 2)."""
    return np.stack(across(np.gradient(points, axis=0)), axis=2)


def greatest_least(level: FloatArray, slope: FloatArray, scale: FloatArray) -> FloatArray:
    """The z that maximises min_k (level_k + slope_k . z), for many small problems at once.

    Parameters
    ----------
    level : (n, k) float array, mm
    slope : (n, k, 2) float array
    scale : (n,) float array, mm
        Size of the section; sharpness and step lengths refer to it.

    Returns
    -------
    (n, 2) float array, mm
        Zero where no other place is better by the planes given.

    Examples
    --------
    Four walls at 1, 3, 2 and 2 mm: the middle is 1 mm towards the second.

    >>> walls = np.array([[[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]])
    >>> greatest_least(np.array([[1.0, 3.0, 2.0, 2.0]]), walls, np.array([2.0])).round(2) + 0.0
    array([[1., 0.]])
    """
    z = np.zeros((len(level), 2))
    best, value = z.copy(), level.min(axis=1)
    for sharpness in SHARPNESS:
        beta = (sharpness / scale)[:, None]
        for _ in range(NEWTON_STEPS):
            weight = beta * (level + np.einsum("nkj,nj->nk", slope, z))
            weight = np.exp(weight.min(axis=1, keepdims=True) - weight)
            weight /= weight.sum(axis=1, keepdims=True)
            mean = np.einsum("nk,nkj->nj", weight, slope)
            gradient = mean - (2.0 * PULL / scale)[:, None] * z
            spread = np.einsum("nk,nki,nkj->nij", weight, slope, slope) - mean[:, :, None] * mean[:, None, :]
            bend = beta[:, :, None] * spread + (2.0 * PULL / scale)[:, None, None] * np.eye(2)
            step = np.linalg.solve(bend, gradient[:, :, None])[:, :, 0]
            # A Newton step of a soft minimum is good for a few of its widths.
            longest = 4.0 / beta[:, 0]
            length = np.linalg.norm(step, axis=1)
            z = z + step * np.minimum(1.0, longest / np.maximum(length, 1e-12))[:, None]
            now = (level + np.einsum("nkj,nj->nk", slope, z)).min(axis=1)
            better = now > value
            best[better], value[better] = z[better], now[better]
    return best
