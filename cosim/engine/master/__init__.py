"""The master: a system of slaves, its order of calls, its time grid, and steps that keep their error, in Python and in C."""
