"""Walls: boundary conditions through a layer of mirror vertices.

The kernel needs vertices on both sides of a wall. Each vertex next to a wall gets a mirror image
across it, attached to the same wall vertices as the vertex itself. Only positions and attachments
matter, particles never enter the layer, so it need not be a mesh: curved walls and corners need no
special treatment. A mirror vertex is not an unknown: its velocity is `C v_owner`, and what particles
give to it is folded back with the transpose (design note, "Essential boundaries: fold, don't clamp").
A wall of kind "contact" prescribes nothing: its mirror vertices are unknowns like others, the layer of
elements outside of the boundary of thesis section 2.1.3.5, and particles are held by `contact`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

CORNER_ANGLE = np.deg2rad(40.0)  # facets that meet at more than this belong to different smooth patches


@dataclass
class Wall:
    """A boundary condition on a named boundary of the mesh.

    Attributes
    ----------
    boundary : name of the boundary, see `SimplexMesh.boundaries`
    kind : "sticky" (velocity prescribed), "slip" (only its normal component) or "contact" (bodies are
        pushed away from it and can lift off, see `contact`)
    velocity : wall velocity, (d,) or a function of time returning it; at rest when not given. The mesh
        does not move with the wall: it is for walls that slide along themselves, or move little
    friction : coefficient mu of Coulomb's law, for kind="contact"
    reach : distance d_hat at which contact begins, a quarter of the mesh size at the wall when not given
    """

    boundary: str = "boundary"
    kind: str = "sticky"
    velocity: np.ndarray | Callable | None = None
    friction: float = 0.0
    reach: float | None = None

    def __post_init__(self):
        if self.kind not in ("sticky", "slip", "contact"):
            raise ValueError(f"wall kind {self.kind!r}: give 'sticky', 'slip' or 'contact'")
        if self.kind == "contact" and self.velocity is not None:
            raise ValueError(
                f"wall {self.boundary!r}: a wall of kind 'contact' is at rest, leave velocity out"
            )
        if self.kind != "contact" and (self.friction or self.reach is not None):
            raise ValueError(f"wall {self.boundary!r}: friction and reach are for kind 'contact'")
        check_friction(f"wall {self.boundary!r}", self.friction, self.reach)

    def velocity_at(self, time):
        """(d,) wall velocity at a time, or None for a wall at rest."""
        return self.velocity(time) if callable(self.velocity) else self.velocity


def check_friction(name, friction, reach):
    """Raise ValueError unless the numbers of a surface with contact are positive."""
    if not friction >= 0 or not (reach is None or reach > 0):
        raise ValueError(f"{name}: friction {friction}, reach {reach} must be positive")


@dataclass
class WallLayer:
    """Mirror vertices and constrained vertices of all walls of a scene.

    Attributes
    ----------
    points : (ng, d) positions of the mirror vertices, those outside of contact walls first
    owner : (ng,) int32 vertex that each one mirrors
    num_free : how many of them are unknowns: those outside of contact walls
    source : (ng - num_free,) int32 vertex of the kernel that the others take their velocity from: the
        owner, or its mirror image in a contact wall
    fold : (ng - num_free, d, d) C in v_mirror = C v_source
    attached : (na, 2) int32 pairs (mirror vertex, wall vertex whose neighbour it becomes)
    vertices : (nw,) int32 vertices on walls that prescribe velocities, and their images in contact walls
    project : (nw, d, d) projection onto their free velocity directions
    moving : list of (wall, mirror_drift (ng, d, d), vertex_drift (nw, d, d)): what the velocity of
        each moving wall adds to the mirror and to the wall vertices
    open_facets : (no, d) int32 exterior facets without a wall
    contact_facets : (nc, d) int32 facets of contact walls
    incomplete : (ni,) int32 vertices without an image in a patch next to them (re-entrant corners)
    """

    points: np.ndarray
    owner: np.ndarray
    num_free: int
    source: np.ndarray
    fold: np.ndarray
    attached: np.ndarray
    vertices: np.ndarray
    project: np.ndarray
    moving: list
    open_facets: np.ndarray
    contact_facets: np.ndarray
    incomplete: np.ndarray


@dataclass
class Patch:
    """A smooth piece of a wall: its facets, its vertices and the outward normals there."""

    wall: int
    facets: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray


@dataclass
class Image:
    """Reflection of one vertex in one patch."""

    normal: np.ndarray
    foot: np.ndarray
    fold: np.ndarray
    attached: set
    wall: int


def wall_layer(mesh, walls):
    """Mirror and constrained vertices of `walls` on `mesh`.

    Raises
    ------
    KeyError
        for an unknown boundary name
    ValueError
        for a facet that two walls claim, or an interior facet
    """
    d = mesh.dim
    facet_sets = [np.asarray(mesh.facets(w.boundary)).reshape(-1, d) for w in walls]
    check_disjoint(mesh, walls, facet_sets)
    patches = [
        patch for index, facets in enumerate(facet_sets) for patch in smooth_patches(mesh, index, facets)
    ]
    empty = np.empty((0, d), np.int32)
    images, incomplete = reflections(mesh, walls, patches)
    layer = assemble_mirrors(mesh, images, walls)
    contact = [f for wall, f in zip(walls, facet_sets, strict=True) if wall.kind == "contact"]
    constraints = vertex_constraints(mesh, walls, patches)
    vertices, project, drift = constrain_images(len(mesh.points), layer, *constraints)
    moving = [
        (wall, layer["drift"][:, index].copy(), drift[:, index].copy())
        for index, wall in enumerate(walls)
        if wall.velocity is not None
    ]
    return WallLayer(
        layer["points"],
        layer["owner"],
        layer["num_free"],
        layer["source"],
        layer["fold"],
        layer["attached"],
        vertices,
        project,
        moving,
        mesh.other_facets(np.concatenate([empty, *facet_sets])),
        np.concatenate([empty, *contact]),
        incomplete,
    )


def check_disjoint(mesh, walls, facet_sets):
    """Each facet is exterior and belongs to one wall at most."""
    owner = np.full(len(mesh.exterior_facets), -1)
    for index, (wall, facets) in enumerate(zip(walls, facet_sets, strict=True)):
        keys = np.sort(facets, axis=1).tolist()
        for key, place in zip(keys, mesh.exterior_places(facets).tolist(), strict=True):
            if place < 0:
                raise ValueError(f"wall {wall.boundary!r}: facet {tuple(key)} lies inside the mesh")
            if owner[place] >= 0:
                other = walls[owner[place]].boundary
                raise ValueError(f"walls {other!r} and {wall.boundary!r} share facet {tuple(key)}")
            owner[place] = index


def facet_normals(mesh, facets):
    """(nf, d) outward normals times the facet's area (length, 1) of exterior facets."""
    x = mesh.points[facets]
    if mesh.dim == 1:
        normal = np.ones((len(facets), 1))
    elif mesh.dim == 2:
        edge = x[:, 1] - x[:, 0]
        normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    else:
        normal = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    inside = mesh.points[opposite_vertices(mesh, facets)]
    outward = np.einsum("fd,fd->f", x[:, 0] - inside, normal)
    return normal * np.sign(outward)[:, None]


def opposite_vertices(mesh, facets):
    """Vertex opposite each exterior facet in its cell."""
    place = mesh.exterior_places(facets)
    if np.any(place < 0):
        raise KeyError(tuple(facets[place < 0][0].tolist()))
    return mesh.cells[mesh.neighbours == -1][place].astype(np.int64)


def smooth_patches(mesh, wall, facets):
    """Split a wall's facets where neighbouring normals differ by more than CORNER_ANGLE."""
    d = mesh.dim
    areas = facet_normals(mesh, facets)
    normals = areas / np.linalg.norm(areas, axis=1, keepdims=True)
    patch_of = np.arange(len(facets))
    if d > 1:
        ridges = {}
        for f, facet in enumerate(facets.tolist()):
            for ridge in combinations(sorted(facet), d - 1):
                ridges.setdefault(ridge, []).append(f)
        smooth = [
            pair
            for group in ridges.values()
            for pair in combinations(group, 2)
            if normals[pair[0]] @ normals[pair[1]] > np.cos(CORNER_ANGLE)
        ]
        patch_of = components(len(facets), smooth)
    for label in np.unique(patch_of):
        chosen = patch_of == label
        vertices, local = np.unique(facets[chosen], return_inverse=True)
        total = np.zeros((len(vertices), d))
        np.add.at(total, local.reshape(-1, d), areas[chosen][:, None, :])
        total /= np.linalg.norm(total, axis=1, keepdims=True)
        yield Patch(wall, facets[chosen], vertices, total)


def components(n, pairs):
    """Label of the connected component of each of n items linked by pairs."""
    parent = list(range(n))

    def root(i):
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for a, b in pairs:
        parent[root(a)] = root(b)
    return np.array([root(i) for i in range(n)])


def reflections(mesh, walls, patches):
    """Images of every vertex next to a patch: {vertex: [Image, ...]} and the vertices without any."""
    d = mesh.dim
    images, rejected = {}, set()
    for patch in patches:
        normal_at = dict(zip(patch.vertices.tolist(), patch.normals, strict=True))
        facets_at = {}
        for facet in patch.facets.tolist():
            for v in facet:
                facets_at.setdefault(v, []).append(facet)
        near = {}
        for v in patch.vertices.tolist():
            for i in mesh.adjacency[mesh.adjacency_start[v] : mesh.adjacency_start[v + 1]].tolist():
                if i not in normal_at:
                    near.setdefault(i, set()).add(v)
        for i, attached in near.items():
            around = {w for v in attached for facet in facets_at[v] for w in facet}
            candidates = np.array([facet for v in around for facet in facets_at[v]])
            foot, weights, facet = closest_point(mesh.points[i], mesh.points[candidates])
            normal = weights @ np.array([normal_at[v] for v in candidates[facet].tolist()])
            normal /= np.linalg.norm(normal)
            offset = foot - mesh.points[i]
            distance = offset @ normal
            # beyond the patch's rim (re-entrant corner, end of the wall) there is no mirror image
            if np.linalg.norm(offset - distance * normal) > 0.3 * distance:
                rejected.add(i)
                continue
            mirror = np.eye(d) - 2 * np.outer(normal, normal)
            fold = mirror if walls[patch.wall].kind == "slip" else -np.eye(d)
            images.setdefault(i, []).append(Image(normal, foot, fold, attached, patch.wall))
    return images, np.array(sorted(rejected), np.int32)


def closest_point(x, facets):
    """Closest point of facets (n, d, d) to x: (point, its weights at the facet's vertices, facet)."""
    origin, edges = facets[:, 0], facets[:, 1:] - facets[:, :1]
    gram = np.einsum("fia,fja->fij", edges, edges)
    local = np.linalg.solve(gram, np.einsum("fia,fa->fi", edges, x - origin)[..., None])[..., 0]
    weights = np.concatenate([1 - local.sum(axis=1, keepdims=True), local], axis=1)
    weights = np.maximum(weights, 0)
    weights /= weights.sum(axis=1, keepdims=True)
    feet = np.einsum("fi,fia->fa", weights, facets)
    best = np.argmin(np.linalg.norm(feet - x, axis=1))
    return feet[best], weights[best], best


def assemble_mirrors(mesh, images, walls):
    """Mirror vertices of single patches, and of two or three patches at once in corners."""
    mirrors = []
    for i, single in images.items():
        for size in range(1, len(single) + 1):
            for group in combinations(single, size):
                shared = set.intersection(*(image.attached for image in group))
                if shared:
                    mirrors.append(compose(mesh.points[i], i, group, walls) | {"attached": sorted(shared)})
    mirrors.sort(key=lambda mirror: len(mirror["prescribed"]) > 0)
    free = [mirror for mirror in mirrors if not mirror["prescribed"]]
    number = {(m["owner"], m["contact"]): len(mesh.points) + k for k, m in enumerate(free)}
    folded = mirrors[len(free) :]
    d = mesh.dim
    return {
        "points": np.array([m["point"] for m in mirrors]).reshape(-1, d),
        "owner": np.array([m["owner"] for m in mirrors], np.int32),
        "num_free": len(free),
        "turn": np.array([m["turn"] for m in free]).reshape(-1, d, d),
        "source": np.array([number.get((m["owner"], m["contact"]), m["owner"]) for m in folded], np.int32),
        "fold": np.array([m["fold"] for m in folded]).reshape(-1, d, d),
        "attached": np.array(
            [(k, v) for k, m in enumerate(mirrors) for v in m["attached"]], np.int32
        ).reshape(-1, 2),
        "drift": np.array([m["drift"] for m in folded]).reshape(len(folded), len(walls), d, d),
    }


def compose(x, owner, group, walls):
    """Image of vertex `owner` at x in a group of patches, one after the other.

    `fold` and `drift` are those of the patches that prescribe velocities; `contact` and `prescribed`
    tell the patches apart.
    """
    d = len(x)
    x, matrix, moves = x.copy(), np.eye(d), np.zeros((len(walls), d, d))
    contact, prescribed = (
        tuple(id(image) for image in group if (walls[image.wall].kind == "contact") == wanted)
        for wanted in (True, False)
    )
    turn = np.eye(d)
    for image in group:
        x += 2 * ((image.foot - x) @ image.normal) * image.normal
        turn = (np.eye(d) - 2 * np.outer(image.normal, image.normal)) @ turn
        if id(image) in prescribed:
            matrix = image.fold @ matrix
            moves = image.fold @ moves
            moves[image.wall] += np.eye(d) - image.fold
    return {
        "point": x,
        "owner": owner,
        "contact": contact,
        "prescribed": prescribed,
        "turn": turn,
        "fold": matrix,
        "drift": moves,
    }


def vertex_constraints(mesh, walls, patches):
    """Wall vertices, projections onto their free directions, and what moving walls prescribe."""
    d = mesh.dim
    rows = {}
    for patch in patches:
        if walls[patch.wall].kind == "contact":
            continue
        sticky = walls[patch.wall].kind == "sticky"
        for v, normal in zip(patch.vertices.tolist(), patch.normals, strict=True):
            rows.setdefault(v, []).extend((patch.wall, r) for r in (np.eye(d) if sticky else normal[None]))
    vertices = np.array(sorted(rows), np.int32)
    project = np.empty((len(vertices), d, d))
    drift = np.zeros((len(vertices), len(walls), d, d))
    for k, v in enumerate(vertices.tolist()):
        wall, normals = zip(*rows[v], strict=True)
        normals = np.array(normals)
        inverse = np.linalg.pinv(normals, rcond=1e-6)
        project[k] = np.eye(d) - inverse @ normals
        for w in set(wall):
            mine = np.array(wall) == w
            drift[k, w] = inverse[:, mine] @ normals[mine]
    return vertices, project, drift


def constrain_images(num_vertices, layer, vertices, project, drift):
    """Add the images of wall vertices in contact walls, constrained like their owners."""
    free = np.flatnonzero(np.isin(layer["owner"][: layer["num_free"]], vertices))
    row, turn = np.searchsorted(vertices, layer["owner"][free]), layer["turn"][free]
    turned = np.einsum("gab,gbc,gdc->gad", turn, project[row], turn)
    return (
        np.concatenate([vertices, num_vertices + free]).astype(np.int32),
        np.concatenate([project, turned]),
        np.concatenate([drift, np.einsum("gab,gwbc->gwac", turn, drift[row])]),
    )


def attached_adjacency(mesh, layer):
    """CSR neighbours of each vertex, mirror vertices (numbered after the mesh's) included."""
    nv = len(mesh.points)
    source = np.repeat(np.arange(nv), np.diff(mesh.adjacency_start))
    source = np.concatenate([source, layer.attached[:, 1]])
    other = np.concatenate([mesh.adjacency, nv + layer.attached[:, 0]])
    order = np.lexsort((other, source))
    start = np.searchsorted(source[order], np.arange(nv + 1))
    return start, other[order].astype(np.int32)
