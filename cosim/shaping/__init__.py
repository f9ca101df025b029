"""Input shapers for a scene: designed, tried, compared and recommended."""
