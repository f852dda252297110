"""The search for a goal: layouts are compared by J on samples of blocks, the best are coded."""
