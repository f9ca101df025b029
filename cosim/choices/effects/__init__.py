"""The fewest effects that keep the metrics within a tolerance, verified by runs."""
