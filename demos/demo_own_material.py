"""A material, a condition and an obstacle of one's own: shaken viscoelastic bar, block on a slope."""

import dolfinx
import numpy as np
from mpi4py import MPI

import fempm
from fempm.cli import print_files, run_options, scene_arguments
from fempm.picture import snapshot_strip

FRICTION, LENGTH, GRIP, SHAKE, OMEGA, DT = 0.4, 0.2, 0.6, 1e-3, 80.0, 2e-4
DOWN, NORMAL = np.array([0.8, -0.6]), np.array([0.6, 0.8])  # directions of the slope


class Viscoelastic(fempm.NeoHookean):
    """A spring beside an equal one that a dashpot lets go in the time 1 / OMEGA; for steps DT."""

    state = {"overstress": (2, 2), "spring": (2, 2)}  # kept for every particle, zero at first

    def kirchhoff_stress(self, deformation_gradient, out, overstress, spring):
        bad = super().kirchhoff_stress(deformation_gradient, out)  # the first inverted particle or -1
        decay = np.exp(-0.5 * DT * OMEGA)
        overstress[:] = decay * (decay * overstress + out - spring)
        spring[:], out[:] = out, out + overstress
        return bad

    def energy(self, deformation_gradient, **state):
        return super().energy(deformation_gradient)  # of the first spring


def shake(points, velocity, time):  # the vertices in the grip move up and down, the others as they like
    held = np.all(points > [0.9, GRIP - 1e-9], axis=1)
    return np.where(held[:, None], [0, SHAKE * OMEGA * np.cos(OMEGA * time)], velocity)


def main(argv=None):
    args = scene_arguments(__doc__, argv, until=0.6)
    rectangle = dolfinx.mesh.create_rectangle(MPI.COMM_WORLD, [[0, 0], [1.2, 0.8]], [48, 32])
    law = Viscoelastic(density=1000.0, young=4e5)
    bar = fempm.Body(*fempm.fill_box([0.95, GRIP - LENGTH], [1.05, 0.7], 0.00625), law)
    x, volume = fempm.fill_box([0.05, 0.0], [0.25, 0.1], 0.00625)
    block = fempm.Body([0, 0.7] + x @ [DOWN, NORMAL], volume, law)
    slope = fempm.Obstacle(lambda x: (x - [0, 0.7]) @ NORMAL, FRICTION, reach=0.00625 / 2)
    own = {"obstacles": [slope], "condition": shake, "threads": args.threads}
    scene = fempm.Simulation(fempm.from_dolfinx(rectangle), [bar, block], gravity=[0, -9.81], **own)
    record = fempm.run(scene, **run_options(args), dt=DT, watch=lambda s: {"tip": s.gather("position")[0, 1]})
    late = record.log["time"] > scene.time - 4 * np.pi / OMEGA  # the last two swings
    swing = np.ptp(record.log["tip"][late]) / (2 * SHAKE)
    exact = abs(1 / np.cos(OMEGA * LENGTH * np.sqrt(law.density / law.young / (1 + 1j / (1 + 1j)))))
    slid = np.mean((scene.gather("position")[len(bar.position) :] - block.position) @ DOWN)
    slide = 0.5 * 9.81 * (-DOWN[1] - FRICTION * NORMAL[1]) * scene.time**2
    print(f"tip / grip {swing:.3f} (thin bar: {exact:.3f}); block slid {slid:.4f} m (rigid: {slide:.4f} m)")
    moments = [(t, x, np.hypot(*v.T)) for t, x, v in record.frames[::10]]
    print_files([*record.files, snapshot_strip(f"{args.output}.png", moments, label="speed (m/s)")])
    return {"swing": swing / exact, "slid": slid / slide, "record": record}


if __name__ == "__main__":
    main()
