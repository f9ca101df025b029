"""Discrete-time blocks as slaves."""
