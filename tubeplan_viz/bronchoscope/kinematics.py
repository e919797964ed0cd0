"""Shape of the active sections: constant-curvature arcs, their inverse, and the chain of rigid links beside them.

Frames of robots have their third column along the robot's axis, towards the tip. A section bends by phi in the plane at
the angle theta about its base's axis and does not twist: as in a tendon-driven section, the frame at its end is the base's
turned by phi about the normal of that plane.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray
from segmentation.errors import GeometryError

STRAIGHT = 1e-7  # rad; the terms of the arc's series that are dropped below it are smaller than the length times 1e-14


def pose_along(point: ArrayLike, direction: ArrayLike) -> FloatArray:
    """A pose at a point whose third column is a direction; the same direction always gives the same pose.

    The first column is as near as can be to the +x axis, or to +y where the direction runs along x.

    Parameters
    ----------
    point : (3,) array_like, mm
    direction : (3,) array_like
        Not zero.

    Returns
    -------
    (4, 4) float array

    Raises
    ------
    GeometryError
        If the direction has no length.
    """
    axis = np.asarray(direction, dtype=float)
    length = float(np.linalg.norm(axis))
    if not length > 0.0:
        raise GeometryError("the direction of a pose has no length; give a direction that is not zero")
    axis = axis / length
    aid = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = aid - (aid @ axis) * axis
    first /= np.linalg.norm(first)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([first, np.cross(axis, first), axis])
    pose[:3, 3] = np.asarray(point, dtype=float)
    return pose


def section_transform(length: float, phi: float, theta: float) -> FloatArray:
    """Pose of a section's end in the frame of its base, (4, 4), mm: the text's eq. 1 without twist.

    ``R = Rz(theta) Ry(phi) Rz(-theta)`` and ``p = L / phi [cos(theta) (1 - cos(phi)), sin(theta) (1 - cos(phi)), sin(phi)]``
    [1]_.

    Parameters
    ----------
    length : float, mm
        Arc length of the section.
    phi, theta : float, rad
        Bend, and angle of the bending plane about the base's axis.

    References
    ----------
    .. [1] Webster, R. J., Jones, B. A. (2010). Design and kinematic modeling of constant curvature continuum robots:
       a review. Int. J. Robotics Research 29(13), 1661-1683.

    Examples
    --------
    A quarter circle of radius 10 mm in the plane of x and z ends at (10, 0, 10):

    >>> section_transform(5.0 * np.pi, np.pi / 2, 0.0)[:3, 3].round(6) + 0.0
    array([10.,  0., 10.])
    """
    made = np.eye(4)
    made[:3, :3] = bend_rotation(phi, theta)
    made[:3, 3] = arc_points(length, phi, theta, np.array([1.0]))[0]
    return made


def bend_rotation(phi: float, theta: float) -> FloatArray:
    """Rotation by phi about the normal of the bending plane at theta, (3, 3)."""
    c, s, ct, st = math.cos(phi), math.sin(phi), math.cos(theta), math.sin(theta)
    mixed = ct * st * (c - 1.0)
    return np.array(
        [[ct * ct * c + st * st, mixed, ct * s], [mixed, st * st * c + ct * ct, st * s], [-ct * s, -st * s, c]],
    )


def arc_points(length: float, phi: float, theta: float, shares: FloatArray) -> FloatArray:
    """Places on a section's axis at shares of its length, in the frame of its base, (n, 3) mm."""
    made = np.empty((len(shares), 3))
    if phi < STRAIGHT:  # to this bend the series end with the terms that are left
        along, across = length * shares, 0.5 * length * phi * shares * shares
    else:
        angle, radius = phi * shares, length / phi
        along, across = radius * np.sin(angle), 2.0 * radius * np.sin(0.5 * angle) ** 2
    made[:, 0], made[:, 1], made[:, 2] = math.cos(theta) * across, math.sin(theta) * across, along
    return made


def bend_towards(point: ArrayLike, bend_max: float) -> tuple[float, float]:
    """Bend and plane that point a section's chord at a place: the inverse of `section_transform` for the end's position.

    The chord of a circular arc leaves its tangent by half the arc's angle, so phi is twice the angle between the base's axis
    and the place. The arc length is the section's own, so only the direction can be met; it is met exactly where phi stays
    below `bend_max`, else the bend is the largest one.

    Parameters
    ----------
    point : (3,) array_like, mm
        In the frame of the section's base.
    bend_max : float, rad

    Returns
    -------
    (phi, theta) : float, rad
    """
    x, y, z = np.asarray(point, dtype=float)
    across = float(np.hypot(x, y))
    if across == 0.0:
        return (0.0 if z >= 0.0 else bend_max), 0.0
    return min(2.0 * float(np.arctan2(across, z)), bend_max), float(np.arctan2(y, x))


def chain_transform(length: float, phi: float, theta: float, links: int) -> FloatArray:
    """Pose of the end of a section made of rigid links, (4, 4), mm: the text's eqs. 2 to 6.

    A rotary base of one link's length carries `links` links, ``L1 = n L2 + L3`` with ``L2 = L3``; each hinge
    bends by phi / n. The frames are turned back by theta at the end, as a section without twist asks.

    Parameters
    ----------
    length : float, mm
        Of the whole section, L1.
    phi, theta : float, rad
    links : int
        n.
    """
    piece = length / (links + 1)
    angle = phi / links * np.arange(links + 1)
    made = np.eye(4)
    made[:3, :3] = bend_rotation(phi, theta)
    across, along = piece * float(np.sin(angle).sum()), piece * float(np.cos(angle).sum())
    made[:3, 3] = [np.cos(theta) * across, np.sin(theta) * across, along]
    return made


def chain_deviation(length: float, phi: float, links: int) -> float:
    """Distance of the chain's tip from the constant-curvature tip, mm, in closed form (the text's figure 2).

    With h = phi / n and k = n + 1 equal pieces of length L / k, the sums of sines and cosines are
    ``sin(n h / 2) sin(k h / 2) / sin(h / 2)`` and ``cos(n h / 2) sin(k h / 2) / sin(h / 2)``: the chain's chord points
    along phi / 2 exactly as the arc's does, so both tips lie on one ray and differ by the lengths of their chords only,
    ``L | sin(k h / 2) / (k sin(h / 2)) - sin(phi / 2) / (phi / 2) |``.
    """
    if phi == 0.0:
        return 0.0
    half, count = 0.5 * phi / links, links + 1
    chain = np.sin(count * half) / (count * np.sin(half))
    return float(length * abs(chain - np.sin(0.5 * phi) / (0.5 * phi)))
