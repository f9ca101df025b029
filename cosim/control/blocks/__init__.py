"""Discrete-time blocks from CasADi equations: slaves in Python, and C code for FMUs."""
