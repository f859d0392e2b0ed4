"""Making domains: plan the solves, run them, render the frames, write the shards."""
