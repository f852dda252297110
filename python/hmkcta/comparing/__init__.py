"""Follow a chosen plan, fit those that only a fit can tell apart from it, and keep the best model."""
