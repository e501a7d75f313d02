"""coupling: compressible flow with shocks on simplex meshes (in work: exact Riemann solutions so far)."""
