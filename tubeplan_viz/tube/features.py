"""Feature points of a centerline: coarse and fine scan (Dai 2024, section 1.2-1.3)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.geometry import menger_curvature
from tubeplan_viz.plan import FeatureKind

SCANS = ("extrema", "segments", "inflections", "nodes", "dense")


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """Numbers of the scans (Dai 2024, table 1) and which of them run.

    Attributes
    ----------
    neighbourhood : int
        J, points on either side.
    t1 .. t4 : float
        Ratios of eq. 4, 7, 10 and 13.
    t5, t6, t7 : int
        Point counts of the wide-range rule (eq. 15) and of the over-dense rule.
    scans : tuple of str
        Of ``extrema``, ``segments``, ``inflections``, ``nodes``, ``dense`` (removal of
        over-dense points). The extrema and segment scans follow the noise of the
        centerline: on one tube with 0.01 mm of noise they give 3 to 37 points.
        With ``nodes`` alone the wide-range rule acts on the start-goal pair.
    """

    neighbourhood: int = 5
    t1: float = 1.9
    t2: float = 5.0
    t3: float = 3.0
    t4: float = 3.0
    t5: int = 20
    t6: int = 10
    t7: int = 7
    scans: tuple[str, ...] = ("nodes",)

    def __post_init__(self) -> None:
        unknown = [name for name in self.scans if name not in SCANS]
        if unknown:
            raise CaseError(f"unknown feature scan {unknown[0]!r}; expected some of {', '.join(SCANS)}")
        if self.neighbourhood < 1 or min(self.t5, self.t6, self.t7) < 1:
            raise CaseError("neighbourhood, t5, t6 and t7 are counts of points; expected at least 1")


def scan_features(points: FloatArray, settings: FeatureSettings) -> list[tuple[int, FeatureKind]]:
    """Feature points of a dense line as (index, kind), in order, start and goal included.

    Parameters
    ----------
    points : (n, 3) float array, mm
        Evenly spaced centerline points.
    """
    n = len(points)
    inner = menger_curvature(points)
    c = np.concatenate([inner[:1], inner, inner[-1:]])
    found: dict[int, FeatureKind] = {}
    if "segments" in settings.scans:
        found |= dict.fromkeys(segment_points(c, settings), FeatureKind.SEGMENT)
    if "extrema" in settings.scans:
        found |= dict.fromkeys(extrema(c, settings), FeatureKind.EXTREMUM)
    found |= {0: FeatureKind.START, n - 1: FeatureKind.GOAL}
    if "inflections" in settings.scans:
        found = {**dict.fromkeys(inflections(c, found, settings), FeatureKind.INFLECTION), **found}
    if "nodes" in settings.scans:
        found = {**dict.fromkeys(wide_range_nodes(c, found, settings), FeatureKind.NODE), **found}
    if "dense" in settings.scans:
        for index in over_dense(found, settings):
            del found[index]
    return sorted(found.items())


def local_mean(c: FloatArray, i: int, reach: int) -> float:
    """Mean curvature over i - J .. i + J.

    The print has 1/J before a sum of 2J + 1 terms (eq. 5); with that factor eq. 13
    cannot hold at T4 = 3, so the arithmetic mean is taken.
    """
    return float(c[max(i - reach, 0) : i + reach + 1].mean())


def extrema(c: FloatArray, settings: FeatureSettings) -> list[int]:
    """Curvature extrema (eq. 3-5)."""
    reach = settings.neighbourhood
    return [
        i
        for i in range(reach, len(c) - reach)
        if c[i] == c[i - reach : i + reach + 1].max() and c[i] > settings.t1 * local_mean(c, i, reach)
    ]


def segment_points(c: FloatArray, settings: FeatureSettings) -> list[int]:
    """Ends of bends (eq. 6-8, with the bar that eq. 8 defines) and beginnings of bends (eq. 9-11)."""
    n, reach = len(c), settings.neighbourhood
    ends = bend_ends(c, settings)
    begins = [n - 1 - i for i in bend_ends(c[::-1], settings)]
    return sorted({i for i in (*ends, *begins) if reach <= i < n - reach})


def bend_ends(c: FloatArray, settings: FeatureSettings) -> list[int]:
    """Points whose J predecessors are all more curved and that begin a quiet stretch."""
    reach = settings.neighbourhood
    found = []
    for i in range(reach, len(c) - reach - 1):
        before = c[i - reach : i][::-1]  # c_{i-j}, j = 1..J
        after = c[i + 2 : i + reach + 2]  # c_{i+j+1}
        if not np.all(before > c[i]):
            continue
        fall = float((before - c[i + 1]).min())
        rise = float((after - c[i + 1]).max())
        roughness = float(np.abs(np.diff(c[i + 1 : i + reach + 2])).mean())
        if fall > settings.t2 * rise and roughness < settings.t3 * local_mean(c, i, reach):
            found.append(i)
    return found


def inflections(c: FloatArray, features: dict[int, FeatureKind], settings: FeatureSettings) -> list[int]:
    """Least curved point between neighbours that are both extrema or both segment points (eq. 12-14).

    Eq. 12 prints the maximum, with which eq. 13-14 cannot hold; the minimum is meant.
    """
    order, reach, found = sorted(features), settings.neighbourhood, []
    for a, b in pairwise(order):
        same = features[a] == features[b] and features[a] in (FeatureKind.EXTREMUM, FeatureKind.SEGMENT)
        if not same or b - a < 2:
            continue
        i = a + 1 + int(np.argmin(c[a + 1 : b]))
        after, before = c[i + 1 : i + reach + 1] - c[i], c[max(i - reach, 0) : i] - c[i]
        if len(after) and len(before) and min(after.max(), before.max()) > settings.t4 * local_mean(c, i, reach):
            found.append(i)
    return found


def wide_range_nodes(c: FloatArray, features: dict[int, FeatureKind], settings: FeatureSettings) -> list[int]:
    """Nodes in long stretches without a feature (eq. 15): the most curved point of each equal part.

    Three features in a row that are all extrema or all not, and span more than T5 points,
    take floor((I1 + I2 - T5) / T6) nodes; a bare start-goal pair counts as such a span.
    """
    order = sorted(features)
    spans = (
        [(order[0], order[-1])]
        if len(order) == 2
        else [(order[k - 1], order[k + 1]) for k in range(1, len(order) - 1) if alike(features, order, k)]
    )
    found: set[int] = set()
    taken = order[0]
    for a, b in spans:
        # Triples overlap by one gap; the part already filled is left as it is.
        a = max(a, taken)
        count = (b - a - settings.t5) // settings.t6
        if b - a <= settings.t5 or count < 1:
            continue
        parts = np.linspace(a + 1, b, count + 1).astype(int)
        found |= {int(p + np.argmax(c[p:q])) for p, q in pairwise(parts) if q > p}
        taken = b
    return sorted(found - set(features))


def alike(features: dict[int, FeatureKind], order: list[int], k: int) -> bool:
    """Whether features k - 1, k and k + 1 are all curvature extrema or all none."""
    kinds = [features[order[j]] is FeatureKind.EXTREMUM for j in (k - 1, k, k + 1)]
    return all(kinds) or not any(kinds)


def over_dense(features: dict[int, FeatureKind], settings: FeatureSettings) -> list[int]:
    """Extrema to drop: a neighbour is an extremum too and the two gaps around span fewer than T7 points."""
    order = sorted(features)
    dropped: list[int] = []
    k = 1
    while k < len(order) - 1:
        a, i, b = order[k - 1], order[k], order[k + 1]
        pair = features[i] is FeatureKind.EXTREMUM and FeatureKind.EXTREMUM in (features[a], features[b])
        if pair and b - a < settings.t7:
            dropped.append(i)
            del order[k]
        else:
            k += 1
    return dropped
