"""Co-simulation: slaves, master, results, metrics, reports and the command line."""
