"""The needle cases of the two papers as tables of case files; datasets/needle holds them as files.

Radii, safety distances and places of the spheres of Huo et al. (2015) are not printed: those here are of the size of
vessels and bones. The planar case of Zhao et al. (2013) is printed in full but for the weights.
"""

from __future__ import annotations

from typing import Any

TARGETS = tuple((x, y, 100.0) for x in (-15.0, 0.0, 15.0) for y in (-15.0, 0.0, 15.0))


def ball(x: float, y: float, z: float, radius: float) -> dict[str, Any]:
    """A sphere of a case file."""
    return {"kind": "sphere", "center": [x, y, z], "radius_mm": radius}


def in_space(name: str, obstacles: list[dict[str, Any]], **own: Any) -> dict[str, Any]:
    """A needle3d case from the origin along +z."""
    asked = {"entry": [0.0, 0.0, 0.0], "target": [0.0, 0.0, 100.0], "kappa": 0.02, "safety_mm": 2.0, **own}
    return {"input": {"case_id": name}, "planner": {"name": "needle3d"}, "needle3d": asked, "obstacles": obstacles}


def planar(*, obstacles: bool = True) -> dict[str, Any]:
    """Zhao et al. (2013), 3: three circles and the target (0, 90), or none and the target (30, 90); radius 50 mm."""
    circles = [((0.0, 40.0), 10.0), ((-40.0, 30.0), 15.0), ((30.0, 50.0), 8.0)] if obstacles else []
    target = [0.0, 90.0] if obstacles else [30.0, 90.0]
    return {
        "input": {"case_id": "planar" if obstacles else "planar-free"},
        "planner": {"name": "needle2d"},
        "needle2d": {"entry": [0.0, 0.0], "target": target, "radius_mm": 50.0, "safety_mm": 0.0},
        "obstacles": [{"kind": "circle", "center": list(center), "radius_mm": radius} for center, radius in circles],
    }


def scattered() -> dict[str, Any]:
    """Huo et al. (2015), scene 1: three scattered spheres."""
    return in_space("scene-1", [ball(0, 5, 40, 5), ball(15, -12, 60, 7), ball(-14, 10, 65, 7)])


def columns() -> dict[str, Any]:
    """Scene 2: two columns of overlapping spheres that every path must pass."""
    first = [ball(-20.0 + 4.0 * k, 8.0, 35.0, 4.0) for k in range(11)]
    return in_space("scene-2", first + [ball(-10.0, -20.0 + 4.0 * k, 65.0, 4.0) for k in range(11)])


def replanned(case: str) -> dict[str, Any]:
    """Section 5.3: one obstacle at (0, 5, 40); `case` is "obstacle", "target" or "model"."""
    events = {
        "obstacle": {"at_mm": 20.0, "obstacle": 1, "center": [0.0, 0.0, 50.0]},
        "target": {"at_mm": 40.0, "target": [0.0, 10.0, 120.0]},
        "model": {"at_mm": 0.0, "kappa": 0.022},
    }
    return {**in_space(f"replan-{case}", [ball(0, 5, 40, 3)], safety_mm=1.0), "events": [events[case]]}


SCENES = {
    "planar": planar(),
    "planar-free": planar(obstacles=False),
    "scene-1": scattered(),
    "scene-2": columns(),
    **{f"replan-{case}": replanned(case) for case in ("obstacle", "target", "model")},
}
