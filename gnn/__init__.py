"""gnn: learned simulation on meshes by bi-stride multi-scale graph networks (thesis chapter 4).

It reads and writes the XDMF files of the solvers and imports none of them.
"""
