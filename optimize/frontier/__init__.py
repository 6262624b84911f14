"""The speed-accuracy frontier: each way to predict a design, timed and compared with renders."""

from optimize.frontier.frontier import PLAN, Frontier, measure_frontier
from optimize.frontier.survey import Survey, survey, surveyed_scenes
