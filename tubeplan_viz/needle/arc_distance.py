"""Where an arc or a line of a needle's path is nearest to a point: closed forms, vectorised over pieces and points."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import BoolArray, FloatArray
from tubeplan_viz.needle.kinematics import Arcs, chord, cross

STRAIGHT = 1e-12  # 1/mm; an arc of this curvature leaves its tangent by 1e-8 mm on 150 mm


def angle_on(arcs: Arcs, spokes: FloatArray) -> FloatArray:
    """How far round from its start, 0 to 2 pi, a piece's circle meets directions from its centre, (..., n, m, 3): (..., n, m)."""
    x = np.einsum("...md,...d->...m", spokes, arcs.tangents)
    y = np.einsum("...md,...d->...m", spokes, arcs.normals)
    return np.asarray(np.mod(np.arctan2(x, -y), 2.0 * np.pi))


def on_arc(arcs: Arcs, spokes: FloatArray) -> BoolArray:
    """Whether directions from the circles' centres, (..., n, m, 3), lead to a point of the arc, (..., n, m)."""
    return np.asarray(angle_on(arcs, spokes) <= (arcs.lengths * arcs.curvatures)[..., None])


def arc_distance(arcs: Arcs, centers: FloatArray) -> FloatArray:
    """Exact distance, mm, of each piece, (..., n), to each of m points, (m, 3): (..., n, m).

    The nearest point of the whole circle lies in the half plane of the point; if it is not
    on the arc, the nearest is an end. Unlike the printed formula (Huo 2015, eq. 13), which
    compares with the tangents at the ends and holds for arcs under half a turn, this one holds up to a
    full turn. With k the curvature, x along the tangent, y towards the centre, z across:
    distance^2 = ((k (x^2 + y^2) - 2 y) / (1 + q))^2 + z^2, q^2 = (k x)^2 + (1 - k y)^2, exact for k = 0 too.
    """
    # Coordinates of the points in each piece's own frame, (..., n, m): products of matrices, no array of differences.
    x, y, z = (
        axis @ centers.T - np.einsum("...d,...d->...", axis, arcs.starts)[..., None]
        for axis in (arcs.tangents, arcs.normals, cross(arcs.tangents, arcs.normals))
    )
    forward, aside = (v[..., None] for v in chord(arcs.lengths, arcs.curvatures))
    flat, across = x * x + y * y, z * z
    k = np.maximum(arcs.curvatures, STRAIGHT)[..., None]
    kx, ky = k * x, 1.0 - k * y
    radial = (k * flat - 2.0 * y) / (1.0 + np.sqrt(kx * kx + ky * ky))
    angle = np.arctan2(kx, ky)
    whole = (arcs.lengths * arcs.curvatures)[..., None]
    beside = np.where(
        arcs.curvatures[..., None] > STRAIGHT,
        np.where(angle < 0, angle + 2.0 * np.pi, angle) <= whole,
        (x >= 0.0) & (x <= arcs.lengths[..., None]),
    )
    ends = np.minimum(flat, (x - forward) ** 2 + (y - aside) ** 2)
    return np.sqrt(np.where(beside, radial * radial, ends) + across)
