"""Slaves, FMUs as slaves, the master in Python and in C, and results; independent of scenes and robots."""
