# %% [markdown]
# # Bare matrices: reduce, differentiate, identify
#
# No campaign file: matrices and vectors in; a certified reduced model, FRFs and their Jacobian out. Here a beam of steel on twelve mounts
# of unknown stiffness, each a term k b bᵀ of rank one, and an identification of your own around it.

# %%
import numpy as np
import scipy.sparse as sp
from matplotlib.figure import Figure
from scipy.optimize import least_squares

import lrbc_cli as lrbc

# %% [markdown]
# ## A beam
#
# 200 Hermite elements: deflection and rotation at each node.

# %%
elements, length, height, width = 200, 2.0, 0.012, 0.04
E, rho = 2.1e11, 7850.0
le, EI, m = length / elements, E * width * height**3 / 12, rho * width * height
k = EI / le**3 * np.array([[12, 6 * le, -12, 6 * le], [6 * le, 4 * le**2, -6 * le, 2 * le**2],
                           [-12, -6 * le, 12, -6 * le], [6 * le, 2 * le**2, -6 * le, 4 * le**2]])  # fmt: skip
me = m * le / 420 * np.array([[156, 22 * le, 54, -13 * le], [22 * le, 4 * le**2, 13 * le, -3 * le**2],
                              [54, 13 * le, 156, -22 * le], [-13 * le, -3 * le**2, -22 * le, 4 * le**2]])  # fmt: skip
n = 2 * (elements + 1)
K, M = sp.lil_array((n, n)), sp.lil_array((n, n))
for e in range(elements):
    at = np.arange(2 * e, 2 * e + 4)
    K[np.ix_(at, at)] += k
    M[np.ix_(at, at)] += me
K, M = K.tocsc(), M.tocsc()


def deflection(*nodes: int) -> np.ndarray:
    """(n, k) unit vectors of the deflections at nodes."""
    columns = np.zeros((n, len(nodes)))
    columns[2 * np.array(nodes), np.arange(len(nodes))] = 1.0
    return columns


mounts = np.linspace(4, elements - 4, 12).round().astype(int)
sensors = (15, 62, 110, 171)

# %% [markdown]
# ## Reduce
#
# No value of the mounts is sampled: the basis serves all of them, from free to clamped; the error is measured on lines outside it.

# %%
model = lrbc.reduce(
    K,
    M,
    4e-6 * K + 2.0 * M,
    loads=deflection(35),
    outputs=deflection(*sensors).T,
    terms=deflection(*mounts),
    band_hz=(20.0, 800.0),
    quantity="acceleration",
)
print(f"{n} DOFs -> {model.reduction.model.size}; measured error at most {model.reduction.worst:.1e}")

# %% [markdown]
# ## FRFs and Jacobian
#
# Against a direct solve at one line, with one mount clamped (`inf`).

# %%
values = np.full(12, 3e5)
values[3] = np.inf
s = 2j * np.pi * 137.0
Z = (K + s * (4e-6 * K + 2.0 * M) + s**2 * M).tolil()
for node, value in zip(mounts, values, strict=True):
    Z[2 * node, 2 * node] += min(value, 1e14)
direct = s**2 * deflection(*sensors).T @ sp.linalg.spsolve(Z.tocsc(), deflection(35)[:, 0])
reduced = model.frf([137.0], values)[0]
print("largest relative difference:", float(np.abs(reduced / direct - 1).max()))

# %% [markdown]
# ## Identify
#
# Noisy FRFs of a beam with two loose mounts; levels in dB and their derivatives go into any optimiser.

# %%
rng = np.random.default_rng(3)
hz = np.arange(20.0, 800.0, 2.0)
true = np.full(12, 5.5) + 0.05 * rng.standard_normal(12)
true[[4, 9]] -= 0.6
H = model.frf(hz, 10.0**true)
H = H * (1 + 0.02 * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)))


def residual(p: np.ndarray) -> np.ndarray:
    """Differences of the levels [dB]."""
    return (20 * np.log10(np.abs(model.frf(hz, 10.0**p) / H))).ravel()


def jacobian(p: np.ndarray) -> np.ndarray:
    """Their derivatives [dB per decade]."""
    return model.sensitivities(hz, p)[1].reshape(-1, p.size)


fit = least_squares(residual, np.full(12, 5.4), jacobian, loss="soft_l1", x_scale=1.0)
std = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) * np.var(residual(fit.x)))
print("largest error [decades]:", float(np.abs(fit.x - true).max()), "largest standard deviation:", float(std.max()))

# %%
figure = Figure(figsize=(8, 3.5), layout="constrained")
axes = figure.subplots()
axes.errorbar(np.arange(1, 13), fit.x, 2 * std, fmt="o", capsize=4, label="identified, 95 %")
axes.plot(np.arange(1, 13), true, "x", label="true")
axes.set(xlabel="mount", ylabel="log10 of its stiffness [N/m]")
axes.legend()
