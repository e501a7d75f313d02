"""Settings of a training: a dataclass, presets for the data sets, overridden from the command line."""

import argparse
import dataclasses
from dataclasses import dataclass

from .graph import HANDLE, NORMAL, OBSTACLE, OUTFLOW


@dataclass
class Config:
    """What is learned, by which model, and how (thesis tables 4.1, 4.2, 4.4).

    Attributes
    ----------
    data : folder of trajectories, *.xdmf; the last `held_out` of them in order of name are not trained on
    fields : fields whose change in a step is learned; at once inputs
    direct : fields that are predicted as they are, from the others
    position : field of the world positions when bodies deform, their change is learned then; "" for none
    predicted : node types that are learned; all others are prescribed
    moving : node types with a motion that is prescribed, an input when bodies deform
    noise : standard deviation of what is added to each of the fields, or to the positions, in their unit
    mirror : axes along which the problem is symmetric: half of the samples are mirrored there
    contact_radius : distance below which nodes of deforming bodies are in contact; 0 for no contact edges
    model, latent, depth : see `models.MODELS`
    transition, repeats, edge_latents, correction : of "bsms" only
    hierarchies : of each mesh in a training, also "bsms" only: of these one has seeds as below, others random
        ones, so that it does not learn by heart which nodes are where on coarser levels
    steps_flat : message passings of "meshgraphnets"
    seeding, top_up : see `hierarchy.build_hierarchy`
    batch : meshes in a step; steps : of the training
    optimizer : "muon" or "adamw", see `optimizers`
    rate, last_rate : of the optimiser at its peak and, after a fall along a cosine, at the end
    weight_decay, clip : of the optimiser; largest norm of the gradient
    minutes : stop after that long, with the schedule by time; 0 for `steps`
    look_every, look_steps : how often to roll a held-out trajectory out, and how far
    save_minutes : between checkpoints
    checkpointing : activations are computed again instead of stored, for big meshes; "bsms" only
    compile : whether torch compiles the network, which takes it a minute or two
    """

    data: str = "results/cylinder"
    fields: tuple[str, ...] = ("velocity",)
    direct: tuple[str, ...] = ()
    position: str = ""
    predicted: tuple[int, ...] = (NORMAL, OUTFLOW)
    moving: tuple[int, ...] = ()
    noise: tuple[float, ...] = (0.02,)
    mirror: tuple[int, ...] = ()
    contact_radius: float = 0.0
    held_out: int = 2
    model: str = "bsms"
    latent: int = 128
    depth: int = 6
    transition: str = "contribution"
    repeats: int = 1
    edge_latents: bool = False
    correction: bool = False
    hierarchies: int = 1
    steps_flat: int = 15
    seeding: str = "min_average"
    top_up: bool = True
    batch: int = 4
    steps: int = 100_000
    optimizer: str = "muon"
    rate: float = 1e-3
    last_rate: float = 1e-5
    weight_decay: float = 0.0
    clip: float = 1.0
    minutes: float = 0.0
    seed: int = 0
    look_every: int = 1000
    look_steps: int = 50
    save_minutes: float = 5.0
    checkpointing: bool = False
    compile: bool = False

    def __post_init__(self):
        state = (self.position,) if self.position else self.fields
        if not state:
            raise ValueError("config: give `fields` or `position`, what is to be learned")
        if len(self.noise) != len(state):
            raise ValueError(f"config: noise {self.noise}, give one for each of {state}")
        if self.contact_radius and not self.position:
            raise ValueError("config: contact edges need the `position` of the deforming bodies")
        sizes = "latent", "repeats", "hierarchies", "batch", "steps", "look_every", "look_steps"
        for name in (*sizes, "rate", "last_rate", "clip"):
            if not getattr(self, name) > 0:
                raise ValueError(f"config: {name} {getattr(self, name)} must be positive")

    @property
    def state(self):
        """Names of the fields that a step goes on from."""
        return (self.position,) if self.position else self.fields


# for sets of --size mini and minutes to an hour on a processor
MINI = {"latent": 64, "depth": 4, "repeats": 3, "edge_latents": True, "correction": True}
MINI |= {"batch": 2, "rate": 2e-3}

PRESETS = {
    "cylinder": {"mirror": (1,)},
    "airfoil": {
        "fields": ("density", "velocity"),
        "direct": ("pressure",),
        "predicted": (NORMAL,),
        "noise": (0.002, 0.5),
    },
    "plate": {
        "fields": (),
        "position": "position",
        "predicted": (NORMAL,),
        "moving": (OBSTACLE, HANDLE),
        "noise": (1e-4,),
        "contact_radius": 0.03,
    },
    "font": {
        "fields": (),
        "position": "position",
        "predicted": (NORMAL,),
        "noise": (1e-3,),
        "contact_radius": 0.03,
    },
}
PRESETS |= {
    "cylinder_mini": PRESETS["cylinder"] | MINI | {"noise": (0.003,), "held_out": 8, "hierarchies": 8},
    # the pressure goes on from itself: as a direct field it is not learned in so short a time
    "airfoil_mini": MINI
    | {"fields": ("density", "velocity", "pressure"), "predicted": (NORMAL,)}
    | {"noise": (5e-4, 0.1, 50.0), "held_out": 4},
    "plate_mini": PRESETS["plate"] | MINI,
    # nodes are farther apart than in the published size
    "font_mini": PRESETS["font"] | MINI | {"contact_radius": 0.07, "held_out": 6},
}


def preset(name, **changes):
    """Config of one of `PRESETS`, with changes."""
    if name not in PRESETS:
        raise ValueError(f"preset {name!r}: there are {', '.join(PRESETS)}")
    return Config(**(PRESETS[name] | {"data": f"results/{name}"} | changes))


def add_arguments(parser):
    """An option for every setting, without default: only what is given changes the preset."""
    for field in dataclasses.fields(Config):
        kind = type(field.default)
        name, own = f"--{field.name.replace('_', '-')}", {"dest": field.name, "default": None}
        if kind is bool:
            parser.add_argument(name, action=argparse.BooleanOptionalAction, **own)
        elif kind is tuple:
            inner = {"noise": float, "predicted": int, "moving": int, "mirror": int}.get(field.name, str)
            parser.add_argument(name, nargs="*", type=inner, metavar=field.name.upper(), **own)
        else:
            parser.add_argument(name, type=kind, metavar=str(field.default) or "NAME", **own)


def from_arguments(args):
    """Config of parsed arguments: the preset with what was given."""
    given = {f.name: getattr(args, f.name) for f in dataclasses.fields(Config)}
    changes = {k: tuple(v) if isinstance(v, list) else v for k, v in given.items() if v is not None}
    return preset(args.preset, **changes)
