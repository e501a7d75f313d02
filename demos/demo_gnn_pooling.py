"""Levels of bi-stride hierarchies: a channel, an aerofoil, a letter, a ball (thesis figure 4.4)."""

import argparse
from pathlib import Path

import dataset_airfoil
import dataset_cylinder
import dataset_font
import numpy as np

import fempm
from fempm import compat
from gnn.graph import from_cells
from gnn.hierarchy import build_hierarchy
from gnn.picture import levels_picture

MESHES = Path(__file__).parent.parent / "meshes"


def graphs(coarser):
    """Name -> MeshGraph of the four meshes, as in the data sets; `coarser` times the mesh size."""
    mesh, _ = dataset_cylinder.channel_mesh((0.3, 0.2), 0.05, 0.015 * coarser, 0.04 * coarser)
    named = {"cylinder": from_cells(compat.vertex_points(mesh), compat.cell_vertices(mesh))}
    wing = dataset_airfoil.outline(0.02, 0.4, 0.12)
    air = dataset_airfoil.airfoil_mesh(wing, **airfoil_sizes(coarser))
    named["aerofoil"] = from_cells(air.points, air.cells)
    h = dataset_font.SIZES["mini"]["h"] * coarser
    X, cells = dataset_font.letter_mesh(dataset_font.outlines("B", h, np.zeros(2)), h)[:2]
    named["letter"] = from_cells(X, cells)
    ball = fempm.read_mesh(MESHES / "sphere.geo", h=0.12 * coarser)
    return named | {"ball": from_cells(ball.points, ball.cells)}


def airfoil_sizes(coarser):
    """Arguments of `dataset_airfoil.airfoil_mesh` for its mini set."""
    size = dataset_airfoil.SIZES["mini"]
    return {"h": size["h"] * coarser, "growth": size["growth"], "radius": size["radius"]}


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--coarser", type=float, default=1.0, help="factor on the mesh sizes")
    parser.add_argument("--seeding", default="min_average", help="or close_center")
    parser.add_argument("--output", default="results/gnn_pooling.png", help="picture to write")
    args = parser.parse_args(argv)
    named, sizes = {}, {}
    for name, graph in graphs(args.coarser).items():
        hierarchy = build_hierarchy(graph.edges, graph.points, 8, args.seeding)
        named[name], sizes[name] = (graph, hierarchy), [level.num_nodes for level in hierarchy.levels]
        print(f"{name}: {' '.join(map(str, sizes[name]))} nodes")
    Path(args.output).parent.mkdir(parents=True, exist_ok=True)
    print(levels_picture(args.output, named))
    return sizes


if __name__ == "__main__":
    main()
