"""Benchmarks: every figure that an issue names, measured against its peer in the same run."""
