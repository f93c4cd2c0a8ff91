"""An algorithm, a family of trajectories and a kind of figures from outside the package."""
