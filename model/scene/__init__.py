"""What a user writes: the scene file, its sections and checks, and the scenes that ship; needs no CasADi."""
