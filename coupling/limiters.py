"""Limited slopes: what the two differences a and b on both sides of a node make of its slope.

All but WENO are between zero and twice the smaller difference, so that states at the middle of an
edge stay between those of its ends (LeVeque, Finite Volume Methods, section 6.11). "contact" is
Koren's third-order limiter with superbee for the density where it changes and the pressure does not: only
contacts keep no steepness of their own.
"""

from numba import njit

NAMES = ("first_order", "van_leer", "mc", "koren", "superbee", "weno", "contact")


@njit(cache=True, inline="always")
def slope(limiter, a, b, scale):
    """Slope at a node from the differences a behind and b ahead, b being that of the edge.

    `limiter` is a tuple as long as the place of its name in NAMES, which makes it known to the compiler;
    `scale` is the size of what is reconstructed (for WENO).
    """
    if len(limiter) == 0:
        return 0.0
    if len(limiter) == 5:
        # WENO of third order (Jiang and Shu 1996): weights 1/3 and 2/3, smoothness a^2 and b^2
        small = 1e-6 * scale * scale + 1e-300
        w = (small + b * b) / (small + a * a)
        w = 0.5 * w * w
        return (w * a + b) / (w + 1.0)
    if len(limiter) == 1:
        return 2.0 * a * b / (a + b) if a * b > 0.0 else 0.0
    s = 1.0 if b > 0.0 else -1.0
    a, b = s * a, s * b
    if len(limiter) == 2:
        return s * max(0.0, min(2.0 * a, 2.0 * b, 0.5 * (a + b)))
    if len(limiter) == 4:
        return s * max(0.0, min(2.0 * a, b), min(a, 2.0 * b))
    return s * max(0.0, min(2.0 * a, 2.0 * b, (a + 2.0 * b) / 3.0))


@njit(cache=True, inline="always")
def contact_share(density, other_density, energy, other_energy):
    """How much an edge looks like a contact: 1 - |d ln e| / |d ln rho|, e the internal energy per volume."""
    jump = abs(other_density - density) * (energy + other_energy)
    change = abs(other_energy - energy) * (density + other_density)
    return 1.0 - change / jump if change < jump else 0.0


def known(name):
    """The tuple by which the kernels know a limiter."""
    return (1,) * NAMES.index(name)
