"""Volume files: every voxel at its LPS place, and what is no CT refused."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from scipy.spatial.transform import Rotation

from segmentation.dicom import FILL_HU, write_series
from segmentation.errors import TubeplanError, VolumeError
from segmentation.images import inspect_path, read_ct
from segmentation.volume import Volume

DATA = Path(__file__).parents[2].parent / "shared" / "data"
# HU per mm along L, P, S: different for each axis, so that no swap or flip goes unseen.
FIELD, AT_ORIGIN = np.array([8.0, 13.0, 17.0]), -100.0
SUFFIXES = [".nii", ".nii.gz", ".mha", ".mhd"]


def field_image(kind: int = sitk.sitkInt16, axes: np.ndarray | None = None) -> sitk.Image:
    """An image of 26 x 20 x 12 voxels that holds the field's value at every LPS point."""
    axes = np.eye(3) if axes is None else axes
    image = sitk.Image(26, 20, 12, sitk.sitkFloat64)
    spacing = np.array([0.7, 0.8, 1.5])
    centre = axes @ (spacing * (np.array([26, 20, 12]) - 1) / 2)
    image.SetSpacing(spacing)
    image.SetDirection(axes.ravel())
    image.SetOrigin(np.array([3.0, -2.0, 1.0]) - centre)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in (26, 20, 12)), indexing="ij"), axis=-1)
    points = (index * spacing) @ axes.T + image.GetOrigin()
    filled = sitk.GetImageFromArray(np.ascontiguousarray(np.rint(points @ FIELD + AT_ORIGIN).transpose(2, 1, 0)))
    filled.CopyInformation(image)
    return sitk.Cast(filled, kind)


def worst_error(volume: Volume) -> float:
    index = np.stack(np.meshgrid(*(np.arange(n) for n in volume.voxels.shape), indexing="ij"), axis=-1)
    return float(np.abs(volume.voxels - (volume.to_lps(index) @ FIELD + AT_ORIGIN)).max())


def saved(image: sitk.Image, path: Path) -> Path:
    sitk.WriteImage(image, str(path))
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("turn", [None, 1, 2])
def test_every_voxel_of_a_volume_file_is_in_its_place(suffix, turn, tmp_path):
    axes = np.eye(3) if turn is None else Rotation.random(rng=np.random.default_rng(turn)).as_matrix()
    image = read_ct(saved(field_image(axes=axes), tmp_path / f"case{suffix}"))
    # Rounding to whole HU is 0.5; NIfTI keeps axes and places in single precision.
    assert worst_error(image.volume) < 0.55
    assert image.volume.voxels.dtype == np.int16
    assert image.inputs[0][0] == f"case{suffix}"
    assert len(image.inputs) == (2 if suffix == ".mhd" else 1)


@pytest.mark.parametrize("kind", [sitk.sitkInt32, sitk.sitkFloat32, sitk.sitkFloat64])
def test_other_number_types_come_out_in_whole_hu(kind, tmp_path):
    assert worst_error(read_ct(saved(field_image(kind), tmp_path / "case.nii.gz")).volume) < 0.55


def test_a_mirrored_image_keeps_its_side(tmp_path):
    assert worst_error(read_ct(saved(field_image(axes=np.diag([-1.0, 1.0, 1.0])), tmp_path / "case.nii")).volume) < 0.55


def test_fill_far_below_air_becomes_air_and_is_a_fact(tmp_path):
    image = field_image()
    image[0:4, 0:4, :] = -3024
    read = read_ct(saved(image, tmp_path / "case.mha"))
    assert np.all(read.volume.voxels[:, :4, :4] == FILL_HU)
    assert read.warnings == ()
    assert read.facts["Padding"].startswith(f"{16 * 12} voxels outside the scan (undeclared value far below air)")
    assert read.padding.count == 16 * 12


def spaced(x: float) -> sitk.Image:
    image = field_image()
    image.SetSpacing([x, 0.8, 1.5])
    return image


def with_nan() -> sitk.Image:
    image = field_image(sitk.sitkFloat32)
    image[3, 3, 3] = float("nan")
    return image


REFUSED = {
    "four dimensions": (lambda: sitk.JoinSeries([field_image(), field_image()]), "has 4 dimensions, expected 3"),
    "a slice": (lambda: field_image()[:, :, 0:1], "has 26 x 20 x 1 voxels, expected at least 3"),
    "colours": (lambda: sitk.Compose(field_image(), field_image()), "has 2 values per voxel, expected 1"),
    "eight bits": (lambda: sitk.Cast(field_image() > 0, sitk.sitkUInt8), "which cannot hold HU"),
    "a mask": (lambda: sitk.Cast(field_image() > 0, sitk.sitkInt16), "values span only 0 to 1"),
    "metres": (lambda: spaced(0.0007), "has voxels of 0.0007 x 0.8 x 1.5 mm, expected 0.05 to 5 mm"),
    "decimetres": (lambda: spaced(70.0), "has voxels of 70 x 0.8 x 1.5 mm"),
    "not a number": (with_nan, "holds values that are not finite"),
    "no intercept": (lambda: field_image() + 1024, "the rescale is wrong or missing"),
    "intercept twice": (lambda: field_image() - 1424, "air is -1000; the rescale is wrong"),
}


@pytest.mark.parametrize("suffix", [".nii.gz", ".mha"])
@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_ct_is_refused(name, suffix, tmp_path):
    make, message = REFUSED[name]
    path = saved(make(), tmp_path / f"case{suffix}")
    with pytest.raises(VolumeError, match=message) as caught:
        read_ct(path)
    assert str(caught.value).startswith(f"case{suffix}: ")
    assert str(tmp_path) not in str(caught.value)
    report = inspect_path(path)
    assert not report["usable"]
    assert report["faults"] == [str(caught.value).removeprefix(f"case{suffix}: ")]


def test_a_nifti_that_does_not_say_how_it_lies_is_refused(tmp_path):
    path = saved(field_image(), tmp_path / "case.nii")
    raw = bytearray(path.read_bytes())
    raw[252:256] = bytes(4)  # qform_code and sform_code, NIfTI-1 header
    path.write_bytes(raw)
    with pytest.raises(VolumeError, match="does not say how it lies in the patient"):
        read_ct(path)


@pytest.mark.parametrize(("field", "shift"), [(280, -2.0), (280 + 12, 3.0)], ids=["left and right", "three mm"])
def test_a_nifti_that_says_twice_how_it_lies_is_refused_unless_both_agree(field, shift, tmp_path):
    path = saved(field_image(), tmp_path / "case.nii")
    raw = bytearray(path.read_bytes())
    assert (np.frombuffer(raw, "<i2", 2, 252) > 0).all()  # SimpleITK writes qform and sform, and they agree
    read_ct(path)
    row = np.frombuffer(raw, "<f4", 1, field)[0]
    raw[field : field + 4] = np.float32(row + shift).tobytes()
    path.write_bytes(raw)
    with pytest.raises(VolumeError, match="says twice how it lies in the patient, and its qform and sform are up to"):
        read_ct(path)
    raw[252:254] = bytes(2)  # only sform_code is left
    path.write_bytes(raw)
    if field == 280 + 12:  # the first row's shift; the flip would leave axes of other lengths
        moved = read_ct(path).volume.index_to_lps
        assert (
            abs(np.abs(moved[0, 3] - read_ct(saved(field_image(), tmp_path / "first.nii")).volume.index_to_lps[0, 3]) - 3.0)
            < 1e-4
        )


@pytest.mark.parametrize("key", ["ElementSpacing", "TransformMatrix", "Offset"])
def test_a_metaimage_that_leaves_its_geometry_out_is_refused(key, tmp_path):
    path = saved(field_image(), tmp_path / "case.mhd")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith(key)))
    with pytest.raises(VolumeError, match=rf"does not say .* \({key} is missing\)"):
        read_ct(path)


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".mha"])
@pytest.mark.parametrize("part", [0.0, 0.02, 0.5, 0.99])
def test_a_cut_file_is_refused(suffix, part, tmp_path):
    path = saved(field_image(), tmp_path / f"case{suffix}")
    raw = path.read_bytes()
    path.write_bytes(raw[: int(len(raw) * part)])
    with pytest.raises(VolumeError, match="save it again"):
        read_ct(path)


def test_skewed_axes_are_refused(tmp_path):
    path = saved(field_image(), tmp_path / "case.mha")
    path.write_bytes(path.read_bytes().replace(b"TransformMatrix = 1 0 0 0 1 0", b"TransformMatrix = 1 0 0 .5 1 0"))
    with pytest.raises(VolumeError, match="not perpendicular"):
        read_ct(path)


@pytest.mark.parametrize("target", ["../other.raw", "/etc/hostname", "LIST", "part%02d.raw 1 12 1"])
def test_a_header_that_reads_from_elsewhere_is_refused(target, tmp_path):
    folder = tmp_path / "case"
    folder.mkdir()
    path = saved(field_image(), folder / "case.mhd")
    (tmp_path / "other.raw").write_bytes((folder / "case.raw").read_bytes())
    path.write_text(path.read_text().replace("ElementDataFile = case.raw", f"ElementDataFile = {target}"))
    with pytest.raises(VolumeError, match=r"outside of its folder|several files"):
        read_ct(path)


def test_a_header_that_reads_from_a_link_is_refused(tmp_path):
    folder = tmp_path / "case"
    folder.mkdir()
    path = saved(field_image(), folder / "case.mhd")
    (folder / "case.raw").rename(tmp_path / "other.raw")
    with pytest.raises(VolumeError, match=r"voxel file case\.raw is not there"):
        read_ct(path)
    (folder / "case.raw").symlink_to(tmp_path / "other.raw")
    with pytest.raises(VolumeError, match="from a link"):
        read_ct(path)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("case.zip", "is an archive; unpack it first"),
        ("case.tar.xz", "is an archive; unpack it first"),
        ("DICOMDIR", "only a directory of images"),
        ("case.jpg", r"neither DICOM nor a volume file \(.nii, .nii.gz, .mha, .mhd\)"),
        ("case", "neither DICOM nor a volume file"),
    ],
)
def test_other_files_are_refused_by_what_they_are(name, message, tmp_path):
    (tmp_path / name).write_bytes(b"something")
    for look in (read_ct, inspect_path):
        with pytest.raises(VolumeError, match=message):
            look(tmp_path / name)


@pytest.mark.parametrize("name", ["nothing", "nothing.nii.gz", "nothing.mha"])
def test_a_path_that_is_not_there_is_named(name, tmp_path):
    with pytest.raises(VolumeError, match=f"{name}: there is no such file"):
        read_ct(tmp_path / name)


def test_a_series_cannot_be_named_in_a_volume_file(tmp_path):
    with pytest.raises(VolumeError, match="leave out --series 2"):
        read_ct(saved(field_image(), tmp_path / "case.nii"), series="2")


def test_a_written_series_comes_back(tmp_path):
    volume = read_ct(saved(field_image(), tmp_path / "case.mha")).volume
    write_series(volume, tmp_path / "series")
    image = read_ct(tmp_path / "series")
    assert worst_error(image.volume) < 0.55
    assert image.inputs[0][0] == "DICOM series, 12 files"
    report = inspect_path(tmp_path / "series")
    assert report == json.loads(json.dumps(report))
    assert report["kind"] == "dicom"


def test_a_folder_of_text_is_refused_without_its_path(tmp_path):
    (tmp_path / "case").mkdir()
    (tmp_path / "case" / "a.txt").write_text("hello")
    with pytest.raises(TubeplanError, match="case: holds no DICOM image"):
        read_ct(tmp_path / "case")


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data are not beside the repository")
def test_a_real_nifti_is_turned_from_ras_to_lps():
    path = DATA / "totalseg_abdomen_ct" / "example_ct.nii.gz"
    image = read_ct(path)
    assert image.volume.voxels.shape == (112, 101, 122)
    assert (image.volume.voxels.min(), image.volume.voxels.max()) == (-1207, 3382)
    # The sform in the file's own header, by NIfTI-1's byte offsets, maps (i, j, k) to RAS.
    raw = gzip.decompress(path.read_bytes())[:352]
    sform = np.frombuffer(raw, "<f4", 12, 280).reshape(3, 4)
    for index in ([0, 0, 0], [111, 100, 121], [10, 20, 30]):
        ras = sform @ [index[2], index[1], index[0], 1.0]
        assert image.volume.to_lps(index) == pytest.approx([-ras[0], -ras[1], ras[2]], abs=1e-3)


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data are not beside the repository")
def test_a_real_metaimage_lies_where_its_header_says():
    image = read_ct(DATA / "elastix_right_lung" / "3DCT_lung.mha")
    assert image.volume.voxels.shape == (129, 157, 115)
    assert image.volume.to_lps([0, 0, 0]) == pytest.approx([-153.827, -150.352, -1434.5], abs=1e-3)
    assert image.volume.spacing == pytest.approx([2.5, 1.366, 1.366], abs=1e-3)
    assert image.facts["HU range"] == "-1255 to 1474 HU"
