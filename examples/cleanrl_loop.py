"""Train steering and speed by PPO in one file, in the style of CleanRL.

    python examples/cleanrl_loop.py
    python examples/cleanrl_loop.py --steps 3000000 --opponent lattice:pace=0.3

The car trains alone (default) or against a planner. A line for every tenth of the training reports
progress and crashes; then the mean of the policy drives ten episodes. Tested with gymnasium 1.4.0
and torch 2.13.0.
"""

import argparse

import gymnasium as gym
import numpy as np

import pcs_racing

try:
    import torch
    from torch import nn
    from torch.distributions import Normal
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

gym.register_envs(pcs_racing)


class Agent(nn.Module):
    """Policy (mean and standard deviation of the action) and value function."""

    def __init__(self, observations: int, actions: int) -> None:
        super().__init__()
        self.mean = network(observations, actions, 0.01)
        self.value = network(observations, 1, 1.0)
        self.log_spread = nn.Parameter(torch.full((actions,), -0.5))

    def action(self, observations: torch.Tensor) -> Normal:
        """Return the distribution of the action."""
        return Normal(self.mean(observations), self.log_spread.exp())


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size_in, size_out, scale in ((inputs, 64, 2**0.5), (64, 64, 2**0.5), (64, outputs, gain)):
        layer = nn.Linear(size_in, size_out)
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def main() -> None:
    a = parse()
    torch.manual_seed(a.seed)
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    opponent = None if a.opponent == "none" else a.opponent
    given = {
        "track": a.track,
        "opponent": opponent,
        "normalize": True,
        "autoreset_mode": "SAME_STEP",
    }
    envs = gym.make_vec("pcs_racing/Drive-v1", num_envs=a.envs, **given)
    size, actions = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(size, actions)
    optimiser = torch.optim.Adam(agent.parameters(), lr=a.learning_rate, eps=1e-5)
    # Most elements vary in a small part of [-1, 1]: a running scale normalizes them.
    scale = RunningScale(size)
    observations = torch.as_tensor(envs.reset(seed=a.seed)[0])
    updates = max(1, a.steps // (a.envs * a.rollout))
    ended: list[tuple[float, bool]] = []  # progress and crash of the episodes since the last line
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = a.learning_rate * (1.0 - update / updates)
        rows = (a.rollout, a.envs)
        states, moves = torch.zeros((*rows, size)), torch.zeros((*rows, actions))
        log_probs, rewards, values = (
            torch.zeros(rows),
            torch.zeros(rows),
            torch.zeros((a.rollout + 1, a.envs)),
        )
        dones, beyond = torch.zeros(rows), torch.zeros(rows)
        for t in range(a.rollout):
            with torch.no_grad():
                states[t] = scale(observations, learn=True)
                action = agent.action(states[t])
                moves[t] = action.sample()
                log_probs[t] = action.log_prob(moves[t]).sum(-1)
                values[t] = agent.value(states[t]).squeeze(-1)
            following, reward, terminated, truncated, info = envs.step(moves[t].numpy())
            observations, rewards[t] = (
                torch.as_tensor(following),
                torch.as_tensor(reward, dtype=torch.float32),
            )
            done = terminated | truncated
            dones[t] = torch.as_tensor(done, dtype=torch.float32)
            for i in np.flatnonzero(done):
                ended.append((info["final_info"]["progress"][i], terminated[i]))
                if truncated[i]:  # end of time: add the value of the last state
                    with torch.no_grad():
                        beyond[t, i] = agent.value(scale(torch.as_tensor(info["final_obs"][i])))[0]
        with torch.no_grad():
            values[-1] = agent.value(scale(observations)).squeeze(-1)
        advantages, last = torch.zeros(rows), torch.zeros(a.envs)
        for t in reversed(range(a.rollout)):
            going = 1.0 - dones[t]
            error = rewards[t] + a.gamma * (going * values[t + 1] + beyond[t]) - values[t]
            last = error + a.gamma * a.gae_lambda * going * last
            advantages[t] = last
        returns = advantages + values[:-1]
        flat = [
            x.reshape(a.rollout * a.envs, -1).squeeze(-1)
            for x in (states, moves, log_probs, advantages, returns)
        ]
        for _ in range(a.epochs):
            for part in torch.randperm(a.rollout * a.envs).chunk(a.minibatches):
                s, m, old, advantage, target = (x[part] for x in flat)
                action = agent.action(s)
                ratio = (action.log_prob(m).sum(-1) - old).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                gain = torch.min(
                    ratio * advantage, ratio.clamp(1 - a.clip, 1 + a.clip) * advantage
                ).mean()
                value_loss = (agent.value(s).squeeze(-1) - target).pow(2).mean()
                loss = -gain + 0.5 * value_loss - a.entropy * action.entropy().sum(-1).mean()
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimiser.step()
        if (update + 1) % max(1, updates // 10) == 0 and ended:
            progress, crashes = np.mean(ended, axis=0)
            steps = (update + 1) * a.envs * a.rollout
            print(
                f"{steps:9d} steps: mean progress {progress:6.1f} m, crash rate {crashes:5.1%}",
                flush=True,
            )
            ended.clear()
    drive(agent, scale, a, opponent)


def drive(agent: Agent, scale: "RunningScale", a: argparse.Namespace, opponent: str | None) -> None:
    """Drive ten episodes with the mean of the policy."""
    env = gym.make("pcs_racing/Drive-v1", track=a.track, opponent=opponent, normalize=True)
    for episode in range(10):
        observation, _ = env.reset(seed=1_000_000 + episode)
        over = False
        while not over:
            with torch.no_grad():
                move = agent.mean(scale(torch.as_tensor(observation))).numpy()
            observation, _, terminated, truncated, info = env.step(np.clip(move, -1.0, 1.0))
            over = terminated or truncated
        crash = env.unwrapped.outcome()["crash"]
        print(
            f"episode {episode}: {info['progress']:6.1f} m in {info['time']:4.1f} s, crash: {crash}"
        )


class RunningScale:
    """Running mean and variance of observations (Chan et al. 1979)."""

    def __init__(self, size: int) -> None:
        self.mean, self.variance, self.count = torch.zeros(size), torch.ones(size), 1e-4

    def __call__(self, observations: torch.Tensor, learn: bool = False) -> torch.Tensor:
        """Normalize observations, after an update of the scale if ``learn``."""
        if learn:
            count, total = len(observations), self.count + len(observations)
            shift = observations.mean(0) - self.mean
            between = shift**2 * self.count * count / total
            self.variance = (
                self.variance * self.count + observations.var(0, correction=0) * count + between
            ) / total
            self.mean, self.count = self.mean + shift * count / total, total
        return ((observations - self.mean) / (self.variance + 1e-8).sqrt()).clamp(-10.0, 10.0)


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    option = parser.add_argument
    option("--steps", type=int, default=150_000, help="training steps of all races together")
    option("--track", default="Tarnfjord", help="name of a shipped track or a map folder")
    option("--opponent", default="none", help="none, or a policy such as lattice:pace=0.3")
    option("--envs", type=int, default=64, help="races at once")
    option("--rollout", type=int, default=64, help="steps of each race between two updates")
    option("--epochs", type=int, default=5, help="passes over a rollout")
    option("--minibatches", type=int, default=8, help="minibatches of a pass")
    option(
        "--learning-rate", type=float, default=1e-3, help="initial learning rate, which falls to 0"
    )
    option("--gamma", type=float, default=0.99, help="discount of a step of 0.1 s")
    option(
        "--gae-lambda", type=float, default=0.95, help="lambda of generalized advantage estimation"
    )
    option("--clip", type=float, default=0.2, help="clip range of the probability ratio")
    option("--entropy", type=float, default=0.0, help="weight of the entropy")
    option("--seed", type=int, default=0, help="seed of all random numbers")
    return parser.parse_args()


if __name__ == "__main__":
    main()
