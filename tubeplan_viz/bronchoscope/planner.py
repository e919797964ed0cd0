"""The lower layer: segmented spherical sampling with a growing tree of poses (Guo et al. 2022, section 1.2)."""

# Strategy: the route is cut into stages with sub-goals. A sample is a place in the sphere about the stage's sub-goal; the
# first one of a stage is the sub-goal itself. It bends the guide so that it passes through the sample. From the nearest pose
# of the tree the robot is steered along that line, both sections' chords pointed at it, push by push until the sub-goal
# is reached or a push collides: one sample carries a whole stage where nothing is in the way. Pushes that the kinematic model
# already sees collide are not given to the mover. Every pose stays in the tree, so that a later sample goes on from
# it; when a stage finds nothing for long, the one before is entered anew from another place.

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.kinematic import active_points
from tubeplan_viz.bronchoscope.mover import Command, Mover, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import Node, PlannerSettings, RobotPlan, StageTally
from tubeplan_viz.bronchoscope.route import Stage
from tubeplan_viz.bronchoscope.steering import AIM_ROUNDS, active_shares, advanced, bends_of, command_of, fitted, predicted_tip
from tubeplan_viz.geometry import WallDistance

AWAY_ROUNDS, AWAY_MARGIN = 4, 0.15
SAG_NOTICED = 0.1  # mm; interpolation between the body's places is off by less
AT_GOAL = 0.03  # mm
ROOM_MIN = 0.3  # mm; beside the guide, for its weight where the lumen is hardly wider than the robot


def plan_segmented(
    mover: Mover,
    robot: Robot,
    guide: Guide,
    stages: tuple[Stage, ...],
    settings: PlannerSettings | None = None,
    *,
    wall: WallDistance,
    rng: np.random.Generator,
    foresee: Mover | None = None,
    watch: Callable[[Node, int], None] | None = None,
) -> RobotPlan:
    """Plan from the entrance to the guide's end.

    Parameters
    ----------
    mover : Mover
        What moves the robot.
    robot : Robot
    guide : Guide
        From the entrance to the goal.
    stages : tuple of Stage
        Along the guide; the last one's sub-goal is the goal.
    settings : PlannerSettings, optional
    wall : WallDistance
        Sections that would meet it are laid a little away from it.
    rng : numpy.random.Generator
    foresee : Mover, optional
        A cheap mover that is asked first; pushes that it sees collide are not given to `mover`.
    watch : callable, optional
        Called with each new node and its number.

    Returns
    -------
    RobotPlan
    """
    return _Growth(mover, robot, guide, stages, settings or PlannerSettings(), wall, rng, foresee, watch).run()


def sagged(step: Step, robot: Robot) -> FloatArray:
    """How far the active sections' places lie from those of ideal arcs at the same base and bends, (m, 3) mm."""
    body = step.body
    left = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(body[::-1], axis=0), axis=1))])
    wanted = robot.active_length * (1.0 - active_shares(robot))
    real = np.column_stack([np.interp(wanted, left, column) for column in body[::-1].T])
    ideal = active_points(robot, step.base, bends_of(step))[0]
    off = real - ideal
    return np.asarray(off) if float(np.linalg.norm(off, axis=1).max()) > SAG_NOTICED else np.zeros_like(off)


class _Growth:
    """One growing tree."""

    def __init__(
        self,
        mover: Mover,
        robot: Robot,
        guide: Guide,
        stages: tuple[Stage, ...],
        settings: PlannerSettings,
        wall: WallDistance,
        rng: np.random.Generator,
        foresee: Mover | None,
        watch: Callable[[Node, int], None] | None,
    ) -> None:
        self.mover, self.robot, self.guide, self.stages = mover, robot, guide, stages
        self.settings, self.wall, self.rng, self.foresee, self.watch = settings, wall, rng, foresee, watch
        self.nodes: list[Node] = []
        self.failures: list[int] = []
        self.samples: list[tuple[int, FloatArray]] = []
        self.tallies = [StageTally() for _ in stages]
        self.entries: list[list[int]] = [[] for _ in stages]  # nodes from which each stage may begin
        self.begun = time.perf_counter()

    def run(self) -> RobotPlan:
        """Grow until the goal is reached or the budget is used up."""
        start = self.mover.start()
        self._add(start, -1, 0, accepted=True)
        if start.disc_clearance < 0.0 or start.body_clearance < self.settings.body_margin:
            return self._plan(0, "the straight robot does not fit at the entrance")
        self.entries[0].append(0)
        stage, dry = 0, [0] * len(self.stages)
        while not self._spent():
            reached = self._sample(stage)
            if reached is None:
                dry[stage] += 1
                near = self._nearest_end(stage) if dry[stage] >= self.settings.patience else None
                if near is not None:
                    return self._plan(near, None)
                if stage > 0 and dry[stage] % self.settings.patience == 0:
                    stage -= 1
                continue
            if stage == len(self.stages) - 1:
                return self._plan(reached, None)
            stage += 1
            self.entries[stage].append(reached)
        best = self._best()
        stuck = self.stages[max(k for k, found in enumerate(self.entries) if found)].name
        tried = f"{len(self.samples)} samples; the tip came within {self._error(best):.1f} mm"
        return self._plan(best, f"no way was found through the stage {stuck!r} with {tried}")

    def _spent(self) -> bool:
        late = self.settings.time_budget is not None and time.perf_counter() - self.begun > self.settings.time_budget
        return len(self.samples) >= self.settings.samples_max or late

    def _sample(self, number: int) -> int | None:
        """One sample of a stage; the node that reached its sub-goal, or None."""
        begun, stage, tally = time.perf_counter(), self.stages[number], self.tallies[number]
        first = tally.samples == 0 or len(self.entries[number]) > tally.samples
        place = stage.goal if first else self._place_in_sphere(stage)
        self.samples.append((number, place))
        tally.samples += 1
        origin = self.entries[number][-1] if first else self._nearest(place, number)
        reached = self._extend(origin, place - stage.goal, number)
        if reached is None:
            self.failures[origin] += 1
        tally.seconds += time.perf_counter() - begun
        return reached

    def _nearest_end(self, number: int) -> int | None:
        """In the last stage: the pose nearest to the goal, corrected, if that is near enough though pushes ahead collide."""
        best = self._best()
        if number < len(self.stages) - 1 or self._error(best) > self.settings.goal_error_max:
            return None
        return self._settle(best, number)

    def _place_in_sphere(self, stage: Stage) -> FloatArray:
        """The text's table 2: distance, azimuth and elevation drawn one by one."""
        distance = stage.radius * self.rng.uniform()
        azimuth, elevation = self.rng.uniform(-np.pi, np.pi), self.rng.uniform(-0.5 * np.pi, 0.5 * np.pi)
        towards = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        return np.asarray(stage.goal + distance * towards)

    def _nearest(self, place: FloatArray, number: int) -> int:
        """The stage's accepted node nearest to a place; one that failed before counts as farther by a push each time."""
        roots = set(self.entries[number])
        able = [k for k, node in enumerate(self.nodes) if node.accepted and (node.stage == number or k in roots)]
        cost = [float(np.linalg.norm(self.nodes[k].tip - place)) + self.settings.push_max * self.failures[k] for k in able]
        return able[int(np.argmin(cost))]

    def _extend(self, origin: int, offset: FloatArray, number: int) -> int | None:
        """Push along the guide, bent by `offset` at the stage's sub-goal, until it is reached or a push collides."""
        stage, last = self.stages[number], number == len(self.stages) - 1
        here = origin
        for _ in range(200):
            node = self.nodes[here]
            at = self.guide.nearest(node.tip, *self._window(node, stage))
            left = stage.end - at
            if last and left < 0.1:
                return self._settle(here, number)
            if not last and (left < 0.5 or float(np.linalg.norm(node.tip - stage.goal)) < 0.3 * stage.radius):
                return here
            made = self._push(here, at, left if last else left + 1.0, offset, number)
            if made is None:
                return None
            here = made
        return None

    def _window(self, node: Node, stage: Stage) -> tuple[float, float]:
        inserted = float(np.linalg.norm(np.diff(node.step.body, axis=0), axis=1).sum())
        return inserted - 25.0, min(inserted + 25.0, self.guide.length)

    def _line_at(self, s: FloatArray, offset: FloatArray, stage: Stage) -> FloatArray:
        """The guide bent towards the sample: fully at the sub-goal, fading out over the stage before and beyond it."""
        fade = np.clip(1.0 - np.abs(s - stage.end) / max(stage.end - stage.begin, 1.0), 0.0, 1.0)
        return np.asarray(self.guide.at(s) + (fade * fade * (3.0 - 2.0 * fade))[:, None] * offset)

    def _push(self, origin: int, tip_at: float, left: float, offset: FloatArray, number: int) -> int | None:
        """One push from a node; the longest first that bends no section too quickly. None if all collide."""
        node, tally = self.nodes[origin], self.tallies[number]
        push = min(self.settings.push_max, left)
        while True:
            command = self._command(node.step, tip_at, push, offset, self.stages[number])
            turned = float(np.linalg.norm(bends_of(replace(node.step, command=command)) - bends_of(node.step), axis=1).max())
            least = push <= min(self.settings.push_min, left)
            if turned <= self.settings.turn_max or least:
                if self.foresee is not None and self._collides(self._foreseen(node.step, command)):
                    tally.foreseen += 1
                else:
                    step = self.mover.move(node.step, command)
                    tally.pushes += 1
                    good = not self._collides(step)
                    tally.refused += not good
                    made = self._add(step, origin, number, accepted=good)
                    if good:
                        return made
                if least:
                    return None
            push = max(0.6 * push, min(self.settings.push_min, left))

    def _foreseen(self, step: Step, command: Command) -> Step:
        assert self.foresee is not None
        return self.foresee.move(step, command)

    def _collides(self, step: Step) -> bool:
        return step.disc_clearance < self.settings.disc_margin or step.body_clearance < self.settings.body_margin

    def _command(self, step: Step, tip_at: float, push: float, offset: FloatArray, stage: Stage) -> Command:
        """The command after which the active sections lie best on the line, given where the push takes the base."""
        robot, bends = self.robot, bends_of(step)
        ahead = tip_at + push
        places = ahead - robot.active_length * (1.0 - active_shares(robot))
        line = self._line_at(places, offset, stage)
        room = np.maximum(self.guide.radius(places) - robot.radius, ROOM_MIN)
        if stage is self.stages[-1] and ahead > stage.end - 1.0:
            room[-1] = AT_GOAL  # the tip itself must end on the goal
        direction = line[-1] - line[-3]
        direction = direction / np.linalg.norm(direction)
        # Weight, contact and slack hinges move the real sections off their ideal arcs: as much is expected after the push.
        sag = sagged(step, robot)
        line = line - sag
        wanted, base = bends, step.base
        for _ in range(AIM_ROUNDS):
            base = advanced(step.base, robot, bends, wanted, push)
            wanted = fitted(base, robot, wanted, line, room, direction)
        for _ in range(AWAY_ROUNDS):
            points = active_points(robot, base, wanted)[0] + sag
            gap, _, foot = self.wall.nearest(points)
            short = robot.radius + AWAY_MARGIN - gap
            if short.max() <= 0.0:
                break
            # The line goes away from the wall where the robot would meet it, and the sections are laid on it anew.
            line = line + (np.maximum(short, 0.0) / np.maximum(gap, 1e-6))[:, None] * (points - foot)
            wanted = fitted(base, robot, wanted, line, room, direction)
            base = advanced(step.base, robot, bends, wanted, push)
        return command_of(wanted, push)

    def _settle(self, here: int, number: int) -> int | None:
        """Correct the tip onto the goal by small commands; the node with the least error, None if none is near enough."""
        goal, best = self.stages[number].goal, here
        tally = self.tallies[number]
        for _ in range(self.settings.corrections_max):
            error = goal - self.nodes[best].tip
            if float(np.linalg.norm(error)) <= self.settings.goal_tolerance:
                break
            command = self._correction(self.nodes[best].step, error)
            if self.foresee is not None and self._collides(self._foreseen(self.nodes[best].step, command)):
                tally.foreseen += 1
                break
            step = self.mover.move(self.nodes[best].step, command)
            tally.pushes += 1
            good = not self._collides(step)
            tally.refused += not good
            made = self._add(step, best, number, accepted=good)
            worse = self._error(made) >= self._error(best) and self.nodes[best].step.disc_clearance >= 0.0
            if not good or worse:
                break
            best = made
        clear = self.nodes[best].step.disc_clearance >= 0.0
        return best if clear and self._error(best) <= self.settings.goal_error_max else None

    def _correction(self, step: Step, error: FloatArray) -> Command:
        """Least change of push and distal bend that moves the tip by `error`, by the kinematic model's derivatives."""
        robot, bends = self.robot, bends_of(step)
        # In units of about one millimetre of tip each, so that least squares weighs them alike.
        scale = np.array([1.0, 1.5 / robot.distal_length, 1.5 / robot.distal_length])

        def tip(x: FloatArray) -> FloatArray:
            changed = bends.copy()
            changed[1] += scale[1:] * x[1:]
            return predicted_tip(advanced(step.base, robot, bends, changed, float(x[0])), robot, changed)[:3, 3]

        zero = tip(np.zeros(3))
        slopes = np.column_stack([(tip(0.05 * unit) - zero) / 0.05 for unit in np.eye(3)])
        x = np.linalg.solve(slopes.T @ slopes + 1e-3 * np.eye(3), slopes.T @ error)
        x *= min(1.0, 3.0 / max(float(np.abs(x).max()), 1e-12))
        changed = bends.copy()
        changed[1] += scale[1:] * x[1:]
        size = float(np.linalg.norm(changed[1]))
        changed[1] *= min(1.0, robot.bend_max / max(size, 1e-12))
        return command_of(changed, float(x[0]))

    def _add(self, step: Step, parent: int, stage: int, *, accepted: bool) -> int:
        self.nodes.append(Node(step=step, parent=parent, stage=stage, accepted=accepted))
        self.failures.append(0)
        if self.watch is not None:
            self.watch(self.nodes[-1], len(self.nodes) - 1)
        return len(self.nodes) - 1

    def _error(self, number: int) -> float:
        return float(np.linalg.norm(self.nodes[number].tip - self.stages[-1].goal))

    def _best(self) -> int:
        able = [k for k, node in enumerate(self.nodes) if node.accepted]
        return min(able, key=self._error)

    def _plan(self, last: int, reason: str | None) -> RobotPlan:
        chain = [last]
        while self.nodes[chain[-1]].parent >= 0:
            chain.append(self.nodes[chain[-1]].parent)
        chain.reverse()
        return RobotPlan(
            steps=tuple(self.nodes[k].step for k in chain),
            step_stages=tuple(self.nodes[k].stage for k in chain),
            stages=self.stages,
            tallies=tuple(self.tallies),
            nodes=tuple(self.nodes),
            samples=tuple(self.samples),
            tip_error=self._error(last),
            reached=reason is None,
            reason=reason,
        )
