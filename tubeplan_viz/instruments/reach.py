"""Which instruments reach one target: few paths searched, every cell judged on all of them."""

# Strategy: a path is a witness for every instrument whose limits it keeps, so one search per bend radius serves all
# diameters. Bend radii are searched by halving: where the clearance comes near to what no path surpasses, softer
# instruments need no search; where a softer one found nothing, stiffer ones are not searched. Then each cell takes
# the path that serves it best. An instrument that can take every shape another can inherits its yes.

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from segmentation.arrays import FloatArray
from segmentation.errors import CaseError
from tubeplan_viz.geometry import SplineCurve, WallDistance
from tubeplan_viz.instruments.advance import farthest
from tubeplan_viz.instruments.catalogue import Instrument
from tubeplan_viz.instruments.proof import SharpBend, impossible, sharp_bends
from tubeplan_viz.instruments.tip import TipClearance, tip_clearance
from tubeplan_viz.instruments.track import Track
from tubeplan_viz.instruments.verdict import Cell, Target, Verdict, Witness, broken, witness_of
from tubeplan_viz.plan import Limits, NoPathError
from tubeplan_viz.tube import METHODS, OptimalSettings, Passage, TubeProblem, TubeSettings, optimise, tube_rounds
from tubeplan_viz.tube.samples import first_spline

# Nearer to the ceiling than this share, a softer instrument gains nothing.
NEAR_CEILING = 0.99
# A search for a verdict: where it succeeds it takes under ten rounds; the rest go to instruments that do not fit.
SEARCH_ROUNDS = 15
SEARCH_TOLERANCE = 2e-3
# A path that is to lie amid the lumen need not lie there to the last digit: fewer control points, mm apart at most.
CENTRE_SPACING, SPACING_MAX = 2.0, 20.0
CENTRE_TOLERANCE = 1e-2


@dataclass(frozen=True, kw_only=True)
class ReachSettings:
    """How paths are searched.

    Attributes
    ----------
    method : {"optimal", "feature_iteration"}
    before_start_mm : float
        Length of instrument that is used up before the start of the path.
    tube : TubeSettings
        Of the path search; its method is not looked at.
    """

    method: str = "optimal"
    before_start_mm: float = 0.0
    tube: TubeSettings = field(default_factory=TubeSettings)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise CaseError(f"the matrix has no method {self.method!r}; expected {' or '.join(METHODS)}")
        if not 0.0 <= self.before_start_mm <= 10_000.0:
            raise CaseError(f"before_start_mm is {self.before_start_mm:g}, expected 0 to 10000 (used up on the way in)")


class Reach:
    """Search and judgement for one target; `cells` gives one cell per instrument in their order.

    Parameters
    ----------
    wall : WallDistance
    start : (3,) float array, mm
    target : Target
    instruments : sequence of Instrument
    settings : ReachSettings
    """

    def __init__(
        self, wall: WallDistance, start: FloatArray, target: Target, instruments: Sequence[Instrument], settings: ReachSettings
    ) -> None:
        self.witnesses: list[Witness] = []
        self.bends: tuple[SharpBend, ...] = ()
        self._wall, self._start, self._target, self._settings = wall, np.asarray(start, dtype=float), target, settings
        self._instruments = tuple(instruments)
        self._tips: dict[tuple[int, float, float], TipClearance] = {}
        self._tracks: dict[int, Track] = {}
        if target.centerline is not None:
            possible = [one for one in self._instruments if self.impossible(one) is None]
            self.search(possible)
            if settings.method == "optimal" and not all(self.is_served(one) for one in self._instruments):
                self.centre()
            hindered = [one for one in possible if not any(self.fits(witness, one) for witness in self.witnesses)]
            self.bends = sharp_bends(wall, target, hindered, self.witnesses)

    def impossible(self, instrument: Instrument) -> Cell | None:
        """The cell of an instrument that no path can be for, or None while nothing proves it."""
        straight = float(np.linalg.norm(self._target.point - self._start)) + self._settings.before_start_mm
        return impossible(instrument, self._target, straight=straight, bends=self.bends)

    def search(self, possible: Sequence[Instrument]) -> None:
        """Find paths for the bend radii of these instruments, stiffest instruments' limits included."""
        levels = sorted({one.limits.curvature_max for one in possible})
        if self._settings.method == "optimal":
            self.halve(levels, possible, stiffest=True)
            return
        ordered = sorted(possible, key=lambda one: (one.limits.curvature_max, -one.radius))
        for one in ordered:
            if not any(self.keeps(witness, one) for witness in self.witnesses):
                self.add(self.feature_path(one.limits), one.limits)

    def halve(self, levels: Sequence[float], possible: Sequence[Instrument], *, stiffest: bool = False) -> None:
        """Largest clearances at some of the curvature limits `levels`, which rise; none for instruments that are served.

        The middle one is searched first, or the `stiffest`: a path that it can follow serves all.
        """
        open_levels = {one.limits.curvature_max for one in possible if not self.is_served(one)}
        levels = [level for level in levels if level in open_levels]
        if not levels:
            return
        middle = 0 if stiffest else len(levels) // 2
        stiffer, softer = levels[:middle], levels[middle + 1 :]
        thinnest = min(one.radius for one in possible if one.limits.curvature_max <= levels[middle])
        limits = Limits(curvature_max=levels[middle], clearance_min=thinnest)
        witness = self.add(self.widest_path(limits), limits)
        found = witness is not None and witness.curvature_bound <= limits.curvature_max
        if found and witness is not None and witness.clearance_bound >= thinnest:
            self.halve(stiffer, possible)
        if not (found and witness is not None and witness.clearance_bound >= NEAR_CEILING * self._target.ceiling.bound):
            self.halve(softer, possible)

    def widest_path(self, limits: Limits) -> SplineCurve | None:
        """The path of largest least clearance under a curvature limit; None when no spline follows the line."""
        first, curve = self._first_spline, None
        if first is None:
            return None
        for proposal in optimise(self._passage(limits), quick(self._settings.tube.optimal), warm=first):
            curve = proposal.curve
            # The first proof ends the phase that raises the least clearance; what follows serves its mean.
            if proposal.clearance is not None:
                break
        return curve

    def centre(self) -> None:
        """Add a path as far from the wall as it can be where the lumen is wider than at its narrowest.

        Instruments that a narrow place keeps out, or whose rigid tip is caught, come farther on it. It bends no more than two
        thirds of them may: more room in the bends against more instruments that can follow.
        """
        levels = sorted(one.limits.curvature_max for one in self._instruments if not self.is_served(one))
        limits = Limits(curvature_max=levels[len(levels) // 3], clearance_min=min(one.radius for one in self._instruments))
        settings = quick(self._settings.tube.optimal)
        spacing = min(CENTRE_SPACING * settings.control_spacing, SPACING_MAX)
        coarse = replace(settings, control_spacing=spacing, tolerance=max(settings.tolerance, CENTRE_TOLERANCE))
        curve = None
        try:
            for proposal in optimise(self._passage(limits), coarse):
                curve = proposal.curve
        except NoPathError:
            return
        self.add(curve, limits)

    @cached_property
    def _first_spline(self) -> SplineCurve | None:
        """The spline fitted to the target's centerline, from which every search begins: the limits play no part in it."""
        try:
            grid, control = first_spline(self._passage(self._instruments[0].limits), self._settings.tube.optimal)
        except NoPathError:
            return None
        return grid.curve(control)

    def _passage(self, limits: Limits) -> Passage:
        assert self._target.centerline is not None
        return Passage(wall=self._wall, line=self._target.centerline.points, limits=limits)

    def feature_path(self, limits: Limits) -> SplineCurve | None:
        """The end of the feature iteration under these limits."""
        assert self._target.centerline is not None
        problem = TubeProblem(
            surface=self._wall.surface,
            wall=self._wall,
            centerline=self._target.centerline,
            start=self._start,
            goal=self._target.point,
            limits=limits,
            settings=replace(self._settings.tube, method="feature_iteration"),
        )
        *_, last = tube_rounds(problem)
        return last.curve

    def add(self, curve: SplineCurve | None, limits: Limits) -> Witness | None:
        """Measure a path and keep it."""
        if curve is None:
            return None
        self.witnesses.append(witness_of(curve, self._wall, limits))
        return self.witnesses[-1]

    def tip(self, index: int, instrument: Instrument) -> TipClearance | None:
        """Least clearance of an instrument's rigid tip along one witness, close enough to decide; None without a tip."""
        length, radius = instrument.rigid_tip_mm, instrument.radius
        if length <= 0.0:
            return None
        if (index, length, radius) not in self._tips:
            curve = self.witnesses[index].curve
            found = tip_clearance(curve, self._wall, length, limit=radius, track=self.track(index))
            self._tips[index, length, radius] = found
        return self._tips[index, length, radius]

    def track(self, index: int) -> Track:
        """One witness laid out by arc length."""
        if index not in self._tracks:
            self._tracks[index] = Track.of(self.witnesses[index].curve, self._wall)
        return self._tracks[index]

    def fits(self, witness: Witness, instrument: Instrument) -> bool:
        """Whether a path is proved to keep curvature limit and clearance."""
        return witness.curvature_bound <= instrument.limits.curvature_max and witness.clearance_bound >= instrument.radius

    def keeps(self, witness: Witness, instrument: Instrument) -> bool:
        """Whether a path is proved to keep curvature limit, clearance and working length; the tip is not looked at."""
        used = witness.length + self._settings.before_start_mm
        return self.fits(witness, instrument) and used <= instrument.working_length_mm

    def is_served(self, instrument: Instrument) -> bool:
        """Whether one of the paths found is proved for shaft and tip of an instrument."""
        for index, witness in enumerate(self.witnesses):
            if self.keeps(witness, instrument):
                tip = self.tip(index, instrument)
                if tip is None or tip.bound >= instrument.radius:
                    return True
        return False

    def cells(self) -> tuple[Cell, ...]:
        """The verdict for every instrument, in the order given."""
        own = [self.judge(instrument) for instrument in self._instruments]
        return tuple(self.with_advance(self.inherit(own, k), k) for k in range(len(own)))

    def with_advance(self, cell: Cell, k: int) -> Cell:
        """A cell that is not feasible, with how far its instrument comes."""
        if cell.verdict is Verdict.FEASIBLE:
            return cell
        tracks = {number: self.track(number) for number, witness in enumerate(self.witnesses) if witness.clearance_bound > 0.0}
        curves = [witness.curve for witness in self.witnesses]
        used = self._settings.before_start_mm
        advance = farthest(self._instruments[k], self._wall, curves, tracks, used=used)
        if advance is None:
            return cell
        return replace(cell, advance=advance, reason=f"{cell.reason}; it comes to {advance.short:.1f} mm before the target")

    def inherit(self, own: Sequence[Cell], k: int) -> Cell:
        """A cell that is not feasible by itself takes the yes of a harder instrument: it can take every shape of that one."""
        if own[k].verdict is Verdict.FEASIBLE:
            return own[k]
        mine = self._instruments[k]
        for cell, other in zip(own, self._instruments, strict=True):
            if cell.verdict is Verdict.FEASIBLE and other is not mine and mine.is_no_harder_than(other):
                assert cell.path is not None
                return self.cell_of(mine, cell.path, self.tip(cell.path, other), other.name)
        return own[k]

    def judge(self, instrument: Instrument) -> Cell:
        """The best of the witnesses for one instrument, or the proof that there is none."""
        proved = self.impossible(instrument)
        if proved is not None:
            return proved
        if not self.witnesses:
            return Cell(
                instrument=instrument.name,
                target=self._target.label,
                verdict=Verdict.FLAGGED,
                reason="no path was found: no chain of inscribed spheres, or no spline along it, joins the start and this target",
            )
        # The tip is costly: it is measured on the best paths first and left at the first that serves.
        order = sorted(range(len(self.witnesses)), key=lambda k: self.shortfall(instrument, k, None))
        cells = []
        for index in order:
            tip = self.tip(index, instrument)
            cell = self.cell_of(instrument, index, tip, None)
            if cell.verdict is Verdict.FEASIBLE:
                return cell
            cells.append((self.shortfall(instrument, index, tip), cell))
        return min(cells, key=lambda pair: pair[0])[1]

    def shortfall(self, instrument: Instrument, index: int, tip: TipClearance | None) -> float:
        """How far a path is from serving, as the largest relative excess over a limit; negative where it serves."""
        witness = self.witnesses[index]
        least = witness.clearance_bound if tip is None else min(witness.clearance_bound, tip.bound)
        reach = witness.length + self._settings.before_start_mm
        return max(
            1.0 - least / instrument.radius,
            witness.curvature_bound * instrument.bend_radius_min_mm - 1.0,
            reach / instrument.working_length_mm - 1.0,
        )

    def cell_of(self, instrument: Instrument, index: int, tip: TipClearance | None, inferred_from: str | None) -> Cell:
        """The cell of an instrument on one witness."""
        witness = self.witnesses[index]
        x, y, z = (float(v) for v in witness.curve(witness.curve.parameter(witness.clearance_at))[0])
        margin, at, point, part = witness.clearance - instrument.radius, witness.clearance_at, (x, y, z), "shaft"
        if tip is not None and tip.sampled < witness.clearance:
            margin, at, point, part = tip.sampled - instrument.radius, tip.arc_length, tip.point, "tip"
        faults = broken(instrument, witness, tip, used=witness.length + self._settings.before_start_mm)
        reason = "; ".join(faults) if faults else "all limits are kept and proved over the whole path"
        if inferred_from is not None:
            reason = f"can take every shape that {inferred_from} takes on its path, and is no thicker and no shorter"
        return Cell(
            instrument=instrument.name,
            target=self._target.label,
            verdict=Verdict.FLAGGED if faults and inferred_from is None else Verdict.FEASIBLE,
            reason=reason,
            margin=margin,
            margin_at=at,
            margin_point=point,
            margin_of=part,
            bend_radius=1.0 / max(witness.curvature, 1e-9),
            bend_at=witness.curvature_at,
            length=witness.length,
            tip=tip,
            inferred_from=inferred_from,
            path=index,
        )


def quick(settings: OptimalSettings) -> OptimalSettings:
    """Settings for many searches: fewer rounds, ended at a gain that no cell would show."""
    return replace(
        settings, max_rounds=min(settings.max_rounds, SEARCH_ROUNDS), tolerance=max(settings.tolerance, SEARCH_TOLERANCE)
    )
