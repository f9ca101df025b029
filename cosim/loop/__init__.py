"""What a scene puts between its motion and its robot: from sections and objects to wired slaves."""
