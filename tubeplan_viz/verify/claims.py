"""What result.json claims about the path, held against the verifier's own measurement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.profile import ON_SURFACE_MM, OwnProfile
from tubeplan_viz.verify.verification import Check

# Points and clearances are computed twice in double precision from coordinates up to 1e3 mm: agreement is far
# below this, and a tenth of a voxel is far above it.
SAME_MM = 1e-6
# The planner's arc length is a quadrature with its own nodes; a hundredth of the finest CT's voxel.
SAME_LENGTH_MM = 1e-3
SAME_CURVATURE = 1e-6  # relative, and 1/mm where it is nearly straight
# An extreme may be stated for samples 0.25 mm apart: the curvature of a cubic changes by well under this between them.
EXTREME_CURVATURE = 0.01  # relative
EXTREME_CLEARANCE_MM = 0.01
FLAG_END_MM = 0.05
CENTERLINE_MM = 0.05  # the reference line may be sampled more coarsely or finely than it is stored


def check_spline_and_path(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    """The sampled path lies on the spline, from end to end, at the arc lengths it says."""
    path = result["path"]
    s, points = np.array(path["s_mm"], dtype=float), np.array(path["points_mm"], dtype=float)
    piece, t = own.samples.at_length(s)
    expected = own.samples.path.evaluate(piece, t)
    off = np.linalg.norm(points - expected, axis=1)
    along = np.abs(np.einsum("ij,ij->i", points - expected, _tangents(own, piece, t)))
    across = np.sqrt(np.maximum(off**2 - along**2, 0.0))
    worst = int(across.argmax())
    yield Check(
        name="path: on the spline",
        ok=bool(across.max() <= SAME_MM),
        found=f"{across.max():.2g} mm off at most",
        expected=f"at most {SAME_MM:g} mm",
        text=f"The sampled points lie on the spline of the file; the farthest is at {s[worst]:.2f} mm.",
    )
    worst = int(along.argmax())
    yield Check(
        name="path: arc length",
        ok=bool(along.max() <= SAME_LENGTH_MM and abs(s[-1] - own.length) <= SAME_LENGTH_MM),
        found=f"ends at {s[-1]:.6f} mm, samples shifted by {along.max():.2g} mm at most",
        expected=f"{own.length:.6f} mm, shifted by at most {SAME_LENGTH_MM:g} mm",
        text=f"The arc lengths agree with those measured along the spline; the largest shift is at {s[worst]:.2f} mm.",
    )
    ends = np.linalg.norm(points[[0, -1]] - own.samples.points[[0, -1]], axis=1)
    yield Check(
        name="path: ends of the spline",
        ok=bool(ends.max() <= SAME_MM),
        found=f"{ends[0]:.2g} and {ends[1]:.2g} mm apart",
        expected=f"at most {SAME_MM:g} mm",
        text="The first and last sample are the ends of the spline.",
    )


def _tangents(own: OwnProfile, piece: Any, t: FloatArray) -> FloatArray:
    first = own.samples.path.evaluate(piece, t, 1)
    return np.asarray(first / np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300))


def check_profile(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    """Curvature and clearance at every sample of the file."""
    path = result["path"]
    s, points = np.array(path["s_mm"], dtype=float), np.array(path["points_mm"], dtype=float)
    stated = np.array(path["curvature_per_mm"], dtype=float)
    beside = [own.samples.at_length(s + shift) for shift in (-SAME_MM, 0.0, SAME_MM)]  # both sides of a knot
    choices = np.array([own.samples.path.curvature(piece, t) for piece, t in beside])
    gap = np.abs(choices - stated).min(axis=0)
    excess = gap - SAME_CURVATURE * np.maximum(np.abs(choices).min(axis=0), 1.0)
    worst = int(excess.argmax())
    yield Check(
        name="path: curvature",
        ok=bool(excess.max() <= 0.0),
        found=f"{stated[worst]:.7g} 1/mm at {s[worst]:.2f} mm",
        expected=f"{choices[1, worst]:.7g} 1/mm",
        text=f"The curvature at each of {len(s)} samples agrees with that of the spline's derivatives; the largest gap is shown.",
    )
    stated = np.array(path["clearance_mm"], dtype=float)
    found, inside = own.lumen.clearance(points, on_surface=ON_SURFACE_MM)
    gap = np.abs(found - stated)
    worst = int(gap.argmax())
    yield Check(
        name="path: clearance",
        ok=bool(gap.max() <= SAME_MM),
        found=f"{stated[worst]:.6f} mm at {s[worst]:.2f} mm",
        expected=f"{found[worst]:.6f} mm",
        text=f"The clearance at each of {len(s)} samples agrees with the exact distance to the triangles of mesh.ply; "
        "the largest gap is shown.",
    )
    outside = np.flatnonzero(~own.inside)
    where = f", first at {own.samples.s[outside[0]]:.2f} mm" if len(outside) else ""
    text = "The surface winds once around every place of the path, at least 20 of them in each mm."
    if len(outside) and result["status"] != "infeasible":
        text = f"The path leaves the lumen{where}: that is no path for an instrument, whatever its flags say."
    yield Check(
        name="path: inside the lumen",
        ok=result["status"] == "infeasible" or (len(outside) == 0 and bool(inside.all())),
        found=f"{len(outside)} of {len(own.inside)} places outside{where}",
        expected="none outside, unless no path was found",
        text=text,
    )


def check_metrics(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    """Each metric against the same quantity of the whole curve."""
    path, metrics = result["path"], result["metrics"]
    samples = len(path["s_mm"])
    curvature, clearance = np.array(path["curvature_per_mm"]), np.array(path["clearance_mm"])
    # The mean of n samples and the mean over arc length differ by the weight of the two ends.
    curvature_slack = float(np.ptp(own.curvature)) / samples + 1e-4
    clearance_slack = float(np.ptp(own.clearance)) / samples + 1e-3
    peak, least = own.curvature_peak, own.clearance_least
    rows = [
        ("length_mm", own.length, SAME_LENGTH_MM, SAME_LENGTH_MM, "mm"),
        ("curvature_mean_per_mm", own.curvature_mean, curvature_slack, curvature_slack, "1/mm"),
        ("clearance_mean_mm", own.clearance_mean, clearance_slack, clearance_slack, "mm"),
        ("curvature_max_per_mm", peak, EXTREME_CURVATURE * peak, SAME_CURVATURE, "1/mm"),
        ("clearance_min_mm", least, least - own.clearance_bound + SAME_MM, EXTREME_CLEARANCE_MM, "mm"),
    ]
    for name, value, below, above, unit in rows:
        stated = metrics[name]
        if stated is None:
            continue
        yield Check(
            name=f"metrics: {name}",
            ok=value - below <= stated <= value + above,
            found=f"{stated:.7g} {unit}",
            expected=f"{value:.7g} {unit}",
            text="The metric agrees with the same quantity of the whole curve, between the samples too.",
        )
    slack = SAME_CURVATURE * max(peak, 1.0)
    stated_peak, stated_least = metrics["curvature_max_per_mm"], metrics["clearance_min_mm"]
    no_better = (stated_peak is None or stated_peak >= curvature.max() - slack) and (
        stated_least is None or stated_least <= clearance.min() + SAME_MM
    )
    yield Check(
        name="metrics: no better than the samples",
        ok=bool(no_better),
        found=f"{_figure(stated_peak)} 1/mm, {_figure(stated_least)} mm",
        expected=f"at least {curvature.max():.7g} 1/mm, at most {clearance.min():.7g} mm",
        text="The stated extremes are no better than the worst samples of the same file.",
    )
    yield from _centerline_distance(result, own)


def _figure(value: float | None) -> str:
    return "not stated" if value is None else f"{value:.7g}"


def _centerline_distance(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    stated = result["metrics"]["centerline_distance_mean_mm"]
    if stated is None or result["centerline"] is None:
        return
    line = np.array(result["centerline"]["points_mm"], dtype=float)
    tree = cKDTree(line)
    points = np.array(result["path"]["points_mm"], dtype=float)
    nearest = np.asarray(tree.query(points)[1])
    best = np.full(len(points), np.inf)
    for offset in (-2, -1, 0, 1):  # the nearest vertex's segments and one more on either side
        start = np.clip(nearest + offset, 0, len(line) - 2)
        a, b = line[start], line[start + 1]
        share = np.clip(
            np.einsum("ij,ij->i", points - a, b - a) / np.maximum(np.einsum("ij,ij->i", b - a, b - a), 1e-300), 0.0, 1.0
        )
        best = np.minimum(best, np.linalg.norm(points - a - share[:, None] * (b - a), axis=1))
    value = float(best.mean())
    yield Check(
        name="metrics: centerline_distance_mean_mm",
        ok=abs(stated - value) <= CENTERLINE_MM,
        found=f"{stated:.4f} mm",
        expected=f"{value:.4f} mm",
        text="The mean distance of the samples to the centerline's segments.",
    )


def check_verdict(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    """Status, flagged intervals and certificate against the limits."""
    limits = result["limits"]
    kinds = {
        "curvature": (own.broken_curvature, limits["curvature_max_per_mm"], SAME_CURVATURE * limits["curvature_max_per_mm"]),
        "clearance": (own.broken_clearance, limits["clearance_min_mm"], -SAME_MM),
    }
    broken = {kind: find(limit + slack) for kind, (find, limit, slack) in kinds.items()}
    total = sum(len(stretches) for stretches in broken.values())
    words = "; ".join(
        f"{kind} from {stretches[0][0]:.2f} to {stretches[0][1]:.2f} mm"
        + (f" and {len(stretches) - 1} more" if len(stretches) > 1 else "")
        for kind, stretches in broken.items()
        if stretches
    )
    status = result["status"]
    wanted = "ok" if total == 0 else "flagged"
    yield Check(
        name="status",
        ok=status in (wanted, "infeasible"),
        found=status,
        expected=f"{wanted}{f' ({words})' if words else ''}",
        text="A path is ok only if curvature and clearance keep their limits everywhere, between the samples too."
        if status != "ok" or total == 0
        else f"THE PATH BREAKS A LIMIT AND IS REPORTED OK: {words}.",
    )
    for kind, (find, limit, slack) in kinds.items():
        stated = [(flag["from_mm"], flag["to_mm"]) for flag in result["flagged_intervals"] if flag["kind"] == kind]
        missed = _uncovered(broken[kind], stated)
        invented = _uncovered(stated, find(limit - slack))
        yield Check(
            name=f"flagged intervals: {kind}",
            ok=missed is None and invented is None,
            found=_intervals(stated),
            expected=_intervals(broken[kind]),
            text=f"The flagged stretches are those that break the limit, their ends within {FLAG_END_MM} mm"
            + (f"; not flagged near {missed:.2f} mm" if missed is not None else "")
            + (f"; flagged without cause near {invented:.2f} mm" if invented is not None else "")
            + ".",
        )
    yield from _flag_extremes(result, own)
    yield from _certificate(result, own)


def _uncovered(wanted: list[tuple[float, float]], given: list[tuple[float, float]]) -> float | None:
    """First place of the wanted intervals that is farther than the tolerance from all given ones."""
    for start, end in wanted:
        reach, met = start, False
        for low, high in sorted(given):
            if low - FLAG_END_MM <= reach and high + FLAG_END_MM >= start:
                reach, met = max(reach, high + FLAG_END_MM), True
        if not met or reach < end:
            return reach
    return None


def _intervals(stretches: list[tuple[float, float]]) -> str:
    shown = ", ".join(f"{start:.2f}-{end:.2f} mm" for start, end in stretches[:6])
    return (shown + (f" and {len(stretches) - 6} more" if len(stretches) > 6 else "")) or "none"


def _flag_extremes(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    faults = []
    s = own.samples.s
    for index, flag in enumerate(result["flagged_intervals"]):
        rows = (s >= flag["from_mm"] - FLAG_END_MM) & (s <= flag["to_mm"] + FLAG_END_MM)
        if not rows.any():
            faults.append(f"{index}: not on the path")
            continue
        if flag["kind"] == "curvature":
            worst = float(own.curvature[rows].max())
            agrees = abs(flag["worst"] - worst) <= EXTREME_CURVATURE * worst
        else:
            worst = float(own.clearance[rows].min())
            agrees = abs(flag["worst"] - worst) <= EXTREME_CLEARANCE_MM
        near = np.abs(s - flag["worst_at_mm"]) <= FLAG_END_MM
        if flag["kind"] == "curvature":
            agrees &= bool(near.any() and own.curvature[near].max() >= (1.0 - EXTREME_CURVATURE) * worst)
        else:
            agrees &= bool(near.any() and own.clearance[near].min() <= worst + EXTREME_CLEARANCE_MM)
        if not agrees:
            faults.append(f"{index}: {flag['worst']:.5g} at {flag['worst_at_mm']:.2f} mm instead of {worst:.5g}")
    yield Check(
        name="flagged intervals: worst values",
        ok=not faults,
        found="; ".join(faults) or f"{len(result['flagged_intervals'])} as measured",
        expected="the worst value of each stretch",
        text="The worst curvature or clearance of each flagged stretch and its place agree with the whole curve's.",
    )


def _certificate(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    certificate, limits = result["certificate"], result["limits"]
    if certificate is None:
        return
    upper, lower = certificate["curvature_upper_bound_per_mm"], certificate["clearance_lower_bound_mm"]
    peak, least = own.curvature_peak, own.clearance_least
    yield Check(
        name="certificate: bounds",
        ok=(upper is None or upper >= peak * (1.0 - 1e-9)) and (lower is None or lower <= least + 1e-9),
        found=f"curvature at most {_figure(upper)} 1/mm, clearance at least {_figure(lower)} mm",
        expected=f"curvature up to {peak:.7g} 1/mm at {own.curvature_peak_at:.2f} mm, clearance down to {least:.7g} mm "
        f"at {own.clearance_least_at:.2f} mm are within",
        text="No place that the verifier finds is worse than the certificate's bounds.",
    )
    keeps = (
        upper is not None
        and lower is not None
        and upper <= limits["curvature_max_per_mm"]
        and lower >= limits["clearance_min_mm"]
    )
    yield Check(
        name="certificate: holds",
        ok=certificate["holds"] == keeps,
        found=str(certificate["holds"]).lower(),
        expected=str(keeps).lower(),
        text="The certificate holds exactly if both bounds keep their limits.",
    )


def check_features_and_centerline(result: Mapping[str, Any], own: OwnProfile) -> Iterator[Check]:
    """Feature points lie on the path where they say; the centerline stays in the lumen."""
    features = result["feature_points"] or []
    if features:
        s = np.array([feature["s_mm"] for feature in features], dtype=float)
        piece, t = own.samples.at_length(s)
        points = np.array([feature["point_mm"] for feature in features], dtype=float)
        off = np.linalg.norm(points - own.samples.path.evaluate(piece, t), axis=1)
        worst = int(off.argmax())
        ordered = bool(
            np.all(np.diff(s) >= -SAME_LENGTH_MM) and s.min() >= -SAME_LENGTH_MM and s.max() <= own.length + SAME_LENGTH_MM
        )
        yield Check(
            name="feature points",
            ok=ordered and bool(off.max() <= SAME_LENGTH_MM),
            found=f"{off.max():.2g} mm off at most, {'in order' if ordered else 'out of order'}",
            expected=f"at most {SAME_LENGTH_MM:g} mm, in order",
            text=f"The spline passes through its feature points at their arc lengths; the farthest is number {worst + 1}, "
            f"a {features[worst]['kind']} point.",
        )
    if result["centerline"] is not None:
        line = np.array(result["centerline"]["points_mm"], dtype=float)
        inside = own.lumen.clearance(line, on_surface=ON_SURFACE_MM)[1]
        outside = np.flatnonzero(~inside)
        yield Check(
            name="centerline: inside the lumen",
            ok=len(outside) == 0,
            found=f"{len(outside)} of {len(line)} points outside" + (f", first number {outside[0] + 1}" if len(outside) else ""),
            expected="none outside",
            text="The surface winds once around every point of the centerline.",
        )
