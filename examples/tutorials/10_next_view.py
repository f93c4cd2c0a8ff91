"""
A policy that chooses the next view
===================================

A scan need not be planned before it begins. Here a policy looks at the volume so far, and chooses
the next direction of the source; the arms move there, or refuse. You will compare three policies in
an environment of `Gymnasium <https://gymnasium.farama.org>`_, the interface that libraries of
reinforcement learning expect.
"""

# %%
# The environment
# ---------------
#
# Both arms of the demo's room hold source and panel. An action is one of the directions within
# their reach. The reward is the fall of the volume's error, less a price for each second of motion.

import matplotlib.pyplot as plt
import numpy as np

from twinct import NextViewEnv, load_scenario
from twinct.recon import Projector, sart

VIEWS = 10
env = NextViewEnv(
    load_scenario("demo", {"trajectory.views": 12}),
    views=VIEWS,
    directions=120,
    voxels=32,
    prices={"second": 1e-4},
)
print(env.action_space, env.observation_space)

# %%
# Three policies
# --------------
#
# The first draws a direction. The second takes the one that is farthest from all before, seen from
# both ends, since opposite rays are alike.


def at_random(env, rng, taken):
    return int(rng.choice(np.setdiff1d(np.arange(len(env.directions)), taken)))


def far_from_all(env, rng, taken):
    if not taken:
        return at_random(env, rng, taken)
    alike = np.abs(env.directions @ env.directions[taken].T).max(axis=1)
    return int(alike.argmin())


# %%
# The third asks what the views so far leave open. Two volumes are made, of half of the views each.
# Their difference is what neither half is sure of. Some of it all views together do see; the rest,
# which no view has seen yet, is what a further view can tell. So the next view is the one that sees
# most of this rest.


def volume_of(A, p):
    return sart(A, p, iterations=5, relaxation=0.3).array


def what_is_open(env, rng, taken):
    if len(taken) < 4:
        return far_from_all(env, rng, taken)
    p, grid = env.scan.line_integrals(), env.volume.grid
    A = Projector(env.scan.geometry("believed"), grid)
    difference = volume_of(A[::2], p[::2]) - volume_of(A[1::2], p[1::2])
    rest = difference - volume_of(A, A(difference))
    seen = np.square(Projector(env.views_of_directions, grid)(rest)).sum(axis=(1, 2))
    seen[taken] = 0
    return int(seen.argmax())


# %%
# Episodes
# --------
#
# A seed draws the noise of the images, and here the first view.


def errors_of(policy, seed):
    rng = np.random.default_rng(seed)
    _, info = env.reset(seed=seed)
    errors, seconds, over, lost, taken = [info["rmse_rel"]], 0.0, False, False, []
    while not (over or lost):
        action = policy(env, rng, taken)
        _, _, over, lost, info = env.step(action)
        taken.append(action)
        if "refused" not in info:
            errors.append(info["rmse_rel"])
            seconds += info["seconds"]
    return errors, seconds


policies = {
    "at random": at_random,
    "far from all": far_from_all,
    "what is open": what_is_open,
}
figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for name, policy in policies.items():
    episodes = [errors_of(policy, seed) for seed in range(2)]
    shortest = min(len(errors) for errors, _ in episodes)
    errors = 100 * np.array([errors[:shortest] for errors, _ in episodes])
    (line,) = axis.plot(errors.mean(axis=0), label=name)
    axis.fill_between(
        range(shortest), errors.min(axis=0), errors.max(axis=0), color=line.get_color(), alpha=0.2
    )
    moving = np.mean([seconds for _, seconds in episodes])
    print(f"{name}: {errors[:, -1].mean():.1f} % after {shortest - 1} views, {moving:.0f} s")
axis.set_xlabel("views")
axis.set_ylabel("RMSE in % of bone")
axis.legend()
env.close()  # a process has one X-ray engine

# %%
# A skull has edges everywhere, so views that are far apart are hard to beat: a policy that asks the
# volume does no better here. Change the specimen, the price of a second or the figure, and see when
# it pays. ``env.scan`` is an ordinary scan: reconstruct it at full resolution, export it, or save
# it.
