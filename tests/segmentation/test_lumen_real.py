"""Real CT: the airway without a hand-picked threshold, and what must be refused."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from segmentation.archive import unpack as unpack_archive
from segmentation.errors import RegionError
from segmentation.images import read_ct
from segmentation.lumen import SegmentationSettings, measure_shape, segment_lumen
from segmentation.surface import SurfaceSettings, lumen_surface
from segmentation.synthetic.urography import urography
from segmentation.volume import Volume

DATA = Path(__file__).parents[2].parent / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the shared data folder is not beside the repository")

# Name, archive or file, least and greatest grown volume in ml, caps, axes of the image faces it opens to.
AIRWAYS = [
    ("cmb_crc_chest_ct", "dicom_original.tar.xz", 30.0, 45.0, 0, set()),
    ("lungfcp_trachea_ct", "dicom_cropped.tar.xz", 18.0, 22.0, 1, {"slice"}),
    ("cip_ct64_dicom", "dicom.tar.xz", 15.0, 18.0, 1, {"slice"}),
    ("elastix_right_lung", "3DCT_lung.mha", 23.6, 27.8, 2, {"column"}),
]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ct")


def volume_of(name: str, file: str, folder: Path) -> Volume:
    source = DATA / name / file
    if source.suffix != ".xz":
        return read_ct(source).volume
    unpack_archive(source, folder / name)
    return read_ct(next(path for path in (folder / name).iterdir() if path.is_dir())).volume


@cache
def abdomen() -> Volume:
    return read_ct(DATA / "totalseg_abdomen_ct" / "example_ct.nii.gz").volume


@needs_data
@pytest.mark.parametrize(("name", "file", "least", "most", "caps", "border"), AIRWAYS, ids=[case[0] for case in AIRWAYS])
def test_an_airway_is_found_grown_without_leak_and_closed(
    name: str, file: str, least: float, most: float, caps: int, border: set[str], unpacked: Path
) -> None:
    volume = volume_of(name, file, unpacked)
    region = segment_lumen(volume, SegmentationSettings(anatomy="airway"))
    assert least <= region.volume_ml <= most
    assert {face.split()[1] for face in region.border} == border
    assert region.curve is not None
    if region.curve.leak_limit is not None:
        assert region.curve.leak_limit - region.hu_max >= 20
        assert region.curve.leak_voxel is not None
        # The gate holds air that the limit of the leak lets in, and the chosen limit keeps out.
        box = tuple(slice(lo, lo + n) for lo, n in zip(region.lower, region.mask.shape, strict=True))
        whole = np.zeros(volume.voxels.shape, dtype=bool)
        whole[box] = region.mask
        assert not whole[region.curve.leak_voxel]
    result = lumen_surface(volume, region, SurfaceSettings())
    surface = result.surface
    walks = np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]])
    forth, back = np.unique(walks, axis=0), np.unique(walks[:, ::-1], axis=0)
    assert len(forth) == len(walks)
    np.testing.assert_array_equal(forth, back)
    assert surface.volume_ml > 0
    assert len(surface.caps) == caps
    # Smoothing moves the wall by a fifth of a voxel in 95 of 100 places.
    assert result.deviation.p95 < 0.2 * volume.spacing.max()
    if name == "elastix_right_lung":
        assert any("(last column) cuts the lumen lengthwise" in note for note in result.notes)


@needs_data
def test_the_lung_leak_of_a_loose_limit_is_refused(unpacked: Path) -> None:
    volume = volume_of(*AIRWAYS[3][:2], unpacked)
    with pytest.raises(RegionError, match="the region leaks: between -1024 and -870 HU it holds more than 150 ml"):
        segment_lumen(volume, SegmentationSettings(anatomy="airway", hu_max=-870))


@needs_data
def test_an_abdomen_has_no_trachea_and_no_collecting_system() -> None:
    with pytest.raises(RegionError, match="no trachea found"):
        segment_lumen(abdomen(), SegmentationSettings(anatomy="airway"))
    with pytest.raises(RegionError):
        segment_lumen(abdomen(), SegmentationSettings(anatomy="urinary"))


@needs_data
@pytest.mark.parametrize("limit", [-700.0, "auto"])
def test_gas_in_the_colon_is_refused_as_a_blob(limit: float | str) -> None:
    volume = abdomen()
    x, y, z = (float(v) for v in volume.to_lps((80, 78, 79)))
    with pytest.raises(RegionError, match="is a blob and no tube"):
        segment_lumen(volume, SegmentationSettings(anatomy="generic", seed_point=(x, y, z), hu_max=limit))


@needs_data
@pytest.mark.parametrize("anatomy", ["vessel", "urinary", "generic"])
def test_bone_stones_and_metal_are_refused_from_any_seed(anatomy: str) -> None:
    volume = abdomen()
    labels, _ = ndimage.label(volume.voxels >= 300)
    sizes = np.bincount(labels.ravel())
    reasons = set()
    for part in np.argsort(sizes[1:])[::-1][:12] + 1:
        index = np.argwhere(labels == part)
        brightest = index[np.argmax(volume.voxels[tuple(index.T)])]
        x, y, z = (float(v) for v in volume.to_lps(brightest))
        hu_min = 300.0 if anatomy == "generic" else None
        with pytest.raises(RegionError) as refused:
            segment_lumen(volume, SegmentationSettings(anatomy=anatomy, seed_point=(x, y, z), hu_min=hu_min))
        reasons.add(str(refused.value).split(":")[0])
    assert len(reasons) > 1


def test_the_collecting_system_of_the_urography_is_found_and_measured() -> None:
    case = urography()
    volume, truth = case.volume, case.truth
    region = segment_lumen(volume, SegmentationSettings(anatomy="urinary"))
    assert float(truth.clearance(volume.to_lps(region.seed))[0]) > 3.0  # in the pelvis
    assert {face.split()[1] for face in region.border} == {"slice"}
    shape = measure_shape(volume, region)
    assert shape.tunnels == 0
    result = lumen_surface(volume, region, SurfaceSettings())
    assert [cap.origin for cap in result.surface.caps] == ["image border"]
    wall = result.surface.vertices[np.unique(result.surface.wall_faces)][::7]
    error = truth.clearance(wall)
    # A voxel is 0.75 mm: half of the wall within a quarter of it, nine tenths within one.
    assert np.abs(np.median(error)) < 0.19
    assert np.percentile(error, 5) > -0.75
    assert np.percentile(error, 95) < 0.75
    # Every calyx is reached: the goal in front of each papilla lies in the grown mask.
    for name, goal in truth.goals:
        index = np.round(volume.to_index(goal)).astype(int) - region.lower
        assert np.all((index >= 0) & (index < region.mask.shape)), name
        assert region.mask[tuple(index)], name
