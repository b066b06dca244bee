"""docs/benchmark.md: its adapter of an own model is code that runs."""

from repository import python_blocks, read_page

BLOCKS = python_blocks(read_page("benchmark.md"))


def test_the_adapter_gives_what_the_users_code_loads():
    loaded = {}
    space = {"load_my_model": lambda weights: loaded.setdefault(weights, object())}
    (code,) = BLOCKS
    exec(compile(code, "benchmark.md", "exec"), space)
    assert space["make_agent"](None, "weights.pt") is loaded["weights.pt"]
