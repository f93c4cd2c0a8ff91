"""Robots: the cell, its motion, what the arms reach, and the gantry that stands in for them."""
