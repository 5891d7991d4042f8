"""The `dexnudge` command: one file per subcommand, heavy imports inside them."""
