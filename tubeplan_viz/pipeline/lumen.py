"""From a case's input to the wall of the lumen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from segmentation.errors import CaseError
from segmentation.images import read_ct, require_image
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.mesh import Surface
from segmentation.mesh_files import read_surface
from segmentation.region_growing import Region
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.volume import Volume
from tubeplan_viz.cases.fields import Place
from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.pipeline.progress import Stopwatch, silent


@dataclass(frozen=True, eq=False, kw_only=True)
class Lumen:
    """The wall that a case gives, and what it was made from.

    Attributes
    ----------
    surface : Surface
    volume, region : Volume and Region, or None for a mesh
    facts : mapping of str to str
        Image and surface facts as label and printed value.
    warnings : tuple of str
    inputs : tuple of (name, sha256)
    details : mapping
        For result.json: growth curve, deviation from the CT, seed.
    """

    surface: Surface
    volume: Volume | None
    region: Region | None
    facts: Mapping[str, str]
    warnings: tuple[str, ...]
    inputs: tuple[tuple[str, str], ...]
    details: Mapping[str, Any] = field(default_factory=dict)


def load_lumen(case: InputCase, *, near: Place | None = None, watch: Stopwatch | None = None) -> Lumen:
    """The wall of the lumen, from a CT or from a mesh file.

    Parameters
    ----------
    case : InputCase
    near : point or label, optional
        The start: of a mesh with several components the one that holds it is kept.
    watch : Stopwatch, optional

    Raises
    ------
    TubeplanError
        If the input cannot be read, or holds no tube.
    """
    watch = watch or Stopwatch(silent)
    return lumen_of_mesh(case, near, watch) if case.mesh is not None else lumen_of_ct(case, watch)


def lumen_of_mesh(case: InputCase, near: Place | None, watch: Stopwatch) -> Lumen:
    """Read a mesh file as the wall."""
    assert case.mesh is not None
    with watch.stage("read mesh"):
        given = read_surface(case.mesh, mesh_unit=case.mesh_unit, part=case.part, near=None if isinstance(near, str) else near)
    return Lumen(surface=given.surface, volume=None, region=None, facts=given.facts, warnings=given.warnings, inputs=given.inputs)


def lumen_of_ct(case: InputCase, watch: Stopwatch) -> Lumen:
    """Read a CT, grow the lumen and make its surface."""
    assert case.ct is not None
    require_image(case.ct)  # a wrong path is what is wrong, whatever else the case lacks
    settings = segmentation_settings(case)
    with watch.stage("read CT") as progress:
        image = read_ct(case.ct, series=case.series, progress=progress)
    with watch.stage("grow region") as progress:
        region = segment_lumen(image.volume, settings, progress=progress)
    with watch.stage("surface"):
        made = lumen_surface(image.volume, region, SurfaceSettings())
    deviation = {"mean": made.deviation.mean, "p95": made.deviation.p95, "max": made.deviation.max}
    seed = image.volume.to_lps(region.seed)
    facts = {
        **image.facts,
        "Lumen": f"{settings.anatomy}, grown from {region.hu_min:.0f} to {region.hu_max:.0f} HU, {region.volume_ml:.1f} ml",
        "Seed": "{:.1f}, {:.1f}, {:.1f} mm".format(*seed),
        "Surface": f"{len(made.surface.faces)} triangles, closed, {made.surface.volume_ml:.1f} ml",
        "Deviation from the CT": "mean {mean:.2f} mm, 95 % below {p95:.2f} mm, largest {max:.2f} mm".format(**deviation),
    }
    if region.border:
        facts["Cut by the image"] = ", ".join(f"{name} ({count} voxels)" for name, count in region.border.items())
    return Lumen(
        surface=made.surface,
        volume=image.volume,
        region=region,
        facts=facts,
        warnings=(*image.warnings, *unseen_wall(image.padding.touching(region)), *made.notes),
        inputs=image.inputs,
        details={
            "anatomy": settings.anatomy,
            "seed_mm": seed,
            "hu_min": region.hu_min,
            "hu_max": region.hu_max,
            "growth": growth_details(region),
            "deviation_mm": deviation,
        },
    )


def unseen_wall(padding: int) -> tuple[str, ...]:
    """What to know of a lumen with so many voxels of padding in it or beside it; padding elsewhere is no matter."""
    if not padding:
        return ()
    return (
        f"{padding} voxels in the lumen or at its wall lie outside what was scanned: "
        "the wall there is where the image ends, and the clearance towards it is unknown",
    )


def segmentation_settings(case: InputCase) -> SegmentationSettings:
    """Settings of region growing; without an anatomy, seed and limits must say everything."""
    anatomy = case.anatomy
    if anatomy is None:
        if case.seed_point is None or (case.hu_min is None and case.hu_max is None):
            raise CaseError(
                "a CT needs --anatomy (airway, urinary, vessel), which brings its own limits and seed, "
                "or a seed point and HU limits (--seed-point with --hu-min or --hu-max)"
            )
        anatomy = "generic"
    return SegmentationSettings(
        anatomy=anatomy,
        seed_point=case.seed_point,
        hu_min=case.hu_min,
        hu_max=case.hu_max,
        connectivity=case.connectivity,
        smoothing=case.smoothing_mm,
    )


def growth_details(region: Region) -> dict[str, Any] | None:
    """The growth curve for result.json, or None when both limits were given."""
    curve = region.curve
    if curve is None:
        return None
    return {
        "varied": curve.varied,
        "limits_hu": curve.limits,
        "volumes_ml": curve.volumes_ml,
        "chosen_hu": curve.chosen,
        "leak_limit_hu": curve.leak_limit,
        "leak_voxel": curve.leak_voxel,
        "leak_point_mm": curve.leak_point,
    }
