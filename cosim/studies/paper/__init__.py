"""Reproduction of the paper's experiment: printed and computed tables and figures side by side."""
