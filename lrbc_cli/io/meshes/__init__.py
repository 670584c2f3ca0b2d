"""Readers of coordinates of nodes: tables, input files of FE programs, and meshes with the numbers that they give their nodes."""
