"""The commands of ``pcs-racing``, a file for each group; every file offers ``add(commands)``."""
