"""What the page says and holds, without a browser."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import re
import runpy
import stat
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pytest

from reports import ReportError, render, render_report, write_page
from reports.figures import Profile, _worst_place
from reports.svg import Axis

HOSTILE = "</script><img src=x onerror=alert(1)>\"'&"


def text_of(page: str) -> str:
    body = page.split("<body", 1)[1].split('<script type="application/json"', 1)[0]
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", body))


def test_each_state_says_its_verdict(make_review: Any) -> None:
    holds = text_of(render_report(make_review(curvature_max=0.25, clearance_min=0.8, ct=False)))
    assert "The path reaches the goal and keeps both limits" in holds
    assert "proved for every point" in holds
    flagged = make_review(ct=False)
    said = text_of(render_report(flagged))
    assert (
        f"but {('no', 'one', 'two', 'three', 'four')[len(flagged.result['flagged_intervals'])]} stretches break a limit" in said
    )
    assert "Everywhere else both limits hold" in said
    impossible = text_of(render_report(make_review(infeasible=True, ct=False)))
    assert "No path keeps both limits" in impossible
    assert "it is not a plan" in impossible
    assert "The lumen is narrower than the instrument at 77.4 mm" in impossible
    for page in (holds, said, impossible):
        assert page.count("Research use, not for clinical decisions") >= 2


def test_one_broken_limit_is_named_with_its_amount_when_there_is_no_path(make_review: Any) -> None:
    narrow = make_review(infeasible=True, curvature_max=0.25, ct=False)
    short = narrow.result["limits"]["clearance_min_mm"] - narrow.result["metrics"]["clearance_min_mm"]
    assert f"No path: the lumen is too narrow by {short:.2f}" in text_of(render_report(narrow))
    bend = {"clearance_upper_bound_mm": 1.234, "point_mm": [0.0, 1.0, 2.0], "proves_impossible": True}
    details = {**narrow.result["details"], "bottleneck": {"bend": bend, "required_mm": 2.0, "proves_impossible": True}}
    bent = dataclasses.replace(narrow, result={**narrow.result, "details": details})
    assert "No path: the bend leaves less than 1.23 mm for this bend radius" in text_of(render_report(bent)).replace(
        "\u00a0", " "
    )
    sharp = make_review(infeasible=True, clearance_min=0.8, ct=False)
    assert "No path: the bend needs a radius of" in text_of(render_report(sharp))


@pytest.mark.parametrize(
    ("objective", "words"), [("length", " for the shortest path"), ("curvature", " for the straightest path"), ("clearance", "")]
)
def test_what_the_path_was_to_be_best_in_stands_beside_the_verdict_unless_it_is_clearance(
    make_review: Any, objective: str, words: str
) -> None:
    for limits, said in (
        ({"curvature_max": 0.25, "clearance_min": 0.8}, f"from start to goal{words};"),
        ({}, f"to the end{words};"),
    ):
        review = make_review(ct=False, **limits)
        settings = {**review.result["provenance"]["settings"], "tube": {"objective": objective}}
        provenance = {**review.result["provenance"], "settings": settings}
        changed = dataclasses.replace(review, result={**review.result, "provenance": provenance})
        assert f"Planned {said}" in text_of(render_report(changed))


PARTS = [{"name": "ureter", "from_mm": 0.0, "to_mm": 60.0}, {"name": "lower calyx E3", "from_mm": 60.0, "to_mm": 200.0}]


def test_the_goal_is_named_by_its_part_else_by_its_label(make_review: Any) -> None:
    review = make_review(curvature_max=0.25, clearance_min=0.8, ct=False)
    review.result["details"]["goal_label"] = "E3"
    assert "The path reaches goal E3 and keeps both limits" in text_of(render_report(review))
    review.result["details"]["parts"] = PARTS
    named = text_of(render_report(review))
    assert "The path reaches the lower calyx E3 and keeps both limits" in named
    tightest = review.result["path"]["s_mm"][int(np.argmin(review.result["path"]["clearance_mm"]))]
    assert f"in the {'ureter' if tightest <= 60.0 else 'lower calyx E3'}, the path comes closest to the wall" in named
    review.result["details"]["parts"] = [PARTS[0], {**PARTS[1], "name": "right lower lobe"}]
    assert "The path reaches the right lower lobe (E3) and keeps both limits" in text_of(render_report(review))
    review.result["details"]["parts"] = [PARTS[0], {**PARTS[1], "name": "calyx E3, group 1"}]
    assert "The path reaches the calyx E3, group 1 and keeps both limits" in text_of(render_report(review))
    # One part alone says nothing of where along the path, but its ends have names.
    review.result["details"]["parts"] = []
    review.result["details"]["endpoints"] = [{"label": "E3", "name": "lower end of the trachea", "point_mm": [0.0, 0.0, 0.0]}]
    assert "The path reaches the lower end of the trachea (E3) and keeps" in text_of(render_report(review))


def test_no_path_is_stated_by_what_is_proved_and_says_how_far_the_best_one_holds(make_review: Any) -> None:
    review = make_review(infeasible=True, curvature_max=0.25, ct=False)
    asked, details = review.result["limits"]["clearance_min_mm"], review.result["details"]
    # The best path may miss the limit by more than the proof says: the title must not claim that much.
    bound = 0.5 * (asked + review.result["metrics"]["clearance_min_mm"])
    way = {"clearance_upper_bound_mm": bound, "point_mm": [0.0, 1.0, 2.0], "required_mm": asked, "proves_impossible": True}
    details["bottleneck"] = {**way, "bend": None, "end": None}
    said = text_of(render_report(review)).replace("\u00a0", " ")
    assert f"No path: the lumen is too narrow by {asked - bound:.2f} mm" in said
    first = min(flag["from_mm"] for flag in review.result["flagged_intervals"])
    path = review.result["path"]
    k = [k for k, s in enumerate(path["s_mm"]) if s < first][-2]
    assert f"keeps both limits up to {path['s_mm'][k]:.1f} mm of {review.result['metrics']['length_mm']:.1f} mm, at (" in said
    assert path["clearance_mm"][k] >= asked
    details["bottleneck"]["end"] = "goal"
    said = text_of(render_report(review)).replace("\u00a0", " ")
    assert f"No path: the goal itself lies too near the wall by {asked - bound:.2f} mm" in said


def test_the_worst_figure_stands_near_its_place_clear_of_limit_curve_and_other_bands() -> None:
    arc = np.linspace(0.0, 180.0, 721)
    values = np.interp(arc, [0.0, 150.0, 158.0, 165.0, 176.0, 180.0], [8.0, 3.5, 1.3, 2.0, 0.3, 0.8])
    flags = [
        {"kind": "clearance", "from_mm": 157.0, "to_mm": 160.0, "worst": 1.3, "worst_at_mm": 158.0},
        {"kind": "clearance", "from_mm": 168.0, "to_mm": 180.0, "worst": 0.3, "worst_at_mm": 176.0},
    ]
    spec = Profile(
        kind="clearance", arc=arc, values=values, limit=1.5, flags=flags,
        label="Clearance", limit_label="least 1.50 mm", worst_label="0.30 mm",
    )  # fmt: skip
    x, y = Axis(0.0, 180.0, 40.0, 740.0), Axis(0.0, 15.0, 120.0, 12.0)
    place = _worst_place(spec, x, y)
    assert place is not None
    left, right, base, _ = place
    assert x(160.0) < left < right <= x.end  # past the other band
    assert base < y(1.5) - 2.0 or base - 11.0 > y(1.5)  # the limit runs above or below the words
    beneath = (x.of(arc) >= left) & (x.of(arc) <= right)
    assert not np.any((y.of(values[beneath]) > base - 11.0) & (y.of(values[beneath]) < base))


def test_hostile_words_are_text_everywhere(make_review: Any) -> None:
    review = make_review(case_id=HOSTILE, reason=HOSTILE, infeasible=True)
    review.result["status"] = "infeasible"
    review.result["details"]["warnings"] = [HOSTILE]
    review.result["details"]["parts"] = [{"name": HOSTILE, "from_mm": 0.0, "to_mm": 90.0}]
    review.result["details"]["anatomy"] = HOSTILE
    review.result["provenance"]["settings"] = {HOSTILE: HOSTILE}
    page = render_report(dataclasses.replace(review, facts={HOSTILE: HOSTILE}))
    assert "<img src=x" not in page
    assert page.count("<script") == page.count("</script>") == 3
    assert "&lt;img src=x" in page


def test_the_policy_allows_this_script_and_nothing_else(make_review: Any) -> None:
    page = render_report(make_review(ct=False))
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy is not None
    script = page.rsplit("<script>", 1)[1].rsplit("</script>", 1)[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in policy[1]
    assert policy[1].startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline';")
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert "url(http" not in page


def test_the_shipped_script_was_built_from_the_sources_beside_it() -> None:
    scene = Path(render.__file__).parent / "scene"
    build = runpy.run_path(str(scene / "build.py"))
    assert (scene / "dist" / "SOURCES.sha256").read_text().strip() == build["sources_digest"]()
    licences = (scene / "dist" / "THIRD_PARTY.txt").read_text()
    assert "three 0." in licences
    # A page is a copy of what it holds, and says whose it is.
    assert (scene / "dist" / "report.js").read_text().startswith(f"/*!\n{licences}*/\n")
    assert "resolved" not in (scene / "package-lock.json").read_text()


def test_no_path_of_a_machine_is_in_the_page(make_review: Any) -> None:
    page = render_report(make_review())
    assert not re.search(r"/(?:home|work|root|tmp|Users|usr)/", page)


def test_what_is_absent_is_left_out(make_review: Any) -> None:
    review = make_review(ct=False)
    bare = {
        key: review.result[key] for key in ("schema_version", "status", "reason", "planner", "frame", "limits", "path", "metrics")
    }
    page = render_report(dataclasses.replace(review, result=bare, surface=None, facts={}, first={}, last={}))
    assert 'id="features"' not in page
    assert "Grown volume" not in page
    nothing = {
        "status": "infeasible",
        "reason": "start and goal lie in two components",
        "frame": "mesh",
        "path": None,
        "metrics": {},
        "limits": {},
    }
    page = text_of(render_report(dataclasses.replace(review, result=nothing, first={})))
    assert "No path from start to goal" in page
    assert "Start and goal lie in two components." in page


def test_without_a_path_the_lumen_is_shown_with_the_ends_that_were_asked_for(make_review: Any) -> None:
    review = make_review(ct=False, path=None, flagged_intervals=[], feature_points=[], iterations=[], metrics={})
    review.result["status"] = "infeasible"
    review.result["details"] |= {"start_mm": [0.0, -27.0, 120.0], "goal_mm": [20.0, -30.0, 170.0]}
    page = render_report(dataclasses.replace(review, first={}, last={}))
    still = page.split('<svg class="still"', 1)[1].split("</svg>", 1)[0]
    assert ">Start<" in still
    assert ">Goal<" in still
    assert "Along the path" not in page


def test_the_template_may_not_print_what_is_not_there() -> None:
    assert render._environment().undefined is jinja2.StrictUndefined
    assert render._environment().autoescape is True


def test_numbers_that_are_not_finite_are_refused(make_review: Any) -> None:
    review = make_review(ct=False)
    review.result["details"]["odd"] = float("nan")
    with pytest.raises(ReportError, match="expected finite numbers only"):
        render_report(review)


def test_the_file_is_the_owners_only_and_small(make_review: Any, tmp_path: Path) -> None:
    target = tmp_path / "report.html"
    target.write_text("old")
    target.chmod(0o644)
    write_page(render_report(make_review()), target)
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    assert target.stat().st_size < 3_000_000
    with pytest.raises(ReportError, match=r"^report\.html cannot be written"):
        write_page(render_report(make_review(ct=False)), tmp_path / "absent" / "report.html")


def test_the_same_run_gives_the_same_bytes(make_review: Any) -> None:
    assert render_report(make_review(ct=False)) == render_report(make_review(ct=False))


def test_critical_places_are_static_pictures(make_review: Any) -> None:
    page = render_report(make_review())
    section = page.split('<section id="places"', 1)[1].split("</section>", 1)[0]
    assert section.count('class="cut"') == 8
    assert section.count("data:image/png;base64,") == 8
    mesh = render_report(make_review(ct=False)).split('<section id="places"', 1)[1].split("</section>", 1)[0]
    assert mesh.count('class="cut no-ct"') == 2
    assert "data:image/png" not in mesh
