"""What proves that an instrument cannot reach a target: a lumen too narrow, a bend too sharp, a way too long."""

# Strategy: a proof holds for all instruments that are no easier than the one it was made for. Narrow places are known with the
# target (its ceiling). Bends are looked at from the most flexible instruments on, and for one bend radius once: what
# keeps out an instrument keeps out every one that is as thick and as stiff, so that little is left for the stiffer ones.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.instruments.catalogue import Instrument
from tubeplan_viz.instruments.verdict import Cell, Target, Verdict, Witness, apart
from tubeplan_viz.plan import Limits
from tubeplan_viz.tube.bend import BendBound, bend_bound


@dataclass(frozen=True, eq=False, kw_only=True)
class SharpBend:
    """A bend that keeps instruments from a target.

    Attributes
    ----------
    limits : Limits
        Of the thinnest instrument that it was proved for: its curvature limit is that of the proof.
    bound : BendBound
        The clearance that no path under that curvature limit keeps, and where.
    """

    limits: Limits
    bound: BendBound

    def keeps_out(self, instrument: Instrument) -> bool:
        """Whether no path can be for an instrument: it bends no more than the proof allows and needs what no such path keeps."""
        return instrument.limits.curvature_max <= self.limits.curvature_max and instrument.radius >= self.bound.bound


def sharp_bends(
    wall: WallDistance, target: Target, instruments: Sequence[Instrument], witnesses: Sequence[Witness]
) -> tuple[SharpBend, ...]:
    """Bends that keep out some of the instruments, those of the most flexible ones first.

    Parameters
    ----------
    wall : WallDistance
    target : Target
    instruments : sequence of Instrument
        That nothing else keeps out and no path serves.
    witnesses : sequence of Witness
        Paths found: a bend leaves what one of them keeps.
    """
    found: list[SharpBend] = []
    if target.centerline is None:
        return ()
    for curvature in sorted({one.limits.curvature_max for one in instruments}, reverse=True):
        level = [one for one in instruments if one.limits.curvature_max == curvature]
        radii = sorted(one.radius for one in level if not any(bend.keeps_out(one) for bend in found))
        if not radii:
            continue
        bound = bend_bound(
            wall,
            target.centerline,
            curvature=curvature,
            ceiling=target.ceiling.bound,
            limit=radii[0],
            known=max((path.clearance_bound for path in witnesses if path.curvature_bound <= curvature), default=0.0),
        )
        kept_out = [] if bound is None else [radius for radius in radii if radius >= bound.bound]
        if bound is not None and kept_out:
            found.append(SharpBend(limits=Limits(curvature_max=curvature, clearance_min=kept_out[0]), bound=bound))
    return tuple(found)


def impossible(instrument: Instrument, target: Target, *, straight: float, bends: Sequence[SharpBend] = ()) -> Cell | None:
    """The cell of an instrument that cannot reach a target, or None where nothing proves it.

    Parameters
    ----------
    instrument : Instrument
    target : Target
    straight : float, mm
        Length of instrument that is needed at least: what is used up before the start, and the straight line from there.
    bends : sequence of SharpBend
        On the way to the target.
    """
    ceiling, label = target.ceiling, target.label
    if instrument.radius > ceiling.bound:
        where = {"start": "at the start itself", "goal": f"at {label} itself", None: "on every way there"}[ceiling.end]
        left, needed = apart(ceiling.bound, instrument.radius)
        reason = f"proved: {where} the lumen leaves {left} mm at most, at {place_words(ceiling.place)}; {needed} mm are required"
        return impossible_cell(instrument, label, reason, available=ceiling.bound, place=ceiling.place)
    if instrument.working_length_mm < straight:
        reason = (
            f"proved: {label} is {straight:.0f} mm away even in a straight line; "
            f"the working length is {instrument.working_length_mm:.0f} mm"
        )
        return impossible_cell(instrument, label, reason, available=ceiling.bound, place=ceiling.place)
    index = min(
        (k for k, bend in enumerate(bends) if bend.keeps_out(instrument)), key=lambda k: bends[k].bound.bound, default=None
    )
    if index is None:
        return None
    bound = bends[index].bound
    left, needed = apart(bound.bound, instrument.radius)
    reason = (
        f"proved: the bend at {place_words(bound.place)} leaves {left} mm at most at a bend radius of "
        f"{1.0 / bends[index].limits.curvature_max:.1f} mm or more; {needed} mm are required"
    )
    return impossible_cell(instrument, label, reason, available=bound.bound, place=bound.place, bend=index)


def impossible_cell(
    instrument: Instrument, target: str, reason: str, *, available: float, place: FloatArray, bend: int | None = None
) -> Cell:
    """A cell whose margin is the most that any path can have."""
    x, y, z = (float(v) for v in place)
    return Cell(
        instrument=instrument.name,
        target=target,
        verdict=Verdict.IMPOSSIBLE,
        reason=reason,
        margin=available - instrument.radius,
        margin_point=(x, y, z),
        margin_of="ceiling" if bend is None else "bend",
        bend=bend,
    )


def place_words(place: FloatArray) -> str:
    """A place as text."""
    # Adding zero makes a rounded negative zero a zero.
    x, y, z = np.round(place, 1) + 0.0
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"
