"""The speed-accuracy frontier: each way to predict a design, timed and compared with renders."""

from optimize.frontier.frontier import Frontier, measure_frontier
from optimize.frontier.plan import check_folder
