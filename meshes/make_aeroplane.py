"""Writes aeroplane.stl into the present folder: a toy aeroplane, 0.6 long, nose at x = 0, y up."""

import gmsh

gmsh.initialize(readConfigFiles=False)
occ = gmsh.model.occ


def plate(corners, shift, thickness):
    """A flat wing: corners (x, along its span), and which way its thickness goes."""
    normal = [0, thickness, 0] if shift == "y" else [0, 0, thickness]
    x = [(a, -thickness / 2, b) if shift == "y" else (a, b, -thickness / 2) for a, b in corners]
    points = [occ.addPoint(*p) for p in x]
    lines = [occ.addLine(p, q) for p, q in zip(points, points[1:] + points[:1])]
    face = occ.addPlaneSurface([occ.addCurveLoop(lines)])
    return [e for e in occ.extrude([(2, face)], *normal) if e[0] == 3]


R = 0.05
parts = [(3, occ.addCylinder(0.09, 0, 0, 0.3, 0, 0, R)), (3, occ.addCone(0.39, 0, 0, 0.21, 0, 0, R, 0.4 * R))]
nose = occ.addSphere(0, 0, 0, 1)
occ.dilate([(3, nose)], 0, 0, 0, 0.09, R, R)
occ.translate([(3, nose)], 0.09, 0, 0)
parts += [(3, nose)]
for s in (1, -1):
    parts += plate([(0.18, 0), (0.3, 0), (0.37, s * 0.32), (0.29, s * 0.32)], "y", 0.04)
    parts += plate([(0.49, 0), (0.59, 0), (0.6, s * 0.13), (0.54, s * 0.13)], "y", 0.036)
parts += plate([(0.47, 0), (0.59, 0), (0.6, 0.16), (0.55, 0.16)], "z", 0.036)
occ.fuse(parts[:1], parts[1:])
occ.synchronize()
gmsh.option.setNumber("Mesh.MeshSizeMin", 0.015)
gmsh.option.setNumber("Mesh.MeshSizeMax", 0.03)
gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 12)
gmsh.option.setNumber("Mesh.Binary", 1)
gmsh.model.mesh.generate(2)
gmsh.write("aeroplane.stl")
gmsh.finalize()
