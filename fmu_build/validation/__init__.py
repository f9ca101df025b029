"""Judges anybody's FMU: archive, description, binaries and behaviour."""
