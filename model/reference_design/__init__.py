"""Joint references designed for the flexible robot: inverse dynamics, robust correction, optimal control."""
