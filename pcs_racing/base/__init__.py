"""What everything else stands on: errors, files, checks, random seeds, compilation."""
