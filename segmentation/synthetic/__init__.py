"""CT series made by calculation, with known truth."""

from segmentation.synthetic.urography import Urography, UrographySettings, urography, write_demo_series

__all__ = ["Urography", "UrographySettings", "urography", "write_demo_series"]
