"""Make the library of lying poses that ships with the package (needs the extra `sim`).

python bench/make_poses.py
"""

from pathlib import Path

import numpy as np

from hsvaos.simulate.ragdoll import make_library

if __name__ == "__main__":
    path = Path(__file__).parents[1] / "hsvaos" / "data" / "poses.npz"
    path.parent.mkdir(exist_ok=True)
    library = make_library(48, seed=7)
    np.savez_compressed(path, **library)
    print(f"{len(library['places'])} poses, {path.stat().st_size / 1e3:.0f} kB: {path}")
