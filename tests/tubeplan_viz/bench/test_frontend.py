"""The front end's benchmark: what it measures with is right, peers are told apart, and a small chest holds its targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from segmentation.errors import TubeplanError
from segmentation.leak import LeakRule
from segmentation.region_growing import GrowthSettings, grow
from tubeplan_viz.bench.frontend import FLOOD, growing_rows
from tubeplan_viz.bench.frontend_surface import loose_edges, tube_rows
from tubeplan_viz.bench.frontend_volumes import AIR, TISSUE, bent_tube, chest
from tubeplan_viz.bench.frontend_worker import against, installed, tried


def test_distance_to_the_bent_tube_is_that_of_planted_points() -> None:
    tube = bent_tube(2.0)
    third = np.cross(tube.normal, tube.start)
    turn = np.linspace(0.0, tube.angle, 40)[:, None]
    outward = np.cos(turn) * tube.start + np.sin(turn) * third
    for away in (-2.0, 0.0, 4.0):
        # Off the axis by radius + away, to the outside of the bend and out of its plane.
        for side in (outward, np.broadcast_to(tube.normal, outward.shape)):
            points = tube.center + tube.bend * outward + (tube.radius + away) * side
            np.testing.assert_allclose(tube.distance(points), away, atol=1e-12)
    # Beyond the first end it is the distance to the ball there.
    end = tube.center + tube.bend * tube.start - 7.0 * third
    assert tube.distance(end[None])[0] == pytest.approx(7.0 - tube.radius)


def test_voxels_of_the_bent_tube_are_air_inside_tissue_outside_and_share_the_volume() -> None:
    tube = bent_tube(1.0)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in tube.volume.voxels.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    level = tube.distance(tube.volume.to_lps(index))
    voxels = tube.volume.voxels.ravel()
    assert np.all(voxels[level < -0.5] == AIR)
    assert np.all(voxels[level > 0.5] == TISSUE)
    # A tube about an arc (Pappus) and two half balls. An edge that falls linearly over one voxel adds, to the mean square
    # of the radius, a twelfth of its square, and to the mean cube of it a quarter of its square times the radius.
    r, edge = tube.radius, 1.0
    exact = np.pi * (r**2 + edge**2 / 12.0) * tube.bend * tube.angle + 4.0 / 3.0 * np.pi * (r**3 + r * edge**2 / 4.0)
    share = (TISSUE - voxels.astype(float)) / (TISSUE - AIR)
    # The grid samples a smooth edge; what is left is rounding to whole HU and the kinks of the edge.
    assert share.sum() == pytest.approx(exact, rel=2e-3)


def test_a_surface_with_a_face_left_out_or_turned_is_not_closed() -> None:
    solid = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert loose_edges(solid) == 0
    assert loose_edges(solid[:3]) == 3
    turned = solid.copy()
    turned[0] = turned[0, ::-1]
    assert loose_edges(turned) > 0


def test_surfaces_hold_their_targets_against_the_closed_form() -> None:
    rows = tube_rows(bent_tube(1.2), 1.2)
    aimed = [row for row in rows if row.target]
    assert len(aimed) == 6
    assert all(row.holds for row in aimed)
    beside = [row for row in rows if row.source.startswith("mask and trimesh")]
    assert beside
    assert all(row.reference is not None and row.ours < row.reference for row in beside)


def test_the_least_peer_carries_the_target() -> None:
    rows = against("case", "CPU s", 1.6, {"slow": 5.0, "quick": 1.0}, times=1.5, floor=0.1)
    assert [row.source for row in rows] == ["quick, this run", "slow, this run"]
    assert rows[0].holds is False
    assert rows[1].holds is None
    assert against("case", "CPU s", 0.09, {"quick": 0.01}, times=1.5, floor=0.1)[0].holds is True
    assert against("case", "CPU s", 0.09, {}, times=1.5) == []


def test_growing_beside_the_peers_holds_the_same_voxels(tmp_path: Path) -> None:
    made = chest((40, 96, 96), (5.0, 3.6, 3.6))
    index = made.volume.to_index((0.0, 0.0, -50.0)).round().astype(int)
    settings = GrowthSettings(
        hu_min=-1024.0, hu_max=-880.0, varied=None, leak=LeakRule(volume_min=3.0, volume_max=300.0, jump=10.0)
    )
    seed = (int(index[0]), int(index[1]), int(index[2]))
    # One peer is enough to see the rows; each is a process of its own.
    rows, least = growing_rows("small", made.volume, seed, settings, tmp_path, peers=[FLOOD])
    jaccard = next(row for row in rows if row.figure.startswith("Jaccard"))
    assert jaccard.holds
    assert least > 0.0
    region = grow(made.volume, seed, settings)
    assert f"{np.count_nonzero(region.mask)} voxels" in rows[0].case
    lumen = made.lumen(made.volume, region.lower, tuple(np.array(region.lower) + region.mask.shape))
    # Voxels of 3.6 mm: what is grown is lumen, of which a rim is lost to partial volume.
    assert (lumen & region.mask).sum() > 0.9 * region.mask.sum()


def test_a_way_that_fails_is_named(tmp_path: Path) -> None:
    with pytest.raises(TubeplanError, match=r"tubeplan failed at the step whole with exit status 1: .*no such file or folder"):
        tried("whole", "tubeplan", tmp_path, {"ct": str(tmp_path / "gone"), "anatomy": "airway"})


def test_ours_is_always_installed() -> None:
    assert all(installed(step)[0] == "tubeplan" for step in ("read", "grow", "surface", "whole"))
