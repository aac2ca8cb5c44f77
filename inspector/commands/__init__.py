"""What the subcommands of `inspector` do: a config, and `run(config)` that returns the exit code."""
