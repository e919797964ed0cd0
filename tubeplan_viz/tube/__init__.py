"""Curvature- and clearance-constrained paths inside a curved tube (Dai et al. 2024)."""
