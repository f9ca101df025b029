"""Elastodynamic model of the flexible five-bar robot: scene, effects, equations of motion, statics and modes."""
