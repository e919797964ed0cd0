"""Stone scores whose parts follow from geometry, each point traced to the number it was given for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

RUSS_SOURCE = "Resorlu B et al., Urology 2012; 80(3): 512-518 (Resorlu-Unsal stone score; one point for each of four)"
RIRS_SOURCE = (
    "Xiao Y et al., BMC Urology 2017; 17: 105, doi 10.1186/s12894-017-0297-0 (R.I.R.S. scoring system; four parts, 4 to 10)"
)


@dataclass(frozen=True, kw_only=True)
class StoneFacts:
    """What the scores ask of the stones and the way to them; None where it is not known.

    Attributes
    ----------
    burden : float or None, mm
        Sum of the stones' largest diameters.
    density : float or None, HU
        Mean of the densest stone.
    calyces : int or None
        Number of different calyces that hold a stone.
    lower_pole : bool or None
        Whether a stone lies in the lower infundibulum or its calyces.
    angle : float or None, degrees
        Lower infundibulopelvic angle, coronal view.
    length : float or None, mm
        Infundibular length to the calyx of the stone; the longest where there are several.
    abnormal : bool or None
        Horseshoe or pelvic kidney, as the case says: it does not follow from the lumen.
    """

    burden: float | None = None
    density: float | None = None
    calyces: int | None = None
    lower_pole: bool | None = None
    angle: float | None = None
    length: float | None = None
    abnormal: bool | None = None


@dataclass(frozen=True, kw_only=True)
class ScorePart:
    """One part of a score.

    Attributes
    ----------
    name, rule : str
    points : int or None
        None where an input is lacking.
    lowest, highest : int
        What the rule can give.
    given : str
        The number or fact the points were given for, in words; why there are none where there are none.
    """

    name: str
    rule: str
    points: int | None
    lowest: int
    highest: int
    given: str


@dataclass(frozen=True, kw_only=True)
class Score:
    """A score with its parts; a range where a part is lacking."""

    name: str
    source: str
    parts: tuple[ScorePart, ...]

    @property
    def low(self) -> int:
        """The least total that the known parts allow."""
        return sum(part.lowest if part.points is None else part.points for part in self.parts)

    @property
    def high(self) -> int:
        """The largest total that the known parts allow."""
        return sum(part.highest if part.points is None else part.points for part in self.parts)

    def details(self) -> dict[str, Any]:
        """The score for result.json; total is null where a part is lacking."""
        return {
            "name": self.name,
            "source": self.source,
            "total": self.low if all(part.points is not None for part in self.parts) else None,
            "low": self.low,
            "high": self.high,
            "parts": [
                {
                    "name": part.name,
                    "rule": part.rule,
                    "points": part.points,
                    "lowest": part.lowest,
                    "highest": part.highest,
                    "given": part.given,
                }
                for part in self.parts
            ],
        }


NO_STONE = "no stone was given"


def part(name: str, rule: str, points: int | None, span: tuple[int, int], given: str) -> ScorePart:
    """One part of a score, whose rule gives from the first to the second of `span`."""
    return ScorePart(name=name, rule=rule, points=points, lowest=span[0], highest=span[1], given=given)


def russ(facts: StoneFacts) -> Score:
    """Resorlu-Unsal stone score [1]_: one point each for four conditions, 0 to 4.

    References
    ----------
    .. [1] Resorlu, B., Unsal, A., Gulec, H., Oztuna, D. (2012). A new scoring system for predicting stone-free rate
       after retrograde intrarenal surgery: the "Resorlu-Unsal stone score". Urology 80(3), 512-518.
    """
    anatomy = (
        "it does not follow from the lumen; say it with abnormal_anatomy in [measures]"
        if facts.abnormal is None
        else f"the case says {'yes' if facts.abnormal else 'no'}"
    )
    return Score(
        name="RUSS",
        source=RUSS_SOURCE,
        parts=(
            part(
                "Stone size",
                "over 20 mm: 1",
                _steps(facts.burden, (20.0,), first=0),
                (0, 1),
                told(facts.burden, "{:.1f} mm in all", NO_STONE),
            ),
            part(
                "Lower pole with an angle below 45°",
                "stone in the lower pole and infundibulopelvic angle below 45°: 1",
                _steep(facts, 45.0, (0, 0, 1), inclusive=False),
                (0, 1),
                _pole_words(facts),
            ),
            part(
                "Stones in several calyces",
                "more than one calyx: 1",
                _steps(facts.calyces, (1.0,), first=0),
                (0, 1),
                told(facts.calyces, "{:d} calyx or calyces", "it is not known in which calyces stones lie"),
            ),
            part(
                "Abnormal renal anatomy",
                "horseshoe or pelvic kidney: 1",
                None if facts.abnormal is None else int(facts.abnormal),
                (0, 1),
                anatomy,
            ),
        ),
    )


def rirs(facts: StoneFacts) -> Score:
    """R.I.R.S. scoring system [1]_: density, inferior pole, infundibular length, burden; 4 to 10.

    References
    ----------
    .. [1] Xiao, Y., Li, D., Chen, L. et al. (2017). The R.I.R.S. scoring system: an innovative scoring system for
       predicting stone-free rate following retrograde intrarenal surgery. BMC Urology 17, 105.
    """
    return Score(
        name="R.I.R.S.",
        source=RIRS_SOURCE,
        parts=(
            part(
                "Renal stone density",
                "up to 1000 HU: 1, above: 2",
                _steps(facts.density, (1000.0,), first=1),
                (1, 2),
                told(facts.density, "{:.0f} HU", NO_STONE),
            ),
            part(
                "Inferior pole stone",
                "not in the lower pole: 1; angle above 30°: 2; up to 30°: 3",
                _steep(facts, 30.0, (1, 2, 3), inclusive=True),
                (1, 3),
                _pole_words(facts),
            ),
            part(
                "Renal infundibular length",
                "up to 25 mm: 1, above: 2",
                _steps(facts.length, (25.0,), first=1),
                (1, 2),
                told(facts.length, "{:.1f} mm", "no infundibular length to the calyx of a stone"),
            ),
            part(
                "Stone burden",
                "up to 10 mm: 1; up to 20 mm: 2; above: 3",
                _steps(facts.burden, (10.0, 20.0), first=1),
                (1, 3),
                told(facts.burden, "{:.1f} mm in all", NO_STONE),
            ),
        ),
    )


def told(value: float | None, form: str, lacking: str) -> str:
    """A value in words, or why there is none."""
    return lacking if value is None else form.format(value)


def _steps(value: float | None, limits: tuple[float, ...], *, first: int) -> int | None:
    """The first points and one more for each limit that is exceeded."""
    return None if value is None else first + sum(value > limit for limit in limits)


def _steep(facts: StoneFacts, limit: float, points: tuple[int, int, int], *, inclusive: bool) -> int | None:
    """Points for: not in the lower pole, there with a wide angle, there with a steep one (the limit itself if `inclusive`)."""
    if facts.lower_pole is None:
        return None
    if not facts.lower_pole:
        return points[0]
    if facts.angle is None:
        return None
    steep = facts.angle <= limit if inclusive else facts.angle < limit
    return points[2] if steep else points[1]


def _pole_words(facts: StoneFacts) -> str:
    if facts.lower_pole is None:
        return "it is not known whether a stone lies in the lower pole"
    if not facts.lower_pole:
        return "no stone in the lower pole"
    return told(facts.angle, "lower pole, angle {:.1f}° in coronal view", "lower pole, but its angle could not be measured")
