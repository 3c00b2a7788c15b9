"""Say where a measurement starts: a few points that one has found by eye.

A woven pattern looks alike at every thread, so that no correlation can tell by how many threads it has moved. One pair
of points, clicked to a pixel, does; an earlier result (start=result), a table of points (start.from_points in a case)
and many points work in the same way. Where the images do not bear out what is given, the search goes on from it.

    python examples/given_start.py

prints

    from one pair: displacement (41.00, 0.00) px, RMS error 0.0125 px
"""

import numpy as np

import ddic

PERIOD, SHIFT = 12.0, 41.0

y, x = np.mgrid[0:500, 0:500]
noise = np.random.default_rng(0).normal(0, 2, (2, 500, 500))
threads = [np.sin(2 * np.pi * (x - shift) / PERIOD) * np.sin(2 * np.pi * y / PERIOD) for shift in (0.0, SHIFT)]
reference, deformed = np.rint(127 + 100 * np.array(threads) + noise)
mesh = ddic.structured_mesh((150, 150, 350, 350), element_size=20)

point, moved = np.array([[250.0, 250.0]]), np.array([[42.0, 1.0]])
result = ddic.measure((reference, deformed), mesh, start=(point, moved))
u, v = result.displacement.mean(axis=0)
error = result.displacement - [SHIFT, 0.0]
print(f"from one pair: displacement ({u:.2f}, {abs(v):.2f}) px, RMS error {np.sqrt((error**2).mean()):.4f} px")
