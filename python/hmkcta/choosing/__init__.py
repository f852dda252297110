"""Choosing a plan for a goal, by trial on samples of the data; `tuning` does it, the others are its parts.

From below: `organisations` and grids make `candidates`; `detail` picks the `blocks` that stand for all; `spectra` are
the energies of their HOSVD cores, a `cut` those of one candidate, and `growth` what whole blocks have more than thinned
ones; `caps` are what memory allows; a `trial` says what a candidate is worth, `judging` keeps it; `climbing` goes from
grid to grid, `clustered` looks at clusters of the data instead of blocks, `number_bits` tells whether numbers are
packed or float16, and `racing` which organisations are worth a climb.
"""
