"""From a nasal scene and a lesion to ranked paths: obstacles, search at growing shrinkage, goals, ranking."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from segmentation.anatomy.nasal.scene import NasalScene, Tissue
from segmentation.arrays import BoolArray, FloatArray, IntArray
from segmentation.errors import CaseError
from tubeplan_viz.rigid.collision import CELLS_ASKED, structure_gaps, to_frame
from tubeplan_viz.rigid.entry import BORDER, entry_border, entry_points
from tubeplan_viz.rigid.instrument import Bodies, CoupledInstrument, posed, swept, unit
from tubeplan_viz.rigid.judge import Judge
from tubeplan_viz.rigid.obstacles import Obstacles, build_obstacles
from tubeplan_viz.rigid.polish import polish
from tubeplan_viz.rigid.ranking import Ranking, Weights, rank
from tubeplan_viz.rigid.search_state import RigidPath, SearchResult, SearchSettings
from tubeplan_viz.rigid.tangent_search import cannot_stand, search
from tubeplan_viz.rigid.verdicts import Verdicts

AROUND_MM = 25.0  # of structures beside the way that are kept; farther ones are no nearer than this
GOAL_DECIMALS = 4  # distances are settled to 1e-3 mm
BENT_RANKED_MM = 2.0  # of paths with bends one is ranked for every cube of starts of this side
Progress = Callable[[str, int, int], None]
SIDES = ("left", "right")


@dataclass(frozen=True, eq=False)
class Problem:
    """One side, one lesion, one instrument, one state of the mucosa.

    Attributes
    ----------
    scene : NasalScene
    side : str
    goal : (3,) float array, LPS mm
    starts : (n, 3) float array, LPS mm
        Voxels of the entry region.
    obstacles : Obstacles
        Structures of the scene and the border of the entry region, the border last.
    instrument : CoupledInstrument
    margin : float, mm
    """

    scene: NasalScene
    side: str
    goal: FloatArray
    starts: FloatArray
    obstacles: Obstacles
    instrument: CoupledInstrument
    margin: float

    def structures_only(self) -> Obstacles:
        """The obstacles without the border of the entry region."""
        masks = {n: m for n, m in zip(self.obstacles.names, self.obstacles.masks, strict=True) if n != BORDER}
        return build_obstacles(self.scene.volume, masks)

    def judge(self, *, exact: bool = False) -> Judge:
        """Collision checks with their own count."""
        return Judge(self.obstacles, self.instrument, self.starts, margin=self.margin, exact=exact)


@dataclass(frozen=True, eq=False)
class RigidPlan:
    """All feasible paths found, ranked; empty lists where there is none.

    Attributes
    ----------
    problem : Problem
        With the mucosa as planned.
    searches : mapping of amount of shrinkage to SearchResult
        In rising order.
    paths : tuple of RigidPath
        Those that are ranked.
    goals : (n, 6) float array
        Columns as in `ranking.GOALS`.
    ranking : Ranking or None
        None without paths.
    """

    problem: Problem
    searches: Mapping[float, SearchResult]
    paths: tuple[RigidPath, ...]
    goals: FloatArray
    ranking: Ranking | None
    searched: SearchResult = field(repr=False)


def make_problem(
    scene: NasalScene,
    side: str,
    goal: FloatArray,
    *,
    instrument: CoupledInstrument,
    margin: float = 0.0,
    like: Obstacles | None = None,
) -> Problem:
    """Obstacles and starts of one side.

    The obstacles are the named structures, both orbits and both turbinates, and the border of the entry region. Other
    bone and soft tissue is no wall: what the channel takes of it counts as tissue to be removed (the text's f_t).
    Structures that are the same in the obstacles `like`, of another state of the mucosa, are taken from there.

    Raises
    ------
    CaseError
        If the side has no entry region, or the lesion lies outside the image, or in the air outside the head.
    """
    if side not in SIDES:
        raise CaseError(f"side is {side!r}, expected left or right (the patient's)")
    if side not in scene.entries:
        raise CaseError(f"no {side} nostril was found in the image; mark it by hand (a mask or a box)")
    volume = scene.volume
    goal = np.asarray(goal, float)
    if not volume.contains(goal):
        raise CaseError("the lesion ({:.1f}, {:.1f}, {:.1f}) mm lies outside the image; give LPS patient mm".format(*goal))
    region = scene.entries[side]
    starts = entry_points(volume, region)
    border = entry_border(volume, region, goal, instrument)
    corners = np.vstack([starts.min(axis=0), starts.max(axis=0), goal])
    low, high = corners.min(axis=0) - AROUND_MM, corners.max(axis=0) + AROUND_MM
    box = np.stack(np.meshgrid(*np.column_stack([low, high]), indexing="ij"), axis=-1).reshape(-1, 3)
    linear = volume.index_to_lps[:3, :3]
    inside = (box - volume.index_to_lps[:3, 3]) @ (linear / np.linalg.norm(linear, axis=0))
    box_of_way = inside.min(axis=0), inside.max(axis=0)
    obstacles = build_obstacles(volume, {**scene.structures, BORDER: border}, within=box_of_way, like=like)
    return Problem(scene, side, goal, starts, obstacles, instrument, margin)


def plan_rigid(
    problems: Mapping[float, Problem],
    settings: SearchSettings,
    weights: Weights,
    *,
    amount: float,
    progress: Progress | None = None,
) -> RigidPlan:
    """Search at each amount of shrinkage in rising order, and rank the paths of one.

    Parameters
    ----------
    problems : mapping of amount of shrinkage, 0 to 1, to Problem
        Each with obstacles that are a part of those before; paths found with less shrinkage stand with more.
    settings : SearchSettings
    weights : Weights
    amount : float
        The one of `problems` whose paths are ranked.
    progress : callable, optional
        Told the stage, and how many starts of how many are decided.
    """
    tell = progress or (lambda stage, done, total: None)
    searches = search_all(problems, settings, tell)
    planned = problems[amount]
    paths = ranked_paths(searches[amount].paths)
    tell("goals", 0, len(paths))
    goals = path_goals(planned, paths) if paths else np.empty((0, 6))
    if paths:
        tell("best paths refined", 0, len(paths))
        paths, goals = refined(planned, paths, goals, weights)
    return RigidPlan(planned, searches, paths, goals, rank(goals, weights) if paths else None, searches[amount])


def search_all(problems: Mapping[float, Problem], settings: SearchSettings, tell: Progress) -> dict[float, SearchResult]:
    """Search at every amount of shrinkage; parameters as `plan_rigid`."""
    # Strategy: paths found with less shrinkage stand with more, and so do verdicts: the amounts are taken in rising order. The
    # most shrunk one goes before where it may decide: if no instrument can stand at the goal there, and the search finds no path
    # either, there is none with more tissue, and only what blocks the straight pushes is left to be told.
    amounts, most = sorted(problems), problems[max(problems)]

    def searched(share: float, verdicts: Verdicts, known: Sequence[RigidPath], settings: SearchSettings) -> SearchResult:
        stage, problem = f"search, mucosa shrunk {100 * share:.0f} %", problems[share]
        judge = replace(problem.judge(), verdicts=verdicts)
        return search(
            judge, problem.starts, problem.goal, settings, known=known, progress=lambda done, total: tell(stage, done, total)
        )

    looked = Verdicts(most.obstacles)
    if len(amounts) > 1 and cannot_stand(replace(most.judge(), verdicts=looked), most.starts, most.goal, settings):
        last = searched(amounts[-1], looked.among(most.obstacles), (), settings)
        if not last.feasible.any():
            straight = replace(settings, nodes=0)
            before = {share: searched(share, Verdicts(problems[share].obstacles), (), straight) for share in amounts[:-1]}
            return {**before, amounts[-1]: last}
    searches: dict[float, SearchResult] = {}
    known: Sequence[RigidPath] = ()
    verdicts = Verdicts(problems[amounts[0]].obstacles)
    for share in amounts:
        verdicts = verdicts.among(problems[share].obstacles)
        searches[share] = searched(share, verdicts, known, settings)
        known = searches[share].paths
    return searches


def refined(
    problem: Problem, paths: tuple[RigidPath, ...], goals: FloatArray, weights: Weights
) -> tuple[tuple[RigidPath, ...], FloatArray]:
    """Paths and goals with what a local search around the best of them adds."""
    more, found = polish(problem.judge(), problem.starts, paths, goals, weights, lambda some: path_goals(problem, some))
    return (*paths, *more), np.vstack([goals, found])


def ranked_paths(paths: Sequence[RigidPath]) -> tuple[RigidPath, ...]:
    """All straight paths, and of those with bends one for every few starts."""
    kept, seen = [], set()
    for path in paths:
        cube = (*np.floor(path.nodes[0] / BENT_RANKED_MM).astype(int).tolist(), len(path.nodes))
        if len(path.nodes) == 2 or cube not in seen:
            kept.append(path)
            seen.add(cube)
    return tuple(kept)


def segments(paths: Sequence[RigidPath]) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Start and end points (m, 3), roll (m,) and path (m,) of all segments of some paths."""
    start = np.vstack([path.nodes[:-1] for path in paths])
    end = np.vstack([path.nodes[1:] for path in paths])
    count = np.array([len(path.nodes) - 1 for path in paths])
    owner = np.repeat(np.arange(len(paths)), count)
    return start, end, np.array([path.roll for path in paths])[owner], owner


def path_goals(problem: Problem, paths: Sequence[RigidPath]) -> FloatArray:
    """Goals of paths, (n, 6), columns as in `ranking.GOALS`, with the decimals that are told: less decides nothing."""
    start, end, roll, owner = segments(paths)
    # Bent paths share their last segments; each is measured once.
    unique, which = np.unique(np.column_stack([start, end, roll]).round(9), axis=0, return_inverse=True)
    which = which.reshape(-1)
    bodies = swept(problem.instrument, unique[:, :3], unique[:, 3:6], unique[:, 6])
    gaps = structure_distances(problem.obstacles, bodies)
    goals = np.full((len(paths), 6), np.inf)
    for k, group in enumerate(GROUPS):
        columns = [j for j, name in enumerate(problem.obstacles.names) if name.startswith(group)]
        if columns:
            np.minimum.at(goals[:, k], owner, gaps[which][:, columns].min(axis=1))
    goals[:, 4] = [path.length for path in paths]
    goals[:, 5] = [len(voxels) for voxels in channels(problem, paths)]
    return np.asarray(np.round(goals, GOAL_DECIMALS))


GROUPS = ("brain", "orbit", "septum", "turbinate")


def structure_distances(obstacles: Obstacles, bodies: Bodies, *, cells: int = CELLS_ASKED) -> FloatArray:
    """Distance of each instrument (two bodies) to each structure, (n, structures) mm; of the border it is not measured."""
    measured = [k for k, name in enumerate(obstacles.names) if name != BORDER]
    gaps = structure_gaps(obstacles, to_frame(bodies, obstacles.frame), measured, cells=cells).distance
    return np.asarray(gaps.reshape(-1, 2, gaps.shape[1]).min(axis=1))


def channels(problem: Problem, paths: Sequence[RigidPath]) -> list[IntArray]:
    """Flat indices of the soft-tissue and bone voxels whose centres the instrument sweeps between start and goal, by path.

    What the shafts pass in front of the start is skin that gives way, and air.
    """
    solid = problem.scene.tissue != Tissue.AIR
    frame = problem.obstacles.frame
    made = []
    for path in paths:
        found: list[IntArray] = []
        for a, b in zip(path.nodes[:-1], path.nodes[1:], strict=True):
            direction = unit(b - a)[None]
            bodies = posed(problem.instrument, b[None], direction, path.roll)
            behind = float(np.linalg.norm(b - path.nodes[0]))
            near = to_frame(bodies.cut(np.repeat(b[None], 2, axis=0), np.full(2, behind)), frame)
            found.extend(voxels_inside(near.take(np.array([k])), solid, frame.spacing) for k in range(2))
        made.append(np.unique(np.concatenate(found)))
    return made


def voxels_inside(body: Bodies, mask: BoolArray, spacing: FloatArray) -> IntArray:
    """Flat indices of the voxels of a mask whose centres lie in one body, given in the image frame."""
    ends = np.vstack([body.tail, body.front])
    low = np.clip(np.floor((ends.min(axis=0) - body.radius) / spacing).astype(int), 0, np.array(mask.shape))
    high = np.clip(np.ceil((ends.max(axis=0) + body.radius) / spacing).astype(int) + 1, low, np.array(mask.shape))
    # Along the longest side the body crosses few voxels of each layer: the box is looked at layer by layer.
    count = int(np.ceil(float(body.length[0]) / float(spacing.min()))) + 1
    axis_points = body.tail + np.linspace(0.0, 1.0, count)[:, None] * (body.front - body.tail)
    reach = np.ceil((body.radius[0] + 0.5 * float(spacing.max())) / spacing).astype(int)
    offsets = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), axis=-1).reshape(-1, 3)
    index = (np.rint(axis_points / spacing).astype(int)[:, None] + offsets).reshape(-1, 3)
    index = index[((index >= low) & (index < high)).all(axis=1)]
    flat = np.unique(np.ravel_multi_index(tuple(index.T), mask.shape))
    flat = flat[mask.ravel()[flat]]
    points = np.column_stack(np.unravel_index(flat, mask.shape)) * spacing
    return np.asarray(flat[body.take(np.zeros(len(flat), dtype=int)).gap(points) <= 0.0])
