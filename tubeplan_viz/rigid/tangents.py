"""Tangent nodes: places beside a structure from which the instrument passes it (patent text, reverse tangent-point search)."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.rigid.instrument import unit
from tubeplan_viz.rigid.judge import Judge
from tubeplan_viz.rigid.search_state import SearchSettings

CELLS_SEEN = 3000  # of a structure, as seen from a node; more only cost time
CHUNK = 48


def tangent_nodes(judge: Judge, here: FloatArray, starts: FloatArray, label: IntArray, settings: SearchSettings) -> FloatArray:
    """Nodes beside the structures in the way, (n, planes, 3) LPS mm, those that turn least first; not a number for none.

    Parameters
    ----------
    here, starts : (n, 3) float array, LPS mm
        Where the search stands, and the start it wants to reach from there.
    label : (n,) int array
        The structure in between; -1 for none.
    """
    out = np.full((len(here), settings.planes, 3), np.nan)
    for k in np.unique(label[label >= 0]):
        cells = judge.obstacles.frame.to_lps(judge.obstacles.cells[judge.obstacles.rows[k]])
        cells = cells[:: max(1, len(cells) // CELLS_SEEN)]
        rows = np.flatnonzero(label == k)
        for part in np.array_split(rows, max(1, len(rows) // CHUNK)):
            out[part] = _tangents(judge, cells, here[part], starts[part], settings)
    return out


def _tangents(judge: Judge, cells: FloatArray, here: FloatArray, starts: FloatArray, settings: SearchSettings) -> FloatArray:
    """Tangent nodes of one structure for a few starts."""
    instrument = judge.instrument
    ahead = unit(starts - here)
    up = unit(np.array([0.0, 0.0, 1.0]) - ahead[:, 2:] * ahead)
    side = np.cross(ahead, up)
    phi = 2.0 * np.pi * np.arange(settings.planes) / settings.planes
    away = np.cos(phi)[None, :, None] * up[:, None] + np.sin(phi)[None, :, None] * side[:, None]  # (n, planes, 3)
    normal = np.cross(ahead[:, None], away)
    offset = cells[None] - here[:, None]  # (n, m, 3)
    forth = np.einsum("nmi,ni->nm", offset, ahead)
    length = np.linalg.norm(starts - here, axis=1)
    reach = np.linalg.norm(offset, axis=2)
    relevant = (forth > 1.0) & (forth < length[:, None])
    out = np.full((len(here), settings.planes, 3), np.nan)
    turned = np.full((len(here), settings.planes), np.inf)
    for p in range(settings.planes):
        sideways = np.einsum("nmi,ni->nm", offset, away[:, p])
        beside = np.abs(np.einsum("nmi,ni->nm", offset, normal[:, p])) < instrument.scope_radius
        # An obstacle below is passed by the shaver, one above by the endoscope.
        rise = -np.einsum("ni,ni->n", away[:, p], up)
        room = np.maximum(instrument.shaver_radius, rise * instrument.offset + instrument.scope_radius * (rise > 0.3))
        room = room + settings.tangent_gap + judge.margin
        angle = np.arctan2(sideways, forth)
        spread = np.arcsin(np.clip(room[:, None] / np.maximum(reach, room[:, None] + 1e-9), 0.0, 1.0))
        for i in range(len(here)):
            use = relevant[i] & beside[i]
            if not use.any():
                continue
            found = _first_free(angle[i, use], spread[i, use])
            if found is None:
                continue
            theta, which = found
            cell = np.flatnonzero(use)[which]
            tangent = np.cos(theta) * ahead[i] + np.sin(theta) * away[i, p]
            # Along the tangent as far as the tangent point: the node is d_t and the instrument's room away from it.
            node = here[i] + (offset[i, cell] @ tangent) * tangent
            out[i, p], turned[i, p] = node, theta
    order = np.argsort(turned, axis=1, kind="stable")
    return np.take_along_axis(out, order[:, :, None], axis=1)


def _first_free(angle: FloatArray, spread: FloatArray) -> tuple[float, int] | None:
    """The least angle from 0 up that lies outside all intervals `angle +- spread`, and which interval ends there.

    Examples
    --------
    >>> theta, which = _first_free(np.array([0.0, 0.15, 0.8]), np.array([0.1, 0.1, 0.1]))
    >>> round(theta, 5), which
    (0.25, 1)
    """
    low, high = angle - spread, angle + spread
    order = np.argsort(low)
    # Up to each interval the ones before it reach to the highest of their ends; the first that begins beyond leaves a gap.
    reach = np.maximum.accumulate(np.concatenate([[0.0], high[order]]))
    gap = np.flatnonzero(low[order] > reach[:-1])
    last = int(gap[0]) if len(gap) else len(order)
    theta = float(reach[last])
    if theta <= 0.0 or theta >= 0.5 * np.pi:
        return None
    return theta + 1e-6, int(order[np.argmax(high[order[:last]] >= theta)])
