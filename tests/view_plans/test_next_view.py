"""The environment of next views: Gymnasium's own checks, and the scan that it makes."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from twinct import simulate
from twinct.core.errors import InputError
from twinct.recon import Projector, sart
from twinct.scenario import load_scenario

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from twinct.view_plans.next_view import NextViewEnv, Prices  # noqa: E402

GANTRY = {
    "extends": "scenarios/circle_gantry.yaml",
    "xray": {"engine": "mesh"},
    "detector": {"columns": 40, "rows": 30, "pixel_pitch_mm": 8.0},
}
ARMS = {"xray.engine": "mesh", "trajectory.views": 4} | {
    f"detector.{key}": value for key, value in GANTRY["detector"].items()
}
SMALL: dict[str, Any] = {"views": 3, "directions": 20, "voxels": 16}


@pytest.fixture
def env():
    made = NextViewEnv(load_scenario(GANTRY), **SMALL)
    yield made
    made.close()


def episode(env, actions, seed=3) -> list[Any]:
    """Results of the reset and of the actions."""
    steps: list[Any] = [env.reset(seed=seed)]
    steps += [env.step(action) for action in actions]
    return steps


def test_gymnasium_accepts_it(env):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*infinity.*")
        check_env(env, skip_render_check=True)


def test_views_are_those_of_a_scan_along_the_same_path(env):
    actions = [4, 11, 7]
    episode(env, actions)
    scan = env.scan
    env.close()  # a process has one X-ray engine
    same = simulate(load_scenario(GANTRY), trajectory=env.views_of_directions[actions])
    np.testing.assert_array_equal(scan.transmission, same.transmission)
    np.testing.assert_array_equal(
        scan.geometry("executed").source, same.geometry("executed").source
    )


def test_observations_show_the_last_view_and_the_volume_of_all(env):
    steps = episode(env, [4, 11])
    observation, scan = steps[-1][0], env.scan
    np.testing.assert_array_equal(observation["projection"], scan.line_integrals()[1])
    A = Projector(scan.geometry("believed"), env.volume.grid)
    volume = sart(A, scan.line_integrals(), iterations=5, relaxation=0.3, nonnegative=True)
    np.testing.assert_array_equal(observation["volume"], volume.array)
    np.testing.assert_allclose(observation["direction"], env.directions[11], atol=1e-6)
    assert observation["left"] == pytest.approx(1 / 3)


def test_rewards_add_up_to_the_fall_of_the_figure_less_the_prices():
    prices = Prices(view=0.01, second=0.002)
    env = NextViewEnv(load_scenario(GANTRY), prices=prices, **SMALL)
    steps = episode(env, [1, 8, 15])
    first, last = steps[0][1]["rmse_rel"], steps[-1][-1]["rmse_rel"]
    paid = 3 * 0.01 + 0.002 * sum(info["seconds"] for *_, info in steps[1:])
    assert sum(reward for _, reward, *_ in steps[1:]) == pytest.approx(first - last - paid)
    assert [over for _, _, over, _, _ in steps[1:]] == [False, False, True]
    env.close()


def test_better_is_up_for_a_figure_that_should_rise():
    env = NextViewEnv(load_scenario(GANTRY), figure="psnr_db", **SMALL)
    _, (_, reward, *_, info) = episode(env, [1])
    assert reward > 0
    assert info["psnr_db"] > 0
    env.close()


def test_a_seed_draws_the_noise(env):
    noisy = {
        "source": {"photons_per_mm2_mas": 1e6},
        "detector": GANTRY["detector"] | {"noise": {"kind": "quantum"}},
    }
    env.close()
    env = NextViewEnv(load_scenario({**GANTRY, **noisy}), **SMALL)
    images = [episode(env, [2], seed)[-1][0]["projection"] for seed in (1, 1, 2)]
    env.close()
    np.testing.assert_array_equal(images[0], images[1])
    assert np.abs(images[0] - images[2]).max() > 0.01


def test_arms_refuse_what_they_cannot_hold_and_stay():
    env = NextViewEnv("scenarios/demo.yaml", **SMALL | {"directions": None}, **ARMS)
    env.reset(seed=1)
    *_, taken = env.step(np.array([0.16, -0.82, 0.55], np.float32))
    assert taken["seconds"] > 0
    _, reward, _, _, info = env.step(np.array([-0.9, -0.44, 0.03], np.float32))
    assert "out of reach" in info["refused"]
    assert (reward, len(env.scan)) == (0.0, 1)
    again = env.step(np.array([0.16, -0.82, 0.55], np.float32))[-1]
    assert again["seconds"] < taken["seconds"] + 1
    *_, info = env.step(np.zeros(3, np.float32))
    assert "has no direction" in info["refused"]
    env.close()


def test_a_scenario_is_drawn_for_each_episode():
    def draw(rng):
        x = rng.uniform(-20, 20)
        return load_scenario({**GANTRY, "specimen": {"position_mm": [x, 0, 0]}})

    env = NextViewEnv(draw, **SMALL)
    images = [episode(env, [2], seed)[-1][0]["projection"] for seed in (1, 2)]
    env.close()
    assert np.abs(images[0] - images[1]).max() > 0.1


def test_dose_of_a_view_is_that_of_the_task():
    patient = {
        "extends": "scenarios/head_screws.yaml",
        "cell": {"kind": "gantry"},
        "detector": GANTRY["detector"],
        "task": {
            "position_mm": [36, -8, 0],
            "radius_mm": 15,
            "views": 9,
            "completeness": {},
            "dose": {"part": "right lens", "photons": 1000, "views": 20, "voxel_mm": 4.0},
        },
    }
    env = NextViewEnv(load_scenario(patient), prices={"dose": 1.0}, **SMALL)
    steps = episode(env, [0, 10])
    doses = [info["dose"] for *_, info in steps[1:]]
    assert min(doses) >= 0
    assert max(doses) > 0
    assert doses[0] != doses[1]
    env.close()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"views": 0}, "views is 0; it must be a whole number of at least 1"),
        ({"voxels": 2.5}, "voxels is 2.5"),
        ({"figure": "rmse"}, "figure is 'rmse'; it must be one of rmse_near_rel"),
        ({"prices": {"second": -1}}, "prices.second is -1; it must be 0 or more"),
    ],
)
def test_wrong_arguments_are_named(keys, message):
    with pytest.raises(InputError, match=message):
        NextViewEnv(load_scenario(GANTRY), **keys)


def test_a_wrong_action_is_named(env):
    with pytest.raises(InputError, match="the episode has not begun: call reset first"):
        env.step(1)
    env.reset(seed=1)
    with pytest.raises(InputError, match=r"action 20: it must be in Discrete\(20\)"):
        env.step(20)


def test_errors_that_would_not_act_are_refused():
    with pytest.raises(InputError, match=r"uncertainty\.views: these errors belong to the views"):
        NextViewEnv(load_scenario(GANTRY, {"uncertainty.views.source_mm": 0.2}), **SMALL)
