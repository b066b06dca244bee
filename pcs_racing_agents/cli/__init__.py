"""The commands of ``pcs-racing``, one file per group."""
