"""A whole sequence of commands at once: the way through where pushes chosen one by one find none."""

# Strategy: without forces the proximal section's base moves along that section's own arc. So the bends over the way of
# the base fix everything: where the base comes, and there both sections' arcs. Pushes chosen one by one look no further than the
# robot's length; the error of heading that they leave is what a later, narrower bend cannot take. Here the bends at knots along
# the rest of the way are the unknowns of one least-squares problem (Levenberg-Marquardt): how far places of the
# active sections stay below the wanted clearance, at every millimetre of the way, how far the tip ends from the goal, and
# a little for every change of a bend. The wall enters by its exact nearest points, renewed in each round. What comes
# out is a proposal: the mover that is asked for moves it, and only its clearances count.

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.bronchoscope.aiming import ROOM_MIN
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.kinematic import SPACING, polar
from tubeplan_viz.bronchoscope.kinematics import STRAIGHT, section_transform
from tubeplan_viz.bronchoscope.mover import Command, Mover, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import Node, PlannerSettings, RobotPlan
from tubeplan_viz.bronchoscope.steering import active_shares, advanced, bends_of, command_of, fitted, limited
from tubeplan_viz.geometry import WallDistance

SUBSTEP, PER_KNOT = 1.0, 2  # mm of push between two looks at the wall; looks from knot to knot
BACK = 80.0  # mm of the way before the goal that are laid anew: four branches of a bronchial tree
ROUNDS = 15
# Later attempts begin with smooth noise on the bends, rad, over some knots.
ATTEMPTS, NOISE, NOISE_WIDTH = 3, 0.1, 4.0
# Clearance beyond the robot's surface that is asked for, mm, and the share of the weights below beside it, one after the other.
SCHEDULE = ((0.25, 1.0), (0.1, 0.3), (0.05, 0.1), (0.03, 0.03))
# Weights beside 1 per mm of missing clearance: per mm of tip error, rad of change between knots, rad beyond the largest bend.
GOAL_WEIGHT, CHANGE_WEIGHT, BEND_WEIGHT = 0.3, 0.02, 10.0
GAIN = 1e-4  # a round that lowers the cost by a smaller share is the last
FIRST_DAMPING, LARGEST_DAMPING = 1e-2, 1e5
SLIGHT = 1e-5  # rad or mm, for differences


@dataclass(frozen=True, eq=False, kw_only=True)
class Course:
    """Where a sequence of bends leads.

    Attributes
    ----------
    middles : (n, 4, 4) float array
        Pose of the proximal section's base in the middle of each substep.
    bases : (n, 4, 4) float array
        The same after each substep.
    bends : (n, 2, 2) float array, rad
        After each substep.
    points : (n, m, 3) float array, mm
        Places of the active sections after each substep, base to tip.
    """

    middles: FloatArray
    bases: FloatArray
    bends: FloatArray
    points: FloatArray


def plan_at_once(
    plan: RobotPlan,
    mover: Mover,
    robot: Robot,
    guide: Guide,
    settings: PlannerSettings,
    *,
    wall: WallDistance,
    watch: Callable[[Node, int], None] | None = None,
) -> RobotPlan:
    """Lay the last stretch of a plan that did not reach its goal anew, all commands together.

    Parameters
    ----------
    plan : RobotPlan
        Of the same mover along the same guide.
    mover : Mover
        Without forces; it judges what is proposed.
    robot : Robot
    guide : Guide
    settings : PlannerSettings
    wall : WallDistance
    watch : callable, optional
        Called with each new node and its number.

    Returns
    -------
    RobotPlan
        That reaches the goal, or `plan` itself where the proposal does not hold.
    """
    begun = time.perf_counter()
    inserted = np.cumsum([0.0 if step.command is None else step.command.push for step in plan.steps])
    before = int(np.flatnonzero(inserted <= max(guide.length - robot.active_length - BACK, 0.0))[-1])
    start, goal = plan.steps[before], np.asarray(plan.stages[-1].goal)
    at = guide.nearest(start.tip[:3, 3], inserted[before], inserted[before] + 2.0 * robot.active_length)
    problem = Problem(start, robot, guide, wall, goal, at)
    guess, first_length = problem.guess()
    for attempt in range(ATTEMPTS):
        knots, length = shaken(guess, attempt), first_length
        for margin, share in SCHEDULE:
            knots, length = problem.solve(knots, length, margin, share)
            steps = moved(mover, start, problem.commands(knots, length), settings)
            error = np.inf if steps is None else float(np.linalg.norm(steps[-1].tip[:3, 3] - goal))
            if steps is not None and error <= settings.goal_error_max:
                return joined(plan, before, steps, error, guide, watch, time.perf_counter() - begun)
    return plan


def shaken(knots: FloatArray, attempt: int) -> FloatArray:
    """The bends to begin an attempt with: the first one as they are, later ones with smooth noise of its own."""
    if attempt == 0:
        return knots
    noise = gaussian_filter1d(np.random.default_rng(attempt).normal(size=knots.shape), NOISE_WIDTH, axis=0)
    noise[0] = 0.0  # the step from which it begins is what it is
    return np.asarray(knots + NOISE / noise.std() * noise)


def moved(mover: Mover, start: Step, commands: list[Command], settings: PlannerSettings) -> list[Step] | None:
    """The steps of commands; None once one of them collides."""
    steps: list[Step] = []
    for command in commands:
        steps.append(mover.move(steps[-1] if steps else start, command))
        if steps[-1].body_clearance < settings.body_margin or steps[-1].disc_clearance < settings.disc_margin:
            return None
    return steps


def joined(
    plan: RobotPlan,
    before: int,
    steps: list[Step],
    error: float,
    guide: Guide,
    watch: Callable[[Node, int], None] | None,
    seconds: float,
) -> RobotPlan:
    """The plan up to one of its steps and then along new ones, which join its tree.

    Parameters
    ----------
    plan : RobotPlan
    before : int
        Index of the last step that is kept.
    steps : list of Step
        What follows it.
    error : float, mm
        Distance of the last one's tip to the goal.
    guide : Guide
        The line that says in which stage a step lies.
    watch : callable or None
        Told of every new node with its number.
    seconds : float
        Time spent on the new steps, added to the plan's.
    """
    nodes, tallies = list(plan.nodes), [replace(tally) for tally in plan.tallies]
    ends = np.array([stage.end for stage in plan.stages[:-1]])
    parent = next(k for k, node in enumerate(nodes) if node.step is plan.steps[before])
    stages = list(plan.step_stages[: before + 1])
    at = guide.nearest(plan.steps[before].tip[:3, 3], 0.0, guide.length)
    for step in steps:
        at = guide.nearest(step.tip[:3, 3], at - 5.0, at + 10.0)
        stages.append(max(int(np.searchsorted(ends, at)), stages[-1]))
        tallies[stages[-1]].pushes += 1
        nodes.append(Node(step=step, parent=parent, stage=stages[-1], accepted=True))
        parent = len(nodes) - 1
        if watch is not None:
            watch(nodes[-1], parent)
    tallies[-1].seconds += seconds
    return replace(
        plan,
        steps=(*plan.steps[: before + 1], *steps),
        step_stages=tuple(stages),
        tallies=tuple(tallies),
        nodes=tuple(nodes),
        tip_error=error,
        reached=True,
        reason=None,
    )


class Problem:
    """The least-squares problem from one step to the goal.

    Parameters
    ----------
    start : Step
    robot : Robot
    guide : Guide
    wall : WallDistance
    goal : (3,) float array, mm
    at : float, mm
        Arc length of the start's tip on the guide.
    """

    def __init__(self, start: Step, robot: Robot, guide: Guide, wall: WallDistance, goal: FloatArray, at: float) -> None:
        self.robot, self.guide, self.wall, self.goal, self.at = robot, guide, wall, goal, at
        self.base, self.first = start.base, bends_of(start)
        self.left = guide.length - at
        self.knots = max(int(np.ceil(self.left / (SUBSTEP * PER_KNOT))), 2)
        place = np.arange(PER_KNOT * self.knots + 1) / PER_KNOT
        self.after = hats(place[1:], self.knots + 1)
        self.middle = hats(0.5 * (place[1:] + place[:-1]), self.knots + 1)
        # Where the wall was asked last, and its signed distance there.
        count = len(self.after) * len(active_shares(robot))
        self._places, self._clearance = np.zeros((count, 3)), np.full(count, -np.inf)

    def guess(self) -> tuple[FloatArray, float]:
        """Bends with which the sections follow the guide, whatever they touch, and the base's way, mm."""
        robot, base, made = self.robot, self.base, [self.first]
        push = self.left / self.knots
        behind = robot.active_length * (1.0 - active_shares(robot))
        for k in range(1, self.knots + 1):
            places = self.at + k * push - behind
            line, room = self.guide.at(places), np.maximum(self.guide.radius(places) - robot.radius, ROOM_MIN)
            direction = line[-1] - line[-3]
            ahead = advanced(base, robot, made[-1], made[-1], push)
            wanted = fitted(ahead, robot, made[-1], line, room, direction / np.linalg.norm(direction))
            base = advanced(base, robot, made[-1], wanted, push)
            made.append(wanted)
        return np.array(made), self.left

    def commands(self, knots: FloatArray, length: float) -> list[Command]:
        """One command for each knot."""
        return [command_of(limited(bends, self.robot.bend_max), length / self.knots) for bends in knots[1:]]

    def course(self, knots: FloatArray, length: float) -> Course:
        """Integrate bends at the knots, (k + 1, 2, 2) rad, over a way of the base, mm."""
        robot, step = self.robot, length / len(self.after)
        mid, bends = np.tensordot(self.middle, knots, 1), np.tensordot(self.after, knots, 1)
        base, bases, middles = self.base, [], []
        for bend in mid[:, 0]:
            phi, theta = polar(bend)
            middles.append(base @ section_transform(0.5 * step, 0.5 * phi * step / robot.proximal_length, theta))
            base = base @ section_transform(step, phi * step / robot.proximal_length, theta)
            bases.append(base)
        placed = np.array(bases)
        return Course(middles=np.array(middles), bases=placed, bends=bends, points=shapes(robot, placed, bends))

    def solve(self, knots: FloatArray, length: float, margin: float, share: float) -> tuple[FloatArray, float]:
        """The knots and the way of the base for which the robot stays clear of the wall and ends on the goal."""
        course = self.course(knots, length)
        residuals, places, outward = self.residuals(course, knots, margin, share)
        damping = FIRST_DAMPING
        for _ in range(ROUNDS):
            slopes = self.slopes(course, knots, length, places, outward, share)
            matrix, falling = slopes.T @ slopes, -slopes.T @ residuals
            cost, done = float(residuals @ residuals), False
            while damping < LARGEST_DAMPING:
                change = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix) + 1e-6), falling)
                moved = knots.copy()
                moved[1:] += change[:-1].reshape(-1, 2, 2)
                farther = max(length + float(change[-1]), 0.5 * self.left)
                trial = self.course(moved, farther)
                found = self.residuals(trial, moved, margin, share)
                less = cost - float(found[0] @ found[0])
                if less > 0.0:
                    knots, length, course = moved, farther, trial
                    residuals, places, outward = found
                    damping, done = max(damping / 4.0, 1e-6), less < GAIN * cost
                    break
                damping *= 5.0
            if done or damping >= LARGEST_DAMPING:
                break
        return knots, length

    def residuals(
        self, course: Course, knots: FloatArray, margin: float, share: float
    ) -> tuple[FloatArray, tuple[IntArray, IntArray], FloatArray]:
        """What is wrong; then the substeps and places that are too near to the wall, and the way off it there, (k, 3)."""
        points, limit = course.points.reshape(-1, 3), self.robot.radius + margin
        # The distance falls by no more than a place moved: most places are far from the wall and need not ask again.
        asked = np.flatnonzero(self._clearance - np.linalg.norm(points - self._places, axis=1) < limit)
        distance, _, foot = self.wall.nearest(points[asked])
        sign = np.where(self.wall.inside(points[asked]), 1.0, -1.0)
        self._places[asked], self._clearance[asked] = points[asked], sign * distance
        chosen = np.flatnonzero(sign * distance < limit)
        near = asked[chosen]
        short = limit - (sign * distance)[chosen]
        outward = (sign / np.maximum(distance, 1e-9))[chosen, None] * (points[near] - foot[chosen])
        size = np.linalg.norm(knots[1:], axis=2)
        parts = (
            short,
            share * GOAL_WEIGHT * (course.points[-1, -1] - self.goal),
            share * CHANGE_WEIGHT * np.diff(knots, axis=0).ravel(),
            BEND_WEIGHT * np.maximum(size - self.robot.bend_max, 0.0).ravel(),
        )
        return np.concatenate(parts), np.divmod(near, course.points.shape[1]), outward

    def slopes(
        self,
        course: Course,
        knots: FloatArray,
        length: float,
        places: tuple[IntArray, IntArray],
        outward: FloatArray,
        share: float,
    ) -> FloatArray:
        """Derivatives of the residuals by the bends at the knots but the first, and by the way of the base."""
        count, last = len(self.after), course.points.shape[1] - 1
        row = np.concatenate([places[0], np.full(3, count - 1)])
        place = np.concatenate([places[1], np.full(3, last)])
        along = np.vstack([-outward, share * GOAL_WEIGHT * np.eye(3)])
        points = course.points[row, place]
        made = np.zeros((len(row), self.knots + 1, 2, 2))
        # What a section's own bend moves while its base stays.
        for section in range(2):
            for side in range(2):
                bends = course.bends.copy()
                bends[:, section, side] += SLIGHT
                moved = shapes(self.robot, course.bases, bends)
                own = np.einsum("ki,ki->k", along, moved[row, place] - points) / SLIGHT
                made[:, :, section, side] = self.after[row] * own[:, None]
        # A bend of the proximal section turns the base's way there, and with it all that comes after.
        arm = points[:, None] - course.middles[None, :, :3, 3]
        turned = np.cross(arm, along[:, None]) * (np.arange(count) <= row[:, None])[..., None]
        lever = length / count / self.robot.proximal_length
        for side, axis, sign in ((0, 1, 1.0), (1, 0, -1.0)):
            about = np.einsum("kni,ni->kn", turned, course.middles[:, :3, axis])
            made[:, :, 0, side] += sign * lever * about @ self.middle
        farther = self.course(knots, length + SLIGHT).points[row, place]
        way = np.einsum("ki,ki->k", along, farther - points) / SLIGHT
        return np.vstack([np.column_stack([made[:, 1:].reshape(len(row), -1), way]), self._plain_slopes(knots, share)])

    def _plain_slopes(self, knots: FloatArray, share: float) -> FloatArray:
        """Derivatives of the residuals that know only the knots."""
        columns = 4 * self.knots + 1
        change = np.eye(4 * self.knots, columns) - np.eye(4 * self.knots, columns, -4)
        size = np.linalg.norm(knots[1:], axis=2)
        over = (size > self.robot.bend_max) / np.maximum(size, 1e-9)
        bend = np.zeros((2 * self.knots, columns))
        rows = np.arange(2 * self.knots)
        for side in range(2):
            bend[rows, 2 * rows + side] = (over * knots[1:, :, side]).ravel()
        return np.vstack([share * CHANGE_WEIGHT * change, BEND_WEIGHT * bend])


def shapes(robot: Robot, bases: FloatArray, bends: FloatArray) -> FloatArray:
    """The places of `kinematic.active_points` for many bases (n, 4, 4) and bends (n, 2, 2) at once, (n, m, 3) mm."""
    parts, start, turn = [bases[:, None, :3, 3]], bases[:, :3, 3], bases[:, :3, :3]
    for section, length in enumerate((robot.proximal_length, robot.distal_length)):
        count = int(np.ceil(length / SPACING))
        phi = np.maximum(np.linalg.norm(bends[:, section], axis=1), STRAIGHT)
        ct, st = (bends[:, section, side] / phi for side in range(2))
        angle = phi[:, None] * np.arange(1, count + 1) / count
        along = (length / phi)[:, None] * np.sin(angle)
        across = (2.0 * length / phi)[:, None] * np.sin(0.5 * angle) ** 2
        local = np.stack([ct[:, None] * across, st[:, None] * across, along], axis=-1)
        parts.append(start[:, None] + np.einsum("nij,nkj->nki", turn, local))
        start = parts[-1][:, -1]
        c, s = np.cos(phi), np.sin(phi)
        mixed = ct * st * (c - 1.0)
        rows = ((ct * ct * c + st * st, mixed, ct * s), (mixed, st * st * c + ct * ct, st * s), (-ct * s, -st * s, c))
        turn = turn @ np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return np.concatenate(parts, axis=1)


def hats(places: FloatArray, count: int) -> FloatArray:
    """Weights of linear interpolation between `count` knots at 0, 1, 2, ..., (n, count)."""
    return np.asarray(np.maximum(1.0 - np.abs(places[:, None] - np.arange(count)), 0.0))
