"""Plans by the size of the lead, in races of 300 s and of 40 s."""
