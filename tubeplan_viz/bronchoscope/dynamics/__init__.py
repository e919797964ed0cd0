"""The robot's dynamics in MuJoCo, on the patient's own airway."""

from tubeplan_viz.bronchoscope.dynamics.settings import DynamicsSettings
from tubeplan_viz.bronchoscope.dynamics.simulator import Moment, Simulator, SimulatorState

__all__ = ["DynamicsSettings", "Moment", "Simulator", "SimulatorState"]
