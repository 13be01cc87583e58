"""Recovery of a known surface from noisy measurements by `lcp fit-reflectance`: the table of docs/measurements/photometry.md.

    python benchmarks/facet_recovery.py [SEEDS]

The surface of tests/test_facet_fit.py (three incidences, 41 directions in the plane of incidence, the direction to the source
left out) with relative noise; and table 3 of the paper, whose directional lobe is faint below 50 deg.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np
from photometry.test_facet_fit import SURFACE, measured, table

from lcp_catalog.photometry.facet_fit import fit_reflectance
from lcp_catalog.photometry.facet_labunets2019 import named_model
from lcp_catalog.photometry.facet_model import PARAMETERS

NOISES = (0.0, 0.01, 0.03)


def rms(rows):
    return np.sqrt(np.mean(np.square(rows), axis=0))


def main(seeds: int) -> None:
    for model in (SURFACE, named_model("labunets-2019-table-3")):
        print(model.name)
        print(
            f"{'noise':>6} {'curves':>7} {'psi':>4} "
            + " ".join(f"{p:>12}" for p in PARAMETERS)
            + "   error %  D1 D2"
        )
        for noise in NOISES:
            fits = [
                fit_reflectance(
                    measured(model, noise, seed), "m", optics=model.optics, normalize=False
                )
                for seed in range(seeds if noise else 1)
            ]
            for kind in ("alone", "smooth"):
                found = [table(fit.alone if kind == "alone" else fit.model.nodes) for fit in fits]
                spread = rms([rows - table(model.nodes) for rows in found])
                left = np.mean(
                    [fit.errors_alone if kind == "alone" else fit.errors for fit in fits], axis=0
                )
                gains = [float(np.median([getattr(fit, d) for fit in fits])) for d in ("d1", "d2")]
                for node, row, error in zip(model.nodes, spread, left, strict=True):
                    cells = " ".join(f"{value:12.4f}" for value in row)
                    print(
                        f"{noise:6g} {kind:>7} {node.incidence_deg:4g} {cells} {100 * error:9.2f}  {gains[0]:.3f} {gains[1]:.3f}"
                    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
