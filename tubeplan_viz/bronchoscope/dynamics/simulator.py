"""The robot moved by MuJoCo in the patient's own lumen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from segmentation.arrays import FloatArray, frozen_array
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from tubeplan_viz.bronchoscope.dynamics.chain import Chain, hinge_angles
from tubeplan_viz.bronchoscope.dynamics.engine import engine
from tubeplan_viz.bronchoscope.dynamics.model import Model, build_model
from tubeplan_viz.bronchoscope.dynamics.motion import Motion
from tubeplan_viz.bronchoscope.dynamics.settings import DynamicsSettings
from tubeplan_viz.bronchoscope.dynamics.wall import PatientWall
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot

STRAIGHT = Command(phi_proximal=0.0, theta_proximal=0.0, phi_distal=0.0, theta_distal=0.0, push=0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatorState:
    """All that the simulator needs to go on from here, bit for bit.

    Attributes
    ----------
    passive : int
        Number of passive hinges of the model.
    values : (n,) float array
        MuJoCo's full integration state of that model.
    angles : (2 n, 2) float array, rad
        Commanded hinge angles, base first.
    inserted : float
        Commanded place of the proximal section's base behind the entrance, mm.
    """

    passive: int
    values: FloatArray
    angles: FloatArray
    inserted: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen_array(self.values, (None,), "values"))
        object.__setattr__(self, "angles", frozen_array(self.angles, (None, 2), "angles"))


@dataclass(frozen=True, eq=False, kw_only=True)
class Moment:
    """The robot at one instant of a motion.

    Attributes
    ----------
    time : float
        s since the motion's begin.
    tip : (4, 4) float array
        Pose of the front disc, mm.
    push : float
        Place of the proximal section's base behind the entrance along the shaft, mm.
    push_speed : float
        mm/s.
    bend : float
        Angle between the proximal section's base and the tip, rad.
    """

    time: float
    tip: FloatArray
    push: float
    push_speed: float
    bend: float


class Simulator:
    """A `Mover` with dynamics: links, motors, gravity and contact with the wall.

    One simulator serves one thread: its models are worked on in place, its states are not.

    Parameters
    ----------
    surface : Surface
        The lumen's wall as it is; nothing is simplified.
    robot : Robot
    entrance : (4, 4) float array, mm
        Where the proximal section's base is at the start; the third column runs into the lumen. The shaft before it is held
        straight by a sheath.
    settings : DynamicsSettings, optional

    Raises
    ------
    CaseError
        If MuJoCo is not installed.
    """

    def __init__(self, surface: Surface, robot: Robot, entrance: FloatArray, settings: DynamicsSettings | None = None) -> None:
        engine()
        self.robot = robot
        self.settings = settings or DynamicsSettings()
        self.wall = PatientWall(surface)
        self.entrance = frozen_array(entrance, (4, 4), "entrance")
        self.steps = 0
        self._chain = Chain(robot=robot, settings=self.settings)
        self._models: dict[int, Model] = {}

    def start(self) -> Step:
        """The robot at rest: straight, the proximal section's base at the entrance, both active sections inside."""
        motion = self._motion(self._chain.passive_for(0.0))
        angles = hinge_angles(self.robot, STRAIGHT)
        motion.begin(None, angles, 0.0)
        motion.go(angles, 0.0, 0.0)
        motion.track = [motion.tip_place()]
        return self._step(motion, None)

    def move(self, step: Step, command: Command) -> Step:
        """The robot after `command`, begun from `step`; the same step and command always give the same outcome.

        Both sections bend evenly while the shaft is pushed: the push takes its length at the robot's speed, or as long as the
        bend needs. The step ends when the robot rests.

        Raises
        ------
        CaseError
            If the command pulls the proximal section out of the entrance, pushes the shaft's end in, or bends too far.
        """
        return self._step(self._run(step, command, None), command)

    def moments(self, step: Step, command: Command) -> list[Moment]:
        """The motion of `move`, one instant for each time step."""
        made: list[Moment] = []

        def look(motion: Motion, time: float) -> None:
            base, tip = motion.base(), motion.tip()
            bend = float(np.arccos(np.clip(base[:3, 2] @ tip[:3, 2], -1.0, 1.0)))
            push, speed = motion.push()
            made.append(Moment(time=time, tip=tip, push=push, push_speed=speed, bend=bend))

        self._run(step, command, look)
        return made

    def _run(self, step: Step, command: Command, look: Callable[[Motion, float], None] | None) -> Motion:
        state: SimulatorState = step.state
        largest = max(command.phi_proximal, command.phi_distal)
        if largest > self.robot.bend_max * (1.0 + 1e-9):
            raise CaseError(
                f"a command bends a section by {np.degrees(largest):.1f} degrees, "
                f"expected at most {np.degrees(self.robot.bend_max):.1f} (robot {self.robot.name})"
            )
        end = state.inserted + command.push
        if not -1e-9 <= end <= self.robot.passive_length:
            raise CaseError(
                f"a command puts the proximal section's base {end:.2f} mm behind the entrance, "
                f"expected 0 to {self.robot.passive_length:g} mm (robot {self.robot.name})"
            )
        angles = hinge_angles(self.robot, command)
        turn = float(np.abs(angles - state.angles).max()) * self.robot.links
        duration = max(abs(command.push) / self.robot.push_speed, turn / self.settings.bend_speed)
        motion = self._motion(state.passive)
        motion.begin(state.values, np.array(state.angles), state.inserted)
        motion.go(angles, end, duration, None if look is None else lambda time: look(motion, time))
        return motion

    def _step(self, motion: Motion, command: Command | None) -> Step:
        self.steps += motion.steps
        body = motion.body()
        disc, clearance = motion.clearances(body)
        contacts, forces = motion.contacts()
        state = SimulatorState(
            passive=motion.model.passive, values=motion.values(), angles=motion.angles, inserted=motion.inserted
        )
        return Step(
            state=state,
            command=command,
            base=motion.base(),
            tip=motion.tip(),
            track=np.array(motion.track if command is None else motion.track[1:]),
            body=body,
            disc_clearance=disc,
            body_clearance=clearance,
            contacts=contacts,
            forces=forces,
            halted=motion.halted,
        )

    def _motion(self, passive: int) -> Motion:
        return Motion(self._chain, self.wall, np.asarray(self.entrance), self._model, passive)

    def _model(self, passive: int) -> Model:
        if passive not in self._models:
            self._models[passive] = build_model(self._chain, np.asarray(self.entrance), passive)
        return self._models[passive]
