"""The Gymnasium environments: the official checker, seeds, speed, a policy that gets there."""

from __future__ import annotations

import time
import warnings
from typing import Any

import gymnasium
import mcdpr
import mcdpr.gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env


@pytest.mark.parametrize("action", ["velocity", "tensions"])
@pytest.mark.parametrize("robot", ["paper-optimistic", "lab-direct", "eight-cable"])
def test_the_checker_has_no_complaint(robot: str, action: Any) -> None:
    env = gymnasium.make("mcdpr/Reach-v0", robot=robot, action=action)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # States have no bounds that hold for every robot: the checker says so of infinite ones.
        warnings.filterwarnings("ignore", message=".*(minimum|maximum) value .*infinity.*")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        check_env(env.unwrapped, skip_render_check=True)


def episode(seed: int, steps: int = 60) -> np.ndarray:
    env = mcdpr.gym.Reach()
    dice = np.random.default_rng(3)
    rows = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        rows.append(env.step(dice.uniform(-0.02, 0.02, 3).astype(np.float32))[0])
    return np.array(rows)


def test_the_same_seed_is_the_same_episode() -> None:
    assert np.array_equal(episode(7), episode(7))
    assert not np.array_equal(episode(7), episode(8))


def test_the_tool_follows_its_velocity_to_the_target() -> None:
    env = mcdpr.gym.Reach()
    away = []
    for seed in range(5):
        seen, _ = env.reset(seed=seed)
        for _ in range(300):
            left = seen[-3:]
            speed = 2.0 * left
            speed *= min(1.0, 0.03 / max(1e-9, float(np.linalg.norm(speed))))
            seen, reward, lost, _, info = env.step(speed)
            assert not lost
        away.append(np.linalg.norm(seen[-3:]))
        assert info["at_target"] and reward > 0.9
    assert max(away) < mcdpr.gym.AT_TARGET_M


def test_tensions_hold_the_platform_and_none_drop_it() -> None:
    robot = mcdpr.Robot.load("lab-direct")
    env = mcdpr.gym.Reach(robot, "tensions", "exact")
    seen, _ = env.reset(seed=1)
    n = robot.cable_count
    held = seen[12 : 12 + n].copy()
    for _ in range(25):
        seen, _, lost, _, _ = env.step(held)
        assert not lost
    assert np.linalg.norm(seen[6:9]) < 0.2
    for _ in range(400):
        _, reward, lost, _, _ = env.step(np.zeros(n, dtype=np.float32))
        if lost:
            break
    assert lost and reward == -10.0


def test_the_vector_is_its_machines() -> None:
    many = gymnasium.make_vec("mcdpr/Reach-v0", num_envs=3, max_episode_steps=20)
    one = mcdpr.gym.Reach()
    seen, info = many.reset(seed=11)
    alone, _ = one.reset(seed=12)
    assert seen.shape == (3, 23) and info["target_m"].shape == (3, 3)
    assert np.array_equal(seen[1], alone)
    dice = np.random.default_rng(1)
    for step in range(25):
        actions = dice.uniform(-0.01, 0.01, (3, 3)).astype(np.float32)
        seen, rewards, lost, cut, _ = many.step(actions)
        assert rewards.shape == lost.shape == (3,) and not lost.any()
        assert cut.all() == (step == 19)
        if step < 20:
            alone, reward, *_ = one.step(actions[1])
            assert np.array_equal(seen[1], alone) and reward == rewards[1]


def test_bad_actions_are_refused() -> None:
    env = mcdpr.gym.Reach()
    env.reset(seed=1)
    with pytest.raises(mcdpr.InputError, match=r"shape \(2,\)"):
        env.step(np.zeros(2, dtype=np.float32))
    with pytest.raises(mcdpr.InputError, match=r"action\[1\] is nan"):
        env.step(np.array([0.0, np.nan, 0.0], dtype=np.float32))
    with pytest.raises(mcdpr.InputError, match="action"):
        mcdpr.gym.Reach(action="odd")  # type: ignore[arg-type]
    with pytest.raises(mcdpr.InputError, match="reach_m"):
        mcdpr.gym.Reach(reach_m=-1.0)


@pytest.mark.parametrize("action", ["velocity", "tensions"])
def test_steps_take_a_hundredth_of_their_time(action: Any) -> None:
    env = mcdpr.gym.Reach(action=action)
    best = 0.0
    for seed in range(4):
        seen, _ = env.reset(seed=seed)
        held = np.zeros(3, dtype=np.float32)
        if action == "tensions":
            held = seen[12:16].copy()
        began = time.process_time()
        for _ in range(250):
            env.step(held)
        best = max(best, 250 * mcdpr.gym.STEP_S / (time.process_time() - began))
    print(f"{action}: {best:.0f} times real time")
    # The figure is 100; a machine that is busy or slow gets half.
    assert best > 50.0
