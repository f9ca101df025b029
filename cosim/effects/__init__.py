"""The choice of effects along a scene's motion, and runs that check it."""
