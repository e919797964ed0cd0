"""Random tubes and random splines in them: what bounds and verifier are tried on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from tubeplan_viz.bench.axes import Axis
from tubeplan_viz.bench.meshing import Radius, sweep
from tubeplan_viz.geometry import SplineCurve

LENGTHS, RADII = (18.0, 40.0), (1.2, 3.5)
# Arcs no sharper than this over at most 40 mm turn by 2.9 rad: their ends stay over 20 mm apart, and no tube meets itself.
SHARPEST = 1.0 / 14.0
# Of the radius: the wall of a real ureter or bronchus is not even.
BULGE = 0.25


@dataclass(frozen=True, eq=False, kw_only=True)
class RandomTube:
    """A tube of changing width around an axis of two to four helical pieces.

    Attributes
    ----------
    axis : Axis
    radius : callable
        Radius in mm at (n,) arc lengths.
    surface : Surface
        Two flat caps, C1 at the start and C2 at the end.
    """

    axis: Axis
    radius: Radius
    surface: Surface


def random_tube(rng: np.random.Generator) -> RandomTube:
    """A tube of 18 to 40 mm and 1.2 to 3.5 mm radius, its mesh even or with rings turned against each other."""
    count = int(rng.integers(2, 5))
    shares = rng.dirichlet(np.full(count, 4.0))
    length = float(rng.uniform(*LENGTHS))
    pieces = tuple(
        (float(share * length), float(rng.uniform(-SHARPEST, SHARPEST)), float(rng.uniform(-0.05, 0.05))) for share in shares
    )
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    frame *= np.sign(np.linalg.det(frame))
    axis = Axis(pieces, rng.uniform(-200.0, 200.0, 3), frame)
    middle, bulge, wave, phase = rng.uniform(*RADII), rng.uniform(0.0, BULGE), rng.uniform(8.0, 20.0), rng.uniform(0.0, 6.3)

    def radius(s: FloatArray) -> FloatArray:
        return np.asarray(middle * (1.0 + bulge * np.cos(2.0 * np.pi * np.asarray(s) / wave + phase)))

    twisted = bool(rng.random() < 0.7)
    surface = sweep(axis, radius, edge=float(rng.uniform(0.25, 0.5) * middle), twisted=twisted, rng=rng)
    return RandomTube(axis=axis, radius=radius, surface=surface)


def random_path(tube: RandomTube, rng: np.random.Generator, *, sway: float) -> SplineCurve:
    """A cubic from cap to cap whose control points lie up to `sway` radii beside the axis.

    Parameters
    ----------
    tube : RandomTube
    rng : numpy.random.Generator
    sway : float
        Share of the radius; above 1 the path may leave the lumen through the wall. The two control
        points at either end stay on the axis, so that it does not swing out through a cap.
    """
    length = tube.axis.length
    count = max(int(length / rng.uniform(2.5, 6.0)), 3) + 3
    inner = np.sort(rng.uniform(0.0, 1.0, count - 4)) if rng.random() < 0.3 else np.arange(1, count - 3) / (count - 3)
    knots = np.concatenate([np.zeros(4), inner, np.ones(4)])
    # Greville abscissae: control points there on a straight axis would give even speed.
    s = length * np.array([knots[k + 1 : k + 4].mean() for k in range(count)])
    points, frames = tube.axis.at(s)
    aside = sway * tube.radius(s) * np.sqrt(rng.random(count))
    aside[[0, 1, -2, -1]] = 0.0
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    return SplineCurve(
        3,
        knots,
        points + (aside * np.cos(angle))[:, None] * frames[:, :, 1] + (aside * np.sin(angle))[:, None] * frames[:, :, 2],
    )
