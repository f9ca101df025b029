"""The scene file: its sections, their checks and the shipped scenes; imports no CasADi."""
