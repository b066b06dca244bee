import numpy as np
import pytest
from refusal import refused

from pcs_racing import RaceState, load_state, save_state
from pcs_racing.race.state import SUMS, concatenate, empty_state, take


@pytest.fixture
def state() -> RaceState:
    """Three races full of random numbers."""
    rng = np.random.default_rng(0)
    state = empty_state(3, 4)
    for array in state:
        array[...] = rng.integers(0, 2, array.shape) if array.dtype.kind in "iu" else rng.normal(size=array.shape)
    return state


def assert_same(found: RaceState, expected: RaceState) -> None:
    for name, array in expected._asdict().items():
        np.testing.assert_array_equal(getattr(found, name), array, err_msg=name, strict=True)


def test_copies_parts_and_files_are_the_same_state_and_an_empty_one_is_zero(state, tmp_path):
    before = state.copy()
    copy = state.copy()
    for array in copy:
        array += np.ones(1, array.dtype)
    assert_same(state, before)
    assert_same(concatenate([take(state, [0]), take(state, [1, 2])]), state)
    assert_same(take(take(state, [2, 0, 1]), [1, 2, 0]), state)
    twice = take(state, [1, 1])
    assert twice.races == 2
    twice.cars[0] += 1.0
    assert not np.array_equal(twice.cars[0], twice.cars[1])
    save_state(state, tmp_path / "race.npz")
    assert_same(load_state(tmp_path / "race.npz"), state)
    assert [path.name for path in tmp_path.iterdir()] == ["race.npz"]
    state = empty_state(3, 4)
    assert state.races == 3
    assert not state.crashed.any()
    for name in ("tick", "seed", "leader"):
        assert getattr(state, name).shape == (3,)
    for name in ("progress", "disturbance", "crash", "fault", "overtakes"):
        assert getattr(state, name).shape == (3, 2)
    sizes = {"cars": (7,), "frenet": (2,), "command": (2,), "path": (12, 4), "memory": (4,), "sums": (len(SUMS),)}
    for name, size in sizes.items():
        assert getattr(state, name).shape == (3, 2, *size)
    for name, array in state._asdict().items():
        assert (array == (-1 if name == "leader" else 0)).all(), name


def test_a_failed_save_leaves_nothing_behind(state, tmp_path, monkeypatch):
    def full_disk(file, **arrays):
        file.write(b"half of it")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez_compressed", full_disk)
    refused("no space left", save_state, state, tmp_path / "race.npz", error=OSError)
    assert not list(tmp_path.iterdir())


def test_missing_and_broken_files_and_arrays_that_do_not_fit_are_refused(state, tmp_path):
    refused(r"nowhere\.npz", load_state, tmp_path / "nowhere.npz")
    file = tmp_path / "race.npz"
    save_state(state, file)
    whole = file.read_bytes()
    for broken in (b"", b"not a zip", whole[: len(whole) // 2], whole[:200] + b"\0" * 50 + whole[250:]):
        file.write_bytes(broken)
        refused(r"race\.npz", load_state, file)
    for change, message in [
        ({"cars": np.zeros((3, 2, 6))}, r"cars has shape \(3, 2, 6\)"),
        ({"tick": np.zeros(3, np.int32)}, "tick has shape .* type int32"),
        ({"progress": np.full((3, 2), np.nan)}, "progress holds NaN"),
        ({"extra": np.zeros(1)}, "holds .*extra"),
        ({"tick": np.zeros(())}, "must have"),
        ({"cars": np.array([{"a": 1}], dtype=object)}, "race state"),  # a pickle: never read
    ]:
        np.savez(tmp_path / "race.npz", **(state._asdict() | change))
        refused(message, load_state, tmp_path / "race.npz")
