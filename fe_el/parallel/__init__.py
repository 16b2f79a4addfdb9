"""Between ranks: halo exchange, messages from compiled code, errors that end all ranks."""
