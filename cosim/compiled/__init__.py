"""The master's loop in C: the same calls in the same order as in Python, without Python between them."""
