"""Surfaces of tubes with closed forms, painted into a CT with partial volume."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from segmentation.errors import SurfaceError
from segmentation.lumen import SegmentationSettings, segment_lumen
from segmentation.mesh import Surface
from segmentation.region_growing import Region
from segmentation.surface import LumenSurface, SurfaceSettings, lumen_surface
from segmentation.volume import Volume

RADIUS = 4.0
SPACING = np.array([1.0, 0.8, 0.8])
AIR, TISSUE = -1000.0, 0.0
HALF = -500.0


def affine(axes: np.ndarray, spacing: np.ndarray = SPACING) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = axes * spacing
    matrix[:3, 3] = (12.0, -30.0, 55.0)
    return matrix


def painted(distance: np.ndarray, matrix: np.ndarray) -> Volume:
    """A CT whose edge is a ramp over 1.6 mm, half of it air where `distance`, positive inside, is zero."""
    inside = np.clip(distance / 1.6 + 0.5, 0.0, 1.0)
    return Volume(np.round(TISSUE + (AIR - TISSUE) * inside).astype(np.int16), matrix)


def grid(shape: tuple[int, int, int]) -> list[np.ndarray]:
    axes = [(np.arange(n) - (n - 1) / 2) * step for n, step in zip(shape, SPACING, strict=True)]
    return np.meshgrid(*axes, indexing="ij")


def tube(matrix: np.ndarray, *, half_length: float = 26.0, shape: tuple[int, int, int] = (70, 21, 21)) -> Volume:
    z, y, x = grid(shape)
    return painted(np.minimum(RADIUS - np.hypot(x, y), half_length - np.abs(z)), matrix)


def ring(matrix: np.ndarray) -> Volume:
    """A torus of radii 15 and 4 mm."""
    z, y, x = grid((21, 60, 60))
    return painted(RADIUS - np.hypot(np.hypot(x, y) - 15.0, z), matrix)


def grown(volume: Volume, index: tuple[int, int, int]) -> Region:
    x, y, z = (float(v) for v in volume.to_lps(index))
    return segment_lumen(volume, SegmentationSettings(anatomy="generic", seed_point=(x, y, z), hu_max=HALF, smoothing=0.0))


def made(volume: Volume, index: tuple[int, int, int], **settings: float) -> LumenSurface:
    return lumen_surface(volume, grown(volume, index), SurfaceSettings(**settings))  # type: ignore[arg-type]


def euler(surface: Surface) -> int:
    edges = np.unique(
        np.sort(np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]]), axis=1), axis=0
    )
    return len(surface.vertices) - len(edges) + len(surface.faces)


def assert_closed(surface: Surface) -> None:
    """Every edge has exactly one face on either side, walked in opposite directions."""
    walks = np.concatenate([surface.faces[:, [0, 1]], surface.faces[:, [1, 2]], surface.faces[:, [2, 0]]])
    seen = {(int(a), int(b)) for a, b in walks}
    assert len(seen) == len(walks)
    assert all((b, a) in seen for a, b in seen)


@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_a_torus_has_its_volume_its_place_and_one_tunnel(flip: float) -> None:
    turn = Rotation.from_euler("xyz", [20, 35, -50], degrees=True).as_matrix()
    volume = ring(affine(turn * np.array([flip, 1.0, 1.0])))
    result = made(volume, (10, 30, 48))
    surface = result.surface
    assert_closed(surface)
    assert surface.caps == ()
    assert surface.frame == "LPS"
    # 2 pi^2 R r^2; a mesh of chords a fifth of the radius long loses about 1 %.
    assert surface.volume_ml == pytest.approx(2 * np.pi**2 * 15 * RADIUS**2 / 1000, rel=0.015)
    index = volume.to_index(surface.vertices) - (np.array(volume.voxels.shape) - 1) / 2
    z, y, x = (index * SPACING).T
    error = np.hypot(np.hypot(x, y) - 15.0, z) - RADIUS
    # A tenth of a voxel: a trilinear ramp of a round wall is not exactly round.
    assert np.abs(error).max() < 0.1
    assert euler(surface) == 0
    assert any("1 tunnel (Euler number 0)" in note for note in result.notes)


def test_without_smoothing_the_wall_is_the_isosurface() -> None:
    result = made(tube(affine(np.eye(3))), (35, 10, 10), smoothing_rounds=0)
    assert result.deviation.max < 1e-6
    assert euler(result.surface) == 2


def test_smoothing_keeps_the_volume_and_reports_what_it_moved() -> None:
    volume = tube(affine(np.eye(3)))
    raw, smooth = made(volume, (35, 10, 10), smoothing_rounds=0), made(volume, (35, 10, 10), smoothing_rounds=30)
    # The even step restores it to first order in a shift of hundredths of a mm.
    assert smooth.surface.volume_ml == pytest.approx(raw.surface.volume_ml, rel=1e-4)
    assert 0 < smooth.deviation.mean < smooth.deviation.p95 < smooth.deviation.max < 0.8


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("last", [False, True])
def test_where_the_image_cuts_the_tube_a_flat_cap_with_a_sharp_rim_closes_it(axis: int, last: bool) -> None:
    z, y, x = grid((70, 21, 21))
    distance = np.moveaxis(np.minimum(RADIUS - np.hypot(x, y), (z if last else -z) + 26.0), 0, axis)
    spacing = np.array([0.8, 0.8, 0.8])
    spacing[axis] = 1.0
    volume = painted(distance, affine(np.eye(3)[:, ::-1], spacing))
    seed = [10, 10, 10]
    seed[axis] = 35
    result = made(volume, (seed[0], seed[1], seed[2]))
    surface = result.surface
    assert_closed(surface)
    (cap,) = surface.caps
    assert (cap.label, cap.origin) == ("C1", "image border")
    assert "cuts the lumen across" in " ".join(result.notes)
    # A disc of the tube's radius: the chords of the rim and its smoothing take less than 3 %.
    assert cap.area == pytest.approx(np.pi * RADIUS**2, rel=0.03)
    outward = (1.0 if last else -1.0) * volume.index_to_lps[:3, axis] / volume.spacing[axis]
    np.testing.assert_allclose(cap.normal, outward, atol=1e-12)
    members = surface.face_cap == 0
    np.testing.assert_allclose(surface.face_normals[members], np.broadcast_to(outward, (members.sum(), 3)), atol=1e-6)
    # The cap lies on the outer face of the last voxels, and no wall passes it.
    place = volume.to_index(surface.vertices)[:, axis]
    face = volume.voxels.shape[axis] - 0.5 if last else -0.5
    np.testing.assert_allclose(place[np.unique(surface.faces[members])], face, atol=1e-9)
    assert np.all(place <= face + 1e-9) if last else np.all(place >= face - 1e-9)
    # Rim vertices lie on the tube's wall.
    rim = np.intersect1d(surface.faces[members], surface.wall_faces)
    middle = volume.to_index(surface.vertices[rim]) - (np.array(volume.voxels.shape) - 1) / 2
    radius = np.linalg.norm(np.delete(middle * spacing, axis, axis=1), axis=1)
    assert np.abs(radius - RADIUS).max() < 0.15


def test_a_lengthwise_cut_is_capped_and_called_unknown() -> None:
    volume = tube(affine(np.eye(3)))
    half = volume.crop((0, 0, 10), volume.voxels.shape)
    result = made(half, (35, 10, 0))
    assert_closed(result.surface)
    (cap,) = result.surface.caps
    assert cap.area == pytest.approx(2 * (RADIUS + 0.4) * 52, rel=0.15)  # a strip of 8 by 52 mm
    (note,) = (note for note in result.notes if note.startswith("C1"))
    assert "(first column) cuts the lumen lengthwise over 5" in note
    assert "the clearance towards it is unknown" in note


def test_a_void_is_filled_and_told() -> None:
    volume = tube(affine(np.eye(3)))
    voxels = volume.voxels.copy()
    voxels[30:33, 9:12, 9:12] = 0
    result = made(Volume(voxels, volume.index_to_lps), (40, 10, 10))
    assert_closed(result.surface)
    assert euler(result.surface) == 2
    assert any(f"voids of {27 * volume.voxel_ml:.3g} ml" in note for note in result.notes)
    assert result.surface.volume_ml == pytest.approx(made(volume, (40, 10, 10)).surface.volume_ml, rel=1e-3)


def test_another_lumen_next_door_leaves_no_trace() -> None:
    volume = tube(affine(np.eye(3)), shape=(70, 21, 21))
    alone = made(volume, (35, 10, 10))
    wide = np.full((70, 21, 40), TISSUE, dtype=np.int16)
    wide[:, :, :21] = volume.voxels
    wide[5:65, 8:13, 17:22] = AIR  # its wall is one voxel thick
    both = made(Volume(wide, volume.index_to_lps), (35, 10, 10))
    assert both.surface.volume_ml == pytest.approx(alone.surface.volume_ml, rel=0.01)
    assert_closed(both.surface)


def test_fewer_faces_on_request_stay_closed_with_a_flat_cap() -> None:
    volume = tube(affine(np.eye(3)), half_length=60.0)
    full, few = made(volume, (35, 10, 10)), made(volume, (35, 10, 10), faces_max=1500)
    assert_closed(few.surface)
    assert len(full.surface.faces) > 5000
    assert 1200 < len(few.surface.faces) <= 1600
    assert few.surface.volume_ml == pytest.approx(full.surface.volume_ml, rel=0.005)
    assert [round(cap.area) for cap in few.surface.caps] == [round(cap.area) for cap in full.surface.caps]
    assert few.deviation.max < 0.2


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(SurfaceError, match="faces_max is 10, expected at least 500"):
        SurfaceSettings(faces_max=10)
    with pytest.raises(SurfaceError, match="smoothing_rounds is -1"):
        SurfaceSettings(smoothing_rounds=-1)
