"""Real scanners' series against what is known of them and against SimpleITK where that is right."""

from __future__ import annotations

import re

import numpy as np
import pytest
import SimpleITK as sitk

from segmentation.dicom import FILL_HU, inspect_folder, read_series
from segmentation.dicom.outliers import judge_slices

# name, shape, (slice, row, column) spacing mm, HU range, Patient position, where from: each case's own notes.
CASES = [
    ("cmb_crc_chest_ct", (100, 512, 512), (2.5, 0.898438, 0.898438), (-1024, 3071), "FFS"),
    ("lungfcp_trachea_ct", (98, 160, 192), (1.0, 0.759766, 0.759766), (-1024, 3071), "HFS"),
    ("cip_ct64_dicom", (79, 64, 64), (3.987, 4.171872, 4.171872), (-1007, 1095), "HFS"),
    ("totalseg_dicom_j2k", (20, 512, 512), (2.0, 0.9765625, 0.9765625), (-1024, 1839), "HFS"),
]


@pytest.mark.parametrize(("name", "shape", "spacing", "hu", "lying"), CASES, ids=[case[0] for case in CASES])
def test_a_real_series_equals_what_simpleitk_reads(name, shape, spacing, hu, lying, real_ct):
    folder = real_ct(name)
    if name == "totalseg_dicom_j2k":
        pytest.importorskip("openjpeg")
    read = read_series(folder)
    volume = read.volume
    assert volume.voxels.shape == shape
    assert volume.spacing == pytest.approx(spacing, abs=1e-3)  # the notes give three decimals
    assert (volume.voxels.min(), volume.voxels.max()) == hu
    assert read.facts["Patient position"].startswith(lying)
    assert read.files == shape[0]

    files = sorted(file for file in folder.rglob("*") if file.is_file() and file.suffix not in (".md", ".png"))
    headers = [sitk.ReadImage(str(file)) for file in (files[0], files[1], files[shape[0] // 2], files[-1])]
    for k in range(len(headers)):
        index = volume.to_index(headers[k].GetOrigin())
        # cip's gaps vary from 3.986 to 3.988 mm, so its slices lie up to 0.001 mm off the uniform stack.
        assert index == pytest.approx([round(index[0]), 0, 0], abs=1e-3)
        theirs = sitk.GetArrayFromImage(headers[k])[0]
        ours = volume.voxels[round(index[0])]
        seen = theirs > -2000  # padding reads -3024 there and -1024 here
        assert np.array_equal(ours[seen], theirs[seen])
        assert np.all(ours[~seen] == FILL_HU)
        corner = headers[k].TransformIndexToPhysicalPoint((shape[2] - 1, shape[1] - 1, 0))
        assert volume.to_lps([round(index[0]), shape[1] - 1, shape[2] - 1]) == pytest.approx(corner, abs=2e-3)


def test_padding_outside_the_scan_circle_is_masked(real_ct):
    read = read_series(real_ct("cmb_crc_chest_ct"))
    assert read.warnings == ()
    assert read.facts["Padding"] == "5577200 voxels outside the scan (declared value), read as -1024 HU"
    assert read.padding.count == 5577200
    # The corners a circle leaves of a square: 1 - pi/4 = 21.5 %.
    assert 5577200 / read.volume.voxels.size == pytest.approx(1 - np.pi / 4, abs=0.005)
    assert read.facts["Contrast agent"] == "yes"


def test_inspection_of_a_stripped_compressed_series(real_ct):
    report = inspect_folder(real_ct("totalseg_dicom_j2k"))
    (series,) = report["series"]
    assert series["transfer_syntax"]["name"] == "JPEG 2000 Lossless"
    assert series["geometry"]["shape"] == [20, 512, 512]
    assert series["geometry"]["residual_mm"] < 1e-6
    assert series["faults"] == []
    assert report["ignored_files"] >= 1  # the notes and the picture beside the series


DAMAGE = {
    "blank": (lambda plane: np.full_like(plane, -1024), "is blank"),
    "swapped bytes": (lambda plane: plane.byteswap(), "rough from pixel to pixel"),
    "bit 11 flipped in 0.1 %": (
        lambda plane: plane ^ (np.where(np.random.default_rng(1).random(plane.shape) < 0.001, 1 << 11, 0).astype(np.int16)),
        "[0-9]+ lone pixels 1500 HU off",
    ),
    "rows shifted": (lambda plane: np.roll(plane, plane.shape[0] // 8, axis=0), "differs .* times more from its neighbours"),
    "bit 8 flipped throughout": (lambda plane: plane ^ np.int16(1 << 8), r"rough from pixel|differs .* times more"),
}


@pytest.fixture(scope="module")
def trachea(real_ct):
    """30 of the trachea's slices."""
    return read_series(real_ct("lungfcp_trachea_ct")).volume.voxels[30:60]


@pytest.mark.parametrize("damage", DAMAGE)
@pytest.mark.parametrize("k", [0, 1, 15, 29])
def test_damage_in_a_real_slice_is_named_and_only_there(damage, k, trachea):
    voxels = trachea.copy()
    names = [f"slice {number}" for number in range(len(voxels))]
    assert judge_slices(voxels, names) == ([], [])
    spoil, message = DAMAGE[damage]
    voxels[k] = spoil(voxels[k])
    faults, doubts = judge_slices(voxels, names)
    (finding,) = faults + doubts
    assert faults or damage == "rows shifted", "all but a shift is refused, not only warned about"
    assert finding.startswith(f"slice {k} ")
    assert re.search(message, finding)


def test_two_damaged_neighbours_are_both_named(trachea):
    voxels = trachea.copy()
    voxels[14:16] = voxels[14:16].byteswap()
    faults, doubts = judge_slices(voxels, [f"slice {number}" for number in range(len(voxels))])
    assert [fault.split(" is")[0] for fault in faults] == ["slice 14", "slice 15"]
    assert doubts == []


def test_blank_ends_of_an_image_without_noise_are_no_damage():
    voxels = np.full((20, 40, 40), 40, dtype=np.int16)
    voxels[3:17, 18:22, 18:22] = 300
    assert judge_slices(voxels, [str(k) for k in range(20)]) == ([], [])
