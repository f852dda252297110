"""The search for a goal: layouts compared by J on samples of blocks, the best coded, each with the step that meets it."""
