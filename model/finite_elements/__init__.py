"""The five-bar by finite elements: an independent formulation that checks the model with mode shapes.

It shares no equations with the model of mode shapes: co-rotational beam elements between nodes in the fixed frame,
hinges as shared node positions, and its own integrator. It converges with the number of elements, but is slow.
"""
