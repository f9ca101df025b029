"""Work and precision: what accuracy costs in time, by integrator, communication step, coupling, effects and tool."""
