"""CT series made by calculation, with known truth."""

from segmentation.synthetic.airway import Airway, AirwayBranch, weibel_airway
from segmentation.synthetic.collecting_system import Branch, CollectingSystem, collecting_system
from segmentation.synthetic.scanner import ScannerSettings, scan
from segmentation.synthetic.shapes import round_cone_distance
from segmentation.synthetic.urography import Urography, UrographySettings, urography, write_demo_series
from segmentation.synthetic.urography_straight import (
    PLAIN,
    SECOND,
    StraightPlan,
    StraightSystem,
    straight_system,
    straight_urography,
)

__all__ = [
    "PLAIN",
    "SECOND",
    "Airway",
    "AirwayBranch",
    "Branch",
    "CollectingSystem",
    "ScannerSettings",
    "StraightPlan",
    "StraightSystem",
    "Urography",
    "UrographySettings",
    "collecting_system",
    "round_cone_distance",
    "scan",
    "straight_system",
    "straight_urography",
    "urography",
    "weibel_airway",
    "write_demo_series",
]
