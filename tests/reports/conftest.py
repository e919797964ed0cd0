"""A synthetic run for the report: a bent tube with a neck, its painted CT and a result that agrees with itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from scipy.spatial import cKDTree

from segmentation.mesh import Cap, Surface
from segmentation.region_growing import GrowthCurve, Region
from segmentation.volume import Volume
from tubeplan_viz.endoluminal import Film, FilmSettings, make_film
from tubeplan_viz.result import Review


def axis_and_radius(count: int = 481, neck: float = 0.85) -> tuple[np.ndarray, np.ndarray]:
    """A line up, over a bend and down again, in LPS mm, with the lumen's radius: a neck before the bend."""
    u = np.linspace(0.0, 1.0, count)
    angle = np.pi * np.clip((u - 0.6) / 0.22, 0.0, 1.0)
    up = np.minimum(u, 0.6) * 125.0
    down = np.maximum(u - 0.82, 0.0) * 125.0
    x = 3.0 * np.sin(u * 9.0) + 7.2 * (1 - np.cos(angle)) + 0.35 * down
    points = np.stack([x, 3.0 * np.cos(4.0 * u) - 30.0, up + 7.2 * np.sin(angle) - down + 120.0], axis=1)
    for _ in range(30):  # round the joins
        points[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
    radius = (
        1.9
        + 0.25 * np.sin(u * 25.0)
        + 3.2 * np.exp(-(((u - 0.72) / 0.07) ** 2))
        - (1.9 - neck) * np.exp(-(((u - 0.55) / 0.025) ** 2))
    )
    return points, radius


def swept(points: np.ndarray, radius: np.ndarray, frame: str, sides: int = 40) -> Surface:
    """Rings along the axis with flat caps."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.cross(tangent, [0.3, 0.9, 0.1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    binormal = np.cross(tangent, normal)
    a = 2 * np.pi * np.arange(sides) / sides
    ring = points[:, None] + radius[:, None, None] * (
        np.cos(a)[:, None] * normal[:, None] + np.sin(a)[:, None] * binormal[:, None]
    )
    n = len(points)
    i, j = np.meshgrid(np.arange(n - 1), np.arange(sides), indexing="ij")
    k = (j + 1) % sides
    wall = np.concatenate(
        [
            np.stack([i * sides + j, i * sides + k, (i + 1) * sides + k], -1),
            np.stack([i * sides + j, (i + 1) * sides + k, (i + 1) * sides + j], -1),
        ]
    ).reshape(-1, 3)
    vertices = np.vstack([ring.reshape(-1, 3), points[:1], points[-1:]])
    near = np.stack([np.arange(sides), np.full(sides, n * sides), (np.arange(sides) + 1) % sides], -1)
    far = np.stack(
        [(n - 1) * sides + np.arange(sides), (n - 1) * sides + (np.arange(sides) + 1) % sides, np.full(sides, n * sides + 1)], -1
    )
    faces = np.vstack([wall, near[:, [0, 1, 2]], far])
    face_cap = np.concatenate([np.full(len(wall), -1), np.zeros(sides, int), np.ones(sides, int)])
    caps = (
        Cap("C1", "image border", points[0], -tangent[0], float(np.pi * radius[0] ** 2)),
        Cap("C2", "flat end", points[-1], tangent[-1], float(np.pi * radius[-1] ** 2)),
    )
    return Surface(vertices, faces, face_cap, caps, frame)


@cache
def painted(neck: float) -> Volume:
    """A CT of 0.8 x 0.8 x 1.25 mm with a bright lumen in soft tissue."""
    rng = np.random.default_rng(3)
    points, radius = axis_and_radius(neck=neck)
    low, high = points.min(axis=0) - 30.0, points.max(axis=0) + 30.0
    size = np.ceil((high - low)[::-1] / [1.25, 0.8, 0.8]).astype(int)
    matrix = np.array([[0, 0, 0.8, low[0]], [0, 0.8, 0, low[1]], [1.25, 0, 0, low[2]], [0, 0, 0, 1.0]])
    index = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1)
    lps = index @ matrix[:3, :3].T + matrix[:3, 3]
    distance, nearest = cKDTree(points).query(lps.reshape(-1, 3), distance_upper_bound=12.0)
    nearest = np.minimum(nearest, len(points) - 1)
    share = np.clip((radius[nearest] - distance) / 0.9 + 0.5, 0.0, 1.0)
    tissue = -80.0 + 130.0 * (np.sin(lps[..., 0] / 11) + np.sin(lps[..., 2] / 17) + np.cos(lps[..., 1] / 13) > 0.4).ravel()
    hu = tissue * (1 - share) + 320.0 * share + rng.normal(0, 15, len(share))
    return Volume(hu.reshape(tuple(size)).astype(np.int16), matrix)


@cache
def filmed(neck: float) -> Film:
    """What the tip sees along the axis; neither the limits nor the frame's name play a part."""
    points, radius = axis_and_radius(neck=neck)
    path = profile(points, radius * 0.97)
    surface, settings = swept(points, radius, "LPS"), FilmSettings(size=48, step=6.0)
    return make_film(surface, np.array(path["s_mm"]), points, np.array(path["clearance_mm"]), settings=settings)


def intervals(arc: np.ndarray, values: np.ndarray, limit: float, kind: str) -> list[dict[str, Any]]:
    bad = values > limit if kind == "curvature" else values < limit
    edges = np.flatnonzero(np.diff(np.concatenate([[0], bad.astype(int), [0]])))
    out = []
    for a, b in zip(edges[::2], edges[1::2] - 1, strict=True):
        k = a + int(values[a : b + 1].argmax() if kind == "curvature" else values[a : b + 1].argmin())
        out.append(
            {
                "kind": kind,
                "from_mm": float(arc[a]),
                "to_mm": float(arc[b]),
                "worst": float(values[k]),
                "worst_at_mm": float(arc[k]),
            }
        )
    return out


def profile(points: np.ndarray, clearance: np.ndarray) -> dict[str, list[Any]]:
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    first = np.gradient(points, arc, axis=0)
    curvature = np.linalg.norm(np.cross(first, np.gradient(first, arc, axis=0)), axis=1)
    return {
        "s_mm": arc.tolist(),
        "points_mm": points.tolist(),
        "curvature_per_mm": curvature.tolist(),
        "clearance_mm": clearance.tolist(),
    }


def build_review(
    *,
    curvature_max: float = 0.125,
    clearance_min: float = 1.2,
    infeasible: bool = False,
    ct: bool = True,
    neck: float = 0.85,
    case_id: str = "phantom-01",
    film: bool = True,
    **changes: Any,
) -> Review:
    """A run of the synthetic tube whose status follows from its limits."""
    points, radius = axis_and_radius(neck=neck)
    path = profile(points, radius * 0.97)
    rough = points + 0.25 * np.sin(np.linspace(0, 60, len(points)))[:, None] * np.array([1.0, 0.3, 0.0])
    first = profile(rough, radius * 0.97 - 0.1)
    arc, curvature, clearance = (np.asarray(path[k]) for k in ("s_mm", "curvature_per_mm", "clearance_mm"))
    flags = intervals(arc, clearance, clearance_min, "clearance") + intervals(arc, curvature, curvature_max, "curvature")
    status = "infeasible" if infeasible else "flagged" if flags else "ok"
    worst_first = {"curvature_max_per_mm": max(first["curvature_per_mm"]), "clearance_min_mm": min(first["clearance_mm"])}
    fade = np.exp(-np.arange(13) / 3.0)
    states = [
        {
            "index": k,
            "feature_count": 9 + k // 4,
            "curvature_max_per_mm": float(curvature.max() + f * (worst_first["curvature_max_per_mm"] - curvature.max())),
            "clearance_min_mm": float(clearance.min() + f * (worst_first["clearance_min_mm"] - clearance.min())),
            "moved": 2 * (k > 0),
            "added": int(k % 4 == 3),
        }
        for k, f in enumerate(fade)
    ]
    surface = swept(points, radius, "LPS" if ct else "mesh")
    spots = [int(v) for v in np.linspace(0, len(points) - 1, 14)]
    kinds = ["start", *("extremum", "inflection", "segment", "node") * 3, "goal"]
    result: dict[str, Any] = {
        "schema_version": 1,
        "status": status,
        "reason": "the lumen is narrower than the instrument at 77.4 mm: 1.02 mm where 1.20 mm are needed"
        if infeasible
        else None
        if not flags
        else "limits are broken",
        "planner": {"name": "tube", "method": "feature_iteration", "version": "1"},
        "frame": "LPS" if ct else "mesh",
        "limits": {"curvature_max_per_mm": curvature_max, "clearance_min_mm": clearance_min},
        "path": path,
        "centerline": {"points_mm": points[::4].tolist(), "radius_mm": radius[::4].tolist()},
        "feature_points": [
            {"point_mm": points[k].tolist(), "kind": kind, "s_mm": float(arc[k])} for k, kind in zip(spots, kinds, strict=True)
        ],
        "metrics": {
            "length_mm": float(arc[-1]),
            "curvature_max_per_mm": float(curvature.max()),
            "curvature_mean_per_mm": float(np.trapezoid(curvature, arc) / arc[-1]),
            "clearance_min_mm": float(clearance.min()),
            "clearance_mean_mm": float(np.trapezoid(clearance, arc) / arc[-1]),
            "centerline_distance_mean_mm": 0.0312,
        },
        "certificate": {
            "holds": not flags,
            "curvature_upper_bound_per_mm": float(curvature.max()) + 1e-4,
            "clearance_lower_bound_mm": float(clearance.min()) - 0.004,
            "method": "piecewise polynomial and Lipschitz bounds",
        },
        "flagged_intervals": flags,
        "iterations": states,
        "details": {
            "surface": {
                "wall_faces": 38400,
                "caps": [
                    {
                        "label": c.label,
                        "origin": c.origin,
                        "center_mm": c.center.tolist(),
                        "normal": c.normal.tolist(),
                        "area_mm2": c.area,
                        "first_face": 0,
                        "faces": 40,
                    }
                    for c in surface.caps
                ],
                "deviation_mm": {"mean": 0.041, "p95": 0.112, "max": 0.287},
            },
            "endpoints": [{"label": "E1", "point_mm": points[0].tolist(), "radius_mm": 1.9, "confidence": 0.97}],
            "centerline_radius_min": {"radius_mm": float(radius.min()), "at_mm": 71.2, "point_mm": points[264].tolist()},
            "warnings": [],
            "walk": {
                "steps": [
                    {
                        "kind": kind,
                        "s_mm": float(arc[k]),
                        "turn_deg": 42.3,
                        "clock_h": 3,
                        "roll_deg": roll,
                        "direction": [0.0, -0.6, 0.8],
                        "toward": "superior and anterior" if ct else None,
                        "other_openings_clock_h": openings,
                    }
                    for kind, k, roll, openings in (("junction", 150, 90.2, [8, 12]), ("bend", 330, -31.7, []))
                ]
            },
        },
        "timings_s": {"read": 0.61, "grow": 0.38, "surface": 0.94, "centerline": 1.52, "plan": 0.12},
        "provenance": {
            "software": "tubeplan",
            "version": "0.1.0",
            "inputs": [{"name": "ct-series", "sha256": "7c" * 32}],
            "rng_seed": 7,
            "settings": {"planner": {"sigma": 0.001, "T1": 1.9}},
            "created_utc": "2026-11-22T00:58:00Z",
            "platform": "Linux, Python 3.11.2",
        },
    }
    result.update(changes)
    curve = GrowthCurve(
        varied="hu_min",
        limits=np.arange(300.0, 100.0, -10.0),
        volumes_ml=4.0 + 80.0 / (1.0 + np.exp((np.arange(300.0, 100.0, -10.0) - 160.0) / 8.0)),
        chosen=210.0,
        leak_limit=180.0,
        leak_voxel=(1, 2, 3),
        leak_point=points[100],
    )
    region = Region(
        mask=np.ones((3, 3, 3), bool),
        lower=(0, 0, 0),
        seed=(1, 1, 1),
        hu_min=210.0,
        hu_max=3000.0,
        volume_ml=4.4,
        border={},
        curve=curve,
    )
    return Review(
        case_id=case_id,
        result=result,
        surface=surface,
        volume=painted(neck) if ct else None,
        region=region if ct else None,
        facts={"Series": "CT, 120 slices", "Voxel": "0.80 × 0.80 × 1.25 mm", "Surface": "38\u202f480 triangles, closed"}
        if ct
        else {"File": "tube.stl", "Surface": "38\u202f480 triangles, closed"},
        first=first,
        last=path,
        film=filmed(neck) if film else None,
    )


def serious(page: Any, rules: Sequence[str] = ()) -> list[str]:
    """Serious and critical faults that axe-core finds, as ``rule: element``; of some rules or of all."""
    only = {"runOnly": list(rules)} if rules else {}
    found = Axe().run(page, options={"resultTypes": ["violations"], **only}).response["violations"]
    return [
        f"{fault['id']}: {node['target']} {node['failureSummary'][:160]}"
        for fault in found
        if fault["impact"] in ("serious", "critical")
        for node in fault["nodes"][:3]
    ]


@pytest.fixture(scope="session")
def hard_to_read() -> Callable[[Any], list[str]]:
    """Serious faults of an open page in both themes and on a phone, where it is left.

    Only colours change with the theme, with the width also what a finger meets and what scrolls: rules of those alone are asked.
    """

    def found(page: Any) -> list[str]:
        faults = serious(page)
        page.emulate_media(color_scheme="dark")
        page.wait_for_timeout(100)
        faults += serious(page, ["color-contrast"])
        page.set_viewport_size({"width": 390, "height": 844})
        page.wait_for_timeout(100)
        return faults + serious(page, ["target-size", "scrollable-region-focusable", "color-contrast", "list"])

    return found


@pytest.fixture(scope="session")
def make_review() -> Callable[..., Review]:
    return build_review
