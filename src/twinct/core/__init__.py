"""Foundations of all packages: errors, files, draws, threads, memory, progress and extensions."""
