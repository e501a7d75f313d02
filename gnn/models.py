"""The models by name."""

from .baselines import MeshGraphNets, MSGNNGrid
from .bsms import BSMS
from .graph_unets import GraphUNets

MODELS = {"bsms": BSMS, "meshgraphnets": MeshGraphNets, "ms_gnn_grid": MSGNNGrid, "graph_unets": GraphUNets}


def make_model(name, **options):
    """Model of `MODELS` with options num_inputs, num_outputs, dim, depth, ..., see the classes."""
    if name not in MODELS:
        raise ValueError(f"model {name!r}: there are {', '.join(MODELS)}")
    return MODELS[name](**options)
