"""Imperfections of sensors, actuators and their wires as discrete-time blocks to put between plant and controller.

Each function returns a `SymbolicBlock` for a `BlockSlave` or for export.
"""
