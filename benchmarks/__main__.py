"""``python -m benchmarks [DATA]``: the rate-distortion table of the README; the others are programs of their own."""

from .rate_distortion import main

main()
