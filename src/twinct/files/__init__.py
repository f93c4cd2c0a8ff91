"""Files of every kind: read once, and written whole or not at all."""
