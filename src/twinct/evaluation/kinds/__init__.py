"""Built-in kinds of figures, one per file."""
