"""Pick-and-place trajectories: blends, motion profiles, paths and joint trajectories."""
