"""Kinematics of a bevel-tip needle: the unicycle model, its pieces in closed form, and its duty cycle.

A needle pushed into tissue runs along a circle of fixed curvature kappa; spinning it turns the
bevel and so the plane of the circle. The body twist per mm pushed is xi = (0, 0, 1, kappa, 0, u)
with u the spin in radian per mm [1]_: the tip moves along its z axis and turns about its x axis, so the
path bends towards -y of the body. Spinning a part of the time lowers the mean curvature; spinning all
the time makes a straight line.

All functions are vectorised: leading axes `...` are paths of a population.

References
----------
.. [1] Webster, R. J. et al. (2006). Nonholonomic modeling of needle steering. International Journal
   of Robotics Research, 25(5-6), 509-525. Zhao, Y. et al. (2013), China Mechanical Engineering 24(1),
   eq. 1-14; Huo, B. et al. (2015), Robot 37(4), eq. 3-10.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the tip is and how it is turned.

    Attributes
    ----------
    position : (3,) float array, mm
    frame : (3, 3) float array
        Columns are the body's x, y and z axis; z is the tangent, the path bends towards -y.
    """

    position: FloatArray
    frame: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen_array(self.position, (3,), "position"))
        frame = frozen_array(self.frame, (3, 3), "frame")
        if np.abs(frame.T @ frame - np.eye(3)).max() > 1e-9 or np.linalg.det(frame) < 0:
            raise CaseError("the frame of a needle's pose is no rotation; expected three unit axes at right angles, right-handed")
        object.__setattr__(self, "frame", frame)

    @property
    def tangent(self) -> FloatArray:
        """Unit vector in which the tip points, (3,)."""
        return self.frame[:, 2]


@dataclass(frozen=True, eq=False)
class Controls:
    """A path as pieces: turn the bevel, then push.

    Attributes
    ----------
    turns : (n,) float array, radian
        Turn of the bevel before each piece.
    lengths : (n,) float array, mm
    curvatures : (n,) float array, 1/mm
        From 0 (spinning all the time) to kappa (not spinning).
    """

    turns: FloatArray
    lengths: FloatArray
    curvatures: FloatArray

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.lengths))
        for name in ("turns", "lengths", "curvatures"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (count,), name))
        if (self.lengths < 0).any() or (self.curvatures < 0).any():
            raise CaseError("a needle's piece has a negative length or curvature; expected 0 or more, turn the bevel instead")

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def length(self) -> float:
        """Length of the whole path, mm."""
        return float(self.lengths.sum())

    def after(self, pushed: float) -> Controls:
        """What is left when `pushed` mm of the path are done: the piece under way goes on without a turn."""
        ends = np.cumsum(self.lengths)
        first = int(np.searchsorted(ends, pushed, side="right"))
        lengths, turns = self.lengths[first:].copy(), self.turns[first:].copy()
        if len(lengths):
            done = pushed - (ends[first] - self.lengths[first])
            lengths[0] -= done
            turns[0] = turns[0] if done <= 0.0 else 0.0
        return Controls(turns, lengths, self.curvatures[first:])


@dataclass(frozen=True, eq=False)
class Arcs:
    """Pieces of paths of a population, each a circular arc or a line, after its turn.

    Attributes
    ----------
    starts : (..., n, 3) array, mm
    tangents, normals : (..., n, 3) arrays
        Unit vectors at the start of each piece; the normal points to the centre of the circle.
    lengths, curvatures : (..., n) arrays, mm and 1/mm
    ends, end_tangents, end_normals : (..., n, 3) arrays
        The same at the end of each piece.
    """

    starts: FloatArray
    tangents: FloatArray
    normals: FloatArray
    lengths: FloatArray
    curvatures: FloatArray
    ends: FloatArray
    end_tangents: FloatArray
    end_normals: FloatArray

    @property
    def tips(self) -> FloatArray:
        """Tip of each path, mm, (..., 3)."""
        return self.ends[..., -1, :]

    def points(self, places: FloatArray) -> FloatArray:
        """Points at `places` mm, (..., n, k), along each piece: (..., n, k, 3)."""
        forward, aside = chord(places, self.curvatures[..., None])
        return np.asarray(
            self.starts[..., None, :]
            + forward[..., None] * self.tangents[..., None, :]
            + aside[..., None] * self.normals[..., None, :]
        )

    def end_pose(self) -> Pose:
        """Pose at the end of a single path (no leading axis)."""
        return Pose(self.ends[-1], frame_of(self.end_tangents[-1], self.end_normals[-1]))


def chord(length: ArrayLike, curvature: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """How far an arc goes along its first tangent and towards its centre, mm; exact for curvature 0 too."""
    push = np.asarray(length, dtype=float)
    half = 0.5 * push * np.asarray(curvature, dtype=float)
    sinc = np.sinc(half / np.pi)
    return push * sinc * np.cos(half), push * sinc * np.sin(half)


def cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Cross products of (..., 3) vectors; numpy's own takes five times as long on the short arrays of one path."""
    a, b, c = first[..., 0], first[..., 1], first[..., 2]
    x, y, z = second[..., 0], second[..., 1], second[..., 2]
    made = np.empty(np.broadcast_shapes(first.shape, second.shape))
    made[..., 0], made[..., 1], made[..., 2] = b * z - c * y, c * x - a * z, a * y - b * x
    return made


def frame_of(tangent: FloatArray, normal: FloatArray) -> FloatArray:
    """Rotation with z along the tangent and -y along the normal, (3, 3), made exactly orthogonal."""
    z = tangent / np.linalg.norm(tangent)
    y = -(normal - (normal @ z) * z)
    y /= np.linalg.norm(y)
    return np.column_stack([cross(y, z), y, z])


def bend(pose: Pose, turns: FloatArray, lengths: FloatArray, curvatures: FloatArray) -> Arcs:
    """All pieces of many paths that leave one pose.

    Parameters
    ----------
    pose : Pose
    turns, lengths, curvatures : (..., n) arrays
        Radian, mm, 1/mm.

    Returns
    -------
    Arcs
        With the same leading axes.
    """
    return bend_from(pose.position, pose.tangent, -pose.frame[:, 1], turns, lengths, curvatures)


def bend_from(
    position: FloatArray, tangent: FloatArray, normal: FloatArray, turns: FloatArray, lengths: FloatArray, curvatures: FloatArray
) -> Arcs:
    """As `bend`, from poses given as (..., 3) position, tangent and normal of each path."""
    shape = (*np.shape(lengths), 3)
    curved = np.broadcast_to(curvatures, shape[:-1])
    forward, aside = (v[..., None] for v in chord(lengths, curved))
    angle = lengths * curved
    cos_turn, sin_turn, cos_angle, sin_angle = (
        v[..., None] for v in (np.cos(turns), np.sin(turns), np.cos(angle), np.sin(angle))
    )
    starts, tangents, normals, ends, end_tangents, end_normals = np.empty((6, *shape))
    p, t, n = position, tangent, normal
    side = cross(t, n)
    for k in range(shape[-2]):
        c, s = cos_turn[..., k, :], sin_turn[..., k, :]
        n, side = c * n + s * side, c * side - s * n
        starts[..., k, :], tangents[..., k, :], normals[..., k, :] = p, t, n
        p = p + forward[..., k, :] * t + aside[..., k, :] * n
        c, s = cos_angle[..., k, :], sin_angle[..., k, :]
        t, n = c * t + s * n, c * n - s * t
        ends[..., k, :], end_tangents[..., k, :], end_normals[..., k, :] = p, t, n
    return Arcs(starts, tangents, normals, np.asarray(lengths, float), curved, ends, end_tangents, end_normals)


def push(pose: Pose, controls: Controls) -> Arcs:
    """The pieces of one path, (n, 3) each."""
    return bend(pose, controls.turns, controls.lengths, controls.curvatures)


def poses_along(pose: Pose, controls: Controls, ratios: FloatArray) -> FloatArray:
    """Poses after each piece of one path, for several ratios of the true curvature to that of the controls.

    Parameters
    ----------
    pose : Pose
    controls : Controls
        n pieces.
    ratios : (k,) array

    Returns
    -------
    (n, k, 4, 4) float array
        Position in the last column, mm; the product of the pieces' motions.
    """
    forward, aside = chord(controls.lengths[:, None], controls.curvatures[:, None] * ratios)
    angle = controls.lengths[:, None] * controls.curvatures[:, None] * ratios
    c, s = np.cos(angle), np.sin(angle)
    turn_c, turn_s = np.cos(controls.turns)[:, None], np.sin(controls.turns)[:, None]
    moves = np.zeros((*angle.shape, 4, 4))
    moves[..., 0, 0], moves[..., 1, 0], moves[..., 3, 3] = turn_c, turn_s, 1.0
    # The turn about z, then the bend about x.
    moves[..., 0, 1], moves[..., 0, 2], moves[..., 0, 3] = -turn_s * c, turn_s * s, turn_s * aside
    moves[..., 1, 1], moves[..., 1, 2], moves[..., 1, 3] = turn_c * c, -turn_c * s, -turn_c * aside
    moves[..., 2, 1], moves[..., 2, 2], moves[..., 2, 3] = s, c, forward
    first = np.eye(4)
    first[:3, :3], first[:3, 3] = pose.frame, pose.position
    moves[0] = first @ moves[0]
    return np.array(list(accumulate(moves, np.matmul)))


def joined(parts: list[Controls]) -> Controls:
    """Controls one after the other as one."""
    if not parts:
        return Controls(np.empty(0), np.empty(0), np.empty(0))
    return Controls(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("turns", "lengths", "curvatures")))


def twist(curvature: float, spin: float) -> FloatArray:
    """Body twist per mm pushed as a 4 x 4 matrix of se(3): curvature and spin in radian per mm (Zhao 2013, eq. 5)."""
    return np.array([[0.0, -spin, 0.0, 0.0], [spin, 0.0, -curvature, 0.0], [0.0, curvature, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]])


def helix(pose: Pose, length: float, curvature: float, spin: float) -> Pose:
    """Pose after pushing `length` mm while spinning `spin` radian per mm, in closed form.

    The motion is a screw about a fixed axis (Zhao 2013, eq. 10-11); spin 0 gives an arc,
    curvature 0 a line.
    """
    axis = np.array([curvature, 0.0, spin])
    rate = float(np.linalg.norm(axis))
    forward = np.array([0.0, 0.0, 1.0])
    if rate == 0.0:
        return Pose(pose.position + length * pose.tangent, pose.frame)
    unit = axis / rate
    cross = np.array([[0.0, -unit[2], unit[1]], [unit[2], 0.0, -unit[0]], [-unit[1], unit[0], 0.0]])
    angle = rate * length
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
    # Integral of the rotation over the push: the part along the axis is straight, the rest goes round.
    along, aside = chord(length, rate)
    moved = along * forward + aside * (cross @ forward) + (length - along) * unit * (unit @ forward)
    return Pose(pose.position + pose.frame @ moved, pose.frame @ rotation)


def duty_cycle(curvature: float, kappa: float) -> float:
    """Share of the push during which the needle spins so that the mean curvature is `curvature`: 1 - curvature / kappa.

    Holds for many short cycles, each with whole revolutions (Minhas et al. 2007).

    Raises
    ------
    CaseError
        If the curvature is not between 0 and kappa.
    """
    if not 0.0 <= curvature <= kappa:
        raise CaseError(f"a curvature of {curvature:g} 1/mm is asked of a needle that bends with 0 to {kappa:g} 1/mm")
    return 1.0 - curvature / kappa


def cycled(pose: Pose, controls: Controls, kappa: float, *, cycle: float) -> Pose:
    """Pose after pieces whose curvature is held by spinning a part of the time, revolution by revolution.

    Every cycle of a push spins once by a whole turn over its share `duty_cycle`, then goes on without a spin. For short
    cycles this ends where arcs of the mean curvature do; how far from there tells whether `cycle` is short enough.

    Parameters
    ----------
    pose : Pose
    controls : Controls
        n pieces, curvatures from 0 to kappa.
    kappa : float, 1/mm
        Curvature of the needle that does not spin.
    cycle : float, mm
        Push of one cycle, at most; a piece holds a whole number of them.
    """
    for turn, length, curvature in zip(controls.turns, controls.lengths, controls.curvatures, strict=True):
        c, s = np.cos(turn), np.sin(turn)
        pose = Pose(pose.position, pose.frame @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
        spinning = duty_cycle(float(curvature), kappa)
        count = max(int(np.ceil(length / cycle)), 1)
        spun = spinning * length / count
        for _ in range(count if length > 0.0 else 0):
            if spun > 0.0:
                pose = helix(pose, spun, kappa, 2.0 * np.pi / spun)
            pose = helix(pose, length / count - spun, kappa, 0.0)
    return pose


def insertion_pose(entry: ArrayLike, direction: ArrayLike) -> Pose:
    """A pose at `entry` that points along `direction`; its bevel bends the path towards -y (or +z along y).

    The entry frame along +z is the identity, as printed.
    """
    z = np.asarray(direction, dtype=float)
    size = float(np.linalg.norm(z))
    if size < 1e-9:
        raise CaseError("the needle's direction is (0, 0, 0), expected a vector that points into the body")
    z = z / size
    guide = np.array([0.0, 1.0, 0.0]) if abs(z[1]) < 0.999 else np.array([0.0, 0.0, -1.0])
    return Pose(np.asarray(entry, dtype=float), frame_of(z, -guide))


def planar_pose(entry: ArrayLike, angle: float) -> Pose:
    """A pose in the plane x = 0: `entry` (y, z), turned about x by the insertion angle, radian (Zhao 2013, eq. 7)."""
    y, z = np.asarray(entry, dtype=float)
    c, s = np.cos(angle), np.sin(angle)
    return Pose(np.array([0.0, y, z]), np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]))
