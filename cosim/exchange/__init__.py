"""Systems for other tools: controllers, shapers and trajectories as FMUs, and whole loops as SSP files."""
