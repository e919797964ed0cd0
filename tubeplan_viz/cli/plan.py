"""tubeplan plan tube: plan without a case file."""

from __future__ import annotations

from typing import Any

from tubeplan_viz.cases.tube import make_case
from tubeplan_viz.cli.options import Outputs, case_options, output_options
from tubeplan_viz.cli.show import plan_and_exit


@output_options
@case_options
def tube(
    *,
    given: dict[str, dict[str, Any]],
    outputs: Outputs,
) -> None:
    """Plan a curvature- and clearance-constrained path inside a curved tube.

    Example: tubeplan plan tube --ct chest/ --anatomy airway --start E1 --goal E3 --clearance-min 2.5 -o run
    """
    case = make_case({**given, "planner": {"name": "tube", **given.get("planner", {})}}, name="options")
    plan_and_exit(case, outputs)
