"""Checks FMUs of any tool: archive, description, binaries and behaviour."""
