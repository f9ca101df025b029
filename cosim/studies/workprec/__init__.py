"""What accuracy costs in time: integrators, formulations, effects, communication steps, and other tools."""
