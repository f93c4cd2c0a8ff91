"""An algorithm, a family of trajectories and an objective from outside the package."""
