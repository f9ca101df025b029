"""The co-simulation master: wiring, order of calls, time grid, coupling algorithms and step control."""
