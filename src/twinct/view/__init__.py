"""The live page: a run, or a plan, to look into with a browser."""
