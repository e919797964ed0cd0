"""Every checkable number of report.html against result.json."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

from tubeplan_viz.verify.verification import Check

PRINTED = re.compile(r"^[+\u2212]?\d+(\.\d+)?$")  # true minus sign, no thousands separators
RESULT_ID = "tubeplan-result"
# Without these a page could pass by printing nothing.
EXPECTED = (
    "limits.curvature_max_per_mm",
    "limits.clearance_min_mm",
    "metrics.length_mm",
    "metrics.curvature_max_per_mm",
    "metrics.clearance_min_mm",
)
LEAST_COUNT = 8
DERIVED_RELATIVE = 1e-12  # a sum or quotient of doubles in another order
FLAG_KEY = re.compile(r"^derived:flag\.(\d+)\.(length_mm|radius_mm|short_mm)$")
SHOWN_FAULTS = 5


@dataclass
class _Number:
    value: str | None
    key: str
    text: str = ""


@dataclass
class _Page(HTMLParser):
    """Collects the data elements of class v and the embedded result."""

    numbers: list[_Number] = field(default_factory=list)
    results: list[str] = field(default_factory=list)
    _open: _Number | None = None
    _in_result: bool = False

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        if tag == "data" and "v" in (named.get("class") or "").split():
            self._open = _Number(named.get("value"), named.get("data-key") or "")
            self.numbers.append(self._open)
        elif tag == "script" and named.get("id") == RESULT_ID:
            self._in_result = True
            self.results.append("")

    def handle_endtag(self, tag: str) -> None:
        if tag == "data":
            self._open = None
        elif tag == "script":
            self._in_result = False

    def handle_data(self, data: str) -> None:
        if self._open is not None:
            self._open.text += data
        elif self._in_result:
            self.results[-1] += data


def check_page(text: str, result: Mapping[str, Any]) -> Iterator[Check]:
    """Numbers of the page, exact and as printed, and the result embedded in it."""
    page = _Page()
    page.feed(text)
    page.close()
    faults = [fault for number in page.numbers for fault in _faults(number, result)]
    shown = "; ".join(faults[:SHOWN_FAULTS]) + (f"; and {len(faults) - SHOWN_FAULTS} more" if len(faults) > SHOWN_FAULTS else "")
    yield Check(
        name="report.html: numbers",
        ok=not faults,
        found=shown or f"{len(page.numbers)} numbers agree",
        expected="value and printed text of every number as in result.json",
        text="Every number of the report that comes from the result is the result's, and is printed as it rounds.",
    )
    present = {number.key for number in page.numbers}
    wanted = [key for key in EXPECTED if _look_up(result, key)[0]]
    missing = [key for key in wanted if key not in present]
    yield Check(
        name="report.html: complete",
        ok=not missing and len(page.numbers) >= LEAST_COUNT,
        found=f"{len(page.numbers)} numbers" + (f", without {', '.join(missing)}" if missing else ""),
        expected=f"at least {LEAST_COUNT}, with {', '.join(wanted)}",
        text="The report prints the figures on which a decision rests, in a form that can be checked.",
    )
    yield _embedded(page.results, result)


def _faults(number: _Number, result: Mapping[str, Any]) -> Iterator[str]:
    printed = number.text.strip()
    known, exact = derived(result, number.key) if number.key.startswith("derived:") else _look_up(result, number.key)
    if not known:
        yield f"{number.key or 'a number without a key'} ({printed}) cannot be checked"
        return
    try:
        value = float(number.value or "")
    except ValueError:
        yield f"{number.key} has the value {number.value!r} instead of {exact!r}"
        return
    slack = DERIVED_RELATIVE * max(abs(exact), 1.0) if number.key.startswith("derived:") else 0.0
    if not abs(value - exact) <= slack:
        yield f"{number.key} has the value {number.value} instead of {exact!r}"
    if not PRINTED.match(printed):
        yield f"{number.key} is printed as {printed!r}, no plain number"
        return
    digits = len(printed.partition(".")[2])
    shown = float(printed.replace("\u2212", "-"))
    if abs(shown - exact) > 0.5 * 10.0**-digits * (1.0 + 1e-9):
        yield f"{number.key} is printed as {printed} instead of {exact:.{digits}f}"


def _look_up(result: Mapping[str, Any], key: str) -> tuple[bool, float]:
    """Whether result.json has a number at a dotted key, and the number."""
    found: Any = result
    for name in key.split("."):
        if isinstance(found, Mapping) and name in found:
            found = found[name]
        elif isinstance(found, list) and name.isdigit() and int(name) < len(found):
            found = found[int(name)]
        else:
            return False, 0.0
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        return False, 0.0
    return True, float(found)


def derived(result: Mapping[str, Any], key: str) -> tuple[bool, float]:
    """Whether a figure can be worked out from result.json, and its value; formulas of the verifier's own.

    ``derived:flag.N.length_mm`` is to_mm - from_mm of the N-th flagged interval, ``radius_mm`` is 1 / worst
    of a curvature flag and ``short_mm`` is the clearance limit less the worst of a clearance flag.
    """
    metrics, limits, path, flags = result["metrics"], result["limits"], result["path"], result["flagged_intervals"]
    match = FLAG_KEY.match(key)
    try:
        if match:
            flag, what = flags[int(match[1])], match[2]
            if what == "length_mm":
                return True, flag["to_mm"] - flag["from_mm"]
            if what == "radius_mm":
                return flag["kind"] == "curvature", 1.0 / flag["worst"]
            return flag["kind"] == "clearance", limits["clearance_min_mm"] - flag["worst"]
        match key.removeprefix("derived:"):
            case "margin_mm":
                return True, metrics["clearance_min_mm"] - limits["clearance_min_mm"]
            case "narrow_by_mm":
                return True, limits["clearance_min_mm"] - result["details"]["bottleneck"]["clearance_upper_bound_mm"]
            case "kept_until_mm":
                first = min((flag["from_mm"] for flag in flags), default=0.0)
                before = sorted(s for s in path["s_mm"] if s < first)
                return len(before) > 1, before[-2]
            case "bend_radius_mm":
                return True, 1.0 / metrics["curvature_max_per_mm"]
            case "bend_radius_limit_mm":
                return True, 1.0 / limits["curvature_max_per_mm"]
            case "bend_radius_before_mm":
                return True, 1.0 / result["iterations"][0]["curvature_max_per_mm"]
            case "curvature_excess_percent":
                return True, 100.0 * (metrics["curvature_max_per_mm"] / limits["curvature_max_per_mm"] - 1.0)
            case "clearance_min_at_mm":
                return True, path["s_mm"][path["clearance_mm"].index(min(path["clearance_mm"]))]
            case "curvature_max_at_mm":
                return True, path["s_mm"][path["curvature_per_mm"].index(max(path["curvature_per_mm"]))]
            case "instrument_diameter_mm":
                return True, 2.0 * limits["clearance_min_mm"]
            case "path_diameter_mm":
                return True, 2.0 * metrics["clearance_min_mm"]
            case "flagged_clearance_mm" | "flagged_curvature_mm" as name:
                return True, float(sum(flag["to_mm"] - flag["from_mm"] for flag in flags if flag["kind"] == name.split("_")[1]))
            case "time_s":
                return True, float(sum(result["timings_s"].values()))
            case _:
                return False, 0.0
    except (TypeError, IndexError, KeyError, ZeroDivisionError):  # a term is null, absent or 0: there is no such figure
        return False, 0.0


def _embedded(results: list[str], result: Mapping[str, Any]) -> Check:
    # The page is written before the digests of all files, its own among them, are known.
    expected = {**result, "provenance": {key: value for key, value in result["provenance"].items() if key != "outputs"}}
    found = f"{len(results)} embedded results"
    ok = False
    if len(results) == 1:
        try:
            embedded = json.loads(results[0])
            difference = _difference(embedded, expected, "")
            ok, found = difference is None, difference or "the same content"
        except ValueError:
            found = "embedded text that is no JSON"
    return Check(
        name="report.html: embedded result",
        ok=ok,
        found=found,
        expected="one, equal to result.json",
        text="The result that the page's scripts draw is result.json.",
    )


def _difference(found: Any, expected: Any, place: str) -> str | None:
    """The first place at which two JSON values differ."""
    if isinstance(found, dict) and isinstance(expected, dict):
        if found.keys() != expected.keys():
            return f"other keys at {place or 'the top level'}: {', '.join(sorted(found.keys() ^ expected.keys()))[:120]}"
        rows = ((found[key], expected[key], f"{place}.{key}" if place else key) for key in expected)
    elif isinstance(found, list) and isinstance(expected, list):
        if len(found) != len(expected):
            return f"{len(found)} entries instead of {len(expected)} at {place}"
        rows = ((a, b, f"{place}.{index}") for index, (a, b) in enumerate(zip(found, expected, strict=True)))
    else:
        same = found == expected and isinstance(found, bool) == isinstance(expected, bool)
        return None if same else f"{str(found)[:40]} instead of {str(expected)[:40]} at {place}"
    return next((difference for row in rows if (difference := _difference(*row)) is not None), None)
