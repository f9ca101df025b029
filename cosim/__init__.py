"""Co-simulation: from a scene or a system of FMUs to runs, metrics, reports and choices, and the command line."""
