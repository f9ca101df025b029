"""Controllers, filters, shapers and imperfections as sampled slaves, each built from its section of a scene."""
