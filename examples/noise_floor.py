"""Find the noise floor: two pictures of a specimen that does not move.

Do this before every test: what is measured between two pictures of the still specimen is noise, and no smaller
displacement can be told from it. Larger elements average over more pixels. For square elements without regularization
theory says sqrt(6) sigma / (h g): sigma is the camera's noise, h the side of an element, g the RMS slope of the image.

    python examples/noise_floor.py

prints

    elements of 10 px: noise 0.0211 px, by theory 0.0211 px; of strain 2.1e-03
    elements of 20 px: noise 0.0097 px, by theory 0.0106 px; of strain 4.6e-04
    elements of 40 px: noise 0.0050 px, by theory 0.0053 px; of strain 1.2e-04
"""

import numpy as np

import ddic

SIGMA = 2.0  # grey levels
images = ddic.make_synthetic_pair(np.zeros_like, (440, 440), noise=SIGMA, seed=14)

# Rounding to whole grey levels is noise as well, of variance 1/12.
sigma = np.sqrt(SIGMA**2 + 1 / 12)
slope = np.sqrt((np.gradient(images[0].astype(float), axis=1) ** 2).mean())

for h in (10, 20, 40):
    mesh = ddic.structured_mesh((20, 20, 420, 420), element_size=h)
    result = ddic.measure(images, mesh)
    # Nodes on the sides of the mesh see fewer pixels.
    inner = ((result.mesh.nodes > 20) & (result.mesh.nodes < 420)).all(axis=1)
    noise = result.displacement[inner].std()
    theory = np.sqrt(6) * sigma / (h * slope)
    strain = result.fields["strain_infinitesimal"][:, 0].std()
    print(f"elements of {h} px: noise {noise:.4f} px, by theory {theory:.4f} px; of strain {strain:.1e}")
