"""How the robot's dynamics are simulated: material, motors, contact with the wall, and time steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

from segmentation.errors import CaseError


@dataclass(frozen=True, kw_only=True)
class DynamicsSettings:
    """Parameters of the simulation; the text uses "a set of virtual parameters" and names none of them.

    Attributes
    ----------
    time_step : float
        s.
    gravity : (3,) tuple of float
        m/s^2 in the lumen's frame; by default along +y, the back of a patient who lies on it (LPS).
    density : float
        g/cm^3 of the whole robot with its open working channel.
    stiffness : float
        Flexural rigidity EI of the passive section, N mm^2; a rod of 3.5 mm with E = 5.4 MPa, a soft elastomer, has 40.
    active_stiffness : float
        EI that the tendons give an active section about its commanded shape, N mm^2.
    relaxation : float
        Damping of every hinge over its stiffness, s.
    integral_time, integral_share : float
        The hinge motors' integral action: its time constant, s, and the share of the largest bend's moment that it may
        add. It takes up gravity; a larger share would wind up against the wall.
    push_stiffness : float
        Of the pusher's position control, N/mm.
    push_force : float
        Largest force of the pusher, N.
    bend_speed : float
        Largest change of a section's bend, rad/s.
    halt_depth : float
        A motion halts before any part of the robot is this deep in the wall, mm.
    friction : float
        Coefficient of sliding friction between robot and moist wall.
    skin : float
        The robot touches where its surface is this near to the wall, mm: more than the deepest usual
        penetration of the soft contact, so that a robot at rest on the wall does not cut it.
    rim_skin : float
        The same for the rim of the front disc, whose sharp edge reaches further than its rounding when it stands askew, mm.
    contact_time : float
        Time constant of the contact, s.
    fine_link, fine_length : float
        Length of the passive section's links behind the active ones, mm, and over which length.
    coarse_link : float
        Length of the links behind them, mm.
    settle_speed : float
        The robot rests when none of its places moves faster, mm/s.
    settle_time : float
        After which a step ends in any case, s.
    """

    time_step: float = 0.002
    gravity: tuple[float, float, float] = (0.0, 9.81, 0.0)
    density: float = 1.2
    stiffness: float = 40.0
    active_stiffness: float = 150.0
    relaxation: float = 0.02
    integral_time: float = 0.5
    integral_share: float = 0.1
    push_stiffness: float = 10.0
    push_force: float = 5.0
    bend_speed: float = math.pi / 2
    halt_depth: float = 0.15
    friction: float = 0.1
    skin: float = 0.05
    rim_skin: float = 0.15
    contact_time: float = 0.004
    fine_link: float = 3.0
    fine_length: float = 60.0
    coarse_link: float = 9.0
    settle_speed: float = 1.0
    settle_time: float = 0.3

    def __post_init__(self) -> None:
        for key in (
            "time_step",
            "density",
            "stiffness",
            "active_stiffness",
            "relaxation",
            "integral_time",
            "push_stiffness",
            "push_force",
            "bend_speed",
            "halt_depth",
            "contact_time",
            "fine_link",
            "coarse_link",
            "settle_speed",
        ):
            if not getattr(self, key) > 0.0:
                raise CaseError(f"dynamics: {key} is {getattr(self, key):g}, expected more than 0")
        for key in ("integral_share", "friction", "skin", "rim_skin", "fine_length", "settle_time"):
            if not getattr(self, key) >= 0.0:
                raise CaseError(f"dynamics: {key} is {getattr(self, key):g}, expected 0 or more")
