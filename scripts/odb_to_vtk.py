"""Write the displacements of an Abaqus result as VTK, one file a frame, and a .pvd that lists them by time.

Run it by Abaqus' own Python, which alone reads .odb files, then compare:

    abaqus python odb_to_vtk.py job.odb [INSTANCE]
    ddic compare case.toml job.pvd --step last

Plain Python without packages, of any version since 2.7: Abaqus brings its own.
"""

# ruff: noqa: UP010, UP031, RUF005, SIM118
from __future__ import print_function

import os
import sys

KINDS = {"CPS3": 5, "CPE3": 5, "S3": 5, "CPS4": 9, "CPE4": 9, "S4": 9, "CPS6": 22, "CPE6": 22, "CPS8": 23, "CPE8": 23,
         "C3D4": 10, "C3D8": 12, "C3D10": 24, "C3D20": 25}
"""VTK's numbers of Abaqus' elements, whose variants (CPS4R, C3D8I, ...) begin with the same letters; both programs have
their nodes in the same order."""


def find_kind(name):
    """VTK's number of an element by its name; the longest beginning that is known counts."""
    known = [begin for begin in KINDS if name.startswith(begin)]
    if not known:
        raise SystemExit("element %s is not known here; add it to KINDS" % name)
    return KINDS[max(known, key=len)]


def write_frame(path, nodes, cells, displacement):
    """One frame as legacy VTK: nodes (label, x, y, z), cells (kind, labels), displacement by label."""
    places = {node[0]: place for place, node in enumerate(nodes)}
    with open(path, "w") as out:
        out.write("# vtk DataFile Version 3.0\nddic\nASCII\nDATASET UNSTRUCTURED_GRID\n")
        out.write("POINTS %d double\n" % len(nodes))
        for node in nodes:
            out.write("%.17g %.17g %.17g\n" % tuple(node[1:]))
        out.write("CELLS %d %d\n" % (len(cells), sum(1 + len(labels) for _, labels in cells)))
        for _, labels in cells:
            out.write("%d %s\n" % (len(labels), " ".join(str(places[label]) for label in labels)))
        out.write("CELL_TYPES %d\n" % len(cells))
        for kind, _ in cells:
            out.write("%d\n" % kind)
        out.write("POINT_DATA %d\nVECTORS U double\n" % len(nodes))
        for node in nodes:
            # Nodes without one are nan: ddic names those that belong to cells.
            u = list(displacement.get(node[0], [float("nan")])) + [0.0, 0.0, 0.0]
            out.write("%.17g %.17g %.17g\n" % tuple(u[:3]))


def read_vector(value):
    """A value of a field, which Abaqus keeps elsewhere where the analysis was in double precision."""
    return value.dataDouble if "DOUBLE" in str(value.precision) else value.data


def write_frames(odb, instance_name, stem):
    """All frames of all steps that have U; time goes on from step to step."""
    instances = odb.rootAssembly.instances
    names = list(instances.keys())
    if instance_name is None and len(names) > 1:
        raise SystemExit("there are several instances, name one: %s" % ", ".join(names))
    instance = instances[instance_name or names[0]]
    nodes = [(node.label,) + tuple(node.coordinates) for node in instance.nodes]
    cells = [(find_kind(element.type), list(element.connectivity)) for element in instance.elements]
    listed, began = [], 0.0
    for name in odb.steps.keys():
        step = odb.steps[name]
        for frame in step.frames:
            if "U" not in frame.fieldOutputs.keys():
                continue
            of_instance = frame.fieldOutputs["U"].getSubset(region=instance)
            displacement = {value.nodeLabel: read_vector(value) for value in of_instance.values}
            path = "%s_%04d.vtk" % (stem, len(listed) + 1)
            write_frame(path, nodes, cells, displacement)
            listed.append((began + frame.frameValue, os.path.basename(path)))
        began += step.timePeriod
    with open(stem + ".pvd", "w") as out:
        out.write('<?xml version="1.0"?>\n<VTKFile type="Collection"><Collection>\n')
        for time, path in listed:
            out.write('<DataSet timestep="%.17g" part="0" file="%s"/>\n' % (time, path))
        out.write("</Collection></VTKFile>\n")
    return listed


if __name__ == "__main__":
    from odbAccess import openOdb

    found = write_frames(openOdb(sys.argv[1], readOnly=True), sys.argv[2] if len(sys.argv) > 2 else None,
                         os.path.splitext(sys.argv[1])[0])
    print("%d frames" % len(found))
