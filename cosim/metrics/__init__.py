"""Metrics of a run, taken from the continuous solution between communication points, each with its error."""
