"""Benchmarks and studies: run from the project's root, never imported by the package."""
