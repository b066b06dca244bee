# /// script
# dependencies = ["pettingzoo==1.27.0"]
# ///
"""PettingZoo: run its API, seed and state tests on every environment.

    python examples/clients/pettingzoo_checks.py

The races of the tests are short.
"""

import warnings

import pettingzoo
from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test, seed_test, state_test

import pcs_racing  # noqa: F401  registers the environments
from pcs_racing.envs import PETTINGZOO_IDS

SHORT = {
    "pcs_racing/head_to_head-v1": {"steps": (0.4,) * 3},
    "pcs_racing/drive_head_to_head-v0": {"duration": 0.5},
}


def main() -> None:
    warnings.simplefilter("error")  # a warning of a test is a fault
    for name in PETTINGZOO_IDS:

        def parallel(name: str = name, **more: object) -> pettingzoo.ParallelEnv:
            return pettingzoo.make("parallel", name, **SHORT[name], **more)

        def turns(name: str = name, **more: object) -> pettingzoo.AECEnv:
            return pettingzoo.make("aec", name, **SHORT[name], **more)

        parallel_api_test(parallel(), num_cycles=50)
        api_test(turns(), num_cycles=50)
        parallel_seed_test(parallel, num_cycles=20)
        seed_test(turns, num_cycles=20)
        state_test(turns(), parallel())
        print(f"{name}: all tests pass")


if __name__ == "__main__":
    main()
