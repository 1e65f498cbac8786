"""Annotated matches: one schema, readers, cleaning, splits, download."""
