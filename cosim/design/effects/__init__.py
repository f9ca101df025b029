"""Chooses the cheapest set of effects that keeps the metrics within a tolerance, verified by runs."""
