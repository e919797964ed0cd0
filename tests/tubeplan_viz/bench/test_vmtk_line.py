"""The peer of bench vmtk: its spline is what scipy makes of the line, and the comparison is at its own curvature."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import splev, splprep

from tubeplan_viz.bench import peers
from tubeplan_viz.bench.models import bent_cylinder_1
from tubeplan_viz.bench.vmtk_line import CURVATURE_MAX, limits_of, smoothed, smoothing_spline, target_rows
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube import TubeSettings, pose_problem


def test_the_smoothing_spline_is_scipys_and_runs_from_end_to_end() -> None:
    s = np.linspace(0.0, 40.0, 400)
    line = np.column_stack([s, 2.0 * np.sin(s / 6.0), np.zeros_like(s)])
    curve = smoothing_spline(line, line[0], line[-1], 0.2)
    assert curve([0.0, 1.0]) == pytest.approx(line[[0, -1]], abs=1e-3)
    # A thousandfold weight holds the ends; the rest leaves the line by the root mean square asked for.
    u = np.linspace(0.0, 1.0, 2000)
    off = np.interp(curve(u)[:, 0], line[:, 0], line[:, 1]) - curve(u)[:, 1]
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.2, rel=0.2)
    tck, _ = splprep(line.T, s=0.0, u=s / s[-1])
    free = smoothing_spline(line, line[0], line[-1], 1e-4)
    assert np.abs(free([0.5])[0] - np.array(splev(0.5, tck))).max() < 0.05


def test_the_optimal_path_beats_the_smoothed_line_at_its_own_curvature() -> None:
    # Bends down to 12 mm (0.083 1/mm): the smoothing spline swings about them, the optimum stays in the middle.
    model = bent_cylinder_1()
    wall = WallDistance(model.surface)
    found = smoothed(np.asarray(model.axis_points), model.start, model.goal, wall)
    peer = found["straightest spline"]
    assert peer.curvature <= found["widest spline"].curvature <= CURVATURE_MAX
    limits = Limits(curvature_max=peer.curvature, clearance_min=0.0)
    problem = pose_problem(model.surface, model.start, model.goal, limits, TubeSettings(), wall=wall)
    least, mean = target_rows("cylinder 1", problem, peer, "test")
    assert least.reference == peer.least
    assert least.holds
    assert least.ours > peer.least + 0.02
    assert mean.ours > 0.0
    # Where the spline leaves the lumen, the whole method stands against it, at the common limit.
    least, _ = target_rows(
        "cylinder 1", replace(problem, limits=limits_of(replace(peer, least=-1.0))), replace(peer, least=-1.0), "test"
    )
    assert least.holds
    # At 0.125 1/mm there is at least the room that 30 control points find at 0.100, and no more than the tube's radius.
    assert 0.99 * 2.998 <= least.ours <= 3.0


def test_vmtk_is_looked_for_in_other_pythons_and_its_absence_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    peers.vmtk_python.cache_clear()
    monkeypatch.setattr(peers, "find_spec", lambda name: None)
    monkeypatch.setattr(peers.shutil, "which", lambda name: None)
    assert peers.vmtk_python() is None
    peers.vmtk_python.cache_clear()
    # A Python without VMTK is passed over.
    monkeypatch.setattr(peers.shutil, "which", lambda name: sys.executable)
    assert peers.vmtk_python() is None
    peers.vmtk_python.cache_clear()
    monkeypatch.setattr(peers, "find_spec", lambda name: object())
    assert peers.vmtk_python() == sys.executable
    peers.vmtk_python.cache_clear()
