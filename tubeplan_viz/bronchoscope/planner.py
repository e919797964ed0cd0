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
from tubeplan_viz.bronchoscope.aiming import Aim, following_share
from tubeplan_viz.bronchoscope.guide import Guide
from tubeplan_viz.bronchoscope.mover import Command, Mover, Step
from tubeplan_viz.bronchoscope.robot import Robot
from tubeplan_viz.bronchoscope.robot_plan import Node, PlannerSettings, RobotPlan, StageTally
from tubeplan_viz.bronchoscope.route import Stage
from tubeplan_viz.bronchoscope.steering import bends_of
from tubeplan_viz.geometry import WallDistance

# Pushes of so many mm that take the tip along the guide by less than this share of them have caught it on the wall: the shaft
# bends out behind it. Shorter ones turn the sections, which may take the tip aside or back, and count together.
CAUGHT_PUSH, CAUGHT = 2.0, 0.25
LATELY = 10.0  # mm of push from which the base's way is learnt


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
    learns: bool = False,
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
    learns : bool
        Expect the base to follow the proximal section's bend as far as it did in the last pushes, and not fully.
    watch : callable, optional
        Called with each new node and its number.

    Returns
    -------
    RobotPlan
    """
    return _Growth(mover, robot, guide, stages, settings or PlannerSettings(), wall, rng, foresee, learns, watch).run()


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
        learns: bool,
        watch: Callable[[Node, int], None] | None,
    ) -> None:
        self.mover, self.guide, self.stages = mover, guide, stages
        self.settings, self.rng, self.foresee, self.learns, self.watch = settings, rng, foresee, learns, watch
        self.aim = Aim(robot=robot, guide=guide, wall=wall, last=stages[-1])
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

    def _push(self, origin: int, tip_at: float, left: float, offset: FloatArray, number: int) -> int | None:
        """One push from a node; the longest first that bends no section too quickly. None if all collide."""
        node, tally = self.nodes[origin], self.tallies[number]
        follows = following_share(self._lately(origin), self.aim.robot) if self.learns else 1.0
        push = min(self.settings.push_max, left)
        while True:
            command = self.aim.command(node.step, tip_at, push, offset, self.stages[number], follows=follows)
            turned = float(np.linalg.norm(bends_of(replace(node.step, command=command)) - bends_of(node.step), axis=1).max())
            least = push <= min(self.settings.push_min, left)
            if turned <= self.settings.turn_max or least:
                if self._foreseen(node.step, command):
                    tally.foreseen += 1
                else:
                    step = self.mover.move(node.step, command)
                    tally.pushes += 1
                    good = not self._collides(step) and not self._caught(origin, step, tip_at, push)
                    tally.refused += not good
                    made = self._add(step, origin, number, accepted=good)
                    if good:
                        return made
                if least:
                    return None
            push = max(0.6 * push, min(self.settings.push_min, left))

    def _lately(self, number: int) -> list[Step]:
        """The steps of the last `LATELY` mm of push to a node, the oldest first."""
        made, pushed = [self.nodes[number].step], 0.0
        while pushed < LATELY and self.nodes[number].parent >= 0:
            command = made[-1].command
            pushed += 0.0 if command is None else abs(command.push)
            number = self.nodes[number].parent
            made.append(self.nodes[number].step)
        return made[::-1]

    def _foreseen(self, step: Step, command: Command) -> bool:
        """Whether the cheap mover, where there is one, sees the command collide."""
        return self.foresee is not None and self._collides(self.foresee.move(step, command))

    def _collides(self, step: Step) -> bool:
        """Whether a step met the wall: too near to it, or halted by it, so that its command was not carried out."""
        near = step.disc_clearance < self.settings.disc_margin or step.body_clearance < self.settings.body_margin
        return near or step.halted

    def _caught(self, origin: int, step: Step, tip_at: float, push: float) -> bool:
        """Whether the tip hangs on the wall: the push from a node, with short ones before it, has hardly brought it on.

        `tip_at` is the guide's arc length beside the node's tip, mm.
        """
        pushed, number = push, origin
        while pushed < CAUGHT_PUSH:
            node = self.nodes[number]
            if node.step.command is None:
                return False
            pushed += max(node.step.command.push, 0.0)
            number = node.parent
        begun = tip_at if number == origin else self.guide.nearest(self.nodes[number].tip, tip_at - pushed, tip_at + pushed)
        return self.guide.nearest(step.tip[:3, 3], begun - pushed, begun + 2.0 * pushed) - begun < CAUGHT * pushed

    def _settle(self, here: int, number: int) -> int | None:
        """Correct the tip onto the goal by small commands; the node with the least error, None if none is near enough."""
        goal, best = self.stages[number].goal, here
        tally = self.tallies[number]
        for _ in range(self.settings.corrections_max):
            error = goal - self.nodes[best].tip
            if float(np.linalg.norm(error)) <= self.settings.goal_tolerance:
                break
            command = self.aim.correction(self.nodes[best].step, error)
            if self._foreseen(self.nodes[best].step, command):
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
