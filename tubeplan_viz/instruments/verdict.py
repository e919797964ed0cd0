"""What is known of one instrument and one target: the target, the paths found to it, the verdict and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from segmentation.arrays import FloatArray, frozen_array
from tubeplan_viz.centerline import Centerline
from tubeplan_viz.geometry import SplineCurve, WallDistance, clearance_lower_bound, curvature_upper_bound
from tubeplan_viz.instruments.advance import Advance
from tubeplan_viz.instruments.catalogue import Instrument
from tubeplan_viz.instruments.tip import TipClearance
from tubeplan_viz.plan import Limits
from tubeplan_viz.result import digits_apart
from tubeplan_viz.tube.bottleneck import Bottleneck


class Verdict(StrEnum):
    """What is known of one instrument and one target."""

    FEASIBLE = "feasible"
    FLAGGED = "flagged"
    IMPOSSIBLE = "impossible"


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """One end point and what is known before any path is searched.

    Attributes
    ----------
    label : str
    point : (3,) float array, mm
    centerline : Centerline or None
        From the start; None when no chain of inscribed spheres joins the two.
    ceiling : Bottleneck
        Proved: no path keeps more clearance.
    """

    label: str
    point: FloatArray
    centerline: Centerline | None
    ceiling: Bottleneck

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", frozen_array(self.point, (3,), "target"))


@dataclass(frozen=True, eq=False, kw_only=True)
class Witness:
    """One path with what holds along all of it.

    Attributes
    ----------
    curve : SplineCurve
    length : float, mm
    clearance, clearance_at : float, mm
        Least sampled clearance, and the arc length where it was met.
    clearance_bound : float, mm
        Proved least clearance.
    curvature, curvature_at : float, 1/mm and mm
    curvature_bound : float, 1/mm
        Proved largest curvature.
    """

    curve: SplineCurve
    length: float
    clearance: float
    clearance_at: float
    clearance_bound: float
    curvature: float
    curvature_at: float
    curvature_bound: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Cell:
    """One instrument and one target.

    Attributes
    ----------
    instrument, target : str
    verdict : Verdict
    reason : str
        One sentence: what holds, what is broken and where, or what proves that no path can be.
    margin : float or None, mm
        Least clearance of shaft and rigid tip less the instrument's radius, on the best path found; of an impossible cell
        the proved most that any path can have.
    margin_at, margin_point : float or None, mm
        Where along the path (for the tip: of its front), and the point.
    margin_of : {"shaft", "tip", "ceiling", "bend"} or None
        What it is the margin of; of an impossible cell the lumen's narrowest place or a bend.
    bend_radius : float or None, mm
        Sharpest bend of the path.
    bend_at : float or None, mm
    length : float or None, mm
        Of the path, without what is used up before its start.
    tip : TipClearance or None
    inferred_from : str or None
        The harder instrument whose path this one can follow shape for shape.
    path : int or None
        Index into the target's witnesses.
    bend : int or None
        Index into the target's sharp bends, of the one that proves the cell impossible.
    advance : Advance or None
        Of a cell that is not feasible, how far the instrument comes; None where it is not known to leave the start.
    """

    instrument: str
    target: str
    verdict: Verdict
    reason: str
    margin: float | None = None
    margin_at: float | None = None
    margin_point: tuple[float, float, float] | None = None
    margin_of: str | None = None
    bend_radius: float | None = None
    bend_at: float | None = None
    length: float | None = None
    tip: TipClearance | None = None
    inferred_from: str | None = None
    path: int | None = None
    bend: int | None = None
    advance: Advance | None = None


def apart(value: float, limit: float) -> tuple[str, str]:
    """Two numbers with as many decimals, 2 to 6, as tell them apart: what does not fit is never said to be as large.

    Examples
    --------
    >>> apart(1.497, 1.5), apart(0.8, 1.5), apart(-0.003, 0.0)
    (('1.497', '1.500'), ('0.80', '1.50'), ('-0.003', '0.000'))
    """
    digits = digits_apart(value, limit, 2)
    return f"{value:.{digits}f}", f"{limit:.{digits}f}"


def witness_of(curve: SplineCurve, wall: WallDistance, limits: Limits) -> Witness:
    """A path measured and proved."""
    # Both bounds come with the extreme value met on the way and its place: nothing need be sampled for them.
    clearance = clearance_lower_bound(curve, wall, limit=limits.clearance_min, tolerance=0.002)
    curvature = curvature_upper_bound(curve, limit=limits.curvature_max)
    tightest, sharpest = curve.arc_length([clearance.at, curvature.at])
    return Witness(
        curve=curve,
        length=curve.length,
        clearance=clearance.sampled,
        clearance_at=float(tightest),
        clearance_bound=clearance.bound,
        curvature=curvature.sampled,
        curvature_at=float(sharpest),
        curvature_bound=curvature.bound,
    )


def broken(instrument: Instrument, witness: Witness, tip: TipClearance | None, *, used: float) -> list[str]:
    """What a path does not keep, in words; empty when all is proved. `used` is the length of instrument it takes, mm."""
    said = []
    radius = instrument.radius
    if witness.clearance_bound < radius:
        left, needed = apart(witness.clearance, radius)
        said.append(
            f"clearance falls to {left} mm at {witness.clearance_at:.1f} mm where {needed} mm are needed"
            if witness.clearance < radius
            else "the clearance between the samples could not be proved"
        )
    if witness.curvature_bound > instrument.limits.curvature_max:
        said.append(
            f"the bend radius falls to {1.0 / witness.curvature:.1f} mm at {witness.curvature_at:.1f} mm "
            f"where {instrument.bend_radius_min_mm:.1f} mm are allowed"
            if witness.curvature > instrument.limits.curvature_max
            else "the curvature between the samples could not be proved"
        )
    if tip is not None and tip.bound < radius:
        left, needed = apart(tip.sampled, radius)
        said.append(
            f"the rigid tip of {instrument.rigid_tip_mm:g} mm comes to {left} mm of the wall "
            f"with its front at {tip.arc_length:.1f} mm where {needed} mm are required"
        )
    if used > instrument.working_length_mm:
        said.append(f"{used:.0f} mm of instrument are needed, the working length is {instrument.working_length_mm:.0f} mm")
    return said
