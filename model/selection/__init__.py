"""Elastic response along a planned motion, linearised about the rigid motion."""
