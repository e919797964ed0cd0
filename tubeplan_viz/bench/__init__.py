"""Published and measured comparisons, rebuilt: tubeplan bench NAME."""

from collections.abc import Callable

from tubeplan_viz.bench.bronchoscope import bronchoscope
from tubeplan_viz.bench.centerline import centerline
from tubeplan_viz.bench.certificate import certificate
from tubeplan_viz.bench.dynamics import dynamics
from tubeplan_viz.bench.faults import faults
from tubeplan_viz.bench.frontend import frontend
from tubeplan_viz.bench.infeasible import infeasible
from tubeplan_viz.bench.matrix import matrix
from tubeplan_viz.bench.measures import measures
from tubeplan_viz.bench.needle import needle3d
from tubeplan_viz.bench.needle2d import needle2d
from tubeplan_viz.bench.optimal import optimal
from tubeplan_viz.bench.paper import paper
from tubeplan_viz.bench.rigid import rigid
from tubeplan_viz.bench.rows import Row
from tubeplan_viz.bench.vmtk_line import vmtk_line

BENCHMARKS: dict[str, Callable[..., list[Row]]] = {
    "paper": paper,
    "centerline": centerline,
    "frontend": frontend,
    "optimal": optimal,
    "certificate": certificate,
    "faults": faults,
    "infeasible": infeasible,
    "matrix": matrix,
    "vmtk": vmtk_line,
    "needle2d": needle2d,
    "needle3d": needle3d,
    "measures": measures,
    "rigid": rigid,
    "bronchoscope": bronchoscope,
    "dynamics": dynamics,
}

__all__ = ["BENCHMARKS", "Row"]
