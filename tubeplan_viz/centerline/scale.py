"""Curvature of a measured line at a stated scale, with an interval: not that of its noise."""

# Strategy: an arc of a circle is fitted to windows of many lengths at all places. The noise is
# read off the residuals of windows of a middling length, its correlation included. A window holds when
# its residuals are noise and when both of its halves find the same curvature as the whole. Every place takes
# the longest window around it that holds, wherever in the window it lies, and is given the
# curvature of that window with the standard error of the fit: long windows on long bends and on straight
# parts, short ones where the line turns from one bend to the next.

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike
from scipy.special import gammaincinv

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import GeometryError
from tubeplan_viz.centerline.trace import even_points, polyline_length

GROWTH = 1.25
# A window spans at most this half chord over the radius: past it the arc nears a half circle, and is known well enough.
STEEPEST = 0.93
GAUSS_NEWTON_STEPS = 5
# Share of the windows whose residuals are held for noise alone, however often bends change.
BETTER = 0.4
# By how much windows longer than the first may correct the noise upwards.
MOST_NOISE = 1.3
# Below this a line is taken for exact; its points are at best chords of a smooth curve, mm.
LEAST_NOISE = 2e-3


@dataclass(frozen=True, kw_only=True)
class ScaleSettings:
    """At which scales curvature is looked for.

    Attributes
    ----------
    spacing : float, mm
        Between the points that are fitted.
    least : float, mm
        Shortest window; bends shorter than it are not resolved.
    noise_window : float, mm
        Window whose residuals tell the noise: short against the bends of lumens (Dai 2024: 8 mm and
        more), long against the noise of a segmentation (a voxel).
    deviation : float
        Standard errors that make up the interval on either side. One window's interval would hold 95 %
        with 1.96; the rest is for choosing the sharpest of many places (measured on arcs, helices
        and double bends with noise of 0.03 to 0.1 mm).
    agreement : float
        Standard errors by which the halves of a window may differ from the whole.
    """

    spacing: float = 1.0
    least: float = 5.0
    noise_window: float = 9.0
    deviation: float = 3.0
    agreement: float = 1.5

    def __post_init__(self) -> None:
        if not 0.0 < 5.0 * self.spacing <= self.least <= self.noise_window:
            raise GeometryError(
                f"a spacing of {self.spacing:g} mm, a least window of {self.least:g} mm and a noise window of "
                f"{self.noise_window:g} mm do not go together; expected five spacings <= least window <= noise window"
            )


@dataclass(frozen=True, eq=False, kw_only=True)
class ScaledCurvature:
    """Curvature along a line with its scale and interval.

    Attributes
    ----------
    arc_length : (n,) float array, mm
    curvature, low, high : (n,) float arrays, 1/mm
        The estimate and the ends of its interval; `low` is never negative.
    scale : (n,) float array, mm
        Length of the window that the estimate comes from.
    noise : float, mm
        Standard deviation of one coordinate of the line about its arcs.
    """

    arc_length: FloatArray
    curvature: FloatArray
    low: FloatArray
    high: FloatArray
    scale: FloatArray
    noise: float

    def __post_init__(self) -> None:
        for name in ("arc_length", "curvature", "low", "high", "scale"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (len(self.arc_length),), name))

    @property
    def sharpest(self) -> int:
        """Index of the place of the greatest curvature that the noise allows to assert: where `low` is greatest."""
        return int(np.argmax(self.low))

    @property
    def least_radius(self) -> float:
        """Bend radius at the sharpest place, mm; infinite on a line that is exactly straight."""
        return reciprocal(float(self.curvature[self.sharpest]))

    @property
    def least_radius_interval(self) -> tuple[float, float]:
        """Interval of the bend radius at the sharpest place, mm."""
        return reciprocal(float(self.high[self.sharpest])), reciprocal(float(self.low[self.sharpest]))


def reciprocal(curvature: float) -> float:
    """Radius of a curvature, mm; infinite for none."""
    return 1.0 / curvature if curvature > 0.0 else float("inf")


def curvature_at_scale(points: ArrayLike, settings: ScaleSettings | None = None) -> ScaledCurvature:
    """Curvature of a noisy line, each place at the longest scale at which the line is an arc of a circle.

    Parameters
    ----------
    points : (n, 3) array_like, mm
        Along the line, in order; not smoothed, since smoothing hides the noise that the intervals come from.
    settings : ScaleSettings, optional

    Raises
    ------
    GeometryError
        If the line is shorter than the least window.
    """
    settings = settings or ScaleSettings()
    line = even_points(np.asarray(points, dtype=float), settings.spacing)
    s = polyline_length(line)
    if s[-1] < settings.least:
        raise GeometryError(
            f"the line is {s[-1]:.1f} mm long, expected at least {settings.least:g} mm; its curvature has no scale that short"
        )
    spacing = float(s[-1]) / (len(line) - 1)
    least = max(round(settings.least / spacing), 5)
    middling = min(max(round(settings.noise_window / spacing), least), len(line) - 1)
    noise, inflation = noise_of(line, middling + 1)
    _, _, scale = longest_windows(line, least, noise, inflation, settings.agreement)
    usual = int(np.median(scale))
    if usual > middling:
        # Longer windows know the noise better; but where all of them hold a misfit it is no noise.
        noise = min(max(noise, noise_of(line, usual + 1)[0]), MOST_NOISE * noise)
    curvature, error, scale = longest_windows(line, least, noise, inflation, settings.agreement)
    width = settings.deviation * error
    return ScaledCurvature(
        arc_length=s,
        curvature=curvature,
        low=np.maximum(curvature - width, 0.0),
        high=curvature + width,
        scale=scale * spacing,
        noise=noise,
    )


def longest_windows(
    line: FloatArray, least: int, noise: float, inflation: float, agreement: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvature, its standard error and the length in steps of the longest window that holds around each place, (n,) each."""
    sizes = [least]
    while sizes[-1] < len(line) - 1:
        sizes.append(min(max(int(GROWTH * sizes[-1]), sizes[-1] + 1), len(line) - 1))
    curvature, error, scale = np.zeros(len(line)), np.full(len(line), np.inf), np.zeros(len(line))
    for size in sizes:
        kappa, spread, holds = fitted_windows(line, size + 1, noise, inflation, agreement)
        if size == least:
            holds = np.ones_like(holds)  # there is nothing shorter to fall back on
        elif not holds.any():
            break
        # The window whose middle is nearest answers for a place.
        starts = np.flatnonzero(holds)
        place = np.arange(len(line))
        right = np.clip(np.searchsorted(starts, place - size // 2), 0, len(starts) - 1)
        left = np.maximum(right - 1, 0)
        middle = starts + size // 2
        chosen = np.where(np.abs(middle[left] - place) < np.abs(middle[right] - place), left, right)
        start = starts[chosen]
        inside = (start <= place) & (place <= start + size)
        curvature[inside], error[inside], scale[inside] = kappa[start[inside]], spread[start[inside]], size
    return curvature, error, scale


def noise_of(line: FloatArray, count: int) -> tuple[float, float]:
    """Standard deviation of the noise in one coordinate, mm, and by how much its correlation inflates variances."""
    _, _, residuals = fit_arcs(sliding_window_view(line, count, axis=0).transpose(0, 2, 1))
    # Windows across a change of bend fit badly: the better ones tell the noise.
    variance = np.einsum("nki,nki->n", residuals, residuals) / (2 * count - 5)
    typical = float(np.quantile(variance, BETTER))
    better = variance <= np.quantile(variance, 0.5)
    chosen = residuals[better]
    energy = float(np.einsum("nki,nki->", chosen, chosen))
    if energy < LEAST_NOISE**2 * chosen.size:
        return LEAST_NOISE, 1.0
    lag = float(np.einsum("nki,nki->", chosen[:, 1:], chosen[:, :-1])) / energy
    # The fit takes out 2.5 degrees of freedom a coordinate, which draws the correlation of neighbours down by about 2.5 / n.
    lag = float(np.clip(lag + 2.5 / count, 0.0, 0.8))
    inflation = (1.0 + lag) / (1.0 - lag)
    # The same loss makes the residuals of correlated noise too small.
    share = max(1.0 - 2.5 * inflation / count, 0.2) / (1.0 - 2.5 / count)
    freedom = max((2 * count - 5) / inflation, 2.0)
    return float(np.sqrt(typical / (2.0 * gammaincinv(0.5 * freedom, BETTER) / freedom) / share)), inflation


def fitted_windows(
    line: FloatArray, count: int, noise: float, inflation: float, agreement: float
) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Curvature, its standard error and whether the window holds, for all windows of `count` points."""
    windows = sliding_window_view(line, count, axis=0).transpose(0, 2, 1)  # (m, count, 3)
    kappa, unit_error, residuals = fit_arcs(windows)
    error = unit_error * noise * np.sqrt(inflation)
    freedom = (2 * count - 5) / inflation
    excess = np.einsum("nki,nki->n", residuals, residuals) / (2 * count - 5) / noise**2
    holds = np.isfinite(kappa) & (excess < 1.0 + 3.0 * np.sqrt(2.0 / max(freedom, 2.0)))
    half = (count + 1) // 2
    if half >= 5:
        for part in (windows[:, :half], windows[:, -half:]):
            other, unit, _ = fit_arcs(part)
            # The half is part of the whole, whose error is small against its own.
            apart = np.abs(np.where(np.isfinite(other), other, 1e9) - np.where(np.isfinite(kappa), kappa, -1e9))
            holds &= apart < agreement * unit * noise * np.sqrt(inflation)
    return np.where(np.isfinite(kappa), kappa, 0.0), error, holds


def fit_arcs(windows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Arcs of circles through many short runs of points, by least squares across their chords.

    Parameters
    ----------
    windows : (m, k, 3) float array, mm

    Returns
    -------
    curvature : (m,) float array, 1/mm
        Infinite where the run bends by more than an arc's usable part.
    error : (m,) float array, 1/mm^2
        Standard error of the curvature for independent noise of 1 mm.
    residuals : (m, k, 2) float array, mm
        In the plane of the arc, across the chord, and out of the plane.
    """
    centered = windows - windows.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", centered, centered))
    out, y, x = (np.einsum("nki,ni->nk", centered, axes[:, :, column]) for column in range(3))
    design = np.stack([np.ones_like(x), x, 0.5 * x**2], axis=2)
    solution = solve_least_squares(design, y)
    offset, tilt, kappa = solution.T
    widest = np.abs(x).max(axis=1)
    limit = STEEPEST / widest
    for _ in range(GAUSS_NEWTON_STEPS):
        kappa = np.clip(kappa, -limit, limit)
        root = np.sqrt(1.0 - (kappa[:, None] * x) ** 2)
        bow = kappa[:, None] * x**2 / (1.0 + root)
        design = np.stack([np.ones_like(x), x, x**2 / (root * (1.0 + root))], axis=2)
        rest = y - offset[:, None] - tilt[:, None] * x - bow
        step = solve_least_squares(design, rest)
        offset, tilt, kappa = offset + step[:, 0], tilt + step[:, 1], kappa + step[:, 2]
    beyond = np.abs(kappa) > limit
    inverse = np.linalg.inv(np.einsum("nki,nkj->nij", design, design))
    return np.where(beyond, np.inf, np.abs(kappa)), np.sqrt(inverse[:, 2, 2]), np.stack([rest, out], axis=2)


def solve_least_squares(design: FloatArray, values: FloatArray) -> FloatArray:
    """Solutions (m, 3) of many small least-squares problems (m, k, 3) by their normal equations."""
    normal = np.einsum("nki,nkj->nij", design, design)
    return np.asarray(np.linalg.solve(normal, np.einsum("nki,nk->ni", design, values)[:, :, None])[:, :, 0])
