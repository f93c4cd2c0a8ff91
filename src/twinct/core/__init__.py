"""Foundations of every package: errors, files, draws, threads, memory, progress and extensions."""
