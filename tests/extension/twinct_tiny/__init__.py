"""An algorithm, a family of trajectories and an export format from outside the package."""
