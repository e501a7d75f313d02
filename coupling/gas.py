"""Equations of state, and the conserved variables of a gas.

The solver asks an equation of state for four functions of arrays; a class of one's own with the same
four methods does as well.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class IdealGas:
    """p = (gamma - 1) rho e (thesis equation 3.9).

    Attributes
    ----------
    gamma : ratio of specific heats, above 1
    """

    gamma: float = 1.4

    def __post_init__(self):
        if not self.gamma > 1:
            raise ValueError(f"gamma {self.gamma}: the ratio of specific heats must exceed 1")

    def pressure(self, density, internal_energy):
        """Pressure (Pa) of density (kg/m^3) and internal energy per volume (J/m^3)."""
        return (self.gamma - 1) * internal_energy

    def internal_energy(self, density, pressure):
        """Internal energy per volume (J/m^3), the inverse of `pressure`."""
        return pressure / (self.gamma - 1)

    def bulk_modulus(self, density, pressure):
        """rho c^2 (Pa), c the speed of sound."""
        return self.gamma * pressure

    def heating(self, density, pressure):
        """dp / d(rho e) at constant density, the number of Grueneisen."""
        return self.gamma - 1


def conserved(eos, density, velocity, pressure):
    """Density, momentum and total energy per volume (n, d + 2) of (n,), (n, d) and (n,)."""
    energy = eos.internal_energy(density, pressure) + 0.5 * density * np.sum(velocity**2, axis=1)
    return np.concatenate([density[:, None], density[:, None] * velocity, energy[:, None]], axis=1)


def check_state(eos, density, pressure):
    """Raise a ValueError with the value of a density or sound speed that is not positive."""
    for name, given, value in (
        ("density", density, density),
        ("pressure", pressure, eos.bulk_modulus(density, pressure)),
    ):
        bad = np.flatnonzero(~(value > 0))
        if len(bad):
            raise ValueError(f"{name} of the gas must be positive, got {given[bad[0]]}")
