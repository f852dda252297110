# Verbs of the project; CI calls the same ones. The environment is made by itself, in .venv.

PYTHON ?= python3
BIN := .venv/bin
CRATES := $(wildcard crates/*/Cargo.toml)
NATIVE := $(CRATES) $(shell find crates -name '*.rs' -not -path '*/target/*')

.PHONY: gallery demo test check bench bench-paper clean help

help:
	@echo "make gallery  pictures like the paper's figures, to gallery-output/ (DATA=FOLDER: of real data too; minutes)"
	@echo "make demo   compress synthetic data, write pictures to demo-output/ (minutes)"
	@echo "make test   run all tests"
	@echo "make check  lint, types, formatting"
	@echo "make bench  measure kernels, decoding and small fits (minutes)"
	@echo "make bench-paper  fits of the paper's sizes: 8 GB of scratch space, an hour or two"
	@echo "make clean  remove what was built"

demo: .venv/.installed
	$(BIN)/hmkcta demo --output demo-output

gallery: .venv/.installed
	$(BIN)/python docs/gallery.py --output gallery-output $(if $(DATA),--data $(DATA))

test: .venv/.installed
	@for crate in $(CRATES); do cargo test --quiet --manifest-path $$crate || exit 1; done
	$(BIN)/python -m pytest

check: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/pyright
	@for crate in $(CRATES); do \
	  cargo fmt --check --manifest-path $$crate && \
	  cargo clippy --quiet --all-targets --manifest-path $$crate -- --deny warnings || exit 1; done

bench: .venv/.installed
	$(BIN)/python -m benchmarks

# HMKCTA_BENCH_DATA names the folder with the steel sheet's parameters; without it the sheet is synthetic.
bench-paper: .venv/.installed
	$(BIN)/python -m benchmarks paper

clean:
	rm -rf .venv demo-output build dist .pytest_cache .ruff_cache .hypothesis crates/*/target
	find python -name '_native*.so' -delete
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# An editable install does not rebuild the Rust kernels by itself, so it is made again when they change.
.venv/.installed: pyproject.toml $(NATIVE)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --editable '.[dev]'
	touch $@
