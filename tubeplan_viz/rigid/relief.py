"""Where there is no way: what stands against the instrument at the lesion, and which changes would open one.

# Strategy: the last segment of any path lies along a direction in which the instrument, its tip on the lesion, is free. Where
# none is, no number of bends helps, and the directions say what is against each. The same question is put again with one
# thing changed at a time: thinner instruments, the endoscope closer to the shaver or rolled to its side, tissue that a surgeon
# may remove; then with changes together. Brain and orbits are never set aside. That a last segment is free is necessary for a
# path, not sufficient: how many starts have a straight push is told beside it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.rigid.free_directions import direction_grid, free_directions
from tubeplan_viz.rigid.instrument import CoupledInstrument
from tubeplan_viz.rigid.planner import Problem
from tubeplan_viz.rigid.witnesses import Witnesses

ROLLS_WIDE = np.radians([0.0, -30.0, 30.0, -60.0, 60.0, -90.0, 90.0])
SPARSE = 4  # of so many starts one is looked at where no direction is free
CLOSEST_MM = 0.3  # between the shafts of endoscope and shaver


@dataclass(frozen=True, eq=False, kw_only=True)
class Relief:
    """One change, and what it opens.

    Attributes
    ----------
    change : str
        In words; empty for the case as it is.
    directions : int
        Directions at the lesion, through the entry region, and rolls that were tried on the coarse grid.
    free : int
        Those found on it and on the finer ones in which the instrument is free.
    starts : int
        Entry voxels with a free straight push.
    against : mapping of structure to int
        Directions of the coarse grid that it blocks without roll.
    """

    change: str
    directions: int
    free: int
    starts: int
    against: dict[str, int]


def reliefs(problem: Problem, rolls: FloatArray, thinnest: CoupledInstrument) -> Iterator[Relief]:
    """The case as it is, then single changes, then changes together.

    Parameters
    ----------
    problem : Problem
        Without a path.
    rolls : (k,) float array, radian
        Those of the search, the smallest first.
    thinnest : CoupledInstrument
        The thinnest endoscope and shaver at hand, with the offset of the problem's instrument.
    """
    own = problem.instrument
    closest = thinnest.scope_radius + thinnest.shaver_radius + CLOSEST_MM
    close = own.scope_radius + own.shaver_radius + CLOSEST_MM
    removable = [name for name in problem.obstacles.names if name in (f"turbinate_{problem.side}", "septum")]
    rolls = rolls[[0, -2, -1]] if len(rolls) > 2 else rolls
    # What stops one instrument is in the way of others too, for as long as nothing is taken away.
    seen = Witnesses()
    yield _tried(problem, rolls, "", seen)
    thin = f"the thinnest instruments ({thinnest.scope_diameter:g} and {thinnest.shaver_diameter:g} mm)"
    thinner = (thinnest.scope_diameter, thinnest.shaver_diameter) != (own.scope_diameter, own.shaver_diameter)
    if thinner:
        yield _tried(replace(problem, instrument=thinnest), rolls, thin, seen)
    if close < own.offset:
        nearer = f"the endoscope {close:.1f} mm above the shaver"
        yield _tried(replace(problem, instrument=replace(own, offset=close)), rolls, nearer, seen)
    yield _tried(problem, ROLLS_WIDE, "the endoscope rolled to the side, up to 90 degrees", seen)
    for name in removable:
        yield _tried(_without(problem, [name]), rolls, _told(name), Witnesses())
    slim = replace(thinnest, offset=min(closest, own.offset))
    together = f"the thinnest instruments {slim.offset:.1f} mm apart, rolled by up to 90 degrees"
    yield _tried(replace(problem, instrument=slim), ROLLS_WIDE, together, seen)
    if removable:
        cleared = replace(_without(problem, removable), instrument=slim)
        told = " and ".join(_told(name) for name in removable)
        yield _tried(cleared, ROLLS_WIDE, f"{together}, {told}", Witnesses())


def _told(name: str) -> str:
    """Words for a structure that is set aside."""
    return "the septum's part in the way removed" if name == "septum" else "the inferior turbinate set aside"


def _without(problem: Problem, names: list[str]) -> Problem:
    """The problem with some structures left out."""
    return replace(problem, obstacles=problem.obstacles.without(names))


def _tried(problem: Problem, rolls: FloatArray, change: str, witnesses: Witnesses) -> Relief:
    """Directions and straight pushes of one problem; `witnesses` are of its obstacles, whatever the instrument."""
    judge = replace(problem.judge(), witnesses=witnesses)
    names, starts, goal = problem.obstacles.names, problem.starts, problem.goal
    grid, reach = direction_grid(starts, goal)
    ends = np.broadcast_to(goal, grid.shape)
    label, _ = judge.push(goal + reach * grid, ends, np.full(len(grid), rolls[0]), anew=True)
    straight, free = np.zeros(len(starts), dtype=bool), 0
    for roll in rolls:
        # Straight pushes lie along free directions: where the grid shows none, a share of the starts is looked at.
        fan = free_directions(judge, starts, goal, float(roll), known=np.empty((0, 3)))
        rows = np.arange(0, len(starts), 1 if len(fan) else SPARSE)
        rows = rows[~straight[rows]]
        found, _ = judge.push(starts[rows], np.broadcast_to(goal, (len(rows), 3)), np.full(len(rows), roll))
        straight[rows] |= found < 0
        free += len(fan)
    against = {name: int((label == k).sum()) for k, name in enumerate(names) if (label == k).any()}
    return Relief(change=change, directions=len(grid) * len(rolls), free=free, starts=int(straight.sum()), against=against)
