"""Motions planned for a scene: the fastest one, or the one of least effort, within limits that hold over bands of payload,
stiffness and damping."""
