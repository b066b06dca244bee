"""Steer a car against a planner, with the keyboard; needs ``pip install ".[window]"``.

    python examples/play_a_race.py
    python examples/play_a_race.py --opponent lattice:pace=0.4 --track Pipkin --rules contest

The arrow keys steer, accelerate and brake; Escape ends the program.
"""

import argparse

import gymnasium as gym
import numpy as np

try:
    import pygame
except ModuleNotFoundError:
    raise SystemExit('this example needs pygame: pip install ".[window]"') from None

TIME_STEP = 0.04  # s, the time between two frames of the window
STEERING = 0.15  # change of the steering action per step, while a key is pressed
SPEED = (0.03, 0.1)  # change of the speed action per step: faster, slower


def next_action(action: np.ndarray, pressed: set[int]) -> np.ndarray:
    """Return the action after a step with some pressed keys; without keys the wheel turns back."""
    turn = (pygame.K_LEFT in pressed) - (pygame.K_RIGHT in pressed)
    faster, slower = pygame.K_UP in pressed, pygame.K_DOWN in pressed
    steering = action[0] + np.clip(turn - action[0], -STEERING, STEERING)
    speed = action[1] + faster * SPEED[0] - slower * SPEED[1]
    return np.clip([steering, speed], -1.0, 1.0).astype(np.float32)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--track", default="Tarnfjord", help="name of a shipped track or a map folder"
    )
    parser.add_argument("--opponent", default="lattice:pace=0.3", help="planner in the other car")
    parser.add_argument("--rules", default="paper", help="rules: a name or a YAML file")
    parser.add_argument("--races", type=int, default=3, help="number of races")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first race")
    arguments = parser.parse_args()

    env = gym.make(
        "pcs_racing:pcs_racing/Drive-v1",
        track=arguments.track,
        opponent=arguments.opponent,
        rules=arguments.rules,
        time_step=TIME_STEP,
        render_mode="human",
        view="car_0",
    )
    keys = (pygame.K_LEFT, pygame.K_RIGHT, pygame.K_UP, pygame.K_DOWN)
    for race in range(arguments.races):
        _, info = env.reset(seed=arguments.seed + race)
        action, over = np.array([0.0, -1.0], np.float32), False
        while not over:
            pressed = pygame.key.get_pressed()
            if pressed[pygame.K_ESCAPE]:
                return
            action = next_action(action, {key for key in keys if pressed[key]})
            _, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        print(f"race {race}: {env.unwrapped.outcome()['result']}, lead {info['lead']:+.1f} m")
    env.close()


if __name__ == "__main__":
    main()
