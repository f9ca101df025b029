"""Other programs for the same robot, which accuracy and time are compared with."""
