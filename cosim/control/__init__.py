"""Controllers, shapers and imperfections of the loop, each built from its section of the scene file."""
