"""Module for the fork server of a program's workers: they find the same modules as the program."""

from pcs_racing.f1tenth.copies import use_copy
from pcs_racing.f1tenth.stand_ins import install

install()
use_copy()
