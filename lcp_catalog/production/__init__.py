"""A catalogue build: areas, jobs, executors, checkpoints and assembly."""
