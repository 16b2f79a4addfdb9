"""What a run needs around its steps: time, output, summary, checkpoints, records, stopping."""
