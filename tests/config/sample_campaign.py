"""A campaign file that is valid and uses most keys."""

VALID = """\
campaign: box
output: ../runs/box

model:
  stiffness: model.h5#K
  mass: {file: model.h5, group: M, format: hdf5}
  damping:
    structure: {alpha: 5.1357, beta: 2.554e-6}
    acoustic: {alpha: 3.7755}
  dofs: dofs.csv

excitation:
  hammer: {near: [0.2735, 0.3440, -0.035], component: UZ}
responses:
  mic01: {near: [0.6, 0.5, 0.05], component: pres}
  acc1: {matrix: rows.mtx, row: 1, quantity: acceleration, record: {node: 201, direction: 3}}

parameters:
  left_edge:
    kind: stiffness
    select: {component: ROTY, box: [[0.1, 0.1], [0.2, 0.7], [-0.04, -0.03]]}
    initial: 4.0
    bounds: [-1.0, 7.0]
    smoothing: [0.333333, 0.666667, 0.333333]
    damping: {initial: 0.0, bounds: [-3.0, 4.0]}
bolts: bolts.csv

reduction: {band: [20.0, 400], tolerance: 1e-3}
update:
  reference: bolts-00
  responses: [mic01, acc1]
  lines: resonances
  regularisation: 0.04
  method: bfgs

jobs:
  bolts-00: {frf: frf/bolts-00.uff}
  bolts-04: {frf: frf/bolts-04.uff, removed: [B08, B09], records: {mic01: channel 7}, scale: {mic01: 1.02}}
"""
