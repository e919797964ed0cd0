"""One motion of the robot: control, contact planes and MuJoCo's steps, from a state to the next."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.bronchoscope.dynamics.chain import RIM_ROUNDING, Chain
from tubeplan_viz.bronchoscope.dynamics.engine import engine
from tubeplan_viz.bronchoscope.dynamics.model import FAR, Model
from tubeplan_viz.bronchoscope.dynamics.wall import SIDES, PatientWall, WallPlanes

# Places on the front disc's rim at which its clearance is measured: between them it bulges by r (1 - cos(pi / 24)), 0.015 mm.
RIM_PLACES = 24
BODY_SPACING = 0.8
TRACK_SPACING = 0.5
# A lifted plane is this far past the ball that it meets, and stays lifted while the ball is no further away, mm.
LIFT = 1e-3
HOLD = 0.03
# Balls this near to the entrance are still led by the sheath, mm.
MOUTH = 0.5
# A step in which a place moves further is none of a robot pushed at 15 mm/s, mm.
LEAP = 0.8
# A motion that begins deep in the wall may go this much deeper, mm.
DEEPER = 0.02
# The wall is asked when some ball has moved this far, mm.
RENEWAL_WAY = 0.1
NONE = np.zeros(0, dtype=np.int64)
# The last millimetre before the entrance: from 10^4 times its stiffness a hinge gives way to its own.
SHEATH = 4.0


class Motion:
    """The robot while it moves.

    Parameters
    ----------
    chain : Chain
    wall : PatientWall
    entrance : (4, 4) float array, mm
    model_for : callable
        The model for a number of passive hinges.
    passive : int
        Number of passive hinges to begin with.
    """

    def __init__(
        self,
        chain: Chain,
        wall: PatientWall,
        entrance: FloatArray,
        model_for: Callable[[int], Model],
        passive: int,
    ) -> None:
        self._mujoco = engine()
        self._chain, self._wall, self._entrance, self._model_for = chain, wall, entrance, model_for
        angle = 2.0 * np.pi * np.arange(RIM_PLACES) / RIM_PLACES
        self._rim = chain.robot.radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        self._front = float(chain.hinges[0])
        self.angles: FloatArray = np.zeros((2 * chain.robot.links, 2))
        self.inserted = 0.0
        self.steps = 0
        self._centers = self._asked = np.zeros((0, 3))
        self.track: list[FloatArray] = []
        self.disc_clearance = np.inf
        self.body_clearance = np.inf
        self.halted = False
        self._depth = 0.0
        self._take(passive)
        self._good = self._memory()

    def begin(self, values: FloatArray | None, angles: FloatArray, inserted: float) -> None:
        """From MuJoCo's state, or straight and at rest without one; the wall's planes are laid anew."""
        if values is None:
            self._mujoco.mj_resetData(self.model.model, self.data)
            self.data.qpos[0] = inserted - self.model.behind
        else:
            self._mujoco.mj_setState(self.model.model, self.data, values, self._mujoco.mjtState.mjSTATE_INTEGRATION)
        self.angles, self.inserted = angles, inserted
        self._sheath()
        self._mujoco.mj_kinematics(self.model.model, self.data)
        self._centers = np.array(self.data.geom_xpos[self.model.balls])
        self._touch(self._centers, fresh=True)
        self.track = [self.tip_place()]
        self._depth = max(self._chain.settings.halt_depth, -self.body_clearance + DEEPER)
        self._good = self._memory()

    def go(self, angles: FloatArray, inserted: float, duration: float, watch: Callable[[float], None] | None = None) -> None:
        """Bring the commanded shape and place evenly to new values, then wait for rest.

        A motion that would press the robot deeper into the wall than `halt_depth`, or throw it about, halts in its last good
        state, as a robot stops whose motors work against too much.

        Parameters
        ----------
        angles : (2 n, 2) float array, rad
        inserted : float, mm
        duration : float, s
        watch : callable, optional
            Called after each step with the time since the begin, s.
        """
        settings = self._chain.settings
        step = settings.time_step
        first_angles, first_place = self.angles, self.inserted
        count = max(int(np.ceil(duration / step)), 1)
        speed, turning = (inserted - first_place) / (count * step), (angles - first_angles) / (count * step)
        rest = 0.0 * turning
        for number in range(1, count + int(np.ceil(settings.settle_time / step)) + 1):
            if number <= count:
                share = number / count
                self.angles = first_angles + share * (angles - first_angles)
                self.inserted = first_place + share * (inserted - first_place)
                wanted = self._chain.passive_for(self.inserted)
                if wanted != self.model.passive:
                    self._change(wanted)
                self._sheath()
            self._control(*((speed, turning) if number <= count else (0.0, rest)))
            self._mujoco.mj_step(self.model.model, self.data)
            self._mujoco.mj_kinematics(self.model.model, self.data)
            self.steps += 1
            centers = np.array(self.data.geom_xpos[self.model.balls])
            way = float(np.square(centers - self._centers).sum(axis=1).max())
            # Written so that a place that is not finite is a leap, too.
            if not way < LEAP**2:
                self._return()
                break
            best = self.disc_clearance, self.body_clearance
            asked = self._touch(centers)
            if self.body_clearance < -self._depth:
                self.disc_clearance, self.body_clearance = best
                self._return()
                break
            if asked:
                self._good = self._memory()
            tip = self.tip_place()
            if np.abs(tip - self.track[-1]).max() > TRACK_SPACING:
                self.track.append(tip)
            if watch is not None:
                watch(number * step)
            if number >= count and way < (settings.settle_speed * step) ** 2:
                break
        self.track.append(self.tip_place())
        self._measure_disc()

    def tip_place(self) -> FloatArray:
        """Middle of the front disc, (3,) mm."""
        body = self.model.tip_body
        return np.asarray(self.data.xpos[body] + self._front * self.data.xmat[body, 2::3])

    def tip(self) -> FloatArray:
        """Pose of the front disc, (4, 4) mm."""
        made = np.eye(4)
        made[:3, :3] = self.data.xmat[self.model.tip_body].reshape(3, 3)
        made[:3, 3] = self.tip_place()
        return made

    def base(self) -> FloatArray:
        """Pose of the proximal section's base, (4, 4) mm."""
        made = np.eye(4)
        made[:3, :3] = self.data.xmat[self.model.base_body].reshape(3, 3)
        made[:3, 3] = self.data.xpos[self.model.base_body]
        return made

    def push(self) -> tuple[float, float]:
        """Place of the proximal section's base behind the entrance along the shaft, mm, and its speed, mm/s."""
        return float(self.data.qpos[0] + self.model.behind), float(self.data.qvel[0])

    def values(self) -> FloatArray:
        """MuJoCo's full integration state."""
        kind = self._mujoco.mjtState.mjSTATE_INTEGRATION
        values = np.empty(self._mujoco.mj_stateSize(self.model.model, kind))
        self._mujoco.mj_getState(self.model.model, self.data, values, kind)
        return values

    def body(self) -> FloatArray:
        """Places along the axis from the entrance to the tip, (m, 3) mm."""
        start, axis = self._entrance[:3, 3], self._entrance[:3, 2]
        links = self.data.xpos[self.model.link_bodies[::-1]]
        out = np.flatnonzero((links - start) @ axis > 1e-6)
        corners = np.vstack([start, links[out[0] :] if len(out) else links[:0], self.tip_place()])
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        places = np.concatenate([[0.0], np.cumsum(lengths)])
        count = np.maximum(np.ceil(lengths / BODY_SPACING).astype(int), 1)
        parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(places[:-1], places[1:], count, strict=True)]
        wanted = np.append(np.concatenate(parts), places[-1])
        return np.column_stack([np.interp(wanted, places, column) for column in corners.T])

    def clearances(self, body: FloatArray) -> tuple[float, float]:
        """Least clearance of the front disc and of the body on the way so far, mm."""
        # The last radius of the axis belongs to the front disc: the rounded front is narrower than the axis' distance there.
        behind = np.linalg.norm(body - body[-1], axis=1) >= self._chain.robot.radius
        here = float(np.min(self._wall.exact.clearance(body[behind]))) - self._chain.robot.radius
        self._measure_disc()
        return self.disc_clearance, min(self.body_clearance, here)

    def contacts(self) -> tuple[FloatArray, FloatArray]:
        """Places (k, 3) mm and normal forces (k,) N of the contacts of the last step."""
        places, forces = [], []
        for number in range(self.data.ncon):
            contact: Any = self.data.contact[number]
            force = 1e-3 * float(self.data.efc_force[contact.efc_address]) if contact.efc_address >= 0 else 0.0
            if force > 1e-6:
                places.append(np.array(contact.pos))
                forces.append(force)
        return np.array(places).reshape(-1, 3), np.array(forces)

    def _take(self, passive: int) -> None:
        self.model = self._model_for(passive)
        self.data = self.model.data
        self._planes = WallPlanes(self._wall, self.model.ball_radii + self.model.ball_skins)
        self._points = self.data.mocap_pos.reshape(-1, SIDES, 3)
        self._turns = self.data.mocap_quat.reshape(-1, SIDES, 4)

    def _control(self, speed: float, turning: FloatArray) -> None:
        self.data.ctrl[0] = self.inserted - self.model.behind
        self.data.ctrl[1] = speed
        self.data.ctrl[2::2] = self.angles.ravel()
        self.data.ctrl[3::2] = turning.ravel()

    def _sheath(self) -> None:
        """Hinges that are still in the sheath are stiff; a hinge gives way over its last millimetre there."""
        depth = np.clip(self.model.hinge_places - self.inserted, 0.0, 1.0)
        self.model.model.jnt_stiffness[self.model.passive_joints] = self.model.passive_stiffness * 10.0 ** (SHEATH * depth)

    def _touch(self, centers: FloatArray, *, fresh: bool = False) -> bool:
        """Lay the wall's planes where the balls are now; whether the wall was asked.

        MuJoCo resists once a ball is past its plane; one that comes at 50 mm/s would be 0.1 mm past it by then. The
        plane of a ball that would pass it in the next step is therefore lifted to meet it, and the step takes its speed.
        """
        model, planes = self.model, self._planes
        if fresh or float(np.square(centers - self._asked).sum(axis=1).max()) > RENEWAL_WAY**2:
            self._asked, asked = centers, True
            inside = model.ball_places < self.inserted + self._chain.robot.active_length - MOUTH
            rows = np.flatnonzero(planes.renew(centers, inside))
        else:
            rows, asked = NONE, False
        if len(rows):
            used = planes.used[rows, :, None]
            self._points[rows] = np.where(used, planes.points[rows], [0.0, 0.0, FAR])
            x, y, z = np.moveaxis(np.where(used, planes.normals[rows], [0.0, 0.0, 1.0]), -1, 0)
            turned = np.stack([np.maximum(1.0 + z, 1e-9), -y, x, 0.0 * z], axis=-1)
            self._turns[rows] = turned / np.sqrt(np.square(turned).sum(axis=-1, keepdims=True))
            self._measure(rows)
        rows, sides = np.nonzero(planes.used)
        if len(rows):
            points, normals = planes.points[rows, sides], planes.normals[rows, sides]
            skin = model.ball_skins[rows]
            gap = np.einsum("ij,ij->i", centers[rows] - points, normals) - model.ball_radii[rows] - skin
            thick = model.ball_radii[rows] == self._chain.robot.radius
            # Between two questions the planes tell how deep a ball is.
            self.body_clearance = min(self.body_clearance, float((gap + skin)[thick].min(initial=np.inf)))
            coming = np.einsum("ij,ij->i", self._centers[rows] - centers[rows], normals)
            lift = skin + np.where((gap > 0.0) & (gap < np.maximum(coming, HOLD)), gap + LIFT, 0.0)
            self._points[rows, sides] = points + lift[:, None] * normals
        self._centers = centers
        return asked

    def _memory(self) -> tuple[int, FloatArray, FloatArray, float]:
        return self.model.passive, self.values(), self.angles, self.inserted

    def _return(self) -> None:
        """Back to the last good state, at rest."""
        passive, values, angles, inserted = self._good
        if passive != self.model.passive:
            self._take(passive)
        clearances = self.disc_clearance, self.body_clearance
        track = self.track
        self.begin(values, angles, inserted)
        self.track = track
        self.data.qvel[:] = 0.0
        self._mujoco.mj_forward(self.model.model, self.data)
        self.disc_clearance, self.body_clearance = clearances
        self.halted = True

    def _measure(self, rows: IntArray) -> None:
        """Least clearances so far, from the balls whose distance is new."""
        radius = self._chain.robot.radius
        distance, thick = self._planes.distance[rows], self.model.ball_radii[rows] == radius
        if thick.any():
            self.body_clearance = min(self.body_clearance, float(distance[thick].min()) - radius)
        # No place of the sharp rim is further than this from the middle of the nearest rim ball.
        bound = float(distance[~thick].min(initial=np.inf)) - np.sqrt(2.0) * RIM_ROUNDING
        if bound < min(self.disc_clearance, radius):
            self._measure_disc()

    def _measure_disc(self) -> None:
        tip = self.tip()
        places = self._rim @ tip[:3, :3].T + tip[:3, 3]
        if float(self._wall.exact.distance(places).min()) < self.disc_clearance:
            self.disc_clearance = min(self.disc_clearance, float(self._wall.exact.clearance(places).min()))

    def _change(self, passive: int) -> None:
        """Go on with a model of more or fewer passive hinges; those that come in or go are in the sheath, straight."""
        old, before = self.model, self.data
        self._take(passive)
        shared = 2 * (min(passive, old.passive) + 2 * self._chain.robot.links)
        self._mujoco.mj_resetData(self.model.model, self.data)
        self.data.qpos[0] = before.qpos[0] + old.behind - self.model.behind
        self.data.qvel[0] = before.qvel[0]
        self.data.qpos[-shared:] = before.qpos[-shared:]
        self.data.qvel[-shared:] = before.qvel[-shared:]
        self.data.act[:] = before.act
        self.data.time = before.time
        self._mujoco.mj_kinematics(self.model.model, self.data)
        self._centers = np.array(self.data.geom_xpos[self.model.balls])
        self._touch(self._centers, fresh=True)
