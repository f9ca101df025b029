"""Runs scenes: planned motion, FMU, connected system, simulation, and variants of a scene."""
