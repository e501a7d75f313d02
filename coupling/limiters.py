"""Limited slopes: what the two differences a and b on both sides of a node make of its slope.

All but WENO are between zero and twice the smaller difference, so that states at the middle of an
edge stay between those of its ends (LeVeque, Finite Volume Methods, section 6.11). "contact" is
Koren's third-order limiter with superbee for the density where it changes and the pressure does not: only
contacts keep no steepness of their own.
"""

from numba import njit

NAMES = ("van_leer", "mc", "koren", "superbee", "weno", "contact")
FIRST_ORDER = -1
SUPERBEE, CONTACT = NAMES.index("superbee"), NAMES.index("contact")


@njit(cache=True, inline="always")
def slope(limiter, a, b, scale):
    """Slope at a node from the differences a behind and b ahead, b being that of the edge.

    `limiter` is an index into NAMES or FIRST_ORDER, `scale` the size of what is reconstructed (for WENO).
    """
    if limiter == 4:
        # WENO of third order (Jiang and Shu 1996): weights 1/3 and 2/3, smoothness a^2 and b^2
        small = 1e-6 * scale * scale + 1e-300
        w = (small + b * b) / (small + a * a)
        w = 0.5 * w * w
        return (w * a + b) / (w + 1.0)
    if a * b <= 0.0 or limiter == FIRST_ORDER:
        return 0.0
    s = 1.0 if a > 0.0 else -1.0
    a, b = abs(a), abs(b)
    if limiter == 0:
        return s * 2.0 * a * b / (a + b)
    if limiter == 1:
        return s * min(2.0 * a, 2.0 * b, 0.5 * (a + b))
    if limiter == 3:
        return s * max(min(2.0 * a, b), min(a, 2.0 * b))
    return s * min(2.0 * a, 2.0 * b, (a + 2.0 * b) / 3.0)


@njit(cache=True, inline="always")
def contact_share(density, other_density, energy, other_energy):
    """How much an edge looks like a contact: 1 - |d ln e| / |d ln rho|, e the internal energy per volume."""
    jump = abs(other_density - density) * (energy + other_energy)
    change = abs(other_energy - energy) * (density + other_density)
    return 1.0 - change / jump if change < jump else 0.0
