"""Ranks of every node's own: what each may have, how a goal shares them out, the fit that meets the goal."""
