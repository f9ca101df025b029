"""Frequency responses as they were measured: estimated from logs, read from files, and their modes."""
