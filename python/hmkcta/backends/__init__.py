from .native import accumulate as accumulate, dictionary_gram as dictionary_gram, fit_cells as fit_cells, project_cells as project_cells
