"""``python -m benchmarks [DATA]``: the rate-distortion table, the only benchmark so far."""

from .rate_distortion import main

main()
