"""What a needle's result tells beside its path: places and obstacles of the case, certificate, means, dangers, scores, forms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.needle_bodies import Distance, place
from tubeplan_viz.verify.needle_motion import STEP_MM
from tubeplan_viz.verify.verification import Check

SAME = 1e-6  # mm, 1/mm relative to the needle's, and without unit: sums in double precision
EXACT_KINDS = ("sphere", "circle", "polygon")


def check_told_needle(
    case: Mapping[str, Any],
    own: Mapping[str, Any],
    result: Mapping[str, Any],
    points: FloatArray,
    bodies: Sequence[Distance],
) -> Iterator[Check]:
    """All of them; `points` (k, 3) are places of the integrated path, `bodies` the case's obstacles."""
    rows = list(case.get("obstacles", []))
    gaps = np.array([float(body(points).min()) for body in bodies])
    yield _places(own, rows, result)
    yield from _certificate(result, gaps)
    yield _samples(result, rows, bodies)
    yield _means(result)
    yield from _danger(own, rows, result, gaps)
    if "forms" in result["details"]:
        yield _forms(own, result)


def _places(own: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], result: Mapping[str, Any]) -> Check:
    details = result["details"]
    wrong = []
    if np.abs(place(details["target_mm"]) - place(own["target"])).max() > 0.0:
        wrong.append("target")
    for number, (row, told) in enumerate(zip(rows, details["obstacles"], strict=False), start=1):
        same = told["kind"] == row["kind"] and told.get("radius_mm") == row.get("radius_mm")
        if row.get("center") is not None:
            same &= bool(np.array_equal(place(told["center_mm"]), place(row["center"])))
        if row.get("points") is not None:
            same &= bool(np.array_equal([place(p) for p in told["points_mm"]], [place(p) for p in row["points"]]))
        if not same:
            wrong.append(f"obstacle {number}")
    turns = [abs(np.degrees(control["turn_rad"]) - control["turn_deg"]) for control in details["controls"]]
    if max(turns) > SAME:
        wrong.append("a turn in degrees")
    if "insertion_angle_deg" in details:
        axis = np.array(details["entry_frame"], dtype=float)[:, 2]
        if abs(np.degrees(np.arctan2(-axis[1], axis[2])) - details["insertion_angle_deg"]) > SAME:
            wrong.append("insertion angle")
    return Check(
        name="places: as in the case",
        ok=not wrong,
        found=", ".join(wrong) or "the same",
        expected="target and obstacles of case.toml, turns alike in both units, the angle of the entry frame",
        text="Target and obstacles that are told and drawn are those of the case.",
    )


def _certificate(result: Mapping[str, Any], gaps: FloatArray) -> Iterator[Check]:
    told, limits = result["certificate"], result["limits"]
    bend = max(control["curvature_per_mm"] for control in result["details"]["controls"])
    upper, lower = told["curvature_upper_bound_per_mm"], told["clearance_lower_bound_mm"]
    least = float(gaps.min()) if len(gaps) else np.inf
    yield Check(
        name="certificate: bounds",
        ok=upper >= bend * (1.0 - SAME) and (lower is None) == (not len(gaps)) and (lower is None or lower <= least + SAME),
        found=f"{upper:g} 1/mm, {'none' if lower is None else f'{lower:.6f} mm'}",
        expected=f"no less than {bend:g} 1/mm, {f'no more than {least:.6f} mm' if len(gaps) else 'none'}",
        text="No place of the path is worse than the certificate's bounds.",
    )
    keeps = upper <= limits["curvature_max_per_mm"] * (1.0 + SAME) and (
        lower is None or lower >= limits["clearance_min_mm"] - SAME
    )
    yield Check(
        name="certificate: holds",
        ok=told["holds"] == keeps,
        found=str(told["holds"]).lower(),
        expected=str(keeps).lower(),
        text="The certificate holds exactly if both bounds keep their limits.",
    )


def _samples(result: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], bodies: Sequence[Distance]) -> Check:
    """Curvature and clearance at every sample of the file."""
    path, controls = result["path"], result["details"]["controls"]
    s, told = np.array(path["s_mm"]), np.array(path["curvature_per_mm"])
    ends = np.cumsum([control["length_mm"] for control in controls])
    bends = np.array([control["curvature_per_mm"] for control in controls])
    beside = [bends[np.minimum(np.searchsorted(ends, s + shift), len(bends) - 1)] for shift in (-SAME, SAME)]
    bad = int(np.sum(np.minimum(*(np.abs(told - bend) for bend in beside)) > SAME * max(float(bends.max()), SAME)))
    if path["clearance_mm"] is not None and all(row["kind"] in EXACT_KINDS for row in rows):
        places = np.array(path["points_mm"], dtype=float)
        found = np.min([body(places) for body in bodies], axis=0)
        bad += int(np.sum(np.abs(found - np.array(path["clearance_mm"])) > SAME))
    return Check(
        name="path: curvature and clearance",
        ok=bad == 0 and (path["clearance_mm"] is None) == (not rows),
        found=f"{bad} of {len(s)} samples otherwise",
        expected="the bend of the piece, and the distance to the nearest obstacle",
        text="Every sample has the curvature of its piece and, where distances are exact, that to the nearest obstacle.",
    )


def _means(result: Mapping[str, Any]) -> Check:
    metrics, path, controls = result["metrics"], result["path"], result["details"]["controls"]
    lengths, bends = (np.array([control[key] for control in controls]) for key in ("length_mm", "curvature_per_mm"))
    meant = {"curvature_mean_per_mm": float(bends @ lengths / lengths.sum()), "curvature_max_per_mm": float(bends.max())}
    if path["clearance_mm"] is not None:
        meant["clearance_mean_mm"] = float(np.mean(path["clearance_mm"]))
    wrong = [f"{key} {metrics[key]}" for key, value in meant.items() if metrics[key] is None or abs(metrics[key] - value) > SAME]
    return Check(
        name="metrics: means and largest curvature",
        ok=not wrong,
        found=", ".join(wrong) or "the same",
        expected=", ".join(f"{value:.6g}" for value in meant.values()),
        text="Means and the largest curvature follow from controls and samples.",
    )


def _danger(
    own: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], result: Mapping[str, Any], gaps: FloatArray
) -> Iterator[Check]:
    """Sum of safety over distance, and the planar planner's score."""
    metrics, safety = result["metrics"], float(own["safety_mm"])
    told = metrics.get("danger")
    if told is None:
        return
    if all(row["kind"] in EXACT_KINDS for row in rows):
        near = np.maximum(gaps, max(safety, 1e-12))
        value = float((safety / near).sum())
        # The measured distances are those of places a step apart.
        slack = float((safety / near**2).sum()) * 0.5 * STEP_MM**2 + SAME
        yield Check(
            name="metrics: danger",
            ok=abs(told - value) <= slack,
            found=f"{told:.6g}",
            expected=f"{value:.6g}",
            text="The danger is the sum of the safety distance over the distance to each obstacle.",
        )
    if metrics.get("score") is not None:
        pieces = len(result["details"]["chosen_form"])
        score = own["weight_length"] * metrics["length_mm"] + own["weight_danger"] * told + own["weight_degree"] * pieces
        yield Check(
            name="metrics: score",
            ok=abs(metrics["score"] - score) <= SAME * max(1.0, score),
            found=f"{metrics['score']:.6f}",
            expected=f"{score:.6f}",
            text="The score is the weighted sum of length, danger and number of pieces.",
        )


def _forms(own: Mapping[str, Any], result: Mapping[str, Any]) -> Check:
    """Every form that is told: its figures fit together, and the best is the one that was chosen."""
    details, metrics = result["details"], result["metrics"]
    wrong: list[str] = []
    best: dict[str, tuple[float, str]] = {}
    for form in details["forms"]:
        name, score, bound = form["form"], form.get("score"), form["score_bound"]
        fits = form["degree"] == len(name) and form["feasible"] == (form["reason"] is None) == (score is not None)
        if fits and score is not None:
            meant = own["weight_length"] * form["length_mm"] + own["weight_danger"] * form["danger"]
            meant += own["weight_degree"] * form["degree"]
            ends = np.linalg.norm(place(form["points_mm"][-1]) - place(own["target"]))
            fits = (
                abs(score - meant) <= SAME * max(1.0, meant)
                and (bound is None or bound <= score + SAME * max(1.0, score))
                and abs(sum(form["lengths_mm"]) - form["length_mm"]) <= SAME
                and form["tip_error_mm"] <= SAME
                and ends <= 0.01  # drawn points are rounded
                and (form["clearance_min_mm"] is None or form["clearance_min_mm"] >= own["safety_mm"] - SAME)
            )
            best[str(len(name))] = min(best.get(str(len(name)), (np.inf, "")), (score, name))
        if not fits:
            wrong.append(f"form {name}")
    per_degree = {degree: name for degree, (_, name) in best.items()}
    if details["best_per_degree"] != per_degree:
        wrong.append("the best of a number of pieces")
    chosen = next((form for form in details["forms"] if form["form"] == details["chosen_form"]), None)
    least = min(best.values(), default=(np.inf, ""))[0]
    told = None if chosen is None else chosen.get("score")
    same = told is not None and told <= least + SAME and abs(told - metrics["score"]) <= SAME
    if chosen is None or not same or abs(chosen["length_mm"] - metrics["length_mm"]) > SAME:
        wrong.append("the chosen form")
    return Check(
        name="forms",
        ok=not wrong,
        found=", ".join(wrong[:5]) or f"{len(details['forms'])} that fit",
        expected="figures that fit together, the best one chosen",
        text="Each form's score follows from its figures, and the path is that of the best.",
    )
