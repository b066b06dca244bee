"""Module for the fork server of a program's workers: they find the same modules as the program."""

from pcs_racing.f1tenth.stand_ins import install

install()
