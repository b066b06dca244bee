"""Long work: tasks, executors, folders that resume, progress, settings."""
