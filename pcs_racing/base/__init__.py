"""Basic tools of both packages: errors, files, checks, random seeds and compilation."""
