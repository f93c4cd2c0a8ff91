"""Foundations of every room: errors, files, draws, threads, memory, progress and extensions."""
