"""Studies of the simulator beside others: what the benchmarks share."""
