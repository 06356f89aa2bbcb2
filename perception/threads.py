"""How the compiled kernels that run on several cores share them.

numba's own order of preference begins with a layer that warns when it is too old and one whose threads burn the cores
while they wait, which hurts whoever else runs on the robot's computer. This one sleeps; it must only be called from
one thread of a process at a time, as the perception worker does.
"""

from numba import config

config.THREADING_LAYER_PRIORITY = ["workqueue", "omp", "tbb"]

SHARES = 2
"""Parts of a work that is cut by hand: the cores of the robot's computer."""
