"""What numbers of one step D cost and leave: J = error / D^2 + lambda * bits, the objective of everything chosen.

A stored number that changes the reconstruction by w (in norm) when it changes by 1 has the step D / w: core numbers in
orthonormal bases have the step D, numbers of a basis column with singular value s the step D / s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import F64

#: Mean squared error of a rounded number, in units of its squared step.
ROUNDED = 1 / 12


@dataclass(frozen=True)
class RateModel:
    """Constants of the objective, fitted to the coder on volumes, light fields and materials at 1/400 to 1/30.

    Attributes:
        trade: lambda, the squared error in units of D^2 that one bit is worth; 0.10 to 0.18 are alike, and theory has
            2 ln 2 / 12 = 0.116 for fine steps.
        dead_zone: how much more than to the nearest numbers are rounded towards zero, in steps (0.02 to 0.09 dB).
        core_bits: bits of any core number; the largest part of it are zeros.
        core_octave_bits: bits of a core number c for each octave of 1 + 12 c^2 (c in units of D). The textbook's 0.5
            alone is a third to a half too low for cores, and right for bases.
        column_bits: bits of a basis column besides its numbers: its scale, and its share of the ranks.
    """

    trade: float = 0.11
    dead_zone: float = 0.1
    core_bits: float = 0.2
    core_octave_bits: float = 0.65
    column_bits: float = 3.0

    def core_change(self, squares: F64) -> F64:
        """Change of J by storing core numbers of these squares (in units of D^2) instead of leaving them out."""
        bits = self.core_bits + self.core_octave_bits * np.log2(1 + 12 * squares)
        return np.minimum(squares, ROUNDED) - squares + self.trade * bits

    def column_cost(self, energies: F64, rows: int) -> F64:
        """J of basis columns of `rows` numbers with these squared singular values, in units of D^2."""
        each = energies / rows
        bits = 0.5 * rows * np.log2(1 + 12 * each) + self.column_bits
        return self.trade * bits + rows * np.minimum(each, ROUNDED)


MODEL = RateModel()
