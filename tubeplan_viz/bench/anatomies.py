"""Ways through real and generated anatomy for the benchmarks: every end point of every data set at hand."""

# Strategy: the generated urography is made in place; the shared data are read where their folder stands beside the
# source tree, and their archives are unpacked for the time of one benchmark only. Each goes through the front end as
# a case of a user would, and the ways lead from its root to each of the other end points.

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from segmentation.archive import unpack as unpack_archive
from segmentation.arrays import FloatArray
from segmentation.mesh import Surface
from segmentation.synthetic.urography import write_demo_series
from tubeplan_viz.cases.inputs import InputCase
from tubeplan_viz.centerline import Endpoint
from tubeplan_viz.pipeline import Tree, entered_tree, load_lumen
from tubeplan_viz.plan import Limits

SHARED = Path(__file__).parents[2].parent / "shared" / "data"
# Table 1 of Dai et al. (2024), row renal: section radius 1.2 mm, least bend radius 8 mm.
RENAL = Limits(curvature_max=0.125, clearance_min=1.2)
# A thin bronchoscope of 4 mm with the same bend radius.
AIRWAY = Limits(curvature_max=0.125, clearance_min=2.0)
# Share of the height above which the tips of a HuBMAP ureter are calyces and not bulges of the ureter.
KIDNEY_SHARE = 0.6


@dataclass(frozen=True, eq=False, kw_only=True)
class Anatomy:
    """One data set made ready for planning, with the ways that lead through it.

    Attributes
    ----------
    name : str
    tree : Tree
    start : (3,) float array, mm
    goals : tuple of (label, (3,) float array in mm)
    limits : Limits
    """

    name: str
    tree: Tree
    start: FloatArray
    goals: tuple[tuple[str, FloatArray], ...]
    limits: Limits


def anatomies(names: tuple[str, ...] | None = None) -> Iterator[Anatomy]:
    """The data sets at hand, one after another; only those named, where names are given."""
    for name, (source, anatomy, limits) in SOURCES.items():
        if names is not None and name not in names:
            continue
        if source is not None and not (SHARED / source).exists():
            continue
        with tempfile.TemporaryDirectory() as temporary:
            surface = read_lumen(None if source is None else SHARED / source, anatomy, Path(temporary))
        tree = entered_tree(surface, anatomy)
        start, goals = ways(tree.endpoints) if name.startswith("HuBMAP ureter") else from_root(tree.endpoints)
        yield Anatomy(name=name, tree=tree, start=start, goals=goals, limits=limits)


# Name: file or archive in the shared data (none: the generated urography), anatomy of a CT, limits.
SOURCES: dict[str, tuple[str | None, str | None, Limits]] = {
    "generated urography": (None, "urinary", RENAL),
    "HuBMAP ureter L": ("hubmap_ureter_female/fused_F_L_mm.stl", None, RENAL),
    "HuBMAP ureter R": ("hubmap_ureter_female/fused_F_R_mm.stl", None, RENAL),
    "HuBMAP airway": ("hubmap_airway_female/fused_airway_F_mm.stl", None, AIRWAY),
    "cmb_crc": ("cmb_crc_chest_ct/dicom_original.tar.xz", "airway", AIRWAY),
    "lungfcp": ("lungfcp_trachea_ct/dicom_cropped.tar.xz", "airway", AIRWAY),
    "cip_ct64": ("cip_ct64_dicom/dicom.tar.xz", "airway", AIRWAY),
    "elastix": ("elastix_right_lung/3DCT_lung.mha", "airway", AIRWAY),
}


def read_lumen(source: Path | None, anatomy: str | None, folder: Path) -> Surface:
    """The wall of one data set; archives are unpacked into the folder."""
    if anatomy is None:
        return load_lumen(InputCase(mesh=source)).surface
    if source is None:
        write_demo_series(folder)
        source = folder
    elif source.name.endswith(".tar.xz"):
        unpack_archive(source, folder)
        source = next(file for file in sorted(folder.rglob("*")) if file.is_file()).parent
    return load_lumen(InputCase(ct=source, anatomy=anatomy)).surface


def from_root(tips: tuple[Endpoint, ...]) -> tuple[FloatArray, tuple[tuple[str, FloatArray], ...]]:
    """From the root to every other tip."""
    return tips[0].point, tuple((tip.label, tip.point) for tip in tips[1:])


def ways(tips: tuple[Endpoint, ...]) -> tuple[FloatArray, tuple[tuple[str, FloatArray], ...]]:
    """From the lowest tip, the ureter's orifice, to every tip in the kidney (y is up in these meshes)."""
    ordered = sorted(tips, key=lambda tip: float(tip.point[1]))
    low, high = float(ordered[0].point[1]), float(ordered[-1].point[1])
    calyces = [tip for tip in ordered if tip.point[1] > low + KIDNEY_SHARE * (high - low)]
    return ordered[0].point, tuple((tip.label, tip.point) for tip in calyces)
