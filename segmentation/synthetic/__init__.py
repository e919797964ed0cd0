"""CT series made by calculation, with known truth."""
