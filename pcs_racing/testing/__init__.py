"""Checks to run on your own planner, archive or characteristic before racing with it."""

from pcs_racing.testing.checks import check_archive, check_characteristic, check_planner

__all__ = ["check_archive", "check_characteristic", "check_planner"]
