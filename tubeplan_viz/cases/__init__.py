"""Cases: what the command line and case files say, checked, with every default resolved; one module a planner."""
