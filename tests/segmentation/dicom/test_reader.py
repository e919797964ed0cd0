"""Sound series: every voxel ends at its place with its value, however the series is stored."""

from __future__ import annotations

import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydicom import dcmwrite
from pydicom.dataset import Dataset, FileDataset
from pydicom.sequence import Sequence
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    EnhancedCTImageStorage,
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
)
from scipy.spatial.transform import Rotation

from segmentation.dicom import FILL_HU, read_series, scan_folder
from segmentation.errors import SeriesError

ORIENTATIONS = {
    "axial": [1, 0, 0, 0, 1, 0],
    "axial prone": [-1, 0, 0, 0, -1, 0],
    "axial seen from above": [1, 0, 0, 0, -1, 0],
    "coronal": [1, 0, 0, 0, 0, -1],
    "sagittal": [0, 1, 0, 0, 0, -1],
    "sagittal, rows and columns swapped": [0, 0, -1, 0, 1, 0],
}


@pytest.mark.parametrize("name", ORIENTATIONS)
@pytest.mark.parametrize("order", ["rising", "falling", "shuffled"])
def test_every_voxel_is_in_its_place(name, order, maker, tmp_path, lies_in_place):
    slices = maker.slices(orientation=ORIENTATIONS[name], PatientPosition="FFS" if order == "falling" else "HFS")
    if order == "falling":
        slices.reverse()
    elif order == "shuffled":
        slices = [slices[k] for k in np.random.default_rng(3).permutation(len(slices))]
    volume = read_series(maker.save(tmp_path / "case", slices)).volume
    assert volume.voxels.shape == maker.shape
    assert volume.spacing == pytest.approx(maker.spacing, abs=1e-4)  # positions are written to 1e-5 mm
    assert np.linalg.det(volume.index_to_lps[:3, :3]) > 0  # slice axis is column x row
    lies_in_place(volume)


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), gap=st.floats(0.3, 4.9))
def test_oblique_stacks_of_any_spacing_lie_in_place(seed, gap, maker, tmp_path_factory, lies_in_place):
    axes = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    slices = maker.slices(orientation=[*axes[:, 0], *axes[:, 1]], depths=np.arange(8) * gap)
    lies_in_place(read_series(maker.save(tmp_path_factory.mktemp("case"), slices)).volume)


def test_small_unevenness_is_taken_with_its_residual_below_the_limit(maker, tmp_path):
    depths = np.arange(8) * 1.5 + [0, 0.05, -0.05, 0.05, 0, 0.1, 0, 0]
    read = read_series(maker.save(tmp_path / "case", maker.slices(depths=depths)))
    assert read.volume.spacing[0] == pytest.approx(1.5, abs=1e-4)


@pytest.mark.parametrize("syntax", [ImplicitVRLittleEndian, ExplicitVRBigEndian, DeflatedExplicitVRLittleEndian])
def test_uncompressed_codings_give_the_same_volume(syntax, maker, tmp_path, lies_in_place, stored_values):
    get_stored, _ = stored_values
    folder = tmp_path / "case"
    folder.mkdir()
    for k, slice_ in enumerate(maker.slices()):
        if syntax == ExplicitVRBigEndian:
            slice_.PixelData = get_stored(slice_).astype(">i2").tobytes()
        bare = Dataset(slice_)  # a plain data set forgets how it was to be written
        bare.file_meta = slice_.file_meta
        bare.file_meta.TransferSyntaxUID = syntax
        dcmwrite(
            folder / f"{k}.dcm",
            bare,
            implicit_vr=syntax == ImplicitVRLittleEndian,
            little_endian=syntax != ExplicitVRBigEndian,
            enforce_file_format=True,
        )
    lies_in_place(read_series(folder).volume)


@pytest.mark.parametrize(
    ("bits", "signed", "slope", "intercept"),
    [(12, 0, 1, -1024), (16, 0, 1, -8192), (16, 1, 1, 0), (12, 1, 1, 0), (16, 1, 0.25, -1000), (16, 0, 2, -2000)],
)
def test_every_way_of_storing_gives_the_same_hounsfield_units(
    bits, signed, slope, intercept, maker, tmp_path, lies_in_place, stored_values
):
    get_stored, set_stored = stored_values
    slices = maker.slices()
    for slice_ in slices:
        hu = get_stored(slice_) - 1024.0
        slice_.BitsStored, slice_.HighBit, slice_.PixelRepresentation = bits, bits - 1, signed
        slice_.RescaleSlope, slice_.RescaleIntercept = slope, intercept
        set_stored(slice_, np.rint((hu - intercept) / slope).astype(int) & ((1 << bits) - 1))
    # Steps of the slope add at most half of it to the rounding to whole HU.
    lies_in_place(read_series(maker.save(tmp_path / "case", slices)).volume, tolerance=0.52 + 0.5 * slope)


def test_values_beyond_sixteen_bits_are_clipped_and_said(maker, tmp_path, stored_values):
    get_stored, set_stored = stored_values
    slices = maker.slices(PixelRepresentation=0)
    for slice_ in slices:
        stored = get_stored(slice_)
        stored[5:7, 5:7] = 60000
        set_stored(slice_, stored)
    read = read_series(maker.save(tmp_path / "case", slices))
    assert np.all(read.volume.voxels[:, 5:7, 5:7] == 32767)
    assert "32 voxels beyond the range -32768 to 32767 HU were clipped to it" in read.warnings


@pytest.mark.parametrize("written", [-2000, 63536], ids=["as SS", "as US"])
def test_padding_becomes_air_and_is_a_fact(written, maker, tmp_path, stored_values):
    get_stored, set_stored = stored_values
    slices = maker.slices()
    for slice_ in slices:
        stored = get_stored(slice_)
        stored[:4, :5] = -2000
        set_stored(slice_, stored)
        slice_.add_new(0x00280120, "US" if written > 0 else "SS", written)
    read = read_series(maker.save(tmp_path / "case", slices))
    assert np.all(read.volume.voxels[:, :4, :5] == FILL_HU)
    assert read.volume.voxels[:, 4:].min() > -1000
    # It decides nothing by itself: a fact of the image and no warning.
    assert read.warnings == ()
    assert read.facts["Padding"] == "160 voxels outside the scan (declared value), read as -1024 HU"
    assert read.padding.count == 160
    expected = np.zeros(read.volume.voxels.shape[1:], dtype=bool)
    expected[:4, :5] = True
    for number in range(len(slices)):
        np.testing.assert_array_equal(read.padding.plane(number), expected)


def test_a_padding_range_is_masked_whole(maker, tmp_path, stored_values):
    get_stored, set_stored = stored_values
    slices = maker.slices()
    for slice_ in slices:
        stored = get_stored(slice_)
        stored[0, :3] = [-2000, -1990, -1980]
        set_stored(slice_, stored)
        slice_.add_new(0x00280120, "SS", -1980)
        slice_.add_new(0x00280121, "SS", -2000)
    voxels = read_series(maker.save(tmp_path / "case", slices)).volume.voxels
    assert np.all(voxels[:, 0, :3] == FILL_HU)


def test_undeclared_fill_far_below_air_becomes_air_and_is_said(maker, tmp_path, stored_values):
    get_stored, set_stored = stored_values
    slices = maker.slices()
    for slice_ in slices:
        stored = get_stored(slice_)
        stored[:4, :5] = -2000
        set_stored(slice_, stored)
    read = read_series(maker.save(tmp_path / "case", slices))
    assert np.all(read.volume.voxels[:, :4, :5] == FILL_HU)
    assert read.warnings == ()
    assert read.facts["Padding"] == "160 voxels outside the scan (undeclared value far below air), read as -1024 HU"
    assert read.padding.count == 160


def test_a_padding_value_that_is_tissue_is_left_alone(maker, tmp_path, lies_in_place):
    slices = maker.slices()
    for slice_ in slices:
        slice_.add_new(0x00280120, "SS", 1024)  # 0 HU
    read = read_series(maker.save(tmp_path / "case", slices))
    lies_in_place(read.volume)
    assert any("padding value that reads as tissue" in warning for warning in read.warnings)


def test_byte_identical_copies_are_dropped_and_said(maker, tmp_path, lies_in_place):
    folder = maker.save(tmp_path / "case", maker.slices())
    (folder / "copy.dcm").write_bytes((folder / "IM003.dcm").read_bytes())
    read = read_series(folder)
    lies_in_place(read.volume)
    assert read.warnings == ("1 byte-identical copies of slices were left out",)
    assert read.files == 8


def test_other_files_and_subfolders_do_no_harm(maker, tmp_path, lies_in_place):
    slices = maker.slices()
    folder = tmp_path / "case"
    maker.save(folder / "A", slices[:4])
    maker.save(folder / "B", slices[4:])
    (folder / "readme.txt").write_text("chest")
    (folder / "DICOMDIR").write_bytes(bytes(128) + b"DICM" + bytes(50))
    (folder / ".DS_Store").write_bytes(bytes(200))
    (folder / "A" / "._IM000.dcm").write_bytes(b"\x00\x05\x16\x07" + bytes(300))
    lies_in_place(read_series(folder).volume)


def test_a_localizer_is_left_out_and_said(maker, tmp_path, lies_in_place):
    slices = maker.slices()
    scout = maker.slices(orientation=[0, 1, 0, 0, 0, -1], ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])[0]
    scout.SeriesInstanceUID = slices[0].SeriesInstanceUID
    read = read_series(maker.save(tmp_path / "case", [*slices, scout]))
    lies_in_place(read.volume)
    assert [warning for warning in read.warnings if "localizer was left out" in warning]


def test_objects_that_are_no_images_are_left_out_and_said(maker, tmp_path, lies_in_place):
    folder = maker.save(tmp_path / "case", maker.slices())
    report = maker.slices(SOPClassUID="1.2.840.10008.5.1.4.1.1.88.67", Modality="SR", SeriesNumber=99)[0]
    for keyword in ("Rows", "Columns", "PixelData", "ImageType", "PixelSpacing", "ImagePositionPatient"):
        delattr(report, keyword)
    maker.save(folder, [report], names=["dose"])
    read = read_series(folder)
    lies_in_place(read.volume)
    assert read.warnings == ("series 2: SR, 1 objects, kernel B30f, SeriesNumber 99, not CT was left out",)


def test_a_one_word_image_type_still_tells_a_localizer(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices(ImageType="LOCALIZER"))
    assert [series.kind for series in scan_folder(folder)] == ["localizer"]


def test_one_of_several_series_is_named(maker, tmp_path, lies_in_place):
    folder = tmp_path / "case"
    for number, kernel in ((2, "B30f"), (3, "B70f")):
        maker.save(folder / kernel, maker.slices(SeriesNumber=number, ConvolutionKernel=kernel))
    with pytest.raises(
        SeriesError, match=r"holds 2 CT series; name one of them as in --series 1 from 1: CT, 8 images 26 x 20, kernel B30f"
    ):
        read_series(folder)
    with pytest.raises(SeriesError, match=r"2 is the place in the listing of one series and the SeriesNumber of another"):
        read_series(folder, series="2")
    with pytest.raises(SeriesError, match="no series is called 7"):
        read_series(folder, series="7")
    uid = scan_folder(folder)[1].uid
    for name, kernel in (("1", "B30f"), ("3", "B70f"), ("line:2", "B70f"), ("number:2", "B30f"), (uid, "B70f")):
        read = read_series(folder, series=name)
        assert read.facts["Kernel"] == kernel
        lies_in_place(read.volume)


def test_a_series_that_is_no_ct_cannot_be_named(maker, tmp_path):
    folder = maker.save(tmp_path / "case", maker.slices())
    maker.save(folder / "mr", maker.slices(SOPClassUID="1.2.840.10008.5.1.4.1.1.4", Modality="MR", SeriesNumber=9))
    assert read_series(folder).files == 8
    with pytest.raises(SeriesError, match="holds no CT slices; name a CT series"):
        read_series(folder, series="9")


def test_stripped_series_uids_are_told_apart_by_the_rest(maker, tmp_path, lies_in_place):
    folder = tmp_path / "case"
    for kernel in ("B30f", "B70f"):
        maker.save(folder / kernel, maker.slices(SeriesInstanceUID="", StudyInstanceUID="", ConvolutionKernel=kernel))
    assert [len(series.headers) for series in scan_folder(folder)] == [8, 8]
    lies_in_place(read_series(folder, series="line:2").volume)


def test_the_digest_is_of_the_files_and_not_of_their_names(maker, tmp_path):
    slices = maker.slices()
    first = read_series(maker.save(tmp_path / "a", slices))
    second = read_series(maker.save(tmp_path / "b", slices[::-1], names=[f"X{k}" for k in range(8)]))
    slices[0].SliceThickness = 3.0
    third = read_series(maker.save(tmp_path / "c", slices))
    assert first.digest == second.digest != third.digest
    assert len(first.digest) == 64


def test_nothing_identifying_is_in_the_facts(maker, tmp_path):
    read = read_series(maker.save(tmp_path / "case", maker.slices(SeriesDescription="Secret", ContrastBolusAgent="Iopamidol")))
    assert "secret" not in repr((read.facts, read.warnings)).lower()
    assert read.facts["Contrast agent"] == "yes"
    assert read.facts["Patient position"] == "HFS (head first, supine)"


def test_progress_counts_the_slices(maker, tmp_path):
    calls: list[tuple[int, int]] = []
    read_series(maker.save(tmp_path / "case", maker.slices()), progress=lambda done, total: calls.append((done, total)))
    assert calls == [(k, 8) for k in range(1, 9)]


@pytest.mark.parametrize(
    ("spoil", "warning"),
    [
        (
            lambda slices: [setattr(s, "GantryDetectorTilt", 12) for s in slices],
            "gantry tilt of 12.0 degrees, but the slices stand straight",
        ),
        (
            lambda slices: [setattr(s, "ImagesInAcquisition", 20) for s in slices],
            "speak of 20 images in the acquisition, 8 are here",
        ),
        (lambda slices: [setattr(s, "InstanceNumber", 2 * k) for k, s in enumerate(slices)], "go in steps of 2"),
        (lambda slices: setattr(slices[2], "InstanceNumber", 99), "do not follow the slice positions"),
        (lambda slices: [setattr(s, "AcquisitionNumber", 2) for s in slices[4:]], "put together from 2 acquisitions"),
        (lambda slices: [setattr(s, "LossyImageCompression", "01") for s in slices], "compressed with loss"),
        (
            lambda slices: setattr(slices[2], "ImageType", ["DERIVED", "PRIMARY", "AXIAL"]),
            "original and derived images are mixed",
        ),
    ],
)
def test_doubtful_series_are_read_with_a_warning(spoil, warning, maker, tmp_path, lies_in_place):
    slices = maker.slices()
    spoil(slices)
    read = read_series(maker.save(tmp_path / "case", slices))
    lies_in_place(read.volume)
    assert [text for text in read.warnings if warning in text]


def enhanced(slices: list[FileDataset], order: list[int]) -> FileDataset:
    """One Enhanced CT file of the slices, its frames in the given order."""
    first = slices[0]
    multi = FileDataset("", {}, file_meta=first.file_meta, preamble=b"\0" * 128)
    multi.update(first)
    for keyword in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "RescaleSlope", "RescaleIntercept", "KVP"):
        delattr(multi, keyword)
    multi.SOPClassUID = multi.file_meta.MediaStorageSOPClassUID = EnhancedCTImageStorage
    multi.NumberOfFrames = len(order)

    def group(keyword: str, **values: object) -> Sequence:
        item = Dataset()
        for name, value in values.items():
            setattr(item, name, value)
        return Sequence([item])

    shared = Dataset()
    shared.PixelMeasuresSequence = group("", PixelSpacing=first.PixelSpacing, SliceThickness=9)
    shared.PlaneOrientationSequence = group("", ImageOrientationPatient=first.ImageOrientationPatient)
    shared.PixelValueTransformationSequence = group("", RescaleSlope=1, RescaleIntercept=-1024, RescaleType="HU")
    multi.SharedFunctionalGroupsSequence = Sequence([shared])
    frames = []
    for k in order:
        frames.append(Dataset())
        frames[-1].PlanePositionSequence = group("", ImagePositionPatient=slices[k].ImagePositionPatient)
    multi.PerFrameFunctionalGroupsSequence = Sequence(frames)
    multi.PixelData = b"".join(slices[k].PixelData for k in order)
    multi["PixelData"].VR = "OW"
    return multi


def test_an_enhanced_ct_in_one_file_lies_in_place(maker, tmp_path, lies_in_place):
    order = [3, 0, 7, 1, 2, 6, 5, 4]
    folder = maker.save(tmp_path / "case", [enhanced(maker.slices(orientation=ORIENTATIONS["coronal"]), order)])
    for path in (folder, folder / "IM000.dcm"):
        read = read_series(path)
        lies_in_place(read.volume)
        assert read.files == 1


def test_an_enhanced_ct_without_a_place_for_each_frame_is_refused(maker, tmp_path):
    multi = enhanced(maker.slices(), list(range(8)))
    multi.PerFrameFunctionalGroupsSequence = multi.PerFrameFunctionalGroupsSequence[:5]
    with pytest.raises(SeriesError, match="describes 5 frames but declares 8"):
        read_series(maker.save(tmp_path / "case", [multi]))


def test_a_deflate_bomb_is_refused_before_it_fills_the_memory(maker, tmp_path):
    slices = maker.slices()
    folder = maker.save(tmp_path / "case", slices)
    # Strategy: deflate the data set of an honest file with pixel data 100 000 times too long.
    whole = (folder / "IM003.dcm").read_bytes()
    start = 132 + 12 + int.from_bytes(whole[140:144], "little")  # behind the group length and what it spans
    pixels = whole.index(b"\xe0\x7f\x10\x00OW")
    size = 1 << 27
    packer = zlib.compressobj(level=1, wbits=-zlib.MAX_WBITS)
    packed = packer.compress(whole[start : pixels + 8] + size.to_bytes(4, "little"))
    packed += b"".join(packer.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packer.flush()
    syntax = b"1.2.840.10008.1.2.1"
    meta = whole[:start]
    at = meta.index(b"\x02\x00\x10\x00UI") + 6
    assert meta[at + 2 : at + 2 + len(syntax)] == syntax
    longer = (syntax + b".99").ljust(22, b"\0")
    meta = meta[:at] + len(longer).to_bytes(2, "little") + longer + meta[at + 2 + 20 :]
    meta = meta[:140] + (int.from_bytes(meta[140:144], "little") + 2).to_bytes(4, "little") + meta[144:]
    (folder / "IM003.dcm").write_bytes(meta + packed)
    assert len(packed) < size / 100

    tracemalloc.start()
    with pytest.raises(SeriesError, match=r"IM003\.dcm inflates to more than the 1040 bytes its header promises"):
        read_series(folder)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 << 20  # a header may inflate to 16 MiB; the bomb is 128 MiB
