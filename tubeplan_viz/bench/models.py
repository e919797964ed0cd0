"""Model tubes whose axis, radius and clearance are known in closed form.

Bent cylinder 1, its variants and bent cylinder 2 are those of Dai et al. (2024),
section 3: with quarter bends of 12, 15, 18 and 20 mm that turn alternately and no
straight pieces at all, the axis ends at (65, 65, 0) and the surface fills the
printed box of 71 x 65 x 6 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from segmentation.arrays import FloatArray, frozen_array
from segmentation.mesh import Surface
from tubeplan_viz.bench.axes import Axis, planar_axis
from tubeplan_viz.bench.meshing import Radius, constant_radius, marching_surface, sweep

Meshing = Literal["swept", "structured", "marching_cubes"]

# Edge and voxel that give about 20,000 faces on bent cylinder 1.
EDGE = 0.44
VOXEL = 0.4
AXIS_STEP = 0.1
SWEEP_SEED = 20241


@dataclass(frozen=True, eq=False, kw_only=True)
class Model:
    """A tube mesh with the truth about it.

    Attributes
    ----------
    name : str
    surface : Surface
        Closed; the flat ends are labelled caps (origin "flat end"), C1 at the start, C2 at the goal.
    axis_points : (n, 3) float array, mm
        Dense points on the exact axis from start to goal, evenly spaced, ends included.
    arc_length : (n,) float array, mm
    radius : (n,) float array, mm
        Radius of the cross-section perpendicular to the axis.
    clearance : (n,) float array, mm
        Exact distance from the axis to the wall of the ideal tube, caps left out. For
        the Y-junction a lower bound (the parent's and child's own radius).
    start, goal : (3,) float array, mm
        Both ends of the axis, in the middle of the caps.
    curvature : (n,) float array, 1/mm
        Of the axis.
    branches : tuple of (k, 3) float array, mm
        Axes of the other branches, from junction to tip.
    """

    name: str
    surface: Surface
    axis_points: FloatArray
    arc_length: FloatArray
    radius: FloatArray
    clearance: FloatArray
    curvature: FloatArray
    branches: tuple[FloatArray, ...] = ()

    def __post_init__(self) -> None:
        points = frozen_array(self.axis_points, (None, 3), "axis_points")
        object.__setattr__(self, "axis_points", points)
        for name in ("arc_length", "radius", "clearance", "curvature"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (len(points),), name))

    @property
    def start(self) -> FloatArray:
        """Middle of cap C1, (3,) mm."""
        return np.asarray(self.axis_points[0])

    @property
    def goal(self) -> FloatArray:
        """Middle of cap C2, (3,) mm."""
        return np.asarray(self.axis_points[-1])

    @property
    def length(self) -> float:
        """Arc length of the axis, mm."""
        return float(self.arc_length[-1])


def bent_cylinder_1(
    bend_radii: Sequence[float] = (12.0, 15.0, 18.0, 20.0),
    *,
    radius: float = 3.0,
    meshing: Meshing = "swept",
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
    name: str = "bent cylinder 1",
) -> Model:
    """Tangent quarter bends in the plane z = 0, turning alternately, first and last direction +y.

    Parameters
    ----------
    bend_radii : sequence of float, mm
        Of the axis, from the start.
    radius : float, mm
        Of the tube.
    meshing : {"swept", "structured", "marching_cubes"}
        Rings turned against each other, exact quad rings (cospherical, hard for Voronoi
        diagrams), or marching cubes of 0.4 mm.
    noise : float, mm
        Standard deviation of the normal noise added to every coordinate of the wall's vertices.
    rng : numpy.random.Generator, optional
        Needed when `noise` is not zero.

    Returns
    -------
    Model
        Length ``pi / 2 * sum(bend_radii)``: 102.1 mm for cylinder 1.

    References
    ----------
    .. [1] Dai et al. (2024). J. Tianjin Univ. 57(10), 1010-1021, section 3.
    """
    pieces = [(0.5 * np.pi * bend, (-1.0) ** (i + 1) / bend) for i, bend in enumerate(bend_radii)]
    return _tube(name, planar_axis(pieces), constant_radius(radius), meshing, noise, rng)


def variant_1(*, meshing: Meshing = "swept", noise: float = 0.0, rng: np.random.Generator | None = None) -> Model:
    """Bent cylinder 1 with bends of 10, 13, 16 and 19 mm; options as there."""
    return bent_cylinder_1((10.0, 13.0, 16.0, 19.0), meshing=meshing, noise=noise, rng=rng, name="variant 1")


def variant_2(*, meshing: Meshing = "swept", noise: float = 0.0, rng: np.random.Generator | None = None) -> Model:
    """Bent cylinder 1 with bends of 8, 12, 16 and 20 mm; options as there."""
    return bent_cylinder_1((8.0, 12.0, 16.0, 20.0), meshing=meshing, noise=noise, rng=rng, name="variant 2")


def bent_cylinder_2(*, meshing: Meshing = "swept", noise: float = 0.0, rng: np.random.Generator | None = None) -> Model:
    """Radius 10 mm, axis of 40 mm bent by 60 degrees, and at each end a cone that narrows from 10 to 2 mm.

    A cone of base radius 10 mm and height 20 mm falls by 1 mm of radius in 2 mm of
    axis, so it is cut (radius 2 mm) after 16 mm and the axis is 16 + 40 + 16 = 72 mm
    long; the paper's 88 points at its other models' step of 0.81 mm give 70.5 mm.

    The distance to the cone is not its radius r: the foot of the perpendicular lies
    nearer to the tip, at distance ``r cos(a)`` with ``tan a = 1/2``. With t the arc length
    from the cut end, r = 2 + t/2, it is ``(4 + t) / sqrt(5)`` for t >= 1; before that the
    foot would lie past the cut and the rim is nearest, ``sqrt(4 + t^2)``. See `too_narrow_cylinder_2`.
    """
    curvature = np.deg2rad(60.0) / 40.0
    axis = planar_axis([(16.0, 0.0), (40.0, curvature), (16.0, 0.0)])

    def radius(s: FloatArray) -> FloatArray:
        return np.minimum(10.0, 2.0 + 0.5 * np.clip(np.minimum(s, 72.0 - s), 0.0, None))

    def clearance(s: FloatArray) -> FloatArray:
        t = np.clip(np.minimum(s, 72.0 - s), 0.0, None)
        # In the bend the axis leaves the cone's axis sideways, by a little, while the cone is still the nearest wall.
        turn = np.clip(t - 16.0, 0.0, None) * curvature
        width = np.where(t < 16.0, 2.0 + 0.5 * t, 10.0 + (0.5 * np.sin(turn) - (1.0 - np.cos(turn))) / curvature)
        return np.minimum(10.0, np.where(t < 1.0, np.sqrt(4.0 + t**2), 2.0 / np.sqrt(5.0) * width))

    return _tube("bent cylinder 2", axis, radius, meshing, noise, rng, clearance=clearance, kinks=(16.0, 56.0))


def too_narrow_cylinder_2(clearance_min: float = 6.0) -> tuple[tuple[float, float], tuple[float, float]]:
    """Arc lengths in mm between which the axis of bent cylinder 2 is nearer to the wall than `clearance_min`.

    From ``(4 + t) / sqrt(5) = clearance_min``: t = 9.416 mm for 6 mm, at both ends. Valid
    for limits between sqrt(5) (the foot is on the cone) and 10 mm.

    Examples
    --------
    >>> [tuple(round(x, 3) for x in stretch) for stretch in too_narrow_cylinder_2()]
    [(0.0, 9.416), (62.584, 72.0)]
    """
    if not np.sqrt(5.0) <= clearance_min <= 10.0:
        raise ValueError(f"clearance_min is {clearance_min:g} mm, expected sqrt(5) to 10 mm")
    t = float(np.sqrt(5.0) * clearance_min - 4.0)
    return (0.0, t), (72.0 - t, 72.0)


def straight_tube(
    length: float = 40.0,
    radius: float = 3.0,
    *,
    meshing: Meshing = "swept",
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Model:
    """A cylinder along +y from the origin."""
    return _tube("straight tube", planar_axis([(length, 0.0)]), constant_radius(radius), meshing, noise, rng)


def torus_piece(
    bend_radius: float = 20.0,
    angle: float = np.pi / 2,
    radius: float = 3.0,
    *,
    meshing: Meshing = "swept",
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Model:
    """A piece of a torus: axis of constant curvature over `angle` radians, turning left from +y."""
    return _tube(
        "torus piece", planar_axis([(bend_radius * angle, 1.0 / bend_radius)]), constant_radius(radius), meshing, noise, rng
    )


def helix_tube(
    curvature: float = 0.06,
    torsion: float = 0.03,
    length: float = 80.0,
    radius: float = 2.5,
    *,
    meshing: Meshing = "swept",
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Model:
    """A tube around a helix of the given constant curvature and torsion, 1/mm."""
    axis = Axis(((length, curvature, torsion),), np.zeros(3), np.eye(3))
    return _tube("helix tube", axis, constant_radius(radius), meshing, noise, rng)


def narrow_neck(
    length: float = 40.0,
    radius: float = 3.0,
    neck: float = 1.0,
    width: float = 12.0,
    *,
    meshing: Meshing = "swept",
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Model:
    """A straight tube along +y that narrows to `neck` in the middle, by half a cosine wave on each side of total `width` mm."""

    def profile(s: FloatArray) -> FloatArray:
        t = np.clip(np.abs(np.asarray(s) - 0.5 * length) / (0.5 * width), 0.0, 1.0)
        return neck + (radius - neck) * 0.5 * (1.0 - np.cos(np.pi * t))

    def clearance(s: FloatArray) -> FloatArray:
        # The tube is a body of revolution about its axis: the nearest wall point lies in the meridian plane.
        t = np.linspace(0.0, length, 40001)
        return np.asarray(cKDTree(np.column_stack([t, profile(t)])).query(np.column_stack([s, 0.0 * s]))[0])

    return _tube("narrow neck", planar_axis([(length, 0.0)]), profile, meshing, noise, rng, clearance=clearance)


def y_junction(
    parent: float = 25.0,
    child: float = 20.0,
    radius: float = 3.0,
    child_radius: float = 2.2,
    half_angle: float = np.deg2rad(35.0),
    *,
    voxel: float = VOXEL,
) -> Model:
    """A tube along +y that divides in the plane z = 0 into two straight children, meshed by marching cubes.

    The model's axis goes from the parent's end (C1) into the left child (negative x, C2); `branches`
    holds the right child's axis (its cap is C3). All branch axes meet at (0, parent, 0).
    """
    trunk = planar_axis([(parent, 0.0)])
    joint = (0.0, parent, 0.0)
    left = planar_axis([(child, 0.0)], start=joint, heading=0.5 * np.pi + half_angle)
    right = planar_axis([(child, 0.0)], start=joint, heading=0.5 * np.pi - half_angle)
    tubes = [
        (trunk, constant_radius(radius), (True, False)),
        (left, constant_radius(child_radius), (False, True)),
        (right, constant_radius(child_radius), (False, True)),
    ]
    surface = marching_surface(tubes, voxel=voxel)
    s = np.linspace(0.0, parent + child, int(np.ceil((parent + child) / AXIS_STEP)) + 1)
    points = np.where((s <= parent)[:, None], trunk.at(np.minimum(s, parent))[0], left.at(np.maximum(s - parent, 0.0))[0])
    r = np.where(s <= parent, radius, child_radius)
    other = right.at(np.linspace(0.0, child, int(np.ceil(child / AXIS_STEP)) + 1))[0]
    return Model(
        name="y junction",
        surface=surface,
        axis_points=points,
        arc_length=s,
        radius=r,
        clearance=r,
        curvature=0.0 * s,
        branches=(other,),
    )


def _tube(
    name: str,
    axis: Axis,
    radius: Radius,
    meshing: Meshing,
    noise: float,
    rng: np.random.Generator | None,
    *,
    clearance: Radius | None = None,
    kinks: Sequence[float] = (),
) -> Model:
    # Coarser where the wall is larger than bent cylinder 1's, so that the number of faces stays.
    coarser = max(1.0, float(np.sqrt(radius(np.linspace(0.0, axis.length, 400)).max() * axis.length / 306.0)))
    if meshing == "marching_cubes":
        surface = marching_surface([(axis, radius, (True, True))], voxel=VOXEL * coarser)
    elif meshing in ("swept", "structured"):
        rng_twist = np.random.default_rng(SWEEP_SEED)
        surface = sweep(
            axis, radius, edge=EDGE * coarser, twisted=meshing == "swept", rng=rng_twist, sites=np.asarray(kinks, dtype=float)
        )
    else:
        raise ValueError(f"meshing is {meshing!r}, expected 'swept', 'structured' or 'marching_cubes'")
    if noise > 0.0:
        if rng is None:
            raise ValueError("noise needs a random generator: pass rng")
        surface = with_noise(surface, noise, rng=rng)
    s = np.linspace(0.0, axis.length, int(np.ceil(axis.length / AXIS_STEP)) + 1)
    joints = np.cumsum([piece[0] for piece in axis.pieces])[:-1]
    curvature = np.abs([axis.pieces[i][1] for i in np.searchsorted(joints, s)])
    return Model(
        name=name,
        surface=surface,
        axis_points=axis.at(s)[0],
        arc_length=s,
        radius=radius(s),
        clearance=(clearance or radius)(s),
        curvature=curvature,
    )


def with_noise(surface: Surface, sigma: float, *, rng: np.random.Generator) -> Surface:
    """The surface with normal noise of `sigma` mm on every coordinate of its wall's vertices; inner cap vertices stay."""
    on_wall = np.unique(surface.wall_faces)
    vertices = surface.vertices.copy()
    vertices[on_wall] += rng.normal(0.0, sigma, (len(on_wall), 3))
    return Surface(vertices, surface.faces, surface.face_cap, surface.caps, surface.frame)
