"""The five-bar by finite elements: a second formulation, to check the model of shapes against.

Nothing of the model of shapes is used here: co-rotational beam elements between nodes in the fixed frame, hinges as
shared nodes, and an integrator of its own. It converges with the number of elements, and it is slow.
"""
