"""Slaves, FMUs as slaves, the master in Python and in C, and results; knows no scene and no robot."""
