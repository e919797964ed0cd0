"""The robot as a MuJoCo model: pusher, passive links, active links with motors, and the wall's tangent planes.

Units inside the model are mm, kg and s, so forces are mN and moments N um; the frame is the lumen's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from segmentation.arrays import FloatArray, IntArray
from tubeplan_viz.bronchoscope.dynamics.chain import RIM_BALLS, RIM_ROUNDING, Chain
from tubeplan_viz.bronchoscope.dynamics.engine import engine
from tubeplan_viz.bronchoscope.dynamics.wall import SIDES

# A passive hinge that is still in the sheath is this much stiffer.
SHEATH = 1e4
# Where a plane waits that is not used, mm.
FAR = -1e6
# Softness of a contact: MuJoCo's impedance from the first touch to 0.05 mm deep. Nearer to 1 the robot is thrown off the wall.
IMPEDANCE = [0.95, 0.99, 0.05, 0.5, 2.0]


@dataclass(frozen=True, eq=False, kw_only=True)
class Model:
    """One compiled model and where its parts are in MuJoCo's arrays.

    The passive links that are still in the sheath outside are no part of it: a model has a number of passive hinges,
    and the pusher moves the last of them.

    Attributes
    ----------
    model, data : mujoco.MjModel, mujoco.MjData
    passive : int
        Number of passive hinges.
    behind : float
        Distance of the last hinge from the proximal section's base, mm: the pusher's coordinate is how far the base is
        inside, less this.
    balls : slice
        Geoms of the balls, from the shaft to the tip, the rim's last.
    ball_radii : (b,) float array, mm
    ball_skins : (b,) float array, mm
    ball_places : (b,) float array, mm
        Distance behind the front disc.
    passive_joints : (2 passive,) int array
        Tip first.
    passive_stiffness : (2 passive,) float array, N um / rad
    hinge_places : (2 passive,) float array, mm
        Distance of the passive joints from the proximal section's base.
    tip_body, base_body : int
        The last link, and the first link of the proximal section.
    link_bodies : (l,) int array
        Tip first.
    """

    model: Any
    data: Any
    passive: int
    behind: float
    balls: slice
    ball_radii: FloatArray
    ball_skins: FloatArray
    ball_places: FloatArray
    passive_joints: IntArray
    passive_stiffness: FloatArray
    hinge_places: FloatArray
    tip_body: int
    base_body: int
    link_bodies: IntArray


def build_model(chain: Chain, entrance: FloatArray, passive: int) -> Model:
    """The model with a number of passive hinges.

    Parameters
    ----------
    chain : Chain
    entrance : (4, 4) float array, mm
        The third column runs into the lumen.
    passive : int
        At least 1: the hinge at the proximal section's base.

    Raises
    ------
    CaseError
        If MuJoCo is not installed.
    """
    mujoco = engine()
    robot, settings = chain.robot, chain.settings
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    option = spec.option
    option.timestep = settings.time_step
    # Strategy: the discrete integrator solves contacts in the metric M + h D + h^2 K, implicit in springs, motors and
    # contacts alike: light links on stiff hinges need no artificial mass, and steps of some milliseconds are stable.
    option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.gravity = [1e3 * g for g in settings.gravity]
    # The contact's softness is stated against the exact inertia at each contact, not against that of the straight robot.
    option.enableflags = int(mujoco.mjtEnableBit.mjENBL_DIAGEXACT)
    # A state that is not finite must be seen, not replaced by the straight robot.
    option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)

    count = 2 * robot.links
    hinges = chain.hinges[: count + passive]
    rotation = Rotation.from_matrix(entrance[:3, :3]).as_quat(scalar_first=True)
    body = spec.worldbody.add_body(name="pusher", pos=entrance[:3, 3], quat=rotation)
    # The shaft in the sheath rides on the pusher: it is straight there, and as heavy as the whole robot.
    shaft = max(robot.active_length + robot.passive_length - float(hinges[-1]), 1.0)
    _inertia(body, chain.mass_per_length * shaft, -0.5 * shaft, shaft, robot.radius)
    slide = body.add_joint(name="push", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
    slide.damping = [0.0, 0.0, 0.0]
    push = spec.add_actuator(name="push", target="push", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    stiffness = 1e3 * settings.push_stiffness
    push.set_to_pid(kp=stiffness, kv=stiffness * settings.relaxation)
    push.forcelimited = True
    push.forcerange = [-1e3 * settings.push_force, 1e3 * settings.push_force]

    ball_places = chain.balls[chain.balls < hinges[-1]][::-1]
    radii = np.concatenate([np.full(len(ball_places), robot.radius), np.full(RIM_BALLS, RIM_ROUNDING)])
    angle = 2.0 * np.pi * np.arange(RIM_BALLS) / RIM_BALLS
    ring = robot.radius - RIM_ROUNDING
    for number in range(len(hinges) - 1, -1, -1):
        near = hinges[number - 1] if number else 0.0
        length = float(hinges[number] - near)
        offset = float(hinges[number + 1] - hinges[number]) if number + 1 < len(hinges) else 0.0
        body = body.add_body(name=f"link {number}", pos=[0.0, 0.0, offset])
        _inertia(body, chain.mass_per_length * length, 0.5 * length, length, robot.radius)
        axes = ([1, 0, 0], [0, 1, 0]) if (number - count) % 2 == 1 else ([0, 1, 0], [1, 0, 0])
        for side, axis in enumerate(axes):
            name = f"hinge {number} {side}"
            joint = body.add_joint(name=name, axis=axis)
            if number >= count:
                value = 1e3 * float(chain.stiffness[number - count])
                joint.stiffness = [value, 0.0, 0.0]
                joint.damping = [value * settings.relaxation, 0.0, 0.0]
        for ball in np.flatnonzero((ball_places <= hinges[number]) & (ball_places > near)):
            _ball(mujoco, body, f"ball {ball}", [0.0, 0.0, float(hinges[number] - ball_places[ball])], robot.radius)
        if number == 0:
            for k in range(RIM_BALLS):
                place = [ring * np.cos(angle[k]), ring * np.sin(angle[k]), float(hinges[0]) - RIM_ROUNDING]
                _ball(mujoco, body, f"ball {len(ball_places) + k}", place, RIM_ROUNDING)
    for number in range(count - 1, -1, -1):
        value = 1e3 * float(chain.active_stiffness[number])
        for side in range(2):
            name = f"hinge {number} {side}"
            motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            gain = value / settings.integral_time if settings.integral_share else -1.0
            limit = settings.integral_share * robot.bend_max / robot.links * settings.integral_time
            motor.set_to_pid(kp=value, kv=value * settings.relaxation, ki=gain, imax=limit if gain > 0.0 else -1.0)
    _planes(mujoco, spec, len(radii), settings.friction, settings.contact_time)
    model = spec.compile()
    first = int(model.geom("ball 0").id)
    joints = [int(model.joint(f"hinge {n} {side}").id) for n in range(count, count + passive) for side in range(2)]
    return Model(
        model=model,
        data=mujoco.MjData(model),
        passive=passive,
        behind=float(hinges[-1] - robot.active_length),
        balls=slice(first, first + len(radii)),
        ball_radii=radii,
        ball_skins=np.where(radii < robot.radius, settings.rim_skin, settings.skin),
        ball_places=np.concatenate([ball_places, np.full(RIM_BALLS, RIM_ROUNDING)]),
        passive_joints=np.array(joints),
        passive_stiffness=np.repeat(1e3 * chain.stiffness[:passive], 2),
        hinge_places=np.repeat(chain.passive_hinges[:passive] - robot.active_length, 2),
        tip_body=int(model.body("link 0").id),
        base_body=int(model.body(f"link {count}").id),
        link_bodies=np.array([int(model.body(f"link {number}").id) for number in range(len(hinges))]),
    )


def _inertia(body: Any, mass: float, middle: float, length: float, radius: float) -> None:
    """A solid cylinder along the third axis."""
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    body.explicitinertial = True
    body.mass = mass
    body.ipos = [0.0, 0.0, middle]
    body.inertia = [across, across, 0.5 * mass * radius**2]


def _ball(mujoco: Any, body: Any, name: str, place: list[float], radius: float) -> None:
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=place, contype=0, conaffinity=0, mass=0.0
    )


def _planes(mujoco: Any, spec: Any, balls: int, friction: float, time: float) -> None:
    """Movable tangent planes of the wall, `SIDES` for each ball, touched by that ball alone."""
    for ball in range(balls):
        for side in range(SIDES):
            name = f"wall {ball} {side}"
            body = spec.worldbody.add_body(name=name, mocap=True, pos=[0.0, 0.0, FAR])
            body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[10.0, 10.0, 1.0], contype=0, conaffinity=0)
            pair = spec.add_pair(geomname1=f"ball {ball}", geomname2=name, condim=3 if friction else 1)
            pair.friction = [friction, friction, 0.0, 0.0, 0.0]
            pair.solref = [time, 1.0]
            pair.solimp = IMPEDANCE
