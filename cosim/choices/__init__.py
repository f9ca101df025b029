"""Choice of elastic effects and of input shapers, verified by co-simulation."""
