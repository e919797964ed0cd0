"""Stones as balls of known size."""

from __future__ import annotations

import numpy as np
import pytest

from segmentation.errors import RegionError
from segmentation.stone import grow_stone, masked_stone
from segmentation.volume import Volume

CENTER = np.array([1.3, -2.2, 4.1])


def ball(radius: float, core: float, around: float, *, noise: float = 0.0) -> Volume:
    """A ball with an edge over one voxel, as partial volume makes it, on a grid of 0.8 x 0.7 x 0.7 mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[0.0, 0.0, 0.7], [0.0, 0.7, 0.0], [0.8, 0.0, 0.0]])
    matrix[:3, 3] = (-35.0, -35.0, -40.0)
    index = np.stack(np.meshgrid(*(np.arange(100),) * 3, indexing="ij"), axis=-1)
    away = np.linalg.norm(index @ matrix[:3, :3].T + matrix[:3, 3] - CENTER, axis=-1)
    cover = np.clip(0.5 + (radius - away) / 0.7, 0.0, 1.0)
    hu = around + cover * (core - around) + np.random.default_rng(5).uniform(-noise, noise, away.shape)
    return Volume(np.rint(hu).astype(np.int16), matrix)


@pytest.mark.parametrize(("radius", "core", "around", "noise"), [(5.0, 1100.0, 40.0, 0.0), (4.0, 900.0, 350.0, 50.0)])
def test_a_ball_has_the_volume_size_and_density_it_was_made_with(radius: float, core: float, around: float, noise: float) -> None:
    stone = grow_stone(ball(radius, core, around, noise=noise), tuple(CENTER + np.array([0.9, 0.0, -0.8])))
    # Voxels whose centre lies inside: their count scatters by about the square root of those on the surface, under 5 %.
    assert stone.volume_mm3 == pytest.approx(4.0 / 3.0 * np.pi * radius**3, rel=0.05)
    # From corner to corner of voxels: up to a voxel's diagonal more than the ball.
    assert 2.0 * radius - 0.3 <= stone.diameter <= 2.0 * radius + 1.3
    np.testing.assert_allclose(stone.center, CENTER, atol=0.1)
    assert stone.threshold == pytest.approx(0.5 * (core + around), abs=30.0)
    # The rim's voxels are half covered: the mean lies between the limit and the core.
    assert 0.5 * (core + around) < stone.hu_mean <= core + 5.0


def test_a_stone_hidden_in_contrast_medium_is_refused_with_the_numbers() -> None:
    with pytest.raises(RegionError, match="contrast medium hides the stone"):
        grow_stone(ball(4.0, 400.0, 350.0), tuple(CENTER))


def test_a_point_outside_the_image_is_refused() -> None:
    with pytest.raises(RegionError, match="outside the image"):
        grow_stone(ball(4.0, 900.0, 40.0), (500.0, 0.0, 0.0))


def test_a_mask_gives_the_voxels_it_holds() -> None:
    volume = ball(4.0, 900.0, 40.0)
    mask = np.zeros(volume.voxels.shape, dtype=bool)
    mask[10:12, 20:23, 30:34] = True
    stone = masked_stone(volume, mask)
    assert stone.volume_mm3 == pytest.approx(24 * 0.8 * 0.7 * 0.7)
    assert stone.diameter == pytest.approx(np.linalg.norm([2 * 0.8, 3 * 0.7, 4 * 0.7]))
    assert stone.threshold is None
    with pytest.raises(RegionError, match="is empty"):
        masked_stone(volume, np.zeros_like(mask))
