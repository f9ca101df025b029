"""Work and precision, processor time over error: integrators, formulations, effects, communication steps, and other tools."""
