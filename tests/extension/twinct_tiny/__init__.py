"""An algorithm, a family of trajectories and an X-ray engine from outside the package."""
