"""What result.json tells beside the path, held against the case file, the mesh and itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.verify.mesh_file import MeshFile
from tubeplan_viz.verify.profile import ON_SURFACE_MM, OwnProfile
from tubeplan_viz.verify.verification import Check

SAME_MM = 1e-6  # computed twice in double precision from coordinates up to 1e3 mm
SAME_VOLUME = 1e-6  # relative; sums of as many products as there are faces
SAME_NORMAL = 1e-3  # a cap's faces lie in its plane up to the chamfer at their rim
END_MM = 1e-3  # the planners join their path to the places asked for within a micrometre


def check_told(result: Mapping[str, Any], case: Mapping[str, Any]) -> Iterator[Check]:
    """Settings, method, seed, version and name of the case, of every planner."""
    planner, provenance = result["planner"], result["provenance"]
    settings = provenance["settings"] or {}
    other = next(differences(settings, case, ""), None)
    yield Check(
        name="settings",
        ok=other is None,
        found=other or "the same",
        expected="as in case.toml",
        text="Every setting that the result tells is that of case.toml, with which the case is planned again.",
    )
    asked = case.get("planner", {})
    pairs = [
        ("version", planner["version"], provenance["version"]),
        ("method", planner["method"], asked.get("method", planner["method"])),
        ("random seed", provenance["rng_seed"], settings.get("planner", {}).get("rng_seed", provenance["rng_seed"])),
    ]
    if "case_id" in result["details"]:
        pairs.append(("name of the case", result["details"]["case_id"], case.get("input", {}).get("case_id") or "case"))
    wrong = [f"{what} {told!r} and {meant!r}" for what, told, meant in pairs if told != meant]
    yield Check(
        name="planner, seed and case",
        ok=not wrong,
        found="; ".join(wrong) or "the same",
        expected="the same wherever they are told",
        text="Version, method, random seed and the case's name are the same in the whole result and in case.toml.",
    )


def differences(told: Any, meant: Any, where: str) -> Iterator[str]:
    """The keys of `told` whose values are not those of `meant`; of a file the last part of its path is told."""
    if isinstance(told, Mapping):
        for key, value in told.items():
            place = f"{where}.{key}".lstrip(".")
            if not isinstance(meant, Mapping) or key not in meant:
                yield f"{place} {value!r}, which case.toml does not hold"
            else:
                yield from differences(value, meant[key], place)
    elif isinstance(told, list) and isinstance(meant, list) and len(told) == len(meant):
        for number, (one, other) in enumerate(zip(told, meant, strict=True), start=1):
            yield from differences(one, other, f"{where}.{number}")
    elif told != meant and not (isinstance(meant, str) and told == PurePosixPath(meant).name):
        yield f"{where} {told!r}, in case.toml {meant!r}"


def check_ground(result: Mapping[str, Any], mesh: MeshFile, own: OwnProfile) -> Iterator[Check]:
    """What the result tells of lumen, caps, end points, centerline, ends and rounds."""
    details = result["details"]
    if "surface" in details:
        yield from _surface(details["surface"], mesh)
    places = [
        (f"end point {end['label']}", end["point_mm"], end["radius_mm"])
        for end in details.get("endpoints", [])
        if "radius_mm" in end
    ]
    line = result["centerline"]
    if line is not None:
        rows = zip(line["points_mm"], line["radius_mm"], strict=True)
        places += [(f"centerline point {number}", point, radius) for number, (point, radius) in enumerate(rows, start=1)]
        narrow = details.get("centerline_radius_min")
        if narrow is not None:
            places.append(("narrowest place of the centerline", narrow["point_mm"], narrow["radius_mm"]))
            least = min(line["radius_mm"])
            yield Check(
                name="centerline: narrowest place",
                ok=abs(narrow["radius_mm"] - least) <= SAME_MM,
                found=f"{narrow['radius_mm']:.6f} mm",
                expected=f"{least:.6f} mm",
                text="The narrowest place is the one with the least radius of the centerline.",
            )
    if places:
        yield _radii(places, own)
    ends = [details[key] for key in ("start_mm", "goal_mm") if key in details]
    if len(ends) == 2:
        path = np.array(result["path"]["points_mm"], dtype=float)[[0, -1]]
        off = np.linalg.norm(path - np.array(ends, dtype=float), axis=1)
        yield Check(
            name="ends: as told",
            ok=bool(off.max() <= END_MM),
            found=f"{off[0]:.2g} and {off[1]:.2g} mm off",
            expected=f"at most {END_MM:g} mm",
            text="The path begins and ends where the result says.",
        )
    yield from _rounds(result)


def _surface(told: Mapping[str, Any], mesh: MeshFile) -> Iterator[Check]:
    corners = mesh.vertices[mesh.faces] - mesh.vertices.mean(axis=0)
    volume = float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6000.0
    stated = told.get("volume_ml")
    if stated is not None:
        yield Check(
            name="surface: volume",
            ok=abs(stated - volume) <= SAME_VOLUME * abs(volume),
            found=f"{stated:.6g} ml",
            expected=f"{volume:.6g} ml",
            text="The volume is what the faces of mesh.ply enclose.",
        )
    wrong = []
    for cap in told["caps"]:
        faces = corners[cap["first_face"] : cap["first_face"] + cap["faces"]]
        outward = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]).sum(axis=0)
        off = float(np.linalg.norm(np.array(cap["normal"], dtype=float) - outward / max(float(np.linalg.norm(outward)), 1e-300)))
        if off > SAME_NORMAL:
            wrong.append(f"{cap['label']} {off:.2g} off")
    yield Check(
        name="surface: directions of the caps",
        ok=not wrong,
        found=", ".join(wrong) or f"{len(told['caps'])} as measured",
        expected=f"unit vectors within {SAME_NORMAL:g} of the faces'",
        text="Each cap looks where its faces look.",
    )


def _radii(places: list[tuple[str, FloatArray, float]], own: OwnProfile) -> Check:
    points = np.array([point for _, point, _ in places], dtype=float)
    stated = np.array([radius for _, _, radius in places])
    measured = own.lumen.clearance(points, on_surface=ON_SURFACE_MM)[0]
    off = np.abs(stated - measured)
    worst = int(off.argmax())
    return Check(
        name="radii: of end points and centerline",
        ok=bool(off.max() <= SAME_MM),
        found=f"{stated[worst]:.6f} mm, {places[worst][0]}",
        expected=f"{measured[worst]:.6f} mm",
        text=f"Each of {len(places)} radii is the distance of its point to the triangles of the wall; the largest gap is shown.",
    )


def _rounds(result: Mapping[str, Any]) -> Iterator[Check]:
    """The iterations that are told: in order, with counts of 0 or more."""
    rounds = result["iterations"] or []
    if not rounds:
        return
    counted = [each["index"] for each in rounds] == list(range(rounds[0]["index"], rounds[0]["index"] + len(rounds)))
    whole = all(min(each["feature_count"], each["moved"], each["added"]) >= 0 for each in rounds)
    yield Check(
        name="iterations",
        ok=counted and whole,
        found="in order" if counted and whole else "not in order or with negative counts",
        expected=f"{len(rounds)} in order, counts of 0 or more",
        text="The rounds are told one after the other.",
    )
