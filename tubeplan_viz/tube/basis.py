"""The four B-splines that live at each parameter of a clamped cubic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from segmentation.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Basis:
    """Values and derivatives of the four B-splines that live at each parameter.

    Attributes
    ----------
    first : (k,) int array
        Index of the first of the four control points.
    values : (3, k, 4) float array
        Of the function, its first and its second derivative.
    """

    first: IntArray
    values: FloatArray

    @classmethod
    def at(cls, knots: FloatArray, u: FloatArray) -> Basis:
        """The basis of clamped cubic `knots` at parameters `u`, (k,)."""
        n = len(knots) - 4
        first = np.clip(np.searchsorted(knots, u, side="right") - 4, 0, n - 4).astype(np.int64)
        spline = BSpline(knots, np.eye(n), 3)
        columns = first[:, None] + np.arange(4)
        values = [np.take_along_axis(np.asarray(spline(u, nu=order)), columns, axis=1) for order in range(3)]
        return cls(first, np.stack(values))

    def curve(self, control: FloatArray, order: int = 0) -> FloatArray:
        """Points or derivatives of the spline with these control points, (k, 3)."""
        return np.asarray(np.einsum("kj,kja->ka", self.values[order], control[self.first[:, None] + np.arange(4)]))
