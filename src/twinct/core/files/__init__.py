"""Files of every kind: read once, and written completely or not at all."""
