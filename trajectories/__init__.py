"""Planned motion: paths, blends, motion profiles, trajectories, and input shapers. Depends on numpy and scipy only."""
