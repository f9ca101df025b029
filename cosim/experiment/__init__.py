"""From a scene to its run: the planned motion, the FMU, the wired system, and variants of it."""
