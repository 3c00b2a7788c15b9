"""Write a result file and read it again.

The file is VTKHDF: ParaView opens it, h5py reads it, and ddic.open gives the same object as the measurement did, with
its fields, iterations, residual image and where it came from.

    python examples/read_result.py

prints

    fields at 80 nodes: GlobalNodeId, displacement, displacement_mesh_units, displacement_physical
    strains there: nodal_strain_green_lagrange, nodal_strain_hencky, nodal_strain_infinitesimal
    the file's displacement differs by 0.0 px from the one measured
    3 iterations, the last moved by 0.0000 px RMS
    residual image 240 x 200 px, 1.5 grey levels RMS
    largest component of the displacement 0.060 mm
"""

import numpy as np

import ddic

images = ddic.make_synthetic_pair(lambda points: 0.01 * (points - 100), (240, 200), noise=1, seed=13)
mesh = ddic.structured_mesh((20, 20, 220, 180), element_size=22)
measured = ddic.measure(images, mesh, images={"pixel_size": 0.05, "length_unit": "mm"}, output="result.vtkhdf")

result = ddic.open("result.vtkhdf")
print(f"fields at {result.mesh.n_nodes} nodes: {', '.join(n for n in result.point_data if 'nodal' not in n)}")
print(f"strains there: {', '.join(n for n in result.point_data if n.startswith('nodal_strain'))}")
print(f"the file's displacement differs by {np.abs(result.displacement - measured.displacement).max()} px "
      "from the one measured")

moved = result.gauss_newton["rms_correction_px"]
print(f"{len(moved)} iterations, the last moved by {moved[-1]:.4f} px RMS")

residual = result.residual_image  # nan outside the mesh
if residual is not None:
    print(f"residual image {residual.shape[1]} x {residual.shape[0]} px, {np.nanstd(residual):.1f} grey levels RMS")
unit = result.attributes["units"]["length_unit"]
largest = np.abs(result.fields["displacement_physical"]).max()
print(f"largest component of the displacement {largest:.3f} {unit}")
