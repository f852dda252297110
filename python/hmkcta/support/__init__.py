"""What knows nothing of tensors' models: threads, memory, progress, logs, files that must not be left behind."""
