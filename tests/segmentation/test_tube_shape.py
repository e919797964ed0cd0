"""Shape measures of bodies with known shape."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import RegionError
from segmentation.tube_shape import TubeRule, TubeShape, refuse_unless_tube, tube_shape

SPACING = np.array([1.0, 0.8, 0.8])


def grid(shape: tuple[int, int, int]) -> tuple[np.ndarray, ...]:
    """Coordinates in mm from the middle of the array."""
    axes = [(np.arange(n) - (n - 1) / 2) * step for n, step in zip(shape, SPACING, strict=True)]
    return tuple(np.meshgrid(*axes, indexing="ij"))


def cylinder(radius: float = 4.0) -> np.ndarray:
    z, y, x = grid((90, 17, 17))
    return (np.hypot(x, y) <= radius) & (np.abs(z) < 40)


def test_a_cylinder_has_its_own_length_and_width() -> None:
    shape = tube_shape(cylinder(), SPACING)
    assert shape.volume == pytest.approx(
        np.pi * 16 * 80 / 1000, rel=0.05
    )  # voxels of a fifth of the radius against the closed form
    # The longest way runs from rim to rim: a little over 80 mm, and voxel paths overshoot by up to 5 %.
    assert 80 <= shape.length <= 88
    assert shape.radius == pytest.approx(4.0, abs=0.8)  # one voxel
    assert shape.elongation == pytest.approx(80 / 8, rel=0.15)
    assert shape.section_excess < 1.5
    assert shape.tunnels == 0
    refuse_unless_tube(shape, TubeRule(), "a cylinder")


def test_where_the_image_cuts_a_tube_is_no_wall() -> None:
    half = cylinder()[:, :, 8:]  # cut lengthwise through the axis
    assert tube_shape(half, SPACING).radius == pytest.approx(tube_shape(cylinder(), SPACING).radius, abs=1e-9)


def test_a_ball_is_refused_as_a_blob() -> None:
    z, y, x = grid((40, 40, 40))
    with pytest.raises(RegionError, match=r"a blob and no tube: .* 1\.\d times as long as wide, expected at least 4"):
        refuse_unless_tube(tube_shape(x * x + y * y + z * z <= 12.0**2, SPACING), TubeRule(), "a ball")


def test_a_sheet_is_refused_however_long_it_is() -> None:
    z, y, x = grid((120, 60, 12))
    sheet = (np.abs(x) < 2.0) & (np.abs(z) < 58) & (np.abs(y) < 20)
    with pytest.raises(RegionError, match="a sheet or a sponge and no tube: its cross-sections are"):
        refuse_unless_tube(tube_shape(sheet, SPACING), TubeRule(elongation_min=1.0), "a sheet")


def test_a_line_of_voxels_is_refused_as_unresolved() -> None:
    line = np.zeros((60, 5, 5), dtype=bool)
    line[2:-2, 2, 2] = True
    with pytest.raises(RegionError, match=r"no tube that this image resolves: its widest place has a radius of 0\.8 voxels"):
        refuse_unless_tube(tube_shape(line, SPACING), TubeRule(), "a line")


def test_a_grating_is_refused_for_its_tunnels() -> None:
    body = cylinder(radius=5.0)
    body[6:-6:2, :, 5:12:6] = False
    shape = tube_shape(body, SPACING)
    assert shape.tunnels > 40
    with pytest.raises(RegionError, match=f"{shape.tunnels} tunnels run through it, expected at most 40"):
        refuse_unless_tube(shape, TubeRule(radius_voxels_min=0.5), "a grating")


def test_coarser_voxels_measure_the_same_tube() -> None:
    fine = np.repeat(np.repeat(np.repeat(cylinder(), 3, axis=0), 3, axis=1), 3, axis=2)
    assert fine.sum() > 80_000  # so that the measures are taken on joined voxels
    one, other = tube_shape(cylinder(), SPACING), tube_shape(fine, SPACING / 3)
    assert isinstance(other, TubeShape)
    assert other.length == pytest.approx(one.length, rel=0.05)
    assert other.radius == pytest.approx(one.radius, abs=0.5)
    assert other.elongation == pytest.approx(one.elongation, rel=0.08)
