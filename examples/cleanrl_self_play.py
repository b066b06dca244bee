"""Train self-play PPO in one file, in the style of CleanRL, and race it by a protocol.

    python examples/cleanrl_self_play.py
    pcs-racing tournament --protocol bench-v4 --agents examples.cleanrl_self_play:make_agent

One network moves both cars of every game and learns from both sides, on the training tracks of the
protocol. Run the second command in the folder that contains ``examples``. Tested with torch
2.13.0.
"""

import argparse
from pathlib import Path

from pcs_racing.envs import SelfPlayVectorEnv

try:
    import torch
    from safetensors.torch import load_model, save_model
    from torch import nn
    from torch.distributions import Categorical
except ModuleNotFoundError as error:
    raise SystemExit(f'this example needs {error.name}: pip install ".[learning]"') from None

OUT = Path("out/cleanrl")
ENVS, ROLLOUT, EPOCHS, MINIBATCH = 64, 16, 8, 256
GAE_LAMBDA, CLIP, ENTROPY, LEARNING_RATE = 0.95, 0.2, 0.02, 1e-3
# A game has four moves and one reward at its end: no discount.


def network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size_in, size_out, scale in ((inputs, 64, 2**0.5), (64, 64, 2**0.5), (64, outputs, gain)):
        layer = nn.Linear(size_in, size_out)
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def make_agent(spec):
    """Return the trained agent; the tournament calls this function."""
    from pcs_racing_agents.agents import TorchPolicy

    actor = network(len(spec.observation_elements), spec.offered, 0.01)
    load_model(actor, OUT / "actor.safetensors")
    return TorchPolicy(actor, "cleanrl-self-play")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=60_000, help="training moves of both cars together"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers")
    given = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(given.seed)
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    # of the protocol
    game = {"track": ["Brackwater", "Pipkin"], "archive": "contest", "rules": "contest"}
    envs = SelfPlayVectorEnv(ENVS, autoreset_mode="SAME_STEP", **game)
    size, moves = envs.single_observation_space.shape[0], int(envs.single_action_space.n)
    actor, critic = network(size, moves, 0.01), network(size, 1, 1.0)
    optimiser = torch.optim.Adam(
        [*actor.parameters(), *critic.parameters()], lr=LEARNING_RATE, eps=1e-5
    )
    observations = torch.as_tensor(envs.reset(seed=given.seed)[0])
    updates = max(1, given.steps // (ENVS * ROLLOUT))
    for update in range(updates):
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - update / updates)
        rows = (ROLLOUT, ENVS)
        states, actions = torch.zeros((*rows, size)), torch.zeros(rows, dtype=torch.long)
        log_probs, rewards, dones = torch.zeros(rows), torch.zeros(rows), torch.zeros(rows)
        values = torch.zeros((ROLLOUT + 1, ENVS))
        for t in range(ROLLOUT):
            states[t] = observations
            with torch.no_grad():
                choice = Categorical(logits=actor(observations))
                actions[t], values[t] = choice.sample(), critic(observations).squeeze(-1)
                log_probs[t] = choice.log_prob(actions[t])
            following, reward, terminated, _, _ = envs.step(actions[t].numpy())
            observations = torch.as_tensor(following)
            rewards[t], dones[t] = (
                torch.as_tensor(x, dtype=torch.float32) for x in (reward, terminated)
            )
        with torch.no_grad():
            values[-1] = critic(observations).squeeze(-1)
        advantages, last = torch.zeros(rows), torch.zeros(ENVS)
        for t in reversed(range(ROLLOUT)):
            going = 1.0 - dones[t]
            last = rewards[t] + going * values[t + 1] - values[t] + GAE_LAMBDA * going * last
            advantages[t] = last
        returns = advantages + values[:-1]
        flat = [
            x.reshape(ENVS * ROLLOUT, -1).squeeze(-1)
            for x in (states, actions, log_probs, advantages, returns)
        ]
        for _ in range(EPOCHS):
            for part in torch.randperm(ENVS * ROLLOUT).split(MINIBATCH):
                s, a, old, advantage, target = (x[part] for x in flat)
                choice = Categorical(logits=actor(s))
                ratio = (choice.log_prob(a) - old).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                gain = torch.min(
                    ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage
                ).mean()
                value_loss = (critic(s).squeeze(-1) - target).pow(2).mean()
                loss = -gain + 0.5 * value_loss - ENTROPY * choice.entropy().mean()
                optimiser.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_([*actor.parameters(), *critic.parameters()], 0.5)
                optimiser.step()
        if (update + 1) % max(1, updates // 10) == 0:
            # The mean return is 0: the game is zero-sum.
            with torch.no_grad():
                entropy = Categorical(logits=actor(flat[0])).entropy().mean()
            print(f"{(update + 1) * ENVS * ROLLOUT:8d} moves: entropy {entropy:.3f}", flush=True)
    save_model(actor, str(OUT / "actor.safetensors"))
    print(OUT / "actor.safetensors")


if __name__ == "__main__":
    main()
