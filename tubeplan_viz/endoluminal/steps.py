"""The walk in words: where the lumen forks or bends, and which way to turn there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.centerline import CenterlineTree
from tubeplan_viz.endoluminal.camera import Camera, path_cameras

BEND_DEG = 25.0  # a bend of less than this needs no word
WINDOW_MM = 10.0  # a bend is the angle between the directions so far before and after
APART_MM = 8.0  # two steps closer than this are told as one
FRAME_STEP_MM = 0.5
PATIENT = (("left", "right"), ("posterior", "anterior"), ("superior", "inferior"))  # +x, -x, ... in LPS


@dataclass(frozen=True, kw_only=True)
class WalkStep:
    """One thing to do on the way.

    Attributes
    ----------
    kind : {"junction", "bend"}
    arc_length : float, mm
        Where on the path.
    turn : float, rad
        Angle between the path's direction before and after.
    clock : int, hours
        Where in the picture the path goes on, 1 to 12, 12 at the top.
    roll : float, rad
        How the bending plane turns against the step before, seen along the way, clockwise positive, -pi to pi; for the
        first step against the picture's top.
    direction : (3,) float array
        Unit vector along which the path goes on.
    openings : tuple of int
        Clock positions of the other branches that leave here.
    """

    kind: str
    arc_length: float
    turn: float
    clock: int
    roll: float
    direction: FloatArray
    openings: tuple[int, ...]


def walk_steps(
    arc_length: FloatArray, points: FloatArray, tree: CenterlineTree | None = None, target: int = -1
) -> tuple[WalkStep, ...]:
    """Junctions and bends in order along a path.

    Parameters
    ----------
    arc_length : (n,) float array, mm
    points : (n, 3) float array, mm
    tree : CenterlineTree, optional
        Centerlines from the path's start to the lumen's ends and to the goal; without it no junction is told.
    target : int
        Number of the goal among the tree's targets.
    """
    length = float(arc_length[-1])
    if length < 2.0 * FRAME_STEP_MM:
        return ()
    even = np.linspace(0.0, length, int(length / FRAME_STEP_MM) + 1)
    line = np.column_stack([np.interp(even, arc_length, points[:, k]) for k in range(3)])
    cameras = path_cameras(line)
    found: list[tuple[float, str, float, list[FloatArray]]] = []
    for place, room, others in junctions(even, line, tree, target):
        found.append((place, "junction", room, others))
    for place in bends(even, line):
        if all(abs(place - other[0]) >= APART_MM for other in found):
            found.append((place, "bend", 0.0, []))
    steps: list[WalkStep] = []
    before = 0.0
    for place, kind, room, others in sorted(found, key=lambda item: item[0]):
        reach = max(room, 0.5 * WINDOW_MM)
        incoming, outgoing = (
            chord(even, line, place - 2.0 * reach, place - 0.4 * reach),
            chord(even, line, place + 0.4 * reach, place + 2.0 * reach),
        )
        camera = cameras[int(np.clip(np.searchsorted(even, place - reach), 0, len(cameras) - 1))]
        angle = picture_angle(camera, outgoing)
        turn = float(np.arccos(np.clip(incoming @ outgoing, -1.0, 1.0)))
        steps.append(
            WalkStep(
                kind=kind,
                arc_length=place,
                turn=turn,
                clock=clock(angle),
                roll=float((angle - before + np.pi) % (2.0 * np.pi) - np.pi),
                direction=outgoing,
                openings=tuple(clock(picture_angle(camera, other)) for other in others),
            )
        )
        before = angle
    return tuple(steps)


def junctions(
    even: FloatArray, line: FloatArray, tree: CenterlineTree | None, target: int
) -> list[tuple[float, float, list[FloatArray]]]:
    """Forks along the path: arc length, the lumen's radius there, and the directions of the branches that are not taken."""
    if tree is None or not len(tree.branches) or int(tree.last_branch[target]) < 0:
        return []
    route = [int(tree.last_branch[target])]
    while tree.branches[route[0]].parent >= 0:
        route.insert(0, tree.branches[route[0]].parent)
    found = []
    for number in route[:-1]:
        branch = tree.branches[number]
        place = branch.line.points[-1]
        room = float(branch.line.radii[-1])
        others = [
            unit(
                other.line.points[min(len(other.line.points) - 1, int(np.searchsorted(other.line.arc_length, 2.0 * room)))]
                - place
            )
            for k, other in enumerate(tree.branches)
            if other.parent == number and k not in route
        ]
        nearest = int(np.linalg.norm(line - place, axis=1).argmin())
        # A fork within a radius of the start is the start's own end of the lumen, which lies beside or behind it.
        if others and float(even[nearest]) > room:
            found.append((float(even[nearest]), room, others))
    return found


def bends(even: FloatArray, line: FloatArray) -> list[float]:
    """Arc lengths at which the path turns most, each turn `BEND_DEG` or more within the window around it."""
    reach = int(WINDOW_MM / (even[1] - even[0]))
    if len(even) < 2 * reach + 1:
        return []
    before = line[reach:-reach] - line[: -2 * reach]
    after = line[2 * reach :] - line[reach:-reach]
    cosine = np.einsum("ij,ij->i", before, after) / np.maximum(
        np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1), 1e-12
    )
    turn = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    chosen: list[float] = []
    for k in np.argsort(-turn):
        place = float(even[reach + k])
        if turn[k] < BEND_DEG:
            break
        if all(abs(place - other) >= 2.0 * APART_MM for other in chosen):
            chosen.append(place)
    return sorted(chosen)


def chord(even: FloatArray, line: FloatArray, begin: float, end: float) -> FloatArray:
    """Unit vector from one arc length to another, both kept on the path."""
    spots = np.clip([begin, end], 0.0, even[-1])
    if spots[1] - spots[0] < 1e-6:  # at an end of the path: its own direction there
        spots = np.clip([spots[0] - 1.0, spots[1] + 1.0], 0.0, even[-1])
    at = np.array([[np.interp(s, even, line[:, k]) for k in range(3)] for s in spots])
    return unit(at[1] - at[0])


def picture_angle(camera: Camera, direction: FloatArray) -> float:
    """Angle of a direction in the picture, rad, clockwise from the top."""
    return float(np.arctan2(direction @ camera.right, direction @ camera.up))


def clock(angle: float) -> int:
    """The nearest hour on a clock face for an angle clockwise from the top, rad: 1 to 12."""
    return round(angle / (2.0 * np.pi) * 12.0) % 12 or 12


def patient_words(direction: Sequence[float] | FloatArray) -> str:
    """A direction in the patient (LPS) in words, the strongest part first: ``right and inferior``."""
    vector = np.asarray(direction, dtype=float)
    order = np.argsort(-np.abs(vector))
    words = [PATIENT[k][0] if vector[k] > 0.0 else PATIENT[k][1] for k in order if abs(vector[k]) >= 0.4 * np.abs(vector).max()]
    return " and ".join(words[:2])


def unit(vector: FloatArray) -> FloatArray:
    """The vector with length 1."""
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12))
