# %% [markdown]
# # A campaign from Python
#
# The frame sample: a plate in a clamping frame, six bolts along its left edge, four accelerometers. Run it from the root of the
# repository, as a script or cell by cell.

# %%
import numpy as np
from matplotlib.figure import Figure

import lrbc_cli as lrbc

study = lrbc.load("configs/frame.yaml")
print(study)

# %% [markdown]
# ## The reduced model
#
# Built once and kept in the cache. Its certificate is a measured error: lines outside the basis, solved with the full model for several
# vectors of values, from a free edge to a clamped one.

# %%
reduction = study.reduce()
print(f"{study.model.size} DOFs -> {reduction.model.size}; measured error at most {reduction.worst:.1e}")

# %% [markdown]
# FRFs for any stiffness of the edge, and the derivative of their levels to every unknown (dB per decade).

# %%
hz = np.arange(30.0, 500.0)
figure = Figure(figsize=(8, 4), layout="constrained")
axes = figure.subplots()
for log10 in (3.0, 5.0, 6.5):
    axes.semilogy(hz, np.abs(study.frf(hz, left_edge=log10)[:, 0]), label=f"10^{log10:g}")
axes.set(xlabel="frequency [Hz]", ylabel="acc1 [m/s²/N]")
axes.legend(title="stiffness of the edge")

y, J = study.sensitivities(hz, left_edge=5.0)
felt = np.abs(J).mean(axis=(0, 1))[: study.parameters().groups[0].count]
print("mean sensitivity of the segments [dB/decade]:", felt.round(2))

# %% [markdown]
# ## From a measurement to verdicts
#
# First the tight state, then a job against it. Nothing is written; `record` is what `lrbc update` would write into `result.json`.

# %%
tight = study.identify("tight")
loose = study.identify("loose-2", reference=tight)
print(f"{loose.name}: {loose.status}, misfit {loose.misfit_db:.2f} dB")
for name, verdict in loose.verdicts.items():
    print(f"  {name}: {verdict}, p(loose) = {loose.probability_loose[name]:.3f}")

# %% [markdown]
# Another decision rule judges what was identified; nothing is identified again.

# %%
cautious = study.judge(loose, confidence=0.9999, loose_change=-0.5)
print([bolt.verdict for bolt in cautious.bolts])

# %% [markdown]
# ## A measurement at hand
#
# FRFs need not come from a file: here those of the reduced model, four of ten segments softer, with two percent of noise.

# %%
rng = np.random.default_rng(1)
edge = tight.record.parameters["left_edge"].log10.copy()
edge[3:7] -= 1.5
H = study.frf(hz, left_edge=edge)
H = H * (1 + 0.02 * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2))
found = study.identify("my rig", study.measurement(hz, H), reference=tight)
print({name: verdict for name, verdict in found.verdicts.items() if verdict != "tight"})

# %% [markdown]
# Figures are matplotlib figures: a notebook shows them, `savefig` writes them.

# %%
frf = study.plot_frf(loose, "acc4")
profile = study.plot_profile(loose)

# %% [markdown]
# ## Before anything is measured
#
# What the planned responses can tell of each bolt; `draws=3` would rehearse every bolt through the whole identification.

# %%
plan = study.plan("initial", noise_db=0.5, draws=0)
for bolt in plan.bolts:
    print(f"  {bolt.name}: detectability d' = {bolt.at(1.0).d_prime:.1f} at a loss of one decade")
