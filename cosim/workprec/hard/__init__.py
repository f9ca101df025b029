"""Cases that a simulation of this robot is most likely to get wrong, run for real: what makes each hard, and what happened."""
