"""Controllers, filters, shapers and imperfections as slaves that sample; knows no scene file."""
