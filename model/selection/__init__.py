"""Elastic response along a planned motion, linearised about the rigid motion, and cost of sets of effects."""
