"""Verdicts on straight pushes and on turns at a node, with a count of how many collision evaluations they took."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from segmentation.arrays import BoolArray, FloatArray, IntArray
from tubeplan_viz.rigid.collision import collide, to_frame
from tubeplan_viz.rigid.instrument import Bodies, CoupledInstrument, posed, swept, unit, up_of
from tubeplan_viz.rigid.obstacles import Obstacles
from tubeplan_viz.rigid.verdicts import Verdicts, keys_of
from tubeplan_viz.rigid.witnesses import Witnesses

TURN_SLACK_MM = 0.4  # a turn that is not proved free with this much room is refused
TURN_PARTS = 4
TURN_ROUNDS = 2
TURN_LOOKS = (0.5, 0.25, 0.75)  # poses of a turn that are looked at before it is proved


@dataclass
class Judge:
    """Collision checks of one instrument among obstacles.

    Attributes
    ----------
    obstacles : Obstacles
    instrument : CoupledInstrument
    margin : float, mm
        Least distance asked for between the instrument and any obstacle.
    mouth : (m, 3) float array, LPS mm
        Points of the entry region: what is farther behind the tip than all of them is outside the head.
    exact : bool
        Decide by the exact test what the envelope refuses.
    tests : int
        Instruments put to a test of any kind so far: a push counts 1, a turn as many poses as it takes.
    evaluations : int
        Those of them that neither a verdict from before nor a witness decided.
    witnesses : Witnesses, optional
        What stopped instruments before; one that holds such a place is refused without an evaluation.
    verdicts : Verdicts, optional
        Of searches before among obstacles of which these are a part; what they decided is not asked again.
    """

    obstacles: Obstacles
    instrument: CoupledInstrument
    mouth: FloatArray
    margin: float = 0.0
    exact: bool = False
    tests: int = field(default=0)
    evaluations: int = field(default=0)
    witnesses: Witnesses | None = None
    verdicts: Verdicts | None = None

    def push(self, start: FloatArray, end: FloatArray, roll: FloatArray, *, anew: bool = False) -> tuple[IntArray, FloatArray]:
        """What the instrument meets while its tip goes from `start` to `end`, both (n, 3) LPS.

        With `anew` all are evaluated: what is told then is what each meets first here, not what is known to be in its way.

        Returns
        -------
        label : (n,) int array
            Index of the structure, -1 where the way is free.
        place : (n, 3) float array, LPS mm
            Of that structure; not a number where it is free.
        """
        bodies = swept(self.instrument, start, end, roll)
        return self._verdict(bodies.grown(self.margin) if self.margin else bodies, anew=anew)

    def _verdict(self, bodies: Bodies, *, anew: bool = False) -> tuple[IntArray, FloatArray]:
        """What instruments (two bodies each, LPS mm) meet: by verdicts from before, the witnesses, or an evaluation."""
        self.tests += len(bodies) // 2
        if self.verdicts is None:
            return self._witnessed(bodies, anew=anew)
        keys = keys_of(bodies)
        known, rows = self.verdicts.recall(keys)
        if anew:
            known, rows = np.zeros_like(known), rows[:0]
        label, place = np.full(len(keys), -1, dtype=np.int64), np.full((len(keys), 3), np.nan)
        label[known], place[known] = self.verdicts.label[rows], self.verdicts.place[rows]
        if self.witnesses is not None:
            self.witnesses.add(label[known], place[known])
        rest = np.flatnonzero(~known)
        if len(rest):
            label[rest], place[rest] = self._witnessed(bodies.take(both(rest)), anew=anew)
            self.verdicts.fresh.append((keys[rest], label[rest], place[rest]))
        return label, place

    def _witnessed(self, bodies: Bodies, *, anew: bool) -> tuple[IntArray, FloatArray]:
        if self.witnesses is None:
            return self._evaluated(bodies)
        n = len(bodies) // 2
        label, place = (np.full(n, -1, dtype=np.int64), np.full((n, 3), np.nan)) if anew else self.witnesses.stopping(bodies)
        rows = np.flatnonzero(label < 0)
        if len(rows):
            label[rows], place[rows] = self._evaluated(bodies.take(both(rows)))
            self.witnesses.add(label[rows], place[rows])
        return label, place

    def _evaluated(self, bodies: Bodies) -> tuple[IntArray, FloatArray]:
        self.evaluations += len(bodies) // 2
        bodies = to_frame(bodies, self.obstacles.frame)
        hits = collide(self.obstacles, bodies, exact=self.exact, pairs=True)
        label, place = hits.label.reshape(-1, 2), hits.place.reshape(-1, 2, 3)
        # The shaver's hit is told where both hit.
        second = (label[:, 0] < 0).astype(int)
        rows = np.arange(len(label))
        return label[rows, second], self.obstacles.frame.to_lps(place[rows, second])

    def turn(self, node: FloatArray, before: FloatArray, after: FloatArray, roll: FloatArray) -> BoolArray:
        """Whether the instrument, its tip resting on a node, can turn from one direction to another: (n,).

        The turn is cut into pieces, each seen from its middle: no point of the instrument moves farther from there than
        its distance from the tip times half the piece's angle. All middle poses, grown by that, must be free.
        """
        free = np.ones(len(node), dtype=bool)
        depth = self._depth(node)
        for share in TURN_LOOKS:
            rows = np.flatnonzero(free)
            free[rows] = self._pose_free(node, before, after, roll, rows, np.full(len(rows), share), np.zeros(len(rows)), depth)
        rows = np.flatnonzero(free)
        # Along the way the pose turns by little more than between its ends, since "above" changes with the direction.
        angle = self._angle(before[rows], after[rows], roll[rows])
        count = np.maximum(np.ceil(depth[rows] * 0.5 * angle / TURN_SLACK_MM).astype(int), 1)
        owner = np.repeat(rows, count)
        share = (np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / np.repeat(count, count)
        # Every so many poses first: a turn that is refused there needs no others.
        rank = np.concatenate([np.arange(n) for n in count]) if len(count) else count
        for turn in range(TURN_ROUNDS):
            some = np.flatnonzero((rank % TURN_ROUNDS == turn) & free[owner])
            slack = np.full(len(some), TURN_SLACK_MM)
            blocked = ~self._pose_free(node, before, after, roll, owner[some], share[some], slack, depth)
            free[owner[some[blocked]]] = False
        return free

    def _pose_free(
        self,
        node: FloatArray,
        before: FloatArray,
        after: FloatArray,
        roll: FloatArray,
        rows: IntArray,
        share: FloatArray,
        slack: FloatArray,
        depth: FloatArray,
    ) -> BoolArray:
        """Whether the poses of some turns at some share of the way, grown by some mm, are free: (len(rows),)."""
        direction = between(before[rows], after[rows], share)
        bodies = posed(self.instrument, node[rows], direction, roll[rows])
        near = bodies.cut(np.repeat(node[rows], 2, axis=0), np.repeat(depth[rows], 2))
        label, _ = self._verdict(near.grown(np.repeat(slack, 2) + self.margin))
        return np.asarray(label < 0)

    def _depth(self, node: FloatArray) -> FloatArray:
        """How far behind each node the instrument can meet an obstacle, (n,) mm."""
        low, high = self.mouth.min(axis=0), self.mouth.max(axis=0)
        far = np.maximum(np.abs(node - low), np.abs(node - high))
        return np.asarray(np.linalg.norm(far, axis=1) + self.instrument.reach)

    def _angle(self, before: FloatArray, after: FloatArray, roll: FloatArray) -> FloatArray:
        """Sum of the rotation's angles over `TURN_PARTS` parts of a turn and 1 % more, (n,) radian."""
        frames = []
        for part in range(TURN_PARTS + 1):
            direction = between(before, after, np.full(len(before), part / TURN_PARTS))
            up = up_of(direction, roll)
            frames.append(np.stack([direction, up, np.cross(direction, up)], axis=1))
        total = np.zeros(len(before))
        for one, other in pairwise(frames):
            trace = np.einsum("nij,nij->n", one, other)
            total += np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
        return np.asarray(1.01 * total)


def both(rows: IntArray) -> IntArray:
    """Rows of shaver and endoscope of some instruments."""
    return np.asarray(np.column_stack([2 * rows, 2 * rows + 1]).reshape(-1))


def between(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    """Directions on the shortest way between two, (n, 3)."""
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", before, after), -1.0, 1.0))
    sine = np.maximum(np.sin(angle), 1e-12)
    a = np.where(angle < 1e-9, 1.0 - share, np.sin((1.0 - share) * angle) / sine)
    b = np.where(angle < 1e-9, share, np.sin(share * angle) / sine)
    return unit(a[:, None] * before + b[:, None] * after)
