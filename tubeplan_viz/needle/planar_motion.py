"""How a planar path moves when the lengths of its pieces change: ends, angle, length and clearance with exact derivatives.

# Strategy: the plane is the complex numbers, w = (z - i y) from the entry, so that a heading is e^(ih). A form's free lengths are
# those of all pieces but the last; the last closes on the target. Lengthening piece i moves what lies beyond it along the
# heading at its end and turns it with the piece's curvature; then the whole path turns about the entry, and the last piece
# changes, so that the tip stays on the target: two real equations for two unknowns. The nearest place of a piece to a body is a
# minimum along the piece, so the clearance changes with the motion of that place alone.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.needle.planar_bodies import ComplexArray, FlatScene, Nearest, Piece, side_by_side
from tubeplan_viz.needle.planar_shapes import PlanarProblem


@dataclass(frozen=True, eq=False)
class Posed:
    """Paths of one form that close on the target; k paths of n pieces.

    Attributes
    ----------
    ends : n + 1 arrays (k,), complex mm
        From the entry to the target.
    headings : n + 1 arrays (k,), complex
        At the ends.
    lengths : (k, n) array, mm
        That of the last piece may break its limits, even be negative.
    angle : (k,) array, radian
        Insertion angle.
    curvatures : (k, n) array, 1/mm
        Signed: above 0 to the left of the heading.
    turning, lengthening : (k, n - 1) arrays, radian/mm and no unit
        What the insertion angle and the last length change by per mm of each free length.
    grazing : (k,) array
        Cosine between the heading at the target and the direction from the entry; the derivatives have no bound at 0.
    room : (k,) array, mm
        By how much the last piece can reach the target; the path does not exist, and its numbers mean nothing, below 0.
    speeds : (k, n - 1) array
        How fast the end of the free pieces moves before the path is turned, mm per mm of each free length.
    """

    ends: tuple[ComplexArray, ...]
    headings: tuple[ComplexArray, ...]
    lengths: FloatArray
    angle: FloatArray
    curvatures: FloatArray
    turning: FloatArray
    lengthening: FloatArray
    grazing: FloatArray
    room: FloatArray
    speeds: FloatArray

    def piece(self, k: int) -> Piece:
        """Piece k of all paths."""
        return Piece(self.ends[k], self.headings[k], self.ends[k + 1], self.lengths[:, k], self.curvatures[:, k])

    def take(self, chosen: IntArray) -> Posed:
        """Some of the paths."""
        rest = (getattr(self, part.name)[chosen] for part in fields(self)[2:])
        return Posed(tuple(w[chosen] for w in self.ends), tuple(h[chosen] for h in self.headings), *rest)


def posed(problem: PlanarProblem, free: FloatArray, sides: FloatArray, root: FloatArray) -> Posed:
    """Paths with given free lengths, closed on the target.

    Parameters
    ----------
    problem : PlanarProblem
    free : (k, n - 1) array, mm
    sides : (k, n) array of 0, 1, -1
        A column is all 0 or has no 0: one form.
    root : (k,) array of 1, -1
        Which of the two last pieces that reach the target.
    """
    r, reach = problem.settings.radius, problem.distance
    count, last = free.shape
    ends, headings = [np.zeros(count, complex)], [np.ones(count, complex)]
    for k in range(last):
        w, h = advanced(ends[k], headings[k], free[:, k], sides[:, k], r)
        ends.append(w)
        headings.append(h)
    w, h, side = ends[-1], headings[-1], sides[:, last]
    speeds = np.empty((count, last))
    for i in range(last):
        speeds[:, i] = np.abs(headings[i + 1] + 1j * (sides[:, i] / r) * (w - ends[i + 1]))
    with np.errstate(invalid="ignore"):
        if last_is_line(sides):
            ahead = (w * h.conj()).real
            room = reach - np.abs((w * h.conj()).imag)
            final = -ahead + root * np.sqrt(np.maximum(ahead**2 + reach**2 - np.abs(w) ** 2, 0.0))
        else:
            center = w + 1j * side * r * h
            far = np.abs(center)
            room = np.minimum(reach + r - far, far - abs(reach - r))
            opening = np.arccos(np.clip((reach**2 - far**2 - r**2) / (2.0 * r * np.maximum(far, 1e-300)), -1.0, 1.0))
            begin = np.angle(-1j * side * h)
            final = r * np.mod(side * (np.angle(center) + root * opening - begin), 2.0 * np.pi)
            # Just short of a whole turn is just below no length at all: so it is continuous where a piece vanishes.
            final = np.where(final > 1.5 * np.pi * r, final - 2.0 * np.pi * r, final)
    tip, heading = advanced(w, h, final, side, r)
    turn = np.where(np.abs(tip) > 0.0, tip, 1.0)
    turn = np.exp(1j * problem.bearing) * turn.conj() / np.abs(turn)
    ends, headings = [w * turn for w in (*ends, tip)], [h * turn for h in (*headings, heading)]
    angle = np.angle(turn)
    toward = np.exp(1j * problem.bearing)
    grazing = (headings[-1] * toward.conjugate()).real
    slope = (headings[-1] * toward.conjugate()).imag
    curvatures = sides / r
    turning, lengthening = np.empty((2, count, last))
    safe = np.where(np.abs(grazing) < 1e-9, 1e-9, grazing)
    for i in range(last):
        moved = (headings[i + 1] + 1j * curvatures[:, i] * (reach * toward - ends[i + 1])) * toward.conjugate()
        lengthening[:, i] = -moved.real / safe
        turning[:, i] = -(moved.imag + lengthening[:, i] * slope) / reach
    return Posed(
        tuple(ends),
        tuple(headings),
        np.column_stack([free, final]),
        angle,
        curvatures,
        turning,
        lengthening,
        grazing,
        room,
        speeds,
    )


def last_is_line(sides: FloatArray) -> bool:
    """Whether the paths end with a line."""
    return not sides[:, -1].any()


def advanced(
    w: ComplexArray, h: ComplexArray, length: FloatArray, side: FloatArray, r: float
) -> tuple[ComplexArray, ComplexArray]:
    """Place and heading after one more piece."""
    if not side.any():
        return w + length * h, h
    turned = h * np.exp(1j * side * length / r)
    return w - 1j * side * r * (turned - h), turned


def contacts(scene: FlatScene, paths: Posed) -> Nearest:
    """Where all pieces come nearest to all bodies: (k, n m), piece by piece."""
    return side_by_side([scene.nearest(paths.piece(k)) for k in range(len(paths.ends) - 1)])


def motions(paths: Posed, near: Nearest, pieces: IntArray) -> ComplexArray:
    """How places of paths move, mm per mm of each free length.

    Parameters
    ----------
    paths : Posed
        k paths.
    near : Nearest
        j places of each.
    pieces : (k, j) int array
        On which piece each of them lies.

    Returns
    -------
    (k, j, n - 1) complex array
    """
    made = np.empty((*near.place.shape, paths.lengthening.shape[1]), dtype=complex)
    for i in range(made.shape[2]):
        # What lies beyond piece i goes along its last heading and turns about its end; all turns about the entry.
        heading, end, bend = paths.headings[i + 1][:, None], paths.ends[i + 1][:, None], paths.curvatures[:, i, None]
        shift = np.where(
            pieces > i, heading + 1j * bend * (near.place - end), np.where((pieces == i) & near.at_end, heading, 0.0)
        )
        made[..., i] = shift + 1j * paths.turning[:, i, None] * near.place
    made[(pieces == paths.lengths.shape[1] - 1) & near.at_end] = 0.0  # the target
    return made


def along(motion: ComplexArray, normal: ComplexArray) -> FloatArray:
    """Share of motions, (k, j, i), along unit normals, (k, j): (k, j, i)."""
    return np.asarray(motion.real * normal.real[..., None] + motion.imag * normal.imag[..., None])
