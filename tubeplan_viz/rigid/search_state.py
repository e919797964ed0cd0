"""What a search may do, what it finds, and where it stands in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.judge import Judge


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """What the search may do.

    Attributes
    ----------
    roll_max : float, radian
        `beta` may be between -roll_max and roll_max; the text takes about 0.
    rolls : int
        How many values of it are tried, odd; 0 is tried first.
    planes : int
        Planes around the line from a node to a start in which tangents are looked for.
    nodes : int
        Most bends of a path.
    tangent_gap : float, mm
        `d_t`, on top of the room that the instrument itself needs beside the shaver's axis.
    neighbours : int
        Solved starts whose nodes, and places around them, are offered to a start that is not solved.
    waves : int
        How often they are offered at most.
    """

    roll_max: float = np.radians(15.0)
    rolls: int = 5
    planes: int = 8
    nodes: int = 2
    tangent_gap: float = 0.5
    neighbours: int = 8
    waves: int = 12

    def __post_init__(self) -> None:
        if not 0.0 <= self.roll_max <= np.pi / 2:
            raise CaseError(f"roll_max_deg is {np.degrees(self.roll_max):g}, expected 0 to 90")
        if self.rolls < 1 or self.rolls % 2 == 0:
            raise CaseError(f"rolls is {self.rolls}, expected an odd number")
        if not 0 <= self.nodes <= 4:
            raise CaseError(f"nodes is {self.nodes}, expected 0 to 4")
        if not 4 <= self.planes <= 64:
            raise CaseError(f"planes is {self.planes}, expected 4 to 64")

    @property
    def roll_values(self) -> FloatArray:
        """Rolls in the order in which they are tried: the smallest first."""
        values = np.linspace(-self.roll_max, self.roll_max, self.rolls) if self.rolls > 1 else np.zeros(1)
        return np.asarray(values[np.argsort(np.abs(values), kind="stable")])


@dataclass(frozen=True, eq=False)
class RigidPath:
    """Straight segments from a start to the goal, the instrument's roll the same on all.

    Attributes
    ----------
    nodes : (k, 3) float array, LPS mm
        Start, bends, goal.
    roll : float, radian
    start : int
        Index of the entry voxel.
    """

    nodes: FloatArray
    roll: float
    start: int

    @property
    def length(self) -> float:
        """Sum of the segments, mm."""
        return float(np.linalg.norm(np.diff(self.nodes, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What the search found for every start.

    Attributes
    ----------
    paths : tuple of RigidPath
        At least one for every feasible start.
    feasible : (n,) bool array
    blocked_by : (n,) int array
        Of the straight push without roll: index of the structure, -1 where that push is free.
    blocked_at : (n, 3) float array, LPS mm
        Where; not a number where it is free.
    refused : (n, structures) int array
        How many tries each structure refused, for every start.
    tests : int
        Poses and pushes put to a collision test of any kind.
    evaluations : int
        Those of them that neither a verdict from before nor a witness decided: cylinder envelope against the kd-tree.
    legs : int
        Directions found in which the instrument, its tip on the goal, is free.
    """

    paths: tuple[RigidPath, ...]
    feasible: BoolArray
    blocked_by: IntArray
    blocked_at: FloatArray
    refused: IntArray
    tests: int
    evaluations: int
    legs: int


@dataclass
class State:
    """Where a search stands: which starts have a path, and what refused the others.

    Attributes
    ----------
    starts : (n, 3) float array, LPS mm
    goal : (3,) float array, LPS mm
    judge : Judge
    paths : list of RigidPath
        At least one for every start that is solved.
    solved : (n,) bool array
    refused : (n, structures) int array
        Tries that each structure refused.
    """

    starts: FloatArray
    goal: FloatArray
    judge: Judge
    paths: list[RigidPath]
    solved: BoolArray
    refused: IntArray

    def note(self, rows: IntArray, labels: IntArray) -> None:
        """Count refusals of tries from some starts; label -1 is none."""
        hit = labels >= 0
        np.add.at(self.refused, (rows[hit], labels[hit]), 1)

    def solve(self, row: int, nodes: Sequence[FloatArray], roll: float) -> None:
        """Keep a path and tick its start off."""
        self.paths.append(RigidPath(np.array(nodes), float(roll), int(row)))
        self.solved[row] = True

    def join(
        self,
        rows: IntArray,
        first: FloatArray,
        second: FloatArray,
        rolls: FloatArray,
        after: Callable[[int], Sequence[FloatArray]],
    ) -> IntArray:
        """Join starts to free ways to the goal by the push to the first node and the turn there.

        Parameters
        ----------
        rows : (n,) int array
            Starts; one may stand several times, its first free join counts.
        first, second : (n, 3) float array, LPS mm
            First node of each way, and what comes after it.
        rolls : (n,) float array, radian
        after : callable
            All that follows the first node of one of the n ways.

        Returns
        -------
        (k,) int array
            Which of the n joins solved their start.
        """
        if not len(rows):
            return np.empty(0, dtype=np.int64)
        label, _ = self.judge.push(self.starts[rows], first, rolls)
        self.note(rows, label)
        live = np.flatnonzero(label < 0)
        ahead, further = unit(first[live] - self.starts[rows[live]]), unit(second[live] - first[live])
        free = self.judge.turn(first[live], ahead, further, rolls[live])
        served = []
        for j in live[free]:
            if not self.solved[rows[j]]:
                self.solve(int(rows[j]), (self.starts[rows[j]], first[j], *after(int(j))), rolls[j])
                served.append(j)
        return np.array(served, dtype=np.int64)
