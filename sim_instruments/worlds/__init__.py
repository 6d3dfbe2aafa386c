"""Physics and wiring of the simulated benches, one package per system; they do not know each other."""
