"""The robot moved by MuJoCo in the patient's own lumen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray, IntArray, frozen_array
from segmentation.errors import CaseError
from segmentation.mesh import Surface
from tubeplan_viz.bronchoscope.dynamics.chain import Chain, hinge_angles
from tubeplan_viz.bronchoscope.dynamics.engine import engine
from tubeplan_viz.bronchoscope.dynamics.model import FAR, Model, build_model
from tubeplan_viz.bronchoscope.dynamics.settings import DynamicsSettings
from tubeplan_viz.bronchoscope.dynamics.wall import SIDES, PatientWall, WallPlanes
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot

# Passive hinges come into the model in groups, so that few models are built.
GROUP = 4
# Places on the front disc's rim at which its clearance is measured.
RIM_PLACES = 24
BODY_SPACING = 0.8
# A lifted plane is this far past the ball that it meets, mm.
LIFT = 1e-3
HOLD = 0.03


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatorState:
    """All that MuJoCo needs to go on from here, bit for bit.

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
    push, push_speed : float
        Place of the proximal section's base behind the entrance, mm, and how fast it moves, mm/s.
    bend : float, rad
        Angle between the proximal section's base and the tip.
    """

    time: float
    tip: FloatArray
    push: float
    push_speed: float
    bend: float


class Simulator:
    """A `Mover` with dynamics: links, motors, gravity and contact with the wall.

    Parameters
    ----------
    surface : Surface
        The lumen's wall as it is; nothing is simplified.
    robot : Robot
    entrance : (4, 4) float array, mm
        Where the proximal section's base is at the start; the third column runs into the lumen.
    settings : DynamicsSettings, optional

    Raises
    ------
    CaseError
        If MuJoCo is not installed.
    """

    def __init__(self, surface: Surface, robot: Robot, entrance: FloatArray, settings: DynamicsSettings | None = None) -> None:
        self._mujoco = engine()
        self.robot = robot
        self.settings = settings or DynamicsSettings()
        self.chain = Chain(robot=robot, settings=self.settings)
        self.entrance = frozen_array(entrance, (4, 4), "entrance")
        self.wall = PatientWall(surface)
        self._models: dict[int, Model] = {}
        self.steps = 0

    def start(self) -> Step:
        """The robot at rest: straight, the proximal section's base at the entrance, both active sections inside."""
        model = self._model(GROUP)
        run = _Run(self, model)
        run.place(0.0)
        command = Command(phi_proximal=0.0, theta_proximal=0.0, phi_distal=0.0, theta_distal=0.0, push=0.0)
        angles = hinge_angles(self.robot, command)
        run.begin(angles, 0.0)
        for _ in run.go(angles, 0.0, 0.0):
            pass
        return run.step(None)

    def move(self, step: Step, command: Command) -> Step:
        """The robot after `command`, begun from `step`; the same step and command always give the same outcome.

        Both sections bend evenly while the shaft is pushed: the push takes its length at the robot's speed, or as long as the
        bend needs. The step ends when the robot rests.

        Raises
        ------
        CaseError
            If the command pulls the proximal section out of the entrance or pushes the shaft's end in.
        """
        run = self._resume(step.state)
        for _ in run.go(hinge_angles(self.robot, command), run.inserted + command.push, self._duration(run, command)):
            pass
        return run.step(command)

    def moments(self, step: Step, command: Command) -> Iterator[Moment]:
        """The motion of `move`, instant by instant."""
        run = self._resume(step.state)
        yield from run.go(hinge_angles(self.robot, command), run.inserted + command.push, self._duration(run, command))

    def _resume(self, state: SimulatorState) -> _Run:
        model = self._model(state.passive)
        self._mujoco.mj_setState(model.model, model.data, state.values, self._mujoco.mjtState.mjSTATE_INTEGRATION)
        run = _Run(self, model)
        run.begin(np.array(state.angles), state.inserted)
        return run

    def _duration(self, run: _Run, command: Command) -> float:
        end = run.inserted + command.push
        if not 0.0 <= end <= self.robot.passive_length:
            raise CaseError(
                f"the command puts the proximal section's base {end:.2f} mm behind the entrance, "
                f"expected 0 to {self.robot.passive_length:g} mm"
            )
        change = np.abs(hinge_angles(self.robot, command) - run.angles).max() * self.robot.links
        return float(max(abs(command.push) / self.robot.push_speed, change / self.settings.bend_speed))

    def _model(self, passive: int) -> Model:
        passive = min(passive, len(self.chain.passive_hinges))
        if passive not in self._models:
            self._models[passive] = build_model(self.chain, self.entrance, passive)
        return self._models[passive]

    def _passive_for(self, inserted: float) -> int:
        """Hinges beyond the entrance and the next ones, in whole groups."""
        out = int(np.searchsorted(self.chain.passive_hinges - self.robot.active_length, inserted + self.settings.coarse_link))
        return min(-(-(out + 1) // GROUP) * GROUP, len(self.chain.passive_hinges))


class _Run:
    """One motion from a state."""

    def __init__(self, simulator: Simulator, model: Model) -> None:
        self.simulator = simulator
        self.mujoco = simulator._mujoco
        self._take(model)
        self.angles: FloatArray = np.zeros((2 * simulator.robot.links, 2))
        self.inserted = 0.0
        self.track: list[FloatArray] = []
        self.disc_clearance = np.inf
        self.body_clearance = np.inf

    def _take(self, model: Model) -> None:
        self.model = model
        self.m, self.d = model.model, model.data
        self.planes = WallPlanes(self.simulator.wall, model.ball_radii + model.ball_skins)
        angle = 2.0 * np.pi * np.arange(RIM_PLACES) / RIM_PLACES
        radius = self.simulator.robot.radius
        self.rim = radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        self.front = float(self.simulator.chain.hinges[0])

    def place(self, inserted: float) -> None:
        """The robot straight and at rest at a place."""
        self.mujoco.mj_resetData(self.m, self.d)
        self.d.qpos[0] = inserted - self.model.behind

    def begin(self, angles: FloatArray, inserted: float) -> None:
        """Positions of everything from the state, with the wall's planes laid anew."""
        self.angles, self.inserted = angles, inserted
        self._sheath()
        self._control(angles, inserted, 0.0)
        self.mujoco.mj_kinematics(self.m, self.d)
        self._touch(self._centers(), self._centers())
        self.track = [self.tip()[:3, 3]]

    def go(self, angles: FloatArray, inserted: float, duration: float) -> Iterator[Moment]:
        """Bring the commanded shape and place evenly to new values, then wait for rest."""
        settings = self.simulator.settings
        first_angles, first_place = self.angles, self.inserted
        step = settings.time_step
        count = max(int(np.ceil(duration / step)), 1)
        speed = (inserted - first_place) / (count * step)
        before = self._centers()
        for number in range(1, count + int(np.ceil(settings.settle_time / step)) + 1):
            share = min(number / count, 1.0)
            self.angles = first_angles + share * (angles - first_angles)
            self.inserted = first_place + share * (inserted - first_place)
            if self.simulator._passive_for(self.inserted) != self.model.passive:
                self._change(self.simulator._passive_for(self.inserted))
                before = self._centers()
            self._sheath()
            self._control(self.angles, self.inserted, speed if number <= count else 0.0)
            self.mujoco.mj_step(self.m, self.d)
            self.simulator.steps += 1
            self.mujoco.mj_kinematics(self.m, self.d)
            centers = self._centers()
            self._touch(centers, before)
            self.track.append(self.tip()[:3, 3])
            yield self._moment(number * step)
            fastest = np.sqrt(np.max(np.sum((centers - before) ** 2, axis=1))) / step
            before = centers
            if number >= count and fastest < settings.settle_speed:
                break

    def tip(self) -> FloatArray:
        """Pose of the front disc, (4, 4) mm."""
        made = np.eye(4)
        made[:3, :3] = self.d.xmat[self.model.tip_body].reshape(3, 3)
        made[:3, 3] = self.d.xpos[self.model.tip_body] + self.front * made[:3, 2]
        return made

    def base(self) -> FloatArray:
        """Pose of the proximal section's base, (4, 4) mm."""
        made = np.eye(4)
        made[:3, :3] = self.d.xmat[self.model.base_body].reshape(3, 3)
        made[:3, 3] = self.d.xpos[self.model.base_body]
        return made

    def body(self) -> FloatArray:
        """Places along the axis from the entrance to the tip, mm."""
        links = self.d.xpos[self.model.link_bodies[::-1]]
        axis = self.simulator.entrance[:3, 2]
        start = self.simulator.entrance[:3, 3]
        inside = (links - start) @ axis > 1e-6
        first = int(np.argmax(inside)) if inside.any() else len(links)
        corners = np.vstack([start, links[first:], self.tip()[:3, 3]])
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        places = np.concatenate([[0.0], np.cumsum(lengths)])
        count = np.maximum(np.ceil(lengths / BODY_SPACING).astype(int), 1)
        wanted = np.concatenate(
            [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(places[:-1], places[1:], count, strict=True)]
        )
        wanted = np.append(wanted, places[-1])
        return np.column_stack([np.interp(wanted, places, corners[:, k]) for k in range(3)])

    def step(self, command: Command | None) -> Step:
        """The state and what it means."""
        values = np.empty(self.mujoco.mj_stateSize(self.m, self.mujoco.mjtState.mjSTATE_INTEGRATION))
        self.mujoco.mj_getState(self.m, self.d, values, self.mujoco.mjtState.mjSTATE_INTEGRATION)
        state = SimulatorState(passive=self.model.passive, values=values, angles=self.angles, inserted=self.inserted)
        contacts, forces = self._contacts()
        body = self.body()
        track = np.array(self.track)
        if command is not None:
            keep, last = [], track[0]
            for number in range(1, len(track)):
                if np.linalg.norm(track[number] - last) > 0.5 or number == len(track) - 1:
                    keep.append(number)
                    last = track[number]
            track = track[keep]
        # The last radius of the axis is the front disc's: its rounded edge is narrower than the axis' distance there.
        behind = np.linalg.norm(body - body[-1], axis=1) >= self.simulator.robot.radius
        clearance = float(np.min(self.simulator.wall.exact.clearance(body[behind]))) - self.simulator.robot.radius
        disc = float(np.min(self.simulator.wall.exact.clearance(self._rim_places())))
        return Step(
            state=state,
            command=command,
            base=self.base(),
            tip=self.tip(),
            track=track,
            body=body,
            disc_clearance=min(self.disc_clearance, disc),
            body_clearance=min(self.body_clearance, clearance),
            contacts=contacts,
            forces=forces,
        )

    def _moment(self, time: float) -> Moment:
        base, tip = self.base(), self.tip()
        return Moment(
            time=time,
            tip=tip,
            push=float(self.d.qpos[0] + self.model.behind),
            push_speed=float(self.d.qvel[0]),
            bend=float(np.arccos(np.clip(base[:3, 2] @ tip[:3, 2], -1.0, 1.0))),
        )

    def _centers(self) -> FloatArray:
        return np.asarray(self.d.geom_xpos[self.model.ball_geoms])

    def _rim_places(self) -> FloatArray:
        tip = self.tip()
        return self.rim @ tip[:3, :3].T + tip[:3, 3]

    def _control(self, angles: FloatArray, inserted: float, speed: float) -> None:
        self.d.ctrl[0] = inserted - self.model.behind
        self.d.ctrl[1] = speed
        self.d.ctrl[2::2] = angles.ravel()

    def _sheath(self) -> None:
        """Hinges that are still in the sheath are stiff; a hinge gives way over its last millimetre there."""
        depth = np.clip(self.model.hinge_places - self.inserted, 0.0, 1.0)
        self.m.jnt_stiffness[self.model.passive_joints] = self.model.passive_stiffness * 10.0 ** (4.0 * depth)

    def _touch(self, centers: FloatArray, before: FloatArray) -> None:
        """Lay the wall's planes where the balls are now.

        MuJoCo resists once a ball is past its plane; one that comes at 50 mm/s would be 0.2 mm past it by then. The plane
        of a ball that would pass it in the next step is therefore lifted to meet it: the step takes its speed.
        """
        inside = self.model.ball_places < self.inserted + self.simulator.robot.active_length
        planes = self.planes
        renewed = planes.renew(centers, inside)
        points, turns = self.d.mocap_pos.reshape(-1, SIDES, 3), self.d.mocap_quat.reshape(-1, SIDES, 4)
        if renewed.any():
            rows = np.flatnonzero(renewed)
            normals, used = planes.normals[rows], planes.used[rows]
            points[rows] = np.where(used[..., None], planes.points[rows], [0.0, 0.0, FAR])
            x, y, z = np.moveaxis(np.where(used[..., None], normals, [0.0, 0.0, 1.0]), -1, 0)
            turned = np.stack([np.maximum(1.0 + z, 1e-9), -y, x, 0.0 * z], axis=-1)
            turns[rows] = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
            self._measure(rows)
        rows, sides = np.nonzero(planes.used)
        normals = planes.normals[rows, sides]
        skin = self.model.ball_skins[rows]
        gap = np.einsum("ij,ij->i", centers[rows] - planes.points[rows, sides], normals) - self.model.ball_radii[rows] - skin
        coming = np.einsum("ij,ij->i", before[rows] - centers[rows], normals)
        lift = skin + np.where((gap > 0.0) & (gap < np.maximum(coming, HOLD)), gap + LIFT, 0.0)
        points[rows, sides] = planes.points[rows, sides] + lift[:, None] * normals

    def _measure(self, rows: IntArray) -> None:
        """Least clearances so far, from the balls whose distance is new."""
        radius = self.simulator.robot.radius
        fresh = self.planes.distance[rows[self.model.ball_radii[rows] == radius]] - radius
        if len(fresh):
            self.body_clearance = min(self.body_clearance, float(fresh.min()))
        if (self.model.ball_radii[rows] < radius).any():
            places = self._rim_places()
            if self.simulator.wall.exact.distance(places).min() < self.disc_clearance:
                self.disc_clearance = min(self.disc_clearance, float(self.simulator.wall.exact.clearance(places).min()))

    def _change(self, passive: int) -> None:
        """Go on with a model of more or fewer passive hinges; those that come in or go are in the sheath, straight."""
        old, od = self.model, self.d
        model = self.simulator._model(passive)
        self.mujoco.mj_resetData(model.model, model.data)
        shared = 2 * (min(passive, old.passive) + 2 * self.simulator.robot.links)
        d = model.data
        d.qpos[0] = od.qpos[0] + old.behind - model.behind
        d.qvel[0] = od.qvel[0]
        d.qpos[-shared:] = od.qpos[-shared:]
        d.qvel[-shared:] = od.qvel[-shared:]
        d.act[:] = od.act
        d.time = od.time
        self._take(model)
        self._sheath()
        self.mujoco.mj_kinematics(self.m, self.d)
        self._touch(self._centers(), self._centers())

    def _contacts(self) -> tuple[FloatArray, FloatArray]:
        """Places and normal forces (N) of the contacts of the last step."""
        places, forces = [], []
        for number in range(self.d.ncon):
            contact: Any = self.d.contact[number]
            if contact.efc_address < 0:
                continue
            force = 1e-3 * float(self.d.efc_force[contact.efc_address])
            if force > 1e-6:
                places.append(np.array(contact.pos))
                forces.append(force)
        return np.array(places).reshape(-1, 3), np.array(forces)
