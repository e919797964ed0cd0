"""One way of the front end's benchmark in a process of its own."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from segmentation.arrays import BoolArray
from segmentation.errors import TubeplanError
from tubeplan_viz.bench import frontend_methods
from tubeplan_viz.bench.alone import run_alone
from tubeplan_viz.bench.frontend_methods import NEEDS, OURS, WAYS
from tubeplan_viz.bench.rows import Row

TIME_LIMIT = 600.0
# What takes less than this is waited for by nobody, and is timed poorly.
UNNOTICED = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Trial:
    """What one way found and took.

    Attributes
    ----------
    seconds : float, s
        Processor time of the quickest run.
    clock : float, s
        Time on the wall of the quickest run.
    peak, extra : float, MB
        Most memory of the process, and how much of it came after the input was loaded.
    found : dict
        What the way returned.
    """

    seconds: float
    clock: float
    peak: float
    extra: float
    found: dict[str, Any]

    @property
    def mask(self) -> BoolArray:
        """The mask that a way of growing returned."""
        shape = tuple(int(n) for n in self.found["shape"])
        return np.unpackbits(self.found["mask"], count=int(np.prod(shape))).reshape(shape).astype(bool)


def installed(step: str) -> list[str]:
    """The ways of a step whose modules are at hand, ours first."""
    return [method for method in WAYS[step] if method not in NEEDS or find_spec(NEEDS[method]) is not None]


def tried(step: str, method: str, folder: Path, given: dict[str, Any]) -> Trial:
    """Run one way on what lies in the folder.

    Raises
    ------
    TubeplanError
        If the way fails or takes longer than ten minutes.
    """
    (folder / "given.json").write_text(json.dumps(given), encoding="utf-8")
    with TemporaryDirectory() as place:
        out = Path(place) / "out.npz"
        command = [sys.executable, "-P", str(frontend_methods.__file__), step, method, str(folder), str(out)]
        ended = run_alone(command, limit=TIME_LIMIT)
        if ended.status is None:
            raise TubeplanError(f"{method} took more than {TIME_LIMIT:g} s for the step {step}; leave it out")
        if ended.status != 0:
            raise TubeplanError(f"{method} failed at the step {step} with exit status {ended.status}: {ended.reason}")
        with np.load(out) as made:
            found = {name: made[name] for name in made.files}
    peak, loaded = float(found.pop("peak")), float(found.pop("loaded"))
    seconds, clock = float(found.pop("seconds").min()), float(found.pop("walls").min())
    return Trial(seconds=seconds, clock=clock, peak=peak, extra=peak - loaded, found=found)


def against(case: str, figure: str, ours: float, peers: dict[str, float], *, times: float, floor: float = 0.0) -> list[Row]:
    """Ours beside each peer, the least first; ours may be `times` the least, or up to `floor`."""
    ordered = sorted(peers.items(), key=lambda item: item[1])
    rows = [Row(case=case, figure=figure, ours=ours, reference=value, source=f"{name}, this run") for name, value in ordered]
    if not ordered:
        return rows
    name, least = ordered[0]
    first = Row(
        case=case,
        figure=figure,
        ours=ours,
        reference=least,
        source=f"{name}, this run",
        target=f"at most {times:g} times the least peer" + (f", or {floor:g}" if floor else ""),
        holds=ours <= max(times * least, floor),
    )
    return [first, *rows[1:]]


def equal(case: str, figure: str, value: float, wanted: float, source: str) -> Row:
    """A row whose target is a number met exactly."""
    return Row(case=case, figure=figure, ours=value, reference=wanted, source=source, target="equal", holds=value == wanted)


__all__ = ["OURS", "UNNOTICED", "Trial", "against", "equal", "installed", "tried"]
