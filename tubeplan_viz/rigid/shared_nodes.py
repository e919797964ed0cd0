"""Nodes that serve many starts: a free way from a node to the goal is found once and offered to all starts.

# Of the ways that lead from the goal out through the entry region there are few, and one of them serves many starts: so all
# places on a spread of lines from the goal are tried as nodes, and those that are free, with the nodes of the paths already
# known, are offered to every start that is not solved. What has stopped a neighbour mostly stops a start too and is asked
# first, see `witnesses`. The node that solved most starts is offered first, so that few offers are made in vain.
"""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray, IntArray


def lines_of_nodes(begin: FloatArray, goal: FloatArray, step: float, least: float) -> FloatArray:
    """Places every `step` mm on the lines from the goal to some points, none nearer to the goal than `least`: (m, 3) LPS mm."""
    way = begin - goal
    length = np.linalg.norm(way, axis=1)
    count = np.maximum(((length - least) / step).astype(int), 0)
    owner = np.repeat(np.arange(len(begin)), count)
    rank = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    return np.asarray(begin[owner] - ((rank + 1.0) * step / length[owner])[:, None] * way[owner])


def alternating(count: int) -> IntArray:
    """Numbers below `count`, each far from those before it: multiples of the golden section.

    Examples
    --------
    >>> alternating(5).tolist()
    [0, 2, 4, 1, 3]
    """
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    return np.asarray(np.argsort(np.argsort(np.argsort((np.arange(count) * golden) % 1.0))))
