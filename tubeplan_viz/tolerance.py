"""How a path bears errors of pose and registration: rigid perturbations drawn at random, and what stays clear."""

# Strategy: the same standard normal numbers serve every size of error, so that two sizes differ by scale alone. A place of
# the path whose clearance exceeds its own shift by the limit is clear without a query; only the others ask the wall.

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from segmentation.arrays import BoolArray, FloatArray, IntArray, frozen_array
from segmentation.errors import CaseError
from tubeplan_viz.geometry import WallDistance
from tubeplan_viz.plan import PathProfile

# The word that asks for all presets, in place of one size.
PRESETS = "presets"
# Root mean square shift, mm, and turn, degrees, of the presets: together, the shift alone, the turn alone.
SIZES = (1.0, 2.0, 3.0, 4.0, 5.0)
PRESET_SIZES: tuple[tuple[float, float], ...] = (
    *((size, size) for size in SIZES),
    *((size, 0.0) for size in SIZES),
    *((0.0, size) for size in SIZES),
)
# Of each preset: a share is known to 0.035 or better, one standard error.
PRESET_SAMPLES = 200
# Two-sided 95 % quantile of the normal distribution.
CONFIDENCE = 1.959963984540054
SPACING = 1.0


@dataclass(frozen=True, kw_only=True)
class ToleranceSettings:
    """Size and number of the perturbations.

    Attributes
    ----------
    translation : float, mm
        Root mean square length of the shift, which is normal and the same in all directions.
    rotation : float, degrees
        Root mean square angle of the turn; its rotation vector is normal and the same in all directions.
    samples : int
    pivot : 3 floats, mm, optional
        What the path turns about; by default the middle of its arc length.
    """

    translation: float
    rotation: float
    samples: int = 500
    pivot: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.translation <= 100.0:
            raise CaseError(f"the tolerance's shift is {self.translation:g} mm, expected 0 to 100 (presets: 1 to 5)")
        if not 0.0 <= self.rotation <= 90.0:
            raise CaseError(f"the tolerance's turn is {self.rotation:g} degrees, expected 0 to 90 (presets: 1 to 5)")
        if not 1 <= self.samples <= 1_000_000:
            raise CaseError(f"the tolerance has {self.samples} samples, expected 1 to 1000000")


@dataclass(frozen=True, eq=False, kw_only=True)
class Tolerance:
    """What the perturbations did.

    Attributes
    ----------
    translation : float, mm
    rotation : float, degrees
    samples : int
    probability : float
        Share of perturbations under which the whole path keeps the clearance limit.
    low, high : float
        95 % confidence interval of it (Wilson).
    arc_length : (n,) float array, mm
    clear : (n,) float array
        Share of perturbations under which each place keeps the limit.
    weakest : float, mm
        Arc length of the place that is clear least often; the tightest of several.
    first : float or None, mm
        Median arc length at which an advancing instrument first comes too near to the wall, over the
        perturbations that fail; None when none does.
    """

    translation: float
    rotation: float
    samples: int
    probability: float
    low: float
    high: float
    arc_length: FloatArray
    clear: FloatArray
    weakest: float
    first: float | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "arc_length", frozen_array(self.arc_length, (None,), "arc_length"))
        object.__setattr__(self, "clear", frozen_array(self.clear, (len(self.arc_length),), "clear"))

    def details(self) -> dict[str, Any]:
        """For result.json."""
        return {
            "translation_mm": self.translation,
            "rotation_deg": self.rotation,
            "samples": self.samples,
            "probability": self.probability,
            "probability_low": self.low,
            "probability_high": self.high,
            "weakest_mm": self.weakest,
            "first_breach_mm": self.first,
            "s_mm": self.arc_length,
            "clear": self.clear,
        }


def path_tolerance(
    profile: PathProfile, wall: WallDistance, clearance_min: float, settings: ToleranceSettings, *, rng: np.random.Generator
) -> Tolerance:
    """Share of random rigid errors of pose under which a path stays clear of the wall.

    The path is perturbed as a whole: shifted, and turned about the pivot. Beyond an end cap there is
    no wall, so leaving the lumen through one is no breach.

    Parameters
    ----------
    profile : PathProfile
        Places at most `SPACING` apart are looked at, and every local minimum of the clearance.
    wall : WallDistance
    clearance_min : float, mm
    settings : ToleranceSettings
    rng : numpy.random.Generator
        The same state gives the same perturbations, for any size of error.
    """
    places = chosen_places(profile)
    points, clearance = profile.points[places], profile.clearance[places]
    pivot = (
        profile.points[int(np.searchsorted(profile.arc_length, 0.5 * profile.length))]
        if settings.pivot is None
        else np.asarray(settings.pivot)
    )
    normal = rng.standard_normal((settings.samples, 6))
    # Three components share the mean square.
    shifts = normal[:, :3] * settings.translation / np.sqrt(3.0)
    turns = Rotation.from_rotvec(normal[:, 3:] * np.radians(settings.rotation) / np.sqrt(3.0))
    offset = points - pivot
    turned = np.einsum("kij,nj->kni", turns.as_matrix(), offset)
    moved = turned + pivot + shifts[:, None]  # (samples, places, 3)
    far = np.linalg.norm(moved - points, axis=2)
    clear = clearance - far >= clearance_min
    # Where the error is zero the plan's own clearance decides: rounding must not.
    still = far == 0.0
    clear |= still & (clearance >= clearance_min)
    asked = ~clear & ~still
    if asked.any():
        clear[asked] = keeps_clear(moved[asked], wall, clearance_min)
    whole = clear.all(axis=1)
    share = clear.mean(axis=0)
    low, high = wilson(int(whole.sum()), settings.samples)
    least = np.flatnonzero(share == share.min())
    failing = ~whole
    first = float(np.median(profile.arc_length[places][np.argmin(clear[failing], axis=1)])) if failing.any() else None
    return Tolerance(
        translation=settings.translation,
        rotation=settings.rotation,
        samples=settings.samples,
        probability=float(whole.mean()),
        low=low,
        high=high,
        arc_length=profile.arc_length[places],
        clear=share,
        weakest=float(profile.arc_length[places][least[int(np.argmin(clearance[least]))]]),
        first=first,
    )


def preset_tolerances(profile: PathProfile, wall: WallDistance, clearance_min: float, *, seed: int) -> tuple[Tolerance, ...]:
    """`path_tolerance` for every one of `PRESET_SIZES`, all with the same perturbations but for their size.

    Parameters
    ----------
    profile : PathProfile
    wall : WallDistance
    clearance_min : float, mm
    seed : int
        Of the perturbations.
    """
    return tuple(
        path_tolerance(
            profile,
            wall,
            clearance_min,
            ToleranceSettings(translation=translation, rotation=rotation, samples=PRESET_SAMPLES),
            rng=np.random.default_rng(seed),
        )
        for translation, rotation in PRESET_SIZES
    )


def chosen_places(profile: PathProfile) -> IntArray:
    """Indices of the samples looked at."""
    step = max(int(SPACING / max(profile.arc_length[1] - profile.arc_length[0], 1e-9)), 1)
    padded = np.concatenate([[np.inf], profile.clearance, [np.inf]])
    lowest = np.flatnonzero((profile.clearance <= padded[:-2]) & (profile.clearance <= padded[2:]))
    n = len(profile.arc_length)
    return np.union1d(np.append(np.arange(0, n, step), n - 1), lowest)


def keeps_clear(points: FloatArray, wall: WallDistance, clearance_min: float) -> BoolArray:
    """Whether points keep the distance on the inner side of the nearest wall, (k,)."""
    distance, face, foot = wall.nearest(points)
    inner = np.einsum("ij,ij->i", points - foot, wall.surface.face_normals[face]) <= 0.0
    return np.asarray(inner & (distance >= clearance_min))


def wilson(successes: int, samples: int) -> tuple[float, float]:
    """95 % confidence interval of a share [1]_.

    References
    ----------
    .. [1] Wilson, E. B. (1927). Probable inference, the law of succession, and statistical
       inference. J. Am. Stat. Assoc. 22(158), 209-212.

    Examples
    --------
    >>> [round(bound, 3) for bound in wilson(90, 100)]
    [0.826, 0.945]
    """
    share, z = successes / samples, CONFIDENCE
    middle = (share + z * z / (2.0 * samples)) / (1.0 + z * z / samples)
    half = z / (1.0 + z * z / samples) * np.sqrt(share * (1.0 - share) / samples + z * z / (4.0 * samples**2))
    return max(float(middle - half), 0.0), min(float(middle + half), 1.0)
