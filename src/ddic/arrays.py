"""Arrays as signatures name them: of 64-bit numbers, real ones where the name does not say it."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
