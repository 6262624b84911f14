"""The speed-accuracy frontier: each way to judge a design, timed and held against renders."""
