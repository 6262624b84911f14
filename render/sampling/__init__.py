"""Random numbers by address, Markov chains and plain Monte Carlo over any path sampler."""
