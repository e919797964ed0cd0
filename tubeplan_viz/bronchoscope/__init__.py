"""A bronchoscope robot with two bending sections: kinematics, planning along the airway tree, and dynamics."""
