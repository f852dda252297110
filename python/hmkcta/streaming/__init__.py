"""Where tensors come from, and how those that memory does not hold are worked on: in slabs, blocks and pieces."""
