"""Sweeps: many variants of a scene by several processes, kept on disk case by case, as one table and picture."""
