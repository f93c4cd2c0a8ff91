"""An algorithm and a family of trajectories from outside the package."""
