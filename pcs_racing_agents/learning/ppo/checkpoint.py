"""Checkpoints: the state of a training between two updates, as plain arrays instead of a pickle."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from pcs_racing.base.errors import InputError
from pcs_racing_agents.jobs.chunks import Arrays
from pcs_racing_agents.learning.ppo.learner import Learner

PLAIN = "plain"


def store_learner(learner: Learner) -> Arrays:
    """Return everything that the rest of the training depends on, between two updates."""
    import torch

    model = learner.model
    keys, position, has_gauss, gauss = np.random.get_state()[1:]  # type: ignore[index]  # noqa: NPY002
    arrays: Arrays = {
        "steps": np.array(model.num_timesteps),
        "updates": np.array(model._n_updates),
        "observations": np.asarray(model._last_obs),
        "episode_starts": np.asarray(model._last_episode_starts),
        "random.torch": torch.get_rng_state().numpy().copy(),
        "random.numpy": np.asarray(keys),
        "random.numpy_rest": np.array([position, has_gauss, gauss], np.float64),
    }
    arrays |= {f"policy.{key}": tensor.numpy().copy() for key, tensor in model.policy.state_dict().items()}
    for i, state in model.policy.optimizer.state_dict()["state"].items():
        arrays |= {f"adam.{i}.{key}": np.asarray(tensor.numpy()).copy() for key, tensor in state.items()}
    envs: Any = model.env
    return arrays | {f"envs.{key}": array for key, array in pack(envs.get_state()).items()}


def restore_learner(learner: Learner, arrays: Arrays) -> None:
    """Restore the state that :func:`store_learner` returned, in a learner with equal settings."""
    import torch

    model = learner.model
    envs: Any = model.env
    envs.reset()
    envs.set_state(unpack(under(arrays, "envs"), envs.get_state()))
    try:
        model.policy.load_state_dict({key: torch.from_numpy(value) for key, value in under(arrays, "policy").items()})
    except RuntimeError as error:
        raise InputError(f"the state is one of another network: {error}") from None
    optimiser = model.policy.optimizer
    state: dict[int, dict[str, Any]] = {}
    for key, value in under(arrays, "adam").items():
        index, _, name = key.partition(".")
        state.setdefault(int(index), {})[name] = torch.from_numpy(value)
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
    model.num_timesteps = int(arrays["steps"])
    model._n_updates = int(arrays["updates"])
    model._last_obs = arrays["observations"]
    model._last_episode_starts = arrays["episode_starts"]
    # The generators last: the steps above may have drawn from them.
    position, has_gauss, gauss = arrays["random.numpy_rest"]
    np.random.set_state(("MT19937", arrays["random.numpy"], int(position), int(has_gauss), gauss))  # noqa: NPY002
    torch.set_rng_state(torch.from_numpy(arrays["random.torch"]))


def under(arrays: Arrays, prefix: str) -> Arrays:
    """Return the arrays whose names begin with a prefix and a point, without them."""
    return {key.removeprefix(f"{prefix}."): value for key, value in arrays.items() if key.startswith(f"{prefix}.")}


# Nested values


def pack(value: Any) -> Arrays:
    """Convert a nested value to arrays.

    Parameters
    ----------
    value : nested named tuples, tuples, lists and dicts
        Of arrays, and of numbers (of any size), texts and None.

    Returns
    -------
    dict of ndarray
        Every array under the path to it, and one of bytes, ``plain``, with everything else as JSON.
    """
    arrays: Arrays = {}
    plain: dict[str, Any] = {}
    for path, leaf in _leaves(value, ""):
        if isinstance(leaf, np.ndarray):
            arrays[path] = leaf
        else:
            plain[path] = leaf.item() if isinstance(leaf, np.generic) else leaf
    return {**arrays, PLAIN: np.frombuffer(json.dumps(plain, sort_keys=True).encode(), np.uint8)}


def unpack(arrays: Arrays, like: Any) -> Any:
    """Convert the arrays of :func:`pack` back to a nested value.

    Parameters
    ----------
    like
        A value of the same structure, with arrays of the same shapes and types.
    """
    try:
        plain = json.loads(arrays[PLAIN].tobytes())
    except (KeyError, ValueError):
        raise InputError("the state is not one of a learner's environments") from None
    values = {**plain, **{path: array for path, array in arrays.items() if path != PLAIN}}
    if set(values) != {path for path, _ in _leaves(like, "")}:
        key = sorted(set(values) ^ {path for path, _ in _leaves(like, "")})[0]
        raise InputError(f"the state is one of other environments: {key} is in one of the two only")
    return _filled(like, "", values)


def _children(value: Any) -> dict[str, Any] | None:
    if isinstance(value, dict):
        return {str(key): item for key, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return dict(value._asdict())
    if isinstance(value, tuple | list):
        return {str(i): item for i, item in enumerate(value)}
    return None


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    children = _children(value)
    if children is None:
        yield path, value
        return
    for key, item in children.items():
        yield from _leaves(item, f"{path}.{key}" if path else key)


def _filled(like: Any, path: str, values: dict[str, Any]) -> Any:
    children = _children(like)
    if children is None:
        leaf = values[path]
        fits = isinstance(leaf, np.ndarray) == isinstance(like, np.ndarray)
        if fits and isinstance(like, np.ndarray):
            fits = leaf.shape == like.shape and leaf.dtype == like.dtype
        if not fits:
            raise InputError(f"the state is one of other environments: {path} has another shape or type")
        return leaf
    filled = [_filled(item, f"{path}.{key}" if path else key, values) for key, item in children.items()]
    if isinstance(like, dict):
        return dict(zip(like, filled, strict=True))
    if isinstance(like, tuple) and hasattr(like, "_asdict"):
        return type(like)(*filled)
    return type(like)(filled)
