"""From the robot's pose and the line ahead to a command: each section's chord is pointed at the line."""

from __future__ import annotations

import numpy as np

from segmentation.arrays import FloatArray
from tubeplan_viz.bronchoscope.kinematic import SPACING, active_points, bend_vectors, polar
from tubeplan_viz.bronchoscope.kinematics import bend_towards, section_transform
from tubeplan_viz.bronchoscope.mover import Command, Step
from tubeplan_viz.bronchoscope.robot import Robot

AIM_ROUNDS = 3
FIT_ROUNDS = 6
DAMPING = 1e-3
LOOK = 2.0  # weight of the tip's direction: 0.5 rad off counts like a place at the border of its room


def active_shares(robot: Robot) -> FloatArray:
    """Arc lengths of the places of `active_points` as shares of the active length, (m,)."""
    counts = [int(np.ceil(length / SPACING)) for length in (robot.proximal_length, robot.distal_length)]
    first = robot.proximal_length * np.arange(counts[0] + 1) / counts[0]
    second = robot.proximal_length + robot.distal_length * np.arange(1, counts[1] + 1) / counts[1]
    return np.concatenate([first, second]) / robot.active_length


def command_of(bends: FloatArray, push: float) -> Command:
    """The command with these bend vectors, (2, 2) rad."""
    (phi_p, theta_p), (phi_d, theta_d) = polar(bends[0]), polar(bends[1])
    return Command(phi_proximal=phi_p, theta_proximal=theta_p, phi_distal=phi_d, theta_distal=theta_d, push=push)


def bends_of(step: Step) -> FloatArray:
    """Bend vectors that were ordered last, (2, 2) rad; zero at the start."""
    return np.zeros((2, 2)) if step.command is None else bend_vectors(step.command)


def advanced(base: FloatArray, robot: Robot, first: FloatArray, last: FloatArray, push: float) -> FloatArray:
    """The base after a push during which the proximal bend changes from `first` to `last`, (4, 4)."""
    count = max(int(np.ceil(abs(push) / 2.0)), 1)
    for k in range(count):
        phi, theta = polar(first[0] + (k + 0.5) / count * (last[0] - first[0]))
        base = base @ section_transform(push / count, phi * push / count / robot.proximal_length, theta)
    return base


def predicted_tip(base: FloatArray, robot: Robot, bends: FloatArray) -> FloatArray:
    """The tip's pose for a base and bends, (4, 4)."""
    pose = base
    for length, bend in zip((robot.proximal_length, robot.distal_length), bends, strict=True):
        pose = pose @ section_transform(length, *polar(bend))
    return pose


def aimed(base: FloatArray, robot: Robot, middle: FloatArray, end: FloatArray) -> FloatArray:
    """Bends that point the proximal section's chord at `middle` and the distal one's at `end`, (2, 2) rad."""
    bends, pose = np.zeros((2, 2)), base
    for k, (length, goal) in enumerate(((robot.proximal_length, middle), (robot.distal_length, end))):
        phi, theta = bend_towards(pose[:3, :3].T @ (goal - pose[:3, 3]), robot.bend_max)
        bends[k] = phi * np.cos(theta), phi * np.sin(theta)
        pose = pose @ section_transform(length, phi, theta)
    return bends


def fitted(
    base: FloatArray, robot: Robot, first: FloatArray, line: FloatArray, room: FloatArray, direction: FloatArray
) -> FloatArray:
    """Bends whose arcs lie best on a line: least squares of the distances in units of the room beside the line.

    Parameters
    ----------
    base : (4, 4) float array
    robot : Robot
    first : (2, 2) float array, rad
        Bends from which to begin.
    line : (m, 3) float array, mm
        Where the places of `active_points` should lie.
    room : (m,) float array, mm
    direction : (3,) float array
        Unit vector in which the tip should look.

    Returns
    -------
    (2, 2) float array, rad
    """

    def residuals(x: FloatArray) -> FloatArray:
        points, tip = active_points(robot, base, x.reshape(2, 2))
        return np.concatenate([((points - line) / room[:, None]).ravel(), LOOK * (tip[:3, 2] - direction)])

    x = first.ravel().copy()
    here = residuals(x)
    for _ in range(FIT_ROUNDS):
        slopes = np.column_stack([(residuals(x + 1e-4 * unit) - here) / 1e-4 for unit in np.eye(4)])
        step = np.linalg.solve(slopes.T @ slopes + DAMPING * np.eye(4), -slopes.T @ here)
        trial = limited((x + step).reshape(2, 2), robot.bend_max).ravel()
        found = residuals(trial)
        if found @ found >= here @ here:
            break
        done = float(np.abs(trial - x).max()) < 1e-3
        x, here = trial, found
        if done:
            break
    return x.reshape(2, 2)


def limited(bends: FloatArray, bend_max: float) -> FloatArray:
    """Bend vectors no longer than the largest bend."""
    size = np.linalg.norm(bends, axis=1, keepdims=True)
    return np.asarray(bends * np.minimum(1.0, bend_max / np.maximum(size, 1e-12)))
