"""How far a sampled loop is from instability."""
