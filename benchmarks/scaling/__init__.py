"""What the scaling benchmarks measure."""
