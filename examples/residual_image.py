"""Look at the residual image: it shows where the measurement is not to be believed.

The residual f(x) - g(x + u) is the noise of the camera wherever the displacement explains the images. Where something
else happened, here a drop of paint that fell on the specimen, it stands out, at the place where it happened.

    python examples/residual_image.py

prints

    residual 1.5 grey levels RMS away from the drop
    largest residual near x = 190, y = 80
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import ddic


def move(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([1.3 + 0.004 * points[:, 0], -0.7 - 0.001 * points[:, 1]])


reference, deformed = ddic.make_synthetic_pair(move, (300, 200), noise=1, seed=15)
rows, columns = np.indices(deformed.shape)
drop = np.hypot(columns - 192, rows - 79) < 5
deformed[drop] = 20

mesh = ddic.structured_mesh((20, 20, 280, 180), element_size=20)
result = ddic.measure((reference, deformed), mesh, regularization={"cut_off_wavelength": 80})

# In the reference image's pixels; nan outside the mesh.
residual = result.residual_image
if residual is not None:
    squares = np.nan_to_num(residual) ** 2
    away = np.isfinite(residual) & (np.hypot(columns - 190, rows - 79) > 40)
    print(f"residual {np.sqrt(squares[away].mean()):.1f} grey levels RMS away from the drop")
    row, column = np.unravel_index(ndimage.uniform_filter(squares, 11).argmax(), squares.shape)
    print(f"largest residual near x = {round(column, -1)}, y = {round(row, -1)}")
