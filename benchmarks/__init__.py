"""Side-by-side measurements: ratios of CPU times taken in one run on one machine. Run all: python -m benchmarks."""
