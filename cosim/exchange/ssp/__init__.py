"""System Structure and Parameterization (SSP) files: reading, simulating and writing."""
