"""The live page, which shows a run or a plan in a browser."""
