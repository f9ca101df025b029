"""How a robot responds elastically along a planned motion, linearised about the rigid one, and what sets of effects cost."""
