"""Error terms of arms and poses, one file for each kind."""
