"""Exchange with other tools: controllers, shapers and trajectories as FMUs, and whole systems as SSP files."""
